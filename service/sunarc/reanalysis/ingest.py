"""A folder of archived images to sightings in the archive; can be broken off and begun again at any file."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from functools import cached_property
from multiprocessing.connection import wait
from pathlib import Path
from typing import Final, get_args

import cv2
import numpy as np

from sunarc.archive.archive import Archive, open_archive
from sunarc.archive.database.recovery import upgrade_present
from sunarc.archive.sightings import FileSighting, ImageKey, sun_point_of
from sunarc.archive.values import SunPoint
from sunarc.array_types import Image
from sunarc.calibration.model.result import Calibration
from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_stack
from sunarc.detection.photo.plateau import static_mask
from sunarc.detection.values import Detection, Expectation
from sunarc.detection.values import Method as DetectionMethod
from sunarc.findings import Finding
from sunarc.reanalysis.cameras import known_camera, register_camera
from sunarc.reanalysis.consensus import Agreed, agreed_cameras, as_predicted, expectations, is_consistent, misfit_px
from sunarc.reanalysis.detect_files import Method, full_scale_of, selected_method
from sunarc.reanalysis.image_files import read_checked_image
from sunarc.reanalysis.image_times import Naming
from sunarc.reanalysis.index import ImageFile, Index, Skipped, index_folder, usual_size
from sunarc.reanalysis.ingest_nights import FolderNights, ingest_nights
from sunarc.reanalysis.ingest_summary import IngestSummary, newest_verdicts, write_contact_sheet
from sunarc.reanalysis.learned_sigma import ValidCamera, factor_in_force, learn_sigma, with_factor
from sunarc.reanalysis.look import (
    FileAnswer,
    LookTask,
    PackedMask,
    detect_in_file,
    detect_in_read,
    no_sun,
    pack_mask,
    read_for,
)
from sunarc.reanalysis.messages import RefusedImageError
from sunarc.runtime.child_process import one_thread_each
from sunarc.runtime.clock import SystemClock
from sunarc.settings.model import Settings
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions
from sunarc.utc import from_microseconds

# Images by the time at which they were taken: several of one time are a stack of exposures.

Moment = tuple[ImageFile, ...]
"""All images of one time, in the order of their names."""

MOST_EXPOSURES = 32
"""More images of one time are no stack, but a series whose names say too little of the time."""


def moments_of(images: Iterable[ImageFile]) -> list[Moment]:
    """Return the images grouped by their time; too many for a stack stand alone."""
    by_time: dict[int, list[ImageFile]] = {}
    for image in images:
        by_time.setdefault(image.key[0], []).append(image)
    moments = list[Moment]()
    for members in by_time.values():
        moments += [tuple(members)] if len(members) <= MOST_EXPOSURES else [(image,) for image in members]
    return moments


_BATCH = 32
"""Sightings written at once; a run that is killed loses no more, and finds them again."""
UNPREDICTED = 1
"""`ingest_pass` of a sighting that was found without a prediction."""
PREDICTED = 2
"""`ingest_pass` of a sighting that was found, or confirmed, with a prediction."""

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
) -> IngestSummary:
    """Look for the sun in every image below a folder, and store what was found.

    First without a prediction; then the camera that most sightings agree on predicts the sun, and images whose
    sighting is not there are looked at again: reflections, ghosts and clouds are distinguished from the sun. What
    stands still in the images takes no part. Images of the night go to `ingest_nights`.

    An image is known by its time, exposure and file name; one that is known is left as it is unless `reprocess` is set
    or another method is asked for. Images of one time are a stack: they are looked at together, and the first one's
    sighting is that of all. What was done is in the archive after every few images.

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
    upgrade_present(settings.archive)
    index = index_folder(
        folder,
        naming=options.naming,
        site=settings.site,
        largest_zenith_deg=settings.capture.sun_zenith_deg,
    )
    with open_archive(settings.archive) as archive:
        known_camera(archive, settings)
        known = _known(archive, settings, index, options)
        moments = [
            moment
            for moment in moments_of(index.images)
            if options.reprocess or any(image.key not in known for image in moment)
        ]
        run = Run.of(archive, settings, index, options, progress)
        skipped = run.first_pass(moments)
        camera_findings = run.second_pass()
        found = newest_verdicts(index.images, _stored(archive, settings, index))
        nights = ingest_nights(archive, settings, folder, index.nights, reprocess=options.reprocess, progress=progress)
    return _summary(
        settings,
        index,
        found,
        looked_at=[image for moment in moments for image in moment],
        skipped=[*index.skipped, *skipped, *nights.skipped],
        camera_findings=(*camera_findings, *nights.findings),
        nights=nights,
        options=options,
    )


