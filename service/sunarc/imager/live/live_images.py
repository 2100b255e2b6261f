"""The sun in images as they come: looked for as `ingest` does, and stored as its sightings."""

from __future__ import annotations

import logging
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from datetime import datetime
from typing import NamedTuple

import numpy as np

from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.common.utc import to_microseconds
from sunarc.detection.values import Detection, Expectation
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.pictures_of_one_time import ELSEWHERE
from sunarc.imager.archive.sightings import FROZEN, make_sun_point
from sunarc.imager.archive.values import CalibrationRecord, SunPoint
from sunarc.imager.live.camera_record import register_camera
from sunarc.imager.live.learned_sigma import ValidCamera, factor_in_force, learn_sigma, scale_detection_sigma
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers.calibrating.provisional_pose import is_provisional
from sunarc.imager.workers.image_faults import FrozenAlarm, RepeatedImages, TransferFaults
from sunarc.imaging.image_tiles import image_tiles
from sunarc.sources.detect_files import Method
from sunarc.sources.expected_sun import PREDICTED, SEARCHED, as_predicted, expectations
from sunarc.sources.image_files import read_one_image
from sunarc.sources.image_key import image_key
from sunarc.sources.look import IN_STACK, Answer, Chunk, Item, look_at
from sunarc.sources.sources import open_source

_log = logging.getLogger(__name__)
_CONTENTS = 512
"""Hashes that are remembered: a camera that serves one picture for an hour and more is found."""
_SUNS = 200
"""An hour of them, of which one a minute is remembered."""
_PERHAPS_ELSEWHERE = frozenset({"hidden", "reflection"})


class LiveImage(NamedTuple):
    """Image that has arrived: its file below the folder, time, exposure and content.

    content: hash of the file's bytes.
    """

    file: str
    time: datetime
    exposure_us: float | None
    content: str


class Repetitions:
    """Detection of images that repeat an earlier one, with a condition for a camera that does so.

    Parameters
    ----------
    camera : whose archive gets the event.
    board : where the conditions are set.
    """

    def __init__(self, camera: CameraArchive, board: StatusRegistry) -> None:
        self._camera = camera
        self._alarm, self._faults = FrozenAlarm(camera, board), TransferFaults(board)
        self._images = RepeatedImages(camera.site)
        self._times: OrderedDict[str, datetime] = OrderedDict()

    def resume(self) -> None:
        """Read the last files and their suns from the archive, after a restart."""
        suns = self._camera.archive.sightings.find(self._camera.name, accepted=True, newest_first=True, limit=_SUNS)
        for point in reversed(suns):
            if point.x_px is not None and point.y_px is not None:
                self._images.remember_sun(point.time, (point.x_px, point.y_px))
        for one in reversed(self._camera.archive.seen_files.newest(self._camera.name, limit=_CONTENTS)):
            if one.content is not None and one.time is not None:
                self._times.setdefault(one.content, one.time)

    def earlier(self, image: LiveImage, pixels: Image, sun: tuple[float, float] | None) -> datetime | None:
        """Return when the same picture came before; None for a new one.

        Parameters
        ----------
        image, pixels : the picture.
        sun : where one was found in it, x and y px.
        """
        tiles = image_tiles(pixels)
        first = self._times.setdefault(image.content, image.time)
        self._times.move_to_end(image.content)
        if len(self._times) > _CONTENTS:
            self._times.popitem(last=False)
        repeated = None
        if first != image.time:
            repeated = self._images.compared(tiles, tiles, first, image.time, sun)
        repeated = repeated or self._images.earlier(tiles, image.time, sun)
        self._faults.note(pixels)
        if repeated is None:
            self._alarm.clear()
            return None
        if repeated.is_sure:
            self._alarm.note(image.time, repeated.time)
        return repeated.time


