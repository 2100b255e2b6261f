"""Cameras that repeat their images, or lose rows or bits of them: found, and shown as conditions."""

from __future__ import annotations

import logging
from collections import deque
from datetime import datetime, timedelta
from typing import NamedTuple

import numpy as np

from sunarc.common.array_types import Image
from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imaging.image_tiles import ImageTiles, differs_by_noise, is_same_sun, is_same_texture, shared_texture
from sunarc.imaging.transfer_faults import count_missing_levels, repeated_rows
from sunarc.sky.directions import angular_distance
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

_log = logging.getLogger(__name__)
_FROZEN_CODE = "camera_frozen"
_LASTING = 3
_SUN_MOVED_RAD = float(np.radians(0.02))
"""The sun moves so far in 5 s, which is 0.1 px of the coarsest lens."""
_MOST_IMAGES = 16
_NOISE_SHARE, _NOISE_PAIRS = 0.02, 10
"""Of the textured tiles, in common at most to so many pairs in a row: the camera's noise reaches all of its images."""
_GLARE_CHANGES = timedelta(minutes=10)
"""Bound of the changes of the sun's surroundings, by 2.5 degrees."""
_SUN_EVERY, _TRACK, _MOST_SUNS = timedelta(minutes=1), timedelta(hours=1), 60
_FEWEST_SUNS = 4
_LEAST_MOVED_PX, _OFF_PX, _OFF_SIGMAS = 1.5, 1.0, 4.0
"""A track that moved less, or less than so many of its own residuals, may be a lamp's."""


def sun_moved(earlier: datetime, later: datetime, site: Site) -> bool:
    """Return whether the sun moved between two times as far as an image shows."""
    before, now = sun_directions(np.array([earlier.timestamp(), later.timestamp()]), site)
    return bool(float(angular_distance(before, now)) > _SUN_MOVED_RAD)


class Repetition(NamedTuple):
    """Time at which the same image came before, and whether a live camera cannot have sent it twice."""

    time: datetime
    is_sure: bool


class RepeatedImages:
    """Search for images that came before, also where text in them has changed.

    An image with a sun repeats an earlier one where all around the sun is the same: the sun moved. It is sure that the
    camera stands still where the image has noise, in itself or by the earlier ones; or, after a time, where the images
    before showed the sun move to where it stands: a lamp may be taken for it. Without noise a still sky without a sun
    gives the same image for hours: it says nothing.

    Parameters
    ----------
    site : the camera's, for the sun's movement.
    noisy : whether no image of the camera can come again by chance; False learns it from the images.
    """

    def __init__(self, site: Site, *, noisy: bool = False) -> None:
        self._site = site
        self._pairs = _NOISE_PAIRS if noisy else 0
        self._images: deque[tuple[datetime, ImageTiles]] = deque(maxlen=_MOST_IMAGES)
        self._suns: deque[tuple[datetime, float, float]] = deque(maxlen=_MOST_SUNS)

    def remember_sun(self, time: datetime, sun: tuple[float, float]) -> None:
        """Store the place of the sun in a new image, x and y px."""
        if not self._suns or time - self._suns[-1][0] >= _SUN_EVERY:
            self._suns.append((time, *sun))

    def earlier(self, tiles: ImageTiles, time: datetime, sun: tuple[float, float] | None) -> Repetition | None:
        """Return when the same image came before; None for a new one, which is remembered.

        Parameters
        ----------
        tiles, time : of the image.
        sun : where a sun was found in it, x and y px.
        """
        for before, image in self._images:
            found = None if before == time else self.compared(tiles, image, before, time, sun)
            if found is not None:
                return found
        if self._images:
            self._learn_noise(tiles, self._images[-1][1])
        self._images.append((time, tiles))
        if sun is not None:
            self.remember_sun(time, sun)
        return None

    def compared(
        self, now: ImageTiles, image: ImageTiles, before: datetime, time: datetime, sun: tuple[float, float] | None
    ) -> Repetition | None:
        """Return whether an image repeats that of a time before; None where it does not, or it may be by chance."""
        apart = abs(time - before)
        noisy = self._pairs >= _NOISE_PAIRS or (now.has_noise and image.has_noise)
        if noisy and is_same_texture(now, image):
            return Repetition(before, is_sure=True)
        if sun is None or not is_same_sun(now, image, sun) or not sun_moved(before, time, self._site):
            return None
        return Repetition(before, is_sure=noisy or (apart >= _GLARE_CHANGES and self._is_on_earlier_path(before, sun)))

    def _is_on_earlier_path(self, time: datetime, sun: tuple[float, float]) -> bool:
        """Return whether the sun's places of the hour before a time led to its place in that image."""
        track = [(-(time - at).total_seconds(), x, y) for at, x, y in self._suns if time - _TRACK <= at < time]
        if len(track) < _FEWEST_SUNS:
            return False
        seconds, x, y = np.array(track).T
        lines = np.polyfit(seconds / 60.0, np.stack([x, y], axis=-1), 1)
        residuals = np.stack([x, y], axis=-1) - (seconds[:, None] / 60.0 * lines[0] + lines[1])
        sigma_px = float(np.sqrt(np.mean(np.sum(residuals**2, axis=-1))))
        moved_px = float(np.hypot(*lines[0])) * float(np.ptp(seconds)) / 60.0
        off_px = float(np.hypot(*(lines[1] - np.array(sun))))
        return moved_px >= max(_LEAST_MOVED_PX, _OFF_SIGMAS * sigma_px) and off_px <= _OFF_PX + _OFF_SIGMAS * sigma_px

    def _learn_noise(self, now: ImageTiles, before: ImageTiles) -> None:
        """Learn the noise from images that have nothing in common; changing light may be another cause."""
        shared = shared_texture(now, before)
        if shared is None:
            return
        if shared > _NOISE_SHARE:
            self._pairs = 0 if self._pairs < _NOISE_PAIRS else self._pairs
        elif differs_by_noise(now, before):
            self._pairs += 1


