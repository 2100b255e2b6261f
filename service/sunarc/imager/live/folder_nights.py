"""Images of the night in a folder: their stars named by the served calibration, as the night worker does."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.common.utc import utc_time
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.values import Night, Refit
from sunarc.imager.live.file_frames import make_file_frame
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers.night.exposures import NightCapture, NightExposures
from sunarc.imager.workers.night.night import NightWorker
from sunarc.sources.image_files import read_one_image
from sunarc.sources.index import CameraImages, Failure, ReportProgress, at_night, by_night, evenly, zeniths_deg
from sunarc.sources.sources import open_source

_KNOWN_SHARE = 0.9
"""Share of a night's files, less one, that are known: the others are damaged, and are not read again at each run."""
_CLOCK_S = 1.0
"""Bound of the error of a file's time: names and EXIF have whole seconds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NightOutcome:
    """Result of one night's images.

    Attributes
    ----------
    date : of its evening.
    verdict : clear, partly, cloudy, moonlit or unusable.
    images, accepted : those that were read, and those whose stars are named.
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
    """Results of the nights of a folder.

    Attributes
    ----------
    looked_at : those of this run.
    known : images of nights that are known.
    failures : images that could not be used, with the reason.
    findings : why none could, and that they are stored otherwise than those of the calibration.
    """

    looked_at: tuple[NightOutcome, ...] = ()
    known: int = 0
    failures: tuple[Failure, ...] = ()
    findings: tuple[Finding, ...] = ()


def ingest_nights(
    archive: Archive,
    settings: Settings,
    images: CameraImages,
    *,
    reprocess: bool,
    progress: ReportProgress,
) -> FolderNights:
    """Name the stars in images of the night, and store them with the verdict of each night.

    A night is known by its row: one that has nine tenths of the folder's images is left as it is. Without a served
    calibration the images are left out; `sunarc stars --blind` can make one of them.

    Parameters
    ----------
    archive, settings : of the camera.
    images : of the folder.
    reprocess : read known nights again; the stars of an image take the place of those named in it before. An image
        whose stars are not named again keeps them.
    progress : called after each image.
    """
    camera = CameraArchive(archive, name=settings.name, site=settings.place)
    if not images.nights:
        return FolderNights()
    record = camera.archive.cameras.get(camera.name)
    if camera.archive.calibrations.current_model(camera.name) is None or record is None:
        without = Finding("nights_without_calibration", {"n": len(images.nights)})
        return FolderNights(failures=_list_left_out(images), findings=(without,))
    seen = {} if reprocess else {night.date: night.n_images for night in camera.archive.nights.find(camera.name)}
    found, known, failures, done = list[NightOutcome](), 0, list[Failure](), 0
    flips = dict[str, Finding]()
    for night, every in by_night(images.nights, longitude=settings.place.longitude):
        some = evenly(every)
        if seen.get(night, -1) >= _KNOWN_SHARE * len(some) - 1.0:
            known += len(every)
            continue
        worker = _new_night_worker(camera, settings, now=utc_time(every[-1].unix_s), replaces=reprocess)
        n_read = 0
        for image in some:
            pixels = read_one_image(open_source(image.address), image.file, image.number, size=record.image_size)
            try:
                if isinstance(pixels, Finding):
                    failures.append(Failure(image.path, pixels))
                else:
                    worker.look_at(make_file_frame(pixels, image.unix_s, image.exposure_us, n_read))
                    n_read += 1
            except InputError as error:
                failures.append(Failure(image.path, Finding("file_not_image", {"error": error.problem})))
            done += 1
            progress("naming stars", done, len(images.nights))
        if n_read:
            judged = worker.finish()
            found.append(_make_outcome(judged))
            flips.update({str(one.data["flip"]): one for one in judged.findings if one.code == "stars_flipped"})
    return FolderNights(looked_at=tuple(found), known=known, failures=tuple(failures), findings=tuple(flips.values()))


def _new_night_worker(camera: CameraArchive, settings: Settings, *, now: datetime, replaces: bool) -> NightWorker:
    """Return a worker of the night for files: its event is of the night's last image, and asks for no refit."""

    def skip_refit(reason: str) -> Refit:
        return Refit(id="", camera=camera.name, requested_at=now, reason=reason)

    return NightWorker(
        NightCapture(NightExposures(), DropOldestQueue(capacity=1)),
        camera=camera,
        options=settings.sensor,
        apparent_zenith=lambda: 0.0,
        clock_error_s=lambda _: _CLOCK_S,
        trusted=lambda: True,
        now=lambda: now,
        request_refit=skip_refit,
        board=StatusRegistry(version="", started_at=now, monotonic=lambda: 0.0),
        replaces=replaces,
    )


def _make_outcome(night: Night) -> NightOutcome:
    return NightOutcome(
        date=f"{night.date}",
        verdict=night.verdict,
        images=night.n_images,
        accepted=night.n_accepted,
        stored=night.n_stored,
    )


def _list_left_out(images: CameraImages) -> tuple[Failure, ...]:
    pairs = zip(images.nights, zeniths_deg(images.nights, images.plan.site), strict=True)
    return tuple(Failure(image.path, at_night(zenith)) for image, zenith in pairs)
