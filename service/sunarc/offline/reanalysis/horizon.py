"""Where the sun passes and is never seen unhidden: masts, trees, roofs, as a mask of the image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.detection.values import Expectation
from sunarc.offline.reanalysis.passes import Looked, Sun
from sunarc.utc import DAY_S

_CELLS = 48
"""Cells across the shorter side: wider than the sun's glare in most images, narrower than a tree."""
_FEWEST_DAYS = 3
"""Clear days on which the sun has to pass a cell unseen: clouds hide it at the same place on one day, not on three."""
_CLEAR_SHARE = 0.4
SEEN, UNKNOWN, HIDDEN = 255, 128, 0
"""Values of the mask: the sun was seen here, never passed here on enough clear days, passes here and is never seen."""


class Horizon(NamedTuple):
    """A mask as a PNG, and how many cells of it the sun was seen in, and how many hide it."""

    png: bytes
    seen: int
    hidden: int


def learn_horizon(looked: Looked, expected: Sequence[Expectation | None], size: tuple[int, int]) -> Horizon:
    """Return what hides the sun in a camera's images.

    Parameters
    ----------
    looked : the images, and what was found in them.
    expected : where the sun should have been in each.
    size : width and height of the images, px.
    """
    cell = min(size) / _CELLS
    shape = int(np.ceil(size[1] / cell)), int(np.ceil(size[0] / cell))
    rows = [row for row, one in enumerate(expected) if one is not None]
    pixels = np.array([_pixel(expected[row]) for row in rows]).reshape(-1, 2)
    days = np.array([looked.images[row].unix_s // DAY_S for row in rows])
    seen = np.array([_is_seen(looked, row) for row in rows], dtype=bool)
    state = np.full(shape, UNKNOWN, dtype=np.uint8)
    place = np.clip((pixels[:, ::-1] / cell).astype(int), 0, np.array(shape) - 1)
    clear = {day: float(np.mean(seen[days == day])) >= _CLEAR_SHARE for day in np.unique(days).tolist()}
    for row, column in np.unique(place, axis=0).tolist():
        here = np.all(place == (row, column), axis=1)
        if np.any(seen[here]):
            state[row, column] = SEEN
        elif sum(clear[day] for day in np.unique(days[here]).tolist()) >= _FEWEST_DAYS:
            state[row, column] = HIDDEN
    whole = cv2.resize(state, size, interpolation=cv2.INTER_NEAREST)
    png = cv2.imencode(".png", whole)[1].tobytes()
    return Horizon(png, int(np.count_nonzero(state == SEEN)), int(np.count_nonzero(state == HIDDEN)))


def _pixel(one: Expectation | None) -> tuple[float, float]:
    return (0.0, 0.0) if one is None else (one.x_px, one.y_px)


def _is_seen(looked: Looked, row: int) -> bool:
    found = looked.found[row]
    return isinstance(found, Sun) and found.accepted
