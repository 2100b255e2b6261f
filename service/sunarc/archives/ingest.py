"""A folder of archived images to sightings in the service's archive: both passes, with that archive as their ledger."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Self, cast, get_args

import numpy as np

from sunarc.archives.fit import CameraSightings, Rough, first_analysis, fit_poses
from sunarc.archives.ingest_summary import IngestSummary, write_contact_sheet
from sunarc.archives.ledger import ANY, ImageId, KeptMask, Known
from sunarc.archives.passes import (
    Found,
    FoundSun,
    Looked,
    Passes,
    epoch_at,
    make_image_id,
    predictions,
    scatter_beyond_px,
)
from sunarc.archives.pool import ProcessRunner
from sunarc.archives.states import ArchiveCamera, Epoch, State, disagreeing_days, known_state
from sunarc.calibration.model.options import ImageCircle
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.findings import Finding
from sunarc.common.foreign_files import is_regular, name_path
from sunarc.common.utc import from_microseconds
from sunarc.detection.values import Detection, Expectation, Verdict
from sunarc.detection.values import Method as DetectionMethod
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.recovery import upgrade_present
from sunarc.imager.archive.sightings import FileSighting, make_sun_point
from sunarc.imager.archive.values import SunPoint
from sunarc.imager.live.camera_record import known_camera, register_camera
from sunarc.imager.live.folder_nights import ingest_nights
from sunarc.imager.live.learned_sigma import ValidCamera, factor_in_force, learn_sigma, scale_detection_sigma
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.settings.model import Settings
from sunarc.sky.days import solar_days
from sunarc.sources.detect_files import Method
from sunarc.sources.expected_sun import PREDICTED, SEARCHED, as_predicted
from sunarc.sources.image_key import ImageKey
from sunarc.sources.image_times import ASSUMED_UTC, TimeRules
from sunarc.sources.index import ArchiveImage, CameraImages, CameraPlan, Failure, ReportProgress, Selector, index_folder
from sunarc.sources.look import IN_STACK, PackedMask
from sunarc.sources.source_files import stored_address
from sunarc.sources.sources import open_folder

_BATCH = 32
"""Sightings written at once; a run that is killed loses no more, and finds them again."""
_QUARTER_S = 900.0


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestOptions:
    """Options of the ingest of a folder.

    Attributes
    ----------
    method : see `detect_in_image`.
    rules : how times are read.
    files : which files are the camera's, a pattern of `fnmatch` for their names.
    only : of these the ones to be read, by their paths below the folder; None for all.
    follow_exif : turn pictures as their EXIF orientation states.
    reprocess : read images again that are known, in place of their former sightings.
    processes : how many images are read at once.
    contact_sheet : file of the contact sheet; None for `ingest/contact-sheet.png` in the state folder.
    """

    method: Method = "auto"
    rules: TimeRules = field(default_factory=lambda: ASSUMED_UTC)
    files: str = "*"
    only: frozenset[str] | None = None
    follow_exif: bool = False
    reprocess: bool = False
    processes: int = 1
    contact_sheet: Path | None = None


def ingest_folder(
    settings: Settings, folder: Path, *, options: IngestOptions, progress: ReportProgress = lambda *_: None
) -> IngestSummary:
    """Look for the sun in every image below a folder, and store the sightings.

    First without a prediction; then the states that explain most sightings predict the sun, and images whose sighting
    is not there are read again: reflections, ghosts and clouds are distinguished from the sun. What stands still
    in the images takes no part. Images of the night go to `ingest_nights`.

    An image is known by its time, exposure and file name; one that is known is left as it is unless `reprocess` is set
    or another method is asked for. Images of one time are a stack: they are read together, and the first one's
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
    with open_archive(settings.archive) as archive:
        record = known_camera(archive, settings)
        camera, failures = index_folder(
            _make_plan(settings, folder, options, None if record is None else record.image_size)
        )
        if camera.images and camera.size != (0, 0):
            register_camera(archive, settings, camera.size)
        with FolderLedger(archive, settings, camera, options) as store:
            passes = Passes(store, ProcessRunner(options.processes), progress)
            (mask,) = passes.masks([camera]) if camera.images else [None]
            passes.search([camera], [mask])
            findings = _run_second_pass(passes, store, mask) if store.unpredicted() else ()
        nights = ingest_nights(archive, settings, camera, reprocess=options.reprocess, progress=progress)
        found = store.found()
    sheet = options.contact_sheet or settings.state / "ingest" / "contact-sheet.png"
    if found:
        write_contact_sheet(found, sheet)
    new = [found[image] for image in store.looked_at if image in found]
    accepted, stacked = sum(one.accepted for one in new), sum(one.verdict == IN_STACK for one in new)
    return IngestSummary(
        accepted=accepted,
        rejected=len(new) - accepted - stacked,
        stacked=stacked,
        known=len(camera.images) - len(store.looked_at),
        by_verdict=dict(Counter(one.verdict for one in found.values()).most_common()),
        skipped=(*failures, *store.failures, *nights.failures),
        contact_sheet=sheet if found else None,
        camera_findings=(*camera.findings, *findings, *nights.findings, *list(store.set_aside.values())[:1]),
        nights=nights.looked_at,
        nights_known=nights.known,
    )


