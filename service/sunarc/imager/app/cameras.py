"""The camera of the settings, and its comparison with the archive's record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime

from sunarc.common.errors import ConfigurationError, InputError
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.cameras import require_same_site
from sunarc.imager.archive.values import TO_ACKNOWLEDGE, CameraRecord, Event
from sunarc.imager.cameras.aravis import open_aravis
from sunarc.imager.cameras.frame import CameraInfo, SkyCamera
from sunarc.imager.cameras.replay import open_replay
from sunarc.imager.live.camera_record import begin_with_other_lens
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.settings.model import Settings
from sunarc.sky.site import Site


def camera_opener(settings: Settings, clock: Clock) -> Callable[[], SkyCamera]:
    """Return the opener of the camera that the settings name."""
    camera, replay = settings.camera, settings.replay
    if settings.source == "aravis" and camera is not None:
        return lambda: open_aravis(camera, clock)
    if settings.source == "replay" and replay is not None:
        return lambda: open_replay(replay)
    if settings.source in {"folder", "http", "rtsp"} and getattr(settings, settings.source) is not None:
        return _refuse_opening
    section = "camera" if settings.source == "aravis" else settings.source
    raise ConfigurationError(
        f'setting {section} is missing; add a [{section}] section for source = "{settings.source}"'
    )


def _refuse_opening() -> SkyCamera:
    raise ConfigurationError("images that others have taken come from no camera")


def require_stored_site(archive: Archive, settings: Settings) -> None:
    """Raise `InputError` when the archive has the settings' camera at another site."""
    stored = archive.cameras.get(settings.name)
    if stored is not None:
        require_same_site(stored, settings.place)


def require_same_camera(archive: Archive, *, name: str, info: CameraInfo) -> None:
    """Raise `InputError` when a camera makes other images than those that the archive has of its name.

    What is stored (sightings, poses, calibrations) is in the pixels of those images.
    """
    stored = archive.cameras.get(name)
    if stored is None:
        return
    remedy = f"set the region, binning and pixel format as they were, or begin anew under another name than {name!r}"
    if stored.image_size != (info.width, info.height):
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


def note_other_camera(archive: Archive, record: CameraRecord, *, at: datetime) -> CameraRecord:
    """Retire the calibration and open a pose epoch where the camera's serial number is another than the stored one.

    The lens is another one: the current calibration is retired, a pose epoch with a new lens begins, and an event says
    so. A pinned calibration is retired too, since it is another camera's.

    Parameters
    ----------
    archive : has the camera of before.
    record : the camera that answers now; one that does not state its serial number counts as the one of before.
    at : no later than the first frame of the new camera.

    Returns
    -------
    What to store of the camera.
    """
    stored = archive.cameras.get(record.name)
    if stored is None or not stored.serial:
        return record
    if not record.serial:
        return replace(record, serial=stored.serial)
    if record.serial == stored.serial:
        return record
    retired = begin_with_other_lens(archive, record.name, at)
    details = {"model": record.model, "serial": record.serial, "serial_before": stored.serial}
    replaced = Finding("camera_replaced", {**details, "calibration": retired or "none"})
    archive.events.add(
        Event.of(
            replaced,
            time=at,
            severity="alarm",
            camera=record.name,
            details={"calibration": retired, TO_ACKNOWLEDGE: True},
        )
    )
    return record


def camera_record(info: CameraInfo, *, name: str, site: Site) -> CameraRecord:
    """Return the archive's record of an open camera at a site."""
    return CameraRecord.at(
        site,
        name=name,
        width=info.width,
        height=info.height,
        model=f"{info.vendor} {info.model}".strip(),
        serial=info.serial,
        pixel_format=info.pixel_format,
    )
