"""What hides the sun is where it passes on clear days and is never seen; a cloud is not that."""

from __future__ import annotations

import cv2
import numpy as np

from sunarc.archives.passes import FoundSun, Looked
from sunarc.archives.results import HIDDEN, SEEN, UNKNOWN, learn_horizon
from sunarc.common.utc import DAY_S
from sunarc.detection.values import Expectation
from sunarc.sources.index import ArchiveImage

SIZE = (480, 480)
MAST = range(8, 12)
"""Places of the sun's way, of 30, that a mast hides."""


def looked_at(days: int, *, cloudy: frozenset[int] = frozenset()) -> tuple[Looked, list[Expectation | None]]:
    images, found, expected = [], [], list[Expectation | None]()
    for day in range(days):
        for place in range(30):
            images.append(ArchiveImage(round(1e6 * (day * DAY_S + 60.0 * place)), "a", place, "", None, ""))
            seen = place not in MAST and day not in cloudy
            found.append(FoundSun(seen, "clear" if seen else "hidden", 1.0, 1.0))
            expected.append(Expectation(x_px=15.0 + 15.0 * place, y_px=200.0 + day / 10.0))
    return Looked(tuple(images), tuple(found)), expected


def states_at(png: bytes, row: int) -> list[int]:
    mask = np.asarray(cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_GRAYSCALE))
    assert mask.shape == SIZE[::-1]
    return [int(mask[row, round(15.0 + 15.0 * place)]) for place in range(30)]


def test_a_mast_is_hidden_and_the_rest_of_the_suns_way_is_seen() -> None:
    horizon = learn_horizon(*looked_at(5), SIZE)
    assert states_at(horizon.png, 203) == [HIDDEN if place in MAST else SEEN for place in range(30)]
    assert states_at(horizon.png, 60) == [UNKNOWN] * 30
    assert (horizon.hidden, horizon.seen) == (4, 26)


def test_cloudy_days_hide_nothing() -> None:
    horizon = learn_horizon(*looked_at(5, cloudy=frozenset({0, 1, 2})), SIZE)
    assert (horizon.hidden, horizon.seen) == (0, 26)  # two clear days are too few


def test_where_the_sun_is_outside_nothing_is_learned() -> None:
    looked, expected = looked_at(5)
    assert learn_horizon(looked, [None] * len(expected), SIZE)[1:] == (0, 0)
