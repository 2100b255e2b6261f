"""Sightings of the sun: detected in its exposures, refused where the camera repeats itself, and stored."""

from __future__ import annotations

import hashlib
import logging
import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from datetime import datetime, timedelta
from typing import NamedTuple

import numpy as np

from sunarc.common.array_types import Image
from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding
from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.disc.series import check_against_bracket
from sunarc.detection.values import Detection, DiscOptions, Expectation
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.pictures_of_one_time import ELSEWHERE
from sunarc.imager.archive.sightings import FROZEN, make_sun_point
from sunarc.imager.archive.values import SunPoint
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.loop import DropOldestQueue, entries
from sunarc.imager.runtime.status import StatusRegistry, condition
from sunarc.imager.workers.image_faults import FrozenAlarm, RepeatedImages, TransferFaults, sun_moved
from sunarc.imager.workers.options import SensorOptions, frame_sensor
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.imaging.image_tiles import image_tiles

_log = logging.getLogger(__name__)
_MAX_IMAGES = 256
"""Digests of 16 bytes; a cycle has about eight frames."""
_MAX_POSITIONS = 32
_FEWEST_PIXELS = 100
"""An image that differs from a constant in fewer pixels (hot ones) may truly come again: black, without noise."""
_SAME_PX = 1e-6
"""Two fits of the disc to images with noise differ by a thousand times more."""
_HALF_PX = 6  # around the disc
_FEWEST_LIT = 10
"""Pixels of the disc, not saturated: with their noise, and a sun that moves, so many are never all equal by chance."""
_LIT, _LEAST_COUNTS, _SATURATED = 0.1, 3.0, 0.98


@dataclass(frozen=True, slots=True, eq=False)
class _DeliveredDisc:
    """The image around a disc as it was delivered, and its place in the whole one."""

    time: datetime
    place: tuple[slice, slice]
    image: Image

    def is_in(self, frame: Frame) -> bool:
        """Return whether a frame has these very pixels."""
        here = frame.image[self.place]
        if here.shape != self.image.shape or self.image.size == 0:
            return False
        above = self.image - float(np.median(self.image))
        lit = (above >= max(_LIT * float(above.max()), _LEAST_COUNTS)) & (self.image < _SATURATED * frame.full_scale)
        if np.count_nonzero(lit) < _FEWEST_LIT:
            return False
        return bool(np.array_equal(here[lit], self.image[lit]))


@dataclass(eq=False)
class FrozenFrames:
    """Check for frames that repeat earlier ones, with a condition for such a camera.

    Parameters
    ----------
    camera : its archive and site.
    board : where a camera that repeats its images is shown.
    """

    camera: CameraArchive
    _: KW_ONLY
    board: StatusRegistry

    def __post_init__(self) -> None:
        """Begin without frames."""
        self._lock = threading.Lock()
        self._images: OrderedDict[bytes, datetime] = OrderedDict()
        self._positions: deque[tuple[datetime, float, float]] | None = None
        self._discs: deque[_DeliveredDisc] = deque(maxlen=_MAX_POSITIONS)
        self._tiles = RepeatedImages(self.camera.site, noisy=True)
        self._alarm = FrozenAlarm(self.camera, self.board)

    def remember(self, frame: Frame) -> None:
        """Remember a frame that may never be searched for the sun; a later frame with its image is a copy.

        Called by capture for every frame: probes, normal exposures and discarded cycles are images that a camera can
        deliver again too.
        """
        self._find_same_image(frame)

    def checked(self, frame: Frame, detection: Detection) -> Detection:
        """Return the detection, or its rejection where the frame repeats an earlier one."""
        earlier = self._find_same_image(frame)
        if earlier is None:
            earlier = self._find_same_position(frame.time, detection)
        if earlier is None:
            tiles = self._tiles.earlier(image_tiles(frame.image), frame.time, None)
            earlier = None if tiles is None else tiles.time
        if earlier is None:
            if _is_informative(frame.image):
                self._alarm.clear()
            return self._reject_earlier_disc(frame, detection)
        self._alarm.note(frame.time, earlier)
        repeated = Finding("frame_repeated", {"time": earlier.isoformat(timespec="seconds")})
        return replace(detection, accepted=False, verdict=FROZEN, findings=(repeated,))

    def _find_same_image(self, frame: Frame) -> datetime | None:
        """Return the time of an earlier frame with the same bytes; None without one, or for bytes without content."""
        if not _is_informative(frame.image):
            return None
        digest = hashlib.blake2b(np.ascontiguousarray(frame.image).data, digest_size=16).digest()
        with self._lock:
            earlier = self._images.setdefault(digest, frame.time)
            self._images.move_to_end(digest)
            if len(self._images) > _MAX_IMAGES:
                self._images.popitem(last=False)
        return None if earlier == frame.time else earlier  # the frame itself; a replay may play the same file twice

    def _find_same_position(self, time: datetime, detection: Detection) -> datetime | None:
        """Return when the sun was seen in exactly the same place though it has moved since; None where it was not."""
        if detection.x_px is None or detection.y_px is None or not _is_sun(detection):
            return None
        if self._positions is None:
            self._positions = self._stored(time)
        x_px, y_px = detection.x_px, detection.y_px
        for earlier, x, y in self._positions:
            same = abs(x - x_px) < _SAME_PX and abs(y - y_px) < _SAME_PX
            if same and sun_moved(earlier, time, self.camera.site):
                return earlier
        self._positions.append((time, x_px, y_px))
        return None

    def _reject_earlier_disc(self, frame: Frame, detection: Detection) -> Detection:
        """Return the detection, rejected where the disc is an earlier frame's among rows of this one."""
        if detection.x_px is None or detection.y_px is None:
            return detection
        among = self._discs if _is_sun(detection) else ()
        earlier = next((one for one in among if one.time != frame.time and one.is_in(frame)), None)
        if earlier is not None:
            repeated = Finding("rows_repeated", {"time": earlier.time.isoformat(timespec="seconds")})
            return replace(detection, accepted=False, verdict=FROZEN, findings=(repeated,))
        x, y = (max(round(at) - _HALF_PX, 0) for at in (detection.x_px, detection.y_px))
        place = (slice(y, y + 2 * _HALF_PX + 1), slice(x, x + 2 * _HALF_PX + 1))
        self._discs.append(_DeliveredDisc(frame.time, place, frame.image[place].copy()))
        return detection

    def _stored(self, time: datetime) -> deque[tuple[datetime, float, float]]:
        """Return when and where the sun was seen before this process began."""
        try:
            points = self.camera.archive.sightings.find(
                self.camera.name, until=time, newest_first=True, limit=_MAX_POSITIONS
            )
        except OutsideError as error:
            _log.warning("could not read earlier sightings: %s", error)
            points = ()
        suns = [p for p in points if _is_sun(p)]
        found = [(p.time, p.x_px, p.y_px) for p in suns if p.x_px is not None and p.y_px is not None]
        return deque(reversed(found), maxlen=_MAX_POSITIONS)