def _stored(archive: Archive, settings: Settings, index: Index) -> list[FileSighting]:
    return archive.sightings.of_files(settings.name, times_us={image.key[0] for image in index.images})


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
    archive.sightings.name_files(settings.name, adopted.values())
    named_now = [one._replace(file=adopted[one.key[:2]][2]) if one.file == "" and one.key[:2] in adopted else one
                 for one in stored]  # fmt: skip
    return {one.key for one in named_now if options.method in {"auto", one.method}}


@dataclass(frozen=True, kw_only=True)
class Run:
    """The passes over a folder.

    Attributes
    ----------
    archive, settings, index, options, progress : see `ingest_folder`.
    size : width and height of the camera's images, px; (0, 0) where no header can be read.
    """

    archive: Archive
    settings: Settings
    index: Index
    options: IngestOptions
    progress: ReportProgress
    size: tuple[int, int]

    @staticmethod
    def of(archive: Archive, settings: Settings, index: Index, options: IngestOptions, progress: ReportProgress) -> Run:
        """Return the passes over an index, the camera being stored with the size of its images."""
        camera = archive.cameras.get(settings.name)
        size = usual_size(index.folder, index.images) if camera is None else camera.image_size
        if size is not None and index.images:
            register_camera(archive, settings, size)
        return Run(
            archive=archive, settings=settings, index=index, options=options, progress=progress, size=size or (0, 0)
        )

    @cached_property
    def static(self) -> PackedMask | None:
        """What stands still in the images; they are read for it when the first image is to be looked at."""
        return series_mask(self.index.folder, self.index.images, size=self.size, site=self.settings.site)

    @cached_property
    def factors(self) -> dict[str, float]:
        """By what each method's stated sigma is multiplied."""
        return {
            method: factor_in_force(self.archive, self.settings.name, method) for method in get_args(DetectionMethod)
        }

    def first_pass(self, moments: Sequence[Moment]) -> list[Skipped]:
        """Look at images without a prediction; return those that are left out."""
        return self._detect("detecting", moments, None)

    def second_pass(self) -> tuple[Finding, ...]:
        """Look again, with a prediction, at images whose sighting is not where the sun should be.

        Returns
        -------
        Why there is no prediction for some of them, or what of the camera has to be set.
        """
        stored = newest_verdicts(self.index.images, _stored(self.archive, self.settings, self.index))
        if all(one.ingest_pass != UNPREDICTED for one in stored.values()):
            return ()
        agreed = agreed_cameras(self.archive, self.settings, stored.items())
        again = [
            waiting
            for one in agreed
            if one.calibration is not None
            for waiting in self._unexpected(one.calibration, dict(one.found))
        ]
        self._detect("with prediction", [moment for moment, _ in again], [expected for _, expected in again])
        learn_sigma(self.archive, self.settings, _valid_cameras(agreed), now=SystemClock().now())
        return _camera_findings(agreed, self.settings)

    def _unexpected(
        self, calibration: Calibration, found: Mapping[ImageFile, FileSighting]
    ) -> list[tuple[Moment, Expectation | None]]:
        """Return the images without a prediction yet whose sighting is not there; mark those where it is."""
        moments = [one for one in moments_of(found) if any(found[image].ingest_pass == UNPREDICTED for image in one)]
        site = self.settings.site
        misfit = misfit_px(calibration, found.items(), site=site)
        places = expectations(calibration, [moment[0] for moment in moments], site=site, misfit=misfit)
        again, as_expected = list[tuple[Moment, Expectation | None]](), list[ImageKey]()
        for moment, expected in zip(moments, places, strict=True):
            if all(found[image].verdict == IN_STACK or is_consistent(found[image], expected) for image in moment):
                as_expected += [image.key for image in moment]
            else:
                again.append((moment, expected))
        self.archive.sightings.mark_predicted(self.settings.name, as_expected, ingest_pass=PREDICTED)
        return again

    def _detect(
        self, stage: str, moments: Sequence[Moment], expected: Sequence[Expectation | None] | None
    ) -> list[Skipped]:
        """Look at images and store their sightings; return those that are left out."""
        skipped, waiting = list[Skipped](), list[tuple[ImageFile, Detection]]()
        ingest_pass = UNPREDICTED if expected is None else PREDICTED
        tasks, done, total = self._tasks(moments, expected), 0, sum(len(moment) for moment in moments)
        answers = detect_in_pool(tasks, n_tasks=len(moments), processes=self.options.processes)
        places = [None] * len(moments) if expected is None else expected
        try:
            for moment, place, answered in zip(moments, places, answers, strict=True):
                pairs = list(zip(moment, answered, strict=True))
                skipped += [Skipped(image.path, found) for image, found in pairs if isinstance(found, Finding)]
                waiting += [
                    (image, as_predicted(with_factor(found, self.factors[found.method]), place))
                    for image, found in pairs
                    if isinstance(found, Detection)
                ]
                if len(waiting) >= _BATCH:
                    self._store(waiting, ingest_pass)
                    waiting = []
                done += len(moment)
                self.progress(stage, done, total)
        finally:  # also when the run is broken off: what was found need not be looked for again
            self._store(waiting, ingest_pass)
        return skipped

    def _tasks(self, moments: Sequence[Moment], expected: Sequence[Expectation | None] | None) -> Iterator[LookTask]:
        for number, (image, *others) in enumerate(moments):
            yield LookTask(
                path=self.index.folder / image.path,
                exposure_us=image.exposure_us,
                method=self.options.method,
                size=self.size,
                static=self.static,
                expectation=None if expected is None else expected[number],
                outside=expected is not None and expected[number] is None,
                more=tuple((self.index.folder / other.path, other.exposure_us) for other in others),
            )

    def _store(self, answers: Iterable[tuple[ImageFile, Detection]], ingest_pass: int) -> None:
        self.archive.sightings.replace([self._point(image, found, ingest_pass) for image, found in answers])

    def _point(self, image: ImageFile, found: Detection, ingest_pass: int) -> SunPoint:
        time_us, exposure_us, file = image.key
        time = from_microseconds(time_us)
        return sun_point_of(
            found,
            camera=self.settings.name,
            pose_epoch=self.archive.epochs.at(self.settings.name, time, reason="first image").id,
            time=time,
            exposure_us=exposure_us,
            file=file,
            ingest_pass=ingest_pass,
        )


