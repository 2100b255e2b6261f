"""Detection of repeated images and discs: the noise of two frames, and the sun's pixel in them, are never equal."""

from __future__ import annotations

import hashlib
import logging
import threading
from collections import OrderedDict, deque
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from sunarc.archive.camera_archive import CameraArchive
from sunarc.archive.sighting_revisions import ELSEWHERE, FROZEN
from sunarc.archive.values import SunPoint
from sunarc.array_types import Image
from sunarc.cameras.frame import Frame
from sunarc.detection.values import Detection
from sunarc.errors import OutsideError
from sunarc.findings import Finding
from sunarc.runtime.status import Reason, StatusRegistry
from sunarc.sky.directions import angular_distance
from sunarc.sky.sun import sun_directions
from sunarc.workers.messages import MESSAGES

_log = logging.getLogger(__name__)
_MAX_IMAGES = 256
"""Digests of 16 bytes; a cycle has about eight frames."""
_MAX_POSITIONS = 32
_FEWEST_PIXELS = 100
"""An image that differs from a constant in fewer pixels (hot ones) may truly come again: black, without noise."""
_SAME_PX = 1e-6
"""Two fits of the disc to images with noise differ by a thousand times more."""
_SUN_MOVED_RAD = np.radians(0.02)
"""The sun moves so far in 5 s, which is 0.1 px of the coarsest lens."""
_HALF_PX = 6  # around the disc
_FEWEST_LIT = 10
"""Pixels of the disc, not saturated: with their noise, and a sun that moves, so many are never all equal by chance."""
_LIT, _LEAST_COUNTS, _SATURATED = 0.1, 3.0, 0.98
_LASTING = 3
_CODE = "camera_frozen"


@dataclass(frozen=True, slots=True)
class _Position:
    time: datetime
    x_px: float
    y_px: float


@dataclass(frozen=True, slots=True, eq=False)
class _Disc:
    """The pixels around a disc as they were delivered, and their place in the image."""

    time: datetime
    place: tuple[slice, slice]
    pixels: Image

    def is_in(self, frame: Frame) -> bool:
        """Return whether a frame has these very pixels."""
        here = frame.image[self.place]
        if here.shape != self.pixels.shape or self.pixels.size == 0:
            return False
        above = self.pixels - float(np.median(self.pixels))
        lit = (above >= max(_LIT * float(above.max()), _LEAST_COUNTS)) & (self.pixels < _SATURATED * frame.full_scale)
        if np.count_nonzero(lit) < _FEWEST_LIT:
            return False
        return bool(np.array_equal(here[lit], self.pixels[lit]))


class FrozenFrames:
    """Rejects sightings in images that were delivered before, and reports a camera that repeats its images.

    Parameters
    ----------
    camera : its archive and site.
    board : where a camera that repeats its images is shown.
    """

    def __init__(self, camera: CameraArchive, *, board: StatusRegistry) -> None:
        self._camera = camera
        self._board = board
        self._lock = threading.Lock()
        self._images: OrderedDict[bytes, datetime] = OrderedDict()
        self._positions: deque[_Position] | None = None
        self._discs: deque[_Disc] = deque(maxlen=_MAX_POSITIONS)
        self._in_a_row = 0

    def remember(self, frame: Frame) -> None:
        """Take note of a frame that may never be searched for the sun; a later one with its image is a copy.

        Called by capture for every frame: probes, normal exposures and discarded cycles are images that a camera can
        deliver again too.
        """
        self._same_image(frame)

    def checked(self, frame: Frame, detection: Detection) -> Detection:
        """Return the detection, or its rejection where the frame repeats an earlier one."""
        earlier = self._same_image(frame)
        if earlier is None:
            earlier = self._same_position(frame.time, detection)
        if earlier is None:
            if self._in_a_row and _is_informative(frame.image):
                self._clear()
            return self._without_earlier_disc(frame, detection)
        self._count(frame.time, earlier)
        repeated = Finding("frame_repeated", {"time": earlier.isoformat(timespec="seconds")})
        return replace(detection, accepted=False, verdict=FROZEN, findings=(repeated,))

    def _same_image(self, frame: Frame) -> datetime | None:
        """Return the time of an earlier frame with the same bytes; None where there is none, or they say nothing."""
        if not _is_informative(frame.image):
            return None
        digest = hashlib.blake2b(np.ascontiguousarray(frame.image).data, digest_size=16).digest()
        with self._lock:
            earlier = self._images.setdefault(digest, frame.time)
            self._images.move_to_end(digest)
            if len(self._images) > _MAX_IMAGES:
                self._images.popitem(last=False)
        return None if earlier == frame.time else earlier  # the frame itself; a replay may play the same file twice

    def _same_position(self, time: datetime, detection: Detection) -> datetime | None:
        """Return when the sun was seen in exactly the same place though it has moved since; None where it was not."""
        if detection.x_px is None or detection.y_px is None or not _is_sun(detection):
            return None
        if self._positions is None:
            self._positions = self._stored(time)
        x_px, y_px = detection.x_px, detection.y_px
        for position in self._positions:
            if abs(position.x_px - x_px) < _SAME_PX and abs(position.y_px - y_px) < _SAME_PX:
                before, now = sun_directions(np.array([position.time.timestamp(), time.timestamp()]), self._camera.site)
                if float(angular_distance(before, now)) > _SUN_MOVED_RAD:
                    return position.time
        self._positions.append(_Position(time, x_px, y_px))
        return None

    def _without_earlier_disc(self, frame: Frame, detection: Detection) -> Detection:
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
        self._discs.append(_Disc(frame.time, place, frame.image[place].copy()))
        return detection

    def _stored(self, time: datetime) -> deque[_Position]:
        """Return where the sun was seen before this process began."""
        try:
            points = self._camera.sun_points(until=time, newest_first=True, limit=_MAX_POSITIONS)
        except OutsideError as error:
            _log.warning("could not read earlier sightings: %s", error)
            points = ()
        suns = [p for p in points if _is_sun(p)]
        found = [_Position(p.time, p.x_px, p.y_px) for p in suns if p.x_px is not None and p.y_px is not None]
        return deque(reversed(found), maxlen=_MAX_POSITIONS)

    def _count(self, time: datetime, earlier: datetime) -> None:
        self._in_a_row += 1
        if self._in_a_row < _LASTING:
            return
        finding = Finding(_CODE, {"n": self._in_a_row, "time": earlier.isoformat(timespec="seconds")})
        self._board.set_condition(_CODE, Reason.of(finding, MESSAGES), log=False)
        if self._in_a_row == _LASTING:
            self._store(finding, time)

    def _clear(self) -> None:
        self._in_a_row = 0
        self._board.set_condition(_CODE, None)

    def _store(self, finding: Finding, time: datetime) -> None:
        try:
            self._camera.add_event(finding, MESSAGES, time=time, severity="alarm")
        except OutsideError as error:
            _log.warning("could not store an event: %s", error)


def _is_sun(sighting: Detection | SunPoint) -> bool:
    """Return whether a disc was fitted: only its place is never the same twice."""
    return sighting.accepted or sighting.verdict in {FROZEN, ELSEWHERE}


def _is_informative(image: Image) -> bool:
    """Return whether an image differs from a constant in more than a few pixels."""
    return int(np.count_nonzero(image != image.flat[0])) > _FEWEST_PIXELS