def ingest_followed(settings: Settings, *, rules: TimeRules, only: frozenset[str] | None) -> bool:
    """Ingest files of the folder that the service follows, and return that it was done (`FolderAnalysis`).

    Parameters
    ----------
    settings : of the service; its `folder` names the files and the method.
    rules : how times are read.
    only : paths below the folder; None for all files.
    """
    folder = settings.folder
    if folder is None:
        raise ValueError("settings without [folder]")
    options = IngestOptions(
        method=folder.method, rules=rules, files=folder.files, only=only, follow_exif=folder.follow_exif
    )
    ingest_folder(settings, folder.path, options=options)
    return True


def _make_plan(settings: Settings, folder: Path, options: IngestOptions, size: tuple[int, int] | None) -> CameraPlan:
    return CameraPlan(
        name=settings.name,
        site=settings.place,
        selector=Selector((open_folder(folder, follow_exif=options.follow_exif).address,), options.files, options.only),
        rules=options.rules,
        image_size=size,
        method=options.method,
        options=settings.calibration,
        largest_zenith_deg=settings.capture.sun_zenith_deg,
        stacks=True,
        one_by_one=True,
    )


def _run_second_pass(passes: Passes, store: FolderLedger, mask: PackedMask | None) -> tuple[Finding, ...]:
    """Look again, with a prediction, at images whose sighting is not where the sun should be.

    Returns
    -------
    Why there is no prediction for some of them, or what of the camera has to be set.
    """
    points, _ = store.looked().points()
    camera = _make_archive_camera(store)
    rough = _first_analysis(store, points, camera)
    if not rough.states:
        return rough.findings
    # where no state explains a day, the camera's pose on it is unknown: its sightings stay as they are
    doubtful = disagreeing_days(points, rough.states, camera)
    refused = _find_refused_epochs(store, points, rough, camera)
    looked = _drop_refusals(store.looked(without_days=doubtful), rough.epochs, refused)
    states = [one._replace(clock_offset_s=0.0) if _is_time_zone(one.clock_offset_s) else one for one in rough.states]
    images = replace(store.camera, images=looked.images)
    expected = predictions(images, states, rough.epochs, misfit_px=_scatter_of_states_px(points, rough, camera))
    store.expect(looked.images, expected)
    passes.predict([(images, looked)], [expected], [mask])
    store.mark_predicted(looked.images)
    valid = [
        ValidCamera(states[one.state].calibration, one.start_unix_s, one.end_unix_s + 1e-6) for one in rough.epochs
    ]
    learn_sigma(store.archive, store.settings, valid, now=SystemClock().now())
    return (*doubtful.values(), *refused.values(), *_find_mirroring(states, store.settings))


def _make_archive_camera(store: FolderLedger) -> ArchiveCamera:
    settings, numbers = store.settings, store.settings.refit.image_circle_px
    circle = None if numbers is None else ImageCircle(x=numbers[0], y=numbers[1], radius=numbers[2])
    options = replace(settings.calibration, method="robust", mirrored="auto")
    return ArchiveCamera(settings.place, store.camera.size, options, circle)


def _first_analysis(store: FolderLedger, points: Sightings, camera: ArchiveCamera) -> Rough:
    """Return the states and epochs that explain sightings; the calibration that is served is tried first."""
    served = store.archive.calibrations.current_model(store.settings.name)
    known = () if served is None else (known_state(served, points),)
    return first_analysis(CameraSightings(points, camera, known))


def _find_refused_epochs(
    store: FolderLedger, points: Sightings, rough: Rough, camera: ArchiveCamera
) -> dict[int, Finding]:
    """Return the epochs whose sightings give no calibration, with the finding against each; that of a served is one."""
    served = store.archive.calibrations.current_model(store.settings.name) is not None
    poses = [rough.states[one.state].pose for one in rough.epochs]
    if not len(points) or (served and not any(poses)):
        return {}
    path = np.repeat([one.state for one in rough.epochs], [1 + one.last - one.first for one in rough.epochs])
    fitted = fit_poses(points, path, rough.states, camera)
    verdicts = {number: fitted[pose].calibration.verdict for number, pose in enumerate(poses) if pose or not served}
    return {number: verdict.findings[0] for number, verdict in verdicts.items() if not verdict.accepted}


