"""A folder of archived images to sightings in the archive; can be broken off and begun again at any file."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sunarc.archive import Archive, FileSighting, ImageKey, SunPoint, open_archive, sun_point_of, upgrade_present
from sunarc.detection import Detection
from sunarc.offline.cameras import known_camera, register_camera
from sunarc.offline.detect_files import Method
from sunarc.offline.ingest.contact_sheet import write_contact_sheet
from sunarc.offline.ingest.detect_image import Task
from sunarc.offline.ingest.detection_pool import detect_in_pool
from sunarc.offline.ingest.image_times import Naming
from sunarc.offline.ingest.index import ImageFile, Index, Skipped, index_folder, usual_size
from sunarc.offline.ingest.summary import Summary, newest_verdicts
from sunarc.settings import Settings
from sunarc.utc import from_microseconds

_BATCH = 32
"""Sightings written at once; a run that is killed loses no more, and finds them again."""
UNPREDICTED = 1
"""`ingest_pass` of a sighting that was found without a prediction."""

ReportProgress = Callable[[str, int, int], None]
"""Called with the name of a stage, how many images of it are done, and how many there are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestOptions:
    """How a folder is ingested.

    Attributes
    ----------
    method : see `detect_in_image`.
    naming : how times are read.
    reprocess : look at images again that are known, in place of their former sightings.
    processes : how many images are looked at at once.
    contact_sheet : file of the contact sheet; None for `ingest/contact-sheet.png` in the state folder.
    """

    method: Method = "auto"
    naming: Naming = field(default_factory=Naming)
    reprocess: bool = False
    processes: int = 1
    contact_sheet: Path | None = None


def usable_processors() -> int:
    """Return on how many processors this process may run."""
    return len(os.sched_getaffinity(0))


def ingest_folder(
    settings: Settings, folder: Path, *, options: IngestOptions, progress: ReportProgress = lambda *_: None
) -> Summary:
    """Look for the sun in every image below a folder, and store what was found.

    An image is known by its time, exposure and file name; one that is known is left as it is unless `reprocess` is set
    or another method is asked for. What was done is in the archive after every few images.

    Parameters
    ----------
    settings : camera name, site and state folder.
    folder : where the images are.
    options : how.
    progress : called after every image.

    Raises
    ------
    InputError : it is no folder, or it has no images.
    """
    upgrade_present(settings.database)
    index = index_folder(
        folder,
        naming=options.naming,
        site=settings.site,
        largest_zenith_deg=settings.capture.sun_zenith_deg,
    )
    with open_archive(settings.database) as archive:
        known_camera(archive, settings)
        known = _known(archive, settings, index, options)
        images = [image for image in index.images if options.reprocess or image.key not in known]
        skipped = [*index.skipped, *_detect(archive, settings, folder, images, options=options, progress=progress)]
        found = newest_verdicts(index.images, _stored(archive, settings, index))
    return _summary(settings, index, found, looked_at=images, skipped=skipped, options=options)


def _stored(archive: Archive, settings: Settings, index: Index) -> list[FileSighting]:
    return archive.file_sightings(settings.name, times_us={image.key[0] for image in index.images})


def _known(archive: Archive, settings: Settings, index: Index, options: IngestOptions) -> set[ImageKey]:
    """Return the keys of the images that have a sighting by the method asked for, or by any where that is open.

    Sightings of version 0.2 have no file name: they get that of the first image of their time and exposure.
    """
    stored = _stored(archive, settings, index)
    unnamed = {one.key[:2] for one in stored if one.file == ""}
    named = {one.key for one in stored if one.file != ""}
    adopted: dict[tuple[int, float], ImageKey] = {}
    for image in index.images:
        if image.key[:2] in unnamed and image.key not in named:
            adopted.setdefault(image.key[:2], image.key)
    archive.name_files(settings.name, adopted.values())
    named_now = [one._replace(file=adopted[one.key[:2]][2]) if one.file == "" and one.key[:2] in adopted else one
                 for one in stored]  # fmt: skip
    return {one.key for one in named_now if options.method in {"auto", one.method}}


def _detect(
    archive: Archive,
    settings: Settings,
    folder: Path,
    images: Sequence[ImageFile],
    *,
    options: IngestOptions,
    progress: ReportProgress,
) -> list[Skipped]:
    """Look at images and store their sightings; return those that are left out."""
    camera = archive.camera(settings.name)
    size = usual_size(folder, images) if camera is None else camera.image_size
    if size is None:
        size = (0, 0)  # no header can be read: each image is refused with its own reason
    elif images:
        register_camera(archive, settings, size)
    tasks = (
        Task(path=folder / image.path, exposure_us=image.exposure_us, method=options.method, size=size)
        for image in images
    )
    answers = detect_in_pool(tasks, n_tasks=len(images), processes=options.processes)
    skipped, waiting = list[Skipped](), list[tuple[ImageFile, Detection]]()
    try:
        for done, (image, found) in enumerate(zip(images, answers, strict=True), start=1):
            if isinstance(found, Detection):
                waiting.append((image, found))
            else:
                skipped.append(Skipped(image.path, found))
            if len(waiting) >= _BATCH:
                _store(archive, settings, waiting)
                waiting = []
            progress("detecting", done, len(images))
    finally:  # also when the run is broken off: what was found need not be looked for again
        _store(archive, settings, waiting)
    return skipped


def _store(archive: Archive, settings: Settings, answers: Iterable[tuple[ImageFile, Detection]]) -> None:
    archive.replace_sun_points([_point(archive, settings, image, found) for image, found in answers])


def _point(archive: Archive, settings: Settings, image: ImageFile, found: Detection) -> SunPoint:
    time_us, exposure_us, file = image.key
    time = from_microseconds(time_us)
    return sun_point_of(
        found,
        camera=settings.name,
        pose_epoch=archive.epoch_at(settings.name, time, reason="first image").id,
        time=time,
        exposure_us=exposure_us,
        file=file,
        ingest_pass=UNPREDICTED,
    )


def _summary(
    settings: Settings,
    index: Index,
    found: dict[ImageFile, FileSighting],
    *,
    looked_at: Sequence[ImageFile],
    skipped: Sequence[Skipped],
    options: IngestOptions,
) -> Summary:
    sheet = options.contact_sheet or settings.state / "ingest" / "contact-sheet.png"
    if found:
        write_contact_sheet(index.folder, found, sheet)
    new = [found[image] for image in looked_at if image in found]
    accepted = sum(one.accepted for one in new)
    return Summary(
        accepted=accepted,
        rejected=len(new) - accepted,
        known=len(index.images) - len(looked_at),
        by_verdict=dict(Counter(one.verdict for one in found.values()).most_common()),
        skipped=tuple(skipped),
        contact_sheet=sheet if found else None,
    )
