"""Which camera the settings name."""

from __future__ import annotations

from collections.abc import Callable

from sunarc.cameras import SkyCamera, open_aravis, open_replay
from sunarc.clock import Clock
from sunarc.errors import ConfigurationError
from sunarc.settings import Settings


def camera_opener(settings: Settings, clock: Clock) -> Callable[[], SkyCamera]:
    """Return what opens the camera that the settings name."""
    camera, replay = settings.camera, settings.replay
    if settings.source == "aravis" and camera is not None:
        return lambda: open_aravis(camera, clock)
    if settings.source == "replay" and replay is not None:
        return lambda: open_replay(replay)
    section = "camera" if settings.source == "aravis" else "replay"
    raise ConfigurationError(
        f'setting {section} is missing; add a [{section}] section for source = "{settings.source}"'
    )