def _drop_refusals(looked: Looked, epochs: Sequence[Epoch], refused: Container[int]) -> Looked:
    """Return images without those in refused epochs whose sun was refused: the prediction of such a one proves nothing.

    They wait as they are for a calibration that is accepted; see `without_lifted`.
    """
    pairs = [
        (image, one)
        for image, one in zip(looked.images, looked.found, strict=True)
        if not (_is_refusal(one) and epoch_at(epochs, image.unix_s) in refused)
    ]
    return Looked(tuple(image for image, _ in pairs), tuple(one for _, one in pairs))


def _is_refusal(found: Found) -> bool:
    return isinstance(found, FoundSun) and not found.accepted and found.verdict != IN_STACK


def _scatter_of_states_px(points: Sightings, rough: Rough, camera: ArchiveCamera) -> list[float]:
    """Return the scatter of each state's sightings beyond their own and its covariance."""
    misfits = []
    for number, one in enumerate(rough.states):
        rows = [np.arange(epoch.first, epoch.last + 1) for epoch in rough.epochs if epoch.state == number]
        own = points.select(np.concatenate([np.zeros(0, dtype=np.int64), *rows]))
        misfits.append(scatter_beyond_px(one.calibration, camera.shifted(own, one.clock_offset_s), site=camera.site))
    return misfits


def _is_time_zone(offset_s: float) -> bool:
    """Return whether a clock is ahead by whole quarters of an hour: the archive has no clock but UTC.

    Sightings of such a clock are refused; another offset may as well be a turn of the camera.
    """
    return offset_s % _QUARTER_S == 0.0


def _find_mirroring(states: Sequence[State], settings: Settings) -> tuple[Finding, ...]:
    """Return that the camera is mirrored, or is not, where the settings say otherwise."""
    mirrored = any(one.calibration.camera.mirrored for one in states)
    if (settings.calibration.mirrored or "no") != ("no" if mirrored else "yes"):
        return ()
    return (Finding("mirrored_setting_differs", {"mirrored": "yes" if mirrored else "no"}),)


def _make_found_sun(stored: FileSighting) -> FoundSun:
    verdict = cast("Verdict", stored.verdict)
    if not stored.accepted:
        return FoundSun(accepted=False, verdict=verdict)
    return FoundSun(accepted=True, verdict=verdict, x_px=stored.x_px, y_px=stored.y_px, sigma_px=stored.sigma_px)