@dataclass(eq=False)
class LiveImages:
    """Detection of the sun in the images of one time; the sightings are stored.

    With a calibration the sun is looked for where it should be, and where it is not there, in the whole image: a sun
    elsewhere tells that the camera was moved. Without one the whole image is searched.

    Parameters
    ----------
    camera : its archive and site.
    settings : of the service.
    method : see `detect_in_image`.
    clock_error_s : bound of the error of an image's time, s.
    notice : called with the time and place of each sun that was found, for the detection of changes.
    board : where repetitions are reported.
    show : called with the pixels and the time of each picture that is new.
    checked : returns a detection at a time, or its rejection: the sun is behind an obstruction.
    looked_at_again : whether the images from before the first calibration are read again elsewhere; otherwise
        their sightings are held to it here.
    """

    camera: CameraArchive
    _: KW_ONLY
    settings: Settings
    method: Method
    clock_error_s: Callable[[datetime], float]
    notice: Callable[[datetime, Detection], None]
    board: StatusRegistry
    show: Callable[[Image, datetime], None] = lambda _image, _time: None
    checked: Callable[[Detection, datetime], Detection] = lambda found, _time: found
    looked_at_again: bool = False

    def __post_init__(self) -> None:
        """Begin without an image."""
        self.repetitions = Repetitions(self.camera, self.board)
        self._learned_with: str | None = None
        self._noticed: datetime | None = None

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height that the images must have, px; None before the first one."""
        record = self.camera.archive.cameras.get(self.camera.name)
        return None if record is None else record.image_size

    def register(self, sizes: Sequence[tuple[int, int]]) -> None:
        """Store the camera with the size (width, height) that most of some images have, unless it is stored."""
        if self.size is None and sizes:
            register_camera(self.camera.archive, self.settings, Counter(sizes).most_common(1)[0][0])

    def take(self, address: str, images: Sequence[LiveImage]) -> list[Finding | None]:
        """Detect the sun in the images of one time, store the sightings, and return each image's finding, else None.

        `TWO_PICTURES` is of one that is stored, and was set aside.

        Parameters
        ----------
        address : of the source that the files are in.
        images : of one time; several are a stack, which has one sighting.

        Raises
        ------
        OutsideError : the archive cannot store them; nothing is.
        """
        time = images[0].time
        record = self.camera.archive.calibrations.current(self.camera.name, at=time)
        model = None if record is None else self._read_model(record)
        expected = None if model is None else self._predict_sun(model, time)
        answers = self._detect_suns(address, images, expected, outside=model is not None and expected is None)
        suns = {one.file: one.found for one in answers if isinstance(one.found, Detection)}
        if expected is not None and not any(found.accepted for found in suns.values()):
            self._search_whole_images(address, images, suns)
        suns = {file: self.checked(found, time) for file, found in suns.items()}
        accepted = any(found.accepted for found in suns.values())
        repeated = self._find_repetition(address, images[0], suns)
        if repeated is not None:
            self._store_sightings(
                [self._make_sighting(one, _make_frozen_detection(repeated), SEARCHED) for one in images]
            )
            return [repeated for _ in images]
        aside: dict[str, Finding] = {}
        if suns:
            number = SEARCHED if model is None else PREDICTED
            aside = self._store_sightings(
                [self._make_sighting(one, suns[one.file], number) for one in images if one.file in suns]
            )
            if accepted and not suns.keys() <= aside.keys():
                self._show_newest_sighting(time)
        self._report_newest_sun(time, (found for file, found in suns.items() if file not in aside))
        self._learn_sigma_once(record, model)
        return [one.found if isinstance(one.found, Finding) else aside.get(one.file) for one in answers]

    def _find_repetition(self, address: str, image: LiveImage, suns: Mapping[str, Detection]) -> Finding | None:
        """Return the finding of a picture that came before; None for a new one, and for one that cannot be used."""
        pixels = read_one_image(open_source(address), image.file, size=self.size)
        if isinstance(pixels, Finding):
            return None
        places = ((one.x_px, one.y_px) for one in suns.values())  # of a bright region that is refused too
        sun = next(((x, y) for x, y in places if x is not None and y is not None), None)
        earlier = self.repetitions.earlier(image, pixels, sun)
        if earlier is None:
            self.show(pixels, image.time)
        return None if earlier is None else Finding("frame_repeated", {"time": earlier.isoformat(timespec="seconds")})

    def _show_newest_sighting(self, time: datetime) -> None:
        """Show the newest sighting: images may come late, and out of order."""
        shown = self.board.snapshot().last_sighting_at
        if shown is None or time > shown:
            self.board.note(last_sighting_at=time)

    def _report_newest_sun(self, time: datetime, suns: Iterable[Detection]) -> None:
        """Pass on the sun of an image later than all before it: in another order it would seem to move back."""
        for found in suns:
            if (found.accepted or found.verdict == ELSEWHERE) and (self._noticed is None or time > self._noticed):
                self._noticed = time
                self.notice(time, found)

    def _read_model(self, record: CalibrationRecord) -> Calibration | None:
        try:
            return self.camera.archive.calibrations.model(record.id)
        except InputError:
            return None

    def _predict_sun(self, model: Calibration, time: datetime) -> Expectation | None:
        site = self.camera.site_with_air_at(time)
        return expectations(model, np.array([time.timestamp()]), site=site)[0]

    def _detect_suns(
        self, address: str, images: Sequence[LiveImage], expected: Expectation | None, *, outside: bool
    ) -> list[Answer]:
        """Return the detection for each image; in ordinary images it has to agree with the prediction."""
        items = tuple(Item(one.file, 0, one.exposure_us, expected, outside) for one in images)
        size = self.size or (0, 0)
        chunk = Chunk(self.camera.name, address, self.method, size, items, stack=len(items) > 1)
        return [
            one._replace(found=as_predicted(self._scale_detection(one.found), expected))
            if isinstance(one.found, Detection)
            else one
            for one in look_at(chunk)
        ]

    def _scale_detection(self, found: Detection) -> Detection:
        return scale_detection_sigma(found, factor_in_force(self.camera.archive, self.camera.name, found.method))

    def _search_whole_images(self, address: str, images: Sequence[LiveImage], suns: dict[str, Detection]) -> None:
        """Search whole images where no sun is at the predicted place; a sun elsewhere shows that the camera moved."""
        perhaps = [
            one for one in images if one.file in suns and suns[one.file].verdict in {*_PERHAPS_ELSEWHERE, IN_STACK}
        ]
        if not any(suns[one.file].verdict in _PERHAPS_ELSEWHERE for one in perhaps):
            return
        for one in self._detect_suns(address, perhaps, None, outside=False):
            if isinstance(one.found, Detection) and one.found.accepted:
                findings = (Finding("sun_elsewhere"), *suns[one.file].findings)
                suns[one.file] = replace(one.found, accepted=False, verdict="elsewhere", findings=findings)

    def _make_sighting(self, image: LiveImage, found: Detection, ingest_pass: int) -> SunPoint:
        key = image_key(to_microseconds(image.time), image.exposure_us, image.file)
        return make_sun_point(
            found,
            camera=self.camera.name,
            pose_epoch="",
            time=image.time,
            exposure_us=key.exposure_us,
            clock_error_s=self.clock_error_s(image.time),
            file=key.file,
            folder=key.folder,
            ingest_pass=ingest_pass,
        )

    def _store_sightings(self, points: list[SunPoint]) -> dict[str, Finding]:
        return self.camera.archive.sightings.replace(points, first_epoch="first image")

    def _learn_sigma_once(self, record: CalibrationRecord | None, model: Calibration | None) -> None:
        """Learn the sigma of the sightings in images once from each calibration of a full fit."""
        if record is None or model is None or record.id == self._learned_with or is_provisional(model):
            return
        if not self.looked_at_again:
            self._reject_deviating(record, model)
        self._learned_with = record.id
        until = float("inf") if record.valid_until is None else record.valid_until.timestamp()
        valid = ValidCamera(model, record.valid_from.timestamp(), until)
        learn_sigma(self.camera.archive, self.settings, [valid], now=record.created_at)

    def _reject_deviating(self, record: CalibrationRecord, model: Calibration) -> None:
        """Reject sightings of a whole image that deviate from the prediction of a calibration of their pose."""
        searched = self.camera.archive.sightings.find(
            self.camera.name, accepted=True, pose_epoch=record.pose_epoch, ingest_pass=SEARCHED
        )
        times = np.array([one.time.timestamp() for one in searched])
        expected = expectations(model, times, site=self.camera.site)
        held = (as_predicted(*one) for one in zip(searched, expected, strict=True))
        self._store_sightings([replace(one, ingest_pass=PREDICTED) for one in held])


def _make_frozen_detection(repeated: Finding) -> Detection:
    return Detection(method="paper", accepted=False, verdict=FROZEN, findings=(repeated,))