def _valid_cameras(agreed: Sequence[Agreed]) -> list[ValidCamera]:
    """Return the camera of each stretch, for its images' times."""
    times = [[image.unix_s for image, _ in one.found] for one in agreed]
    return [
        ValidCamera(one.calibration, min(unix_s), max(unix_s) + 1e-6)
        for one, unix_s in zip(agreed, times, strict=True)
        if one.calibration is not None
    ]


def _camera_findings(agreed: Sequence[Agreed], settings: Settings) -> tuple[Finding, ...]:
    """Return why some images have no prediction, and that the camera is mirrored where the settings say otherwise."""
    reasons = {finding.code: finding for one in agreed if one.calibration is None for finding in one.findings}
    mirrored = {one.calibration.camera.mirrored for one in agreed if one.calibration is not None}
    if settings.calibration.mirrored == ("no" if True in mirrored else "yes") and mirrored:
        reasons["mirrored_setting_differs"] = Finding(
            "mirrored_setting_differs", {"mirrored": "yes" if True in mirrored else "no"}
        )
    return tuple(reasons.values())


def _summary(
    settings: Settings,
    index: Index,
    found: dict[ImageFile, FileSighting],
    *,
    looked_at: Sequence[ImageFile],
    skipped: Sequence[Skipped],
    camera_findings: tuple[Finding, ...],
    nights: FolderNights,
    options: IngestOptions,
) -> IngestSummary:
    sheet = options.contact_sheet or settings.state / "ingest" / "contact-sheet.png"
    if found:
        write_contact_sheet(index.folder, found, sheet)
    new = [found[image] for image in looked_at if image in found]
    accepted, stacked = sum(one.accepted for one in new), sum(one.verdict == IN_STACK for one in new)
    return IngestSummary(
        accepted=accepted,
        rejected=len(new) - accepted - stacked,
        stacked=stacked,
        known=len(index.images) - len(looked_at),
        by_verdict=dict(Counter(one.verdict for one in found.values()).most_common()),
        skipped=tuple(skipped),
        contact_sheet=sheet if found else None,
        camera_findings=camera_findings,
        nights=nights.looked_at,
        nights_known=nights.known,
    )