class FolderLedger:
    """The service's archive as the ledger of a folder's images; see `AnswerStore`.

    Sightings are written after every few images, and when the store is left. Of an answer the archive keeps the
    sighting: it holds until another method, or `reprocess`, is asked for.

    Parameters
    ----------
    archive, settings : of the service.
    camera : with its images.
    options : how the folder is ingested.

    Attributes
    ----------
    looked_at : images that were read without a prediction.
    failures : those of them that are left out.
    set_aside : of pictures of one time in several folders what was set aside, by their paths.
    """

    def __init__(self, archive: Archive, settings: Settings, camera: CameraImages, options: IngestOptions) -> None:
        self.archive, self.settings, self.camera = archive, settings, camera
        self.looked_at: list[ArchiveImage] = []
        self.failures: list[Failure] = []
        self.set_aside: dict[str, Finding] = {}
        self._options = options
        self._images = {make_image_id(image): image for image in camera.images}
        self._expected: dict[ImageId, Expectation | None] = {}
        self._waiting: list[SunPoint] = []

    def __enter__(self) -> Self:
        self._assign_missing_files()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._write_waiting()  # also when the run is broken off: what was found need not be looked for again

    def answers(self, camera: str, *, pass_number: int) -> Iterator[tuple[ImageId, Known]]:
        """Yield the sightings that are known: without a prediction all, with one those that were predicted."""
        del camera
        known = self._list_known_keys() if pass_number == SEARCHED else None
        for image, one in self.found().items():
            if image.key in known if known is not None else one.ingest_pass != SEARCHED:
                detection = Detection(
                    method=cast("DetectionMethod", one.method), accepted=one.accepted,
                    verdict=cast("Verdict", one.verdict), findings=(),
                    x_px=one.x_px, y_px=one.y_px, sigma_px=one.sigma_px,
                )  # fmt: skip
                yield make_image_id(image), Known(ANY, detection)

    def store(self, camera: str, pass_number: int, answers: Iterable[tuple[ImageId, Known]], *, version: str) -> None:
        """Store the sightings of some images."""
        del camera, version
        for identity, known in answers:
            image, found = self._images[identity], known.found
            if pass_number == SEARCHED:
                self.looked_at.append(image)
            if isinstance(found, Detection):
                found = as_predicted(
                    scale_detection_sigma(found, self._read_sigma_factors[found.method]), self._expected.get(identity)
                )
                self._waiting.append(self._make_sighting(image, found, pass_number))
            elif isinstance(found, Finding) and pass_number == SEARCHED:
                self.failures.append(Failure(image.path, found))
        if len(self._waiting) >= _BATCH:
            self._write_waiting()

    def mask(self, camera: str, *, version: str) -> KeptMask | None:
        """Return that no mask is to be made where no image is to be read."""
        del camera, version
        known = self._list_known_keys()
        return (
            KeptMask(None) if all(one.key in known for one in self.camera.images) and not self.unpredicted() else None
        )

    def keep_mask(self, camera: str, mask: PackedMask | None, *, version: str) -> None:
        """Keep nothing: new images show the static parts as well."""

    def found(self) -> dict[ArchiveImage, FileSighting]:
        """Return the sighting that counts of each image: the accepted one, else the one stored last."""
        self._write_waiting()
        by_key: dict[ImageKey, FileSighting] = {}
        for one in self._read_stored():
            former = by_key.get(one.key)
            if former is None or one.accepted or not former.accepted:
                by_key[one.key] = one
        return {image: by_key[image.key] for image in self.camera.images if image.key in by_key}

    def looked(self, *, without_days: Container[int] = ()) -> Looked:
        """Return the images with a sighting, but for those of some solar days, and these as the archive holds them."""
        found = self.found()
        days = solar_days(np.array([one.unix_s for one in found]), longitude=self.settings.place.longitude).tolist()
        kept = {image: one for (image, one), day in zip(found.items(), days, strict=True) if day not in without_days}
        suns = (_make_found_sun(one) for one in kept.values())
        return Looked(tuple(kept), tuple(suns))

    def unpredicted(self) -> bool:
        """Return whether a sighting was found without a prediction."""
        return any(one.ingest_pass == SEARCHED for one in self.found().values())

    def expect(self, images: Sequence[ArchiveImage], expected: Sequence[Expectation | None]) -> None:
        """Have the sightings of images judged by predictions."""
        self._expected = {make_image_id(image): one for image, one in zip(images, expected, strict=True)}

    def mark_predicted(self, images: Sequence[ArchiveImage]) -> None:
        """Mark the sightings of images that are where the sun should be as predicted."""
        found = self.found()
        keys = [image.key for image in images if found[image].ingest_pass == SEARCHED]
        self.archive.sightings.mark_predicted(self.settings.name, keys, ingest_pass=PREDICTED)

    @cached_property
    def _read_sigma_factors(self) -> dict[str, float]:
        """Return the factor of each method's stated sigma."""
        return {one: factor_in_force(self.archive, self.settings.name, one) for one in get_args(DetectionMethod)}

    def _read_stored(self) -> list[FileSighting]:
        times_us = {image.time_us for image in self.camera.images}
        return self.archive.sightings.file_sightings(self.settings.name, times_us=times_us)

    def _list_known_keys(self) -> set[ImageKey]:
        """Return the keys of the images that have a sighting by the method asked for, or by any where that is open."""
        if self._options.reprocess:
            return set()
        return {one.key for one in self._read_stored() if self._options.method in {"auto", one.method}}

    def _assign_missing_files(self) -> None:
        """Give sightings whose file is not here the name and folder of an image of their time and exposure.

        It has the same name, or is the first one where that is not known (version 0.2): a folder that is ingested by
        another of its parents, or was moved, has the images that were read.
        """
        stored, here = {one.key: None for one in self._read_stored()}, {image.key for image in self.camera.images}
        free: dict[ImageKey, list[ImageKey]] = {}
        for image in self.camera.images:
            for former in (image.named, image.named._replace(file="")) if image.key not in stored else ():
                free.setdefault(former, []).append(image.key)
        renamed: dict[ImageKey, ImageKey] = {}
        taken = set[ImageKey]()
        for former in stored:
            options = () if former in here else free.get(former._replace(folder=""), ())
            new = next((one for one in options if one not in taken), None)
            if new is not None and not self._is_file_present(former):
                renamed[former] = new
                taken.add(new)
        self.archive.sightings.rename_files(self.settings.name, renamed)

    def _is_file_present(self, key: ImageKey) -> bool:
        """Return whether a file is below the folder, though it is not read in this run."""
        root = Path(name_path(stored_address(self.camera.plan.selector.sources[0])))
        return key.folder != "" and is_regular(root / name_path(key.folder) / name_path(key.file.partition("#")[0]))

    def _write_waiting(self) -> None:
        points, self._waiting = self._waiting, []
        if points:
            self.set_aside |= self.archive.sightings.replace(points, first_epoch="first image")

    def _make_sighting(self, image: ArchiveImage, found: Detection, pass_number: int) -> SunPoint:
        return make_sun_point(
            found,
            camera=self.settings.name,
            pose_epoch="",
            time=from_microseconds(image.time_us),
            exposure_us=image.key.exposure_us,
            file=image.key.file,
            folder=image.key.folder,
            ingest_pass=pass_number,
        )