def _is_sun(sighting: Detection | SunPoint) -> bool:
    """Return whether a disc was fitted: only its place is never the same twice."""
    return sighting.accepted or sighting.verdict in {FROZEN, ELSEWHERE}


def _is_informative(image: Image) -> bool:
    """Return whether an image differs from a constant in more than a few pixels."""
    return int(np.count_nonzero(image != image.flat[0])) > _FEWEST_PIXELS


_CAPACITY = 20_000  # a week of two a cycle, and 10 MB
_AT_A_TIME = 200
_NOT_STORED = "sightings_not_stored"


@dataclass(eq=False)
class SightingWriteBuffer:
    """Buffer of sightings that are stored in order, and again later where storing failed.

    Parameters
    ----------
    archive : where they go.
    board : where those that wait are shown.
    capacity : how many may wait; then the oldest is dropped.
    """

    archive: Archive
    _: KW_ONLY
    board: StatusRegistry
    capacity: int = _CAPACITY

    def __post_init__(self) -> None:
        """Begin with no sighting waiting."""
        self._waiting: deque[SunPoint] = deque()
        self._lost = 0
        self._stored = 0

    @property
    def waiting(self) -> int:
        """Number of waiting sightings."""
        return len(self._waiting)

    @property
    def stored(self) -> int:
        """Number of sightings stored so far."""
        return self._stored

    def keep(self, point: SunPoint, *, store: bool = True) -> None:
        """Store a sighting, now or later; its pose epoch is found when it is stored.

        Parameters
        ----------
        point : the sighting.
        store : False leaves it to the next call of `keep` or `store`, so that several share a commit.
        """
        if len(self._waiting) >= self.capacity:
            self._waiting.popleft()
            self._lost += 1
        self._waiting.append(point)
        if store:
            self.store()

    def store(self) -> None:
        """Try to store the waiting sightings."""
        try:
            while self._waiting:
                some = [self._waiting[number] for number in range(min(len(self._waiting), _AT_A_TIME))]
                self.archive.sightings.add(some, first_epoch="first frame")
                # Removed after the commit: a row that is stored twice is ignored, one that is dropped early is lost.
                for _ in some:
                    self._waiting.popleft()
                self._stored += len(some)
        except OutsideError as error:
            reason = condition(_NOT_STORED, waiting=len(self._waiting), lost=self._lost, error=str(error))
            self.board.set_condition(_NOT_STORED, reason)
        else:
            self._lost = 0
            self.board.set_condition(_NOT_STORED, None)

    def give_up(self) -> None:
        """Log how many sightings are lost as the process ends."""
        if self._waiting:
            _log.error("%d sightings could not be stored and are lost", len(self._waiting))


_PERHAPS_ELSEWHERE = frozenset({"hidden", "reflection", "obstructed"})