# What stands still in a folder's images: text overlays, logos, painted marks.

_IMAGES = 24
_LEAST_MOTION_DEG = 40.0
"""Largest angle between two suns of the images that are compared, at least: the glare of one is 20 degrees wide at
most, and has to leave every place."""


def series_mask(folder: Path, images: Sequence[ImageFile], *, size: tuple[int, int], site: Site) -> PackedMask | None:
    """Return what stands still in the images of a folder; None where nothing does, or they cannot tell."""
    some = images[:: len(images) // _IMAGES + 1]
    if not some or _motion_deg(some, site) < _LEAST_MOTION_DEG:
        return None
    images_read = _read(folder, some, size)
    first = next(images_read, None)
    if first is None:
        return None
    like_first = (one for one in images_read if (one.shape, one.dtype) == (first.shape, first.dtype))
    mask = static_mask(itertools.chain([first], like_first), full_scale=full_scale_of(first))
    return None if mask is None or not np.any(mask) else pack_mask(mask)


def _read(folder: Path, images: Sequence[ImageFile], size: tuple[int, int]) -> Iterator[Image]:
    for image in images:
        try:
            yield read_checked_image(folder / image.path, size=size)
        except RefusedImageError:
            continue


def _motion_deg(images: Sequence[ImageFile], site: Site) -> float:
    """Return the largest angle between the suns of two images."""
    directions = sun_directions(np.array([image.unix_s for image in images]), site)
    return float(np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)).max()))


# Detection in many image files at once, in processes: they read and compute, the caller alone writes.

Answers = tuple[FileAnswer, ...]
"""An answer for each file of a task."""

_AHEAD = 4
"""Tasks handed to each process before the first answer is read: bounds the memory of a long run."""


def detect_in_pool(tasks: Iterable[LookTask], *, n_tasks: int, processes: int) -> Iterator[Answers]:
    """Yield the answers of the tasks, in their order; fewer than a process is worth are computed here.

    An image whose process dies (a fault of a decoder, too little memory) is left out, and the others go on.
    """
    if processes < 2 or n_tasks <= 2 * processes:
        yield from map(detect_in_files, tasks)
        return
    waiting = iter(tasks)
    lost: list[LookTask] | None = []
    while lost is not None:
        for task in lost:
            yield answered_alone(task)
        lost = yield from _until_a_process_dies(waiting, processes)


def _until_a_process_dies(tasks: Iterator[LookTask], processes: int) -> Generator[Answers, None, list[LookTask] | None]:
    """Yield answers; return the tasks that were under way when a process died, None when all are done."""
    under_way: deque[tuple[LookTask, Future[Answers]]] = deque()
    pool = _pool(processes)
    try:
        for task in tasks:
            under_way.append((task, _submitted(pool, task)))
            if len(under_way) >= _AHEAD * processes:
                yield under_way[0][1].result()
                under_way.popleft()
        while under_way:
            yield under_way[0][1].result()
            under_way.popleft()
    except BrokenProcessPool:
        return [task for task, _ in under_way]
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return None