class FrozenAlarm:
    """Condition of a camera that repeats its images, set after three in a row.

    Parameters
    ----------
    camera : whose archive gets the event.
    board : where the condition is set.
    """

    def __init__(self, camera: CameraArchive, board: StatusRegistry) -> None:
        self._camera, self._board = camera, board
        self._in_a_row = 0

    def note(self, time: datetime, earlier: datetime) -> None:
        """Count an image that repeats an earlier one."""
        self._in_a_row += 1
        if self._in_a_row < _LASTING:
            return
        found = Finding(_FROZEN_CODE, {"n": self._in_a_row, "time": earlier.isoformat(timespec="seconds")})
        self._board.set_condition(_FROZEN_CODE, Reason.of(found), log=False)
        if self._in_a_row == _LASTING:
            try:
                self._camera.add_event(found, time=time, severity="alarm")
            except OutsideError as error:
                _log.warning("could not store an event: %s", error)

    def clear(self) -> None:
        """Begin anew after a new image."""
        self._in_a_row = 0
        self._board.set_condition(_FROZEN_CODE, None)


_TRANSFER_CODES = ("image_rows_repeated", "image_levels_missing")


class TransferFaults:
    """Condition of a camera whose images have lost rows or bits, set after three in a row.

    Parameters
    ----------
    board : where the conditions are set.
    """

    def __init__(self, board: StatusRegistry) -> None:
        self._board = board
        self._in_a_row = 0

    def note(self, image: Image) -> None:
        """Check an image, and count it."""
        rows = repeated_rows(image)
        levels = 0 if rows else count_missing_levels(image)
        found = Finding("image_rows_repeated", {"n": rows}) if rows else Finding("image_levels_missing", {"n": levels})
        self._in_a_row = self._in_a_row + 1 if rows or levels else 0
        if self._in_a_row == 0:
            self._board.set_one_condition(_TRANSFER_CODES, None)
        elif self._in_a_row >= _LASTING:
            self._board.set_one_condition(_TRANSFER_CODES, Reason.of(found))