class _FrameResult(NamedTuple):
    """A frame of the bracket: time, detection and prediction."""

    time: datetime
    detection: Detection
    expectation: Expectation | None


@dataclass(eq=False)
class DetectWorker:
    """Worker that detects the sun in each queued frame, and stores the sighting, accepted or rejected.

    Parameters
    ----------
    frames : the sun exposures, oldest first.
    keeper, camera : who stores the sightings, and under which name.
    predictor : where the sun should be.
    options, disc : the sensor, and the detector's settings.
    clock_error_s : bound of the error of a frame's time, seconds.
    report : called with every detection (for the exposure controller).
    board : where the time of the last sighting is shown.
    frozen : rejects sightings in images that the camera had delivered before.
    cadence_s : seconds from cycle to cycle; frames nearer than half of it are one bracket.
    checked : returns a detection at a time, or its rejection: the sun is behind an obstruction.
    """

    frames: DropOldestQueue[Frame]
    _: KW_ONLY
    keeper: SightingWriteBuffer
    camera: str
    predictor: SunPredictor
    options: SensorOptions
    disc: DiscOptions
    clock_error_s: Callable[[datetime], float]
    report: Callable[[Frame, Detection], None]
    board: StatusRegistry
    frozen: FrozenFrames
    cadence_s: float
    checked: Callable[[Detection, datetime], Detection] = lambda found, _time: found

    def __post_init__(self) -> None:
        """Begin without an exposure bracket."""
        self._bracket_of = timedelta(seconds=0.5 * self.cadence_s)
        self._bracket: list[_FrameResult] = []
        self._faults = TransferFaults(self.board)

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until stopped, and then until nothing waits."""
        for frame in entries(self.frames, stop, heartbeat):
            if frame is not None:
                self.process(frame)
            elif self.keeper.waiting:
                self.keeper.store()
        self.keeper.give_up()

    def process(self, frame: Frame) -> Detection:
        """Detect the sun in one frame, store the sighting and report it."""
        expectation = self.predictor.expectation(frame.time)
        detection = detect_sun(
            frame.image,
            sensor=frame_sensor(frame, self.options),
            expectation=expectation,
            options=self._disc_options(frame.time),
            exposure_us=frame.exposure_us,
        )
        detection = self._check_with_bracket(frame, detection, expectation)
        detection = self._search_elsewhere(frame, detection, expectation)
        detection = self.checked(self.frozen.checked(frame, detection), frame.time)
        self._faults.note(frame.image)
        point = make_sun_point(
            detection,
            camera=self.camera,
            pose_epoch="",
            time=frame.time,
            exposure_us=frame.exposure_us,
            clock_error_s=self.clock_error_s(frame.time),
        )
        # While frames wait, their sightings share a commit: on a device that stalls one each would fill the queue.
        self.keeper.keep(point, store=len(self.frames) == 0)
        self.report(frame, detection)
        if detection.accepted:
            self.board.note(last_sighting_at=frame.time)
        return detection

    def _check_with_bracket(self, frame: Frame, detection: Detection, expectation: Expectation | None) -> Detection:
        """Return the detection, checked against the cycle's earlier frames, and keep it for the later ones."""
        if self._bracket and not timedelta(0) <= frame.time - self._bracket[0].time < self._bracket_of:
            self._bracket = []
        earlier = tuple(self._bracket)
        self._bracket.append(_FrameResult(frame.time, detection, expectation))
        shifts = [_measure_sun_shift(result.expectation, expectation) for result in earlier]
        known = [shift for shift in shifts if shift is not None]
        complete = known if len(known) == len(shifts) else None
        return check_against_bracket([result.detection for result in earlier], detection, shifts=complete)

    def _search_elsewhere(self, frame: Frame, found: Detection, expectation: Expectation | None) -> Detection:
        """Return the detection, or a clean disc anywhere in a frame without one at its expected place."""
        if found.accepted or expectation is None or found.verdict not in _PERHAPS_ELSEWHERE:
            return found
        sensor, options = frame_sensor(frame, self.options), self._disc_options(frame.time)
        anywhere = detect_sun(frame.image, sensor=sensor, options=options, exposure_us=frame.exposure_us)
        if not anywhere.accepted:
            return found
        findings = (Finding("sun_elsewhere"), *found.findings)
        return replace(anywhere, accepted=False, verdict="elsewhere", findings=findings)

    def _disc_options(self, time: datetime) -> DiscOptions:
        """Return the detector's settings with the clear sun's level as it was learned, unless it was set."""
        if self.disc.clear_level_per_us:
            return self.disc
        return replace(self.disc, clear_level_per_us=self.predictor.clear_level_per_us(time))


def _measure_sun_shift(before: Expectation | None, now: Expectation | None) -> tuple[float, float] | None:
    """Return how far the sun moved, px; None where that is not known."""
    return None if before is None or now is None else (now.x_px - before.x_px, now.y_px - before.y_px)