def _submitted(pool: ProcessPoolExecutor, task: LookTask) -> Future[Answers]:
    """Return the future answer of a task; a pool that is broken already answers with its error."""
    # The process that this may start inherits the mask: Ctrl-C is for the run, which lets each image be finished.
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return pool.submit(detect_in_files, task)
    except BrokenProcessPool as error:
        broken = Future[Answers]()
        broken.set_exception(error)
        return broken
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def answered_alone(task: LookTask) -> Answers:
    """Return the answers of a task in a process of its own; that it died is an answer, too."""
    with _pool(1) as pool:
        try:
            return _submitted(pool, task).result()
        except BrokenProcessPool as error:
            return tuple(Finding("worker_died", {"error": str(error)}) for _ in task.files)


def _pool(processes: int) -> ProcessPoolExecutor:
    one_thread_each()  # read by the processes that are started
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(processes, mp_context=context, initializer=_begin)


def _begin() -> None:
    """Prepare a process: one thread for images, and an end when the run has died."""
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)  # the queue of tasks stays open in every process, and would be waited for without end


# What a process does with the image files of one time: one sighting from all exposures.

IN_STACK: Final = "in_stack"
"""Verdict of an exposure whose stack has its sighting in another file."""


def detect_in_files(task: LookTask) -> tuple[FileAnswer, ...]:
    """Read the files of a task and look for the sun in them; return an answer for each, in their order.

    Exposures of one time that an ordinary image is among are a stack: its sighting is the first one's answer, the
    others name that file. Microsecond exposures, and files that cannot be stacked, are looked at one by one.
    """
    if not task.more:
        return (detect_in_file(task),)
    files = [replace(task, path=path, exposure_us=exposure_us, more=()) for path, exposure_us in task.files]
    images = [read_for(one) for one in files]
    stack = _stack_of(images)
    if len(stack) < 2 or not _is_ordinary(list(stack.values()), task):
        return tuple(_alone_of_detect_stack(image, one) for image, one in zip(images, files, strict=True))
    first, *others = stack
    found = _detect(stack, files, task)
    answers = {first: found} | {n: _member(found, files[n], files[first].path) for n in others}
    return tuple(answers.get(n) or _alone_of_detect_stack(images[n], one) for n, one in enumerate(files))


def _alone_of_detect_stack(image: Image | Finding, task: LookTask) -> FileAnswer:
    return image if isinstance(image, Finding) else detect_in_read(image, task)


def _stack_of(images: list[Image | Finding]) -> dict[int, Image]:
    """Return the images that are like the first one that could be read, by their number."""
    read = {n: image for n, image in enumerate(images) if not isinstance(image, Finding)}
    kinds = [(image.shape, image.dtype) for image in read.values()]
    return {n: image for n, image in read.items() if (image.shape, image.dtype) == kinds[0]}


def _is_ordinary(images: list[Image], task: LookTask) -> bool:
    scale = max(full_scale_of(image) for image in images)
    return any(selected_method(image, task.method, full_scale=scale) == "paper" for image in images)


def _detect(stack: dict[int, Image], files: list[LookTask], task: LookTask) -> Detection:
    if task.outside:
        return no_sun("paper", task.exposure_us)
    full_scale = max(full_scale_of(image) for image in stack.values())
    static = None if task.static is None else task.static.unpacked()
    photos = [Photo(image, full_scale, files[n].exposure_us, static) for n, image in stack.items()]
    return detect_sun_in_stack(photos, expectation=task.expectation)


def _member(found: Detection, task: LookTask, first: Path) -> Detection:
    """Return the answer for an exposure whose stack has its sighting in another file."""
    return Detection(
        method=found.method,
        accepted=False,
        verdict=IN_STACK,
        findings=(Finding("stack_member", {"file": first.name}),),
        exposure_us=task.exposure_us,
    )
