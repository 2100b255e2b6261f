"""When a change was: between the last sighting before it and the first that agrees with it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sunarc.calibration.model.pose_change import PoseChange
from sunarc.changes.online import change_details, describe_change

TIMES = 1000.0 + 60.0 * np.arange(10)


class _Watch:
    unix_s = TIMES

    def __len__(self) -> int:
        return int(TIMES.size)


def described(first: int, inlier: list[int], *, alike: list[int]) -> PoseChange:
    """Describe a mirrored image, a change without a size."""
    window: Any = SimpleNamespace(watch=_Watch(), error_model=SimpleNamespace(selected=(), rotation=slice(0, 3)))
    mask = np.zeros(TIMES.size, dtype=np.bool_)
    mask[inlier] = True
    return describe_change(
        window,
        cast("Any", SimpleNamespace(kind="mirrored", first=first)),
        cast("Any", SimpleNamespace(inlier=mask)),
        gain=12.0,
        alike=alike,
    )


@pytest.mark.parametrize(
    ("first", "inlier", "alike", "times"),
    [
        (4, [4, 5, 6], [], (3, 4, 4)),  # from the sighting before the first that agrees
        (4, [6, 7], [], (3, 6, 6)),  # the first two were outliers
        (4, [4, 5], [2, 6], (1, 4, 6)),  # others explain nearly as well
        (0, [0, 1], [], (0, 0, 0)),  # nothing before
    ],
)
def test_a_change_is_dated_between_sightings(
    first: int, inlier: list[int], alike: list[int], times: tuple[int, int, int]
) -> None:
    change = described(first, inlier, alike=alike)
    found = (change.bracket[0], change.time, change.bracket[1])
    assert found == tuple(TIMES[number] for number in times)


def test_those_that_agree_are_counted_from_the_change_on() -> None:
    change = described(4, [1, 4, 5, 8], alike=[])
    assert (change_details(change)["agreeing"], change_details(change)["of"], change.gain) == (3, 6, 12.0)
    assert (change_details(change)["size"], change_details(change)["size_sigma"]) == (0.0, 0.0)
