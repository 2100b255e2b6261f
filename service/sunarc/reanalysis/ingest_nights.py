"""Images of the night in a folder: their stars named by the served calibration, as the night worker does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from sunarc.archive.archive import Archive, CameraArchive
from sunarc.archive.values import Night, Refit
from sunarc.cameras.frame import Frame
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.reanalysis.image_files import read_checked_image
from sunarc.reanalysis.index import ImageFile, Skipped, zeniths_deg
from sunarc.reanalysis.messages import RefusedImageError
from sunarc.reanalysis.nights import by_night, evenly, frame_of
from sunarc.runtime.loop import DropOldestQueue
from sunarc.runtime.status import StatusRegistry
from sunarc.settings.model import Settings
from sunarc.utc import utc_time
from sunarc.workers.night.exposures import NightCapture, NightExposures
from sunarc.workers.night.night import NightWorker

_KNOWN_SHARE = 0.9
"""Of a night's files, less one, that were looked at: the others are damaged, and are not read again at each run."""
_CLOCK_S = 1.0
"""Bound of the error of a file's time: names and EXIF have whole seconds."""

ReportNight = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class NightOutcome:
    """What a night's images came to.

    Attributes
    ----------
    date : of its evening.
    verdict : clear, partly, cloudy, moonlit or unusable.
    images, accepted : those looked at, and those whose stars are named.
    stored : sightings of stars that are new in the archive.
    """

    date: str
    verdict: str
    images: int
    accepted: int
    stored: int

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of the night."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderNights:
    """The nights of a folder.

    Attributes
    ----------
    looked_at : those of this run.
    known : images of nights that were looked at before.
    skipped : images that could not be used, with the reason.
    findings : why none could.
    """

    looked_at: tuple[NightOutcome, ...] = ()
    known: int = 0
    skipped: tuple[Skipped, ...] = ()
    findings: tuple[Finding, ...] = ()


def ingest_nights(
    archive: Archive,
    settings: Settings,
    folder: Path,
    images: Sequence[ImageFile],
    *,
    reprocess: bool,
    progress: ReportNight,
) -> FolderNights:
    """Name the stars in images of the night, and store them with the verdict of each night.

    A night is known by its row: one that has nine tenths of the folder's images is left as it is. Without a served
    calibration the images are left out; `sunarc stars --blind` can make one of them.

    Parameters
    ----------
    archive, settings : of the camera.
    folder : of the images.
    images : those of the night.
    reprocess : look at known nights again; the stars of an image take the place of those named in it before. An image
        whose stars are not named again keeps them.
    progress : called after each image.
    """
    camera = CameraArchive(archive, name=settings.name, site=settings.site)
    if not images:
        return FolderNights()
    record = camera.record()
    if camera.current_model() is None or record is None:
        without = Finding("nights_without_calibration", {"n": len(images)})
        return FolderNights(skipped=_left_out(images, settings), findings=(without,))
    seen = {} if reprocess else {night.date: night.n_images for night in camera.nights()}
    found, known, skipped, done = list[NightOutcome](), 0, list[Skipped](), 0
    for night, every in by_night(images, longitude=settings.site.longitude):
        some = evenly(every)
        if seen.get(night, -1) >= _KNOWN_SHARE * len(some) - 1.0:
            known += len(every)
            continue
        worker = _worker(camera, settings, now=utc_time(every[-1].unix_s), replaces=reprocess)
        n_read = 0
        for image in some:
            try:
                worker.look_at(_frame(folder, image, record.image_size, n_read))
                n_read += 1
            except (RefusedImageError, InputError) as error:
                skipped.append(Skipped(image.path, _why(error)))
            done += 1
            progress("naming stars", done, len(images))
        if n_read:
            found.append(_outcome(worker.finish()))
    return FolderNights(looked_at=tuple(found), known=known, skipped=tuple(skipped))


def _worker(camera: CameraArchive, settings: Settings, *, now: datetime, replaces: bool) -> NightWorker:
    """Return a worker of the night for files: its event is of the night's last image, and asks for no refit."""

    def no_refit(reason: str) -> Refit:
        return Refit(id="", camera=camera.name, requested_at=now, reason=reason)

    return NightWorker(
        NightCapture(NightExposures(), DropOldestQueue(capacity=1)),
        camera=camera,
        options=settings.sensor,
        apparent_zenith=lambda: 0.0,
        clock_error_s=lambda _: _CLOCK_S,
        trusted=lambda: True,
        now=lambda: now,
        request_refit=no_refit,
        board=StatusRegistry(version="", started_at=now, monotonic=lambda: 0.0),
        replaces=replaces,
    )


def _frame(folder: Path, image: ImageFile, size: tuple[int, int], number: int) -> Frame:
    pixels = read_checked_image(folder / image.path, size=size)
    return frame_of(pixels, image.unix_s, image.exposure_us, number)


def _why(error: RefusedImageError | InputError) -> Finding:
    if isinstance(error, RefusedImageError):
        return error.finding
    return Finding("file_not_image", {"error": error.problem})


def _outcome(night: Night) -> NightOutcome:
    return NightOutcome(
        date=f"{night.date}",
        verdict=night.verdict,
        images=night.n_images,
        accepted=night.n_accepted,
        stored=night.n_stored,
    )


def _left_out(images: Sequence[ImageFile], settings: Settings) -> tuple[Skipped, ...]:
    pairs = zip(images, zeniths_deg(images, settings.site), strict=True)
    return tuple(Skipped(image.path, Finding("file_at_night", {"zenith_deg": zenith})) for image, zenith in pairs)
