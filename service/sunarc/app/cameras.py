"""Which camera the settings name, and whether it is the one that the archive knows."""

from __future__ import annotations

from collections.abc import Callable

from sunarc.archive import Archive, require_same_site
from sunarc.cameras import CameraInfo, SkyCamera, open_aravis, open_replay
from sunarc.clock import Clock
from sunarc.errors import ConfigurationError, InputError
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


def require_stored_site(archive: Archive, settings: Settings) -> None:
    """Raise `InputError` when the archive has the settings' camera at another site."""
    for stored in archive.cameras():
        if stored.name == settings.name:
            require_same_site(stored, settings.site)


def require_same_camera(archive: Archive, *, name: str, info: CameraInfo) -> None:
    """Raise `InputError` when a camera makes other images than those that the archive has of its name.

    What is stored (sightings, poses, calibrations) is in the pixels of those images.
    """
    stored = next((camera for camera in archive.cameras() if camera.name == name), None)
    if stored is None:
        return
    remedy = f"set the region, binning and pixel format as they were, or begin anew under another name than {name!r}"
    if (stored.width, stored.height) != (info.width, info.height):
        raise InputError(
            field="camera",
            problem=f"its images have {info.width}×{info.height} px, those stored {stored.width}×{stored.height}",
            remedy=remedy,
        )
    if stored.pixel_format not in {"", info.pixel_format}:
        raise InputError(
            field="camera",
            problem=f"its images are in {info.pixel_format}, those stored in {stored.pixel_format}",
            remedy=remedy,
        )
