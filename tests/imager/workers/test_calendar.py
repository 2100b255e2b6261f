"""Slots are multiples of the cadence since 1970 in UTC: no calendar moves them."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from itertools import pairwise

import pytest

from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.workers.clock_watch import FrameTime


@pytest.mark.parametrize(
    "moment",
    [
        datetime(2016, 12, 31, 23, 59, 59, 500_000, tzinfo=UTC),  # the last leap second followed
        datetime(2026, 3, 29, 0, 59, 59, tzinfo=UTC),  # summer time begins in Europe
        datetime(2026, 10, 25, 0, 59, 59, tzinfo=UTC),  # and ends
        datetime(2026, 12, 31, 23, 59, 59, tzinfo=UTC),
        datetime(2028, 2, 28, 23, 59, 59, tzinfo=UTC),
    ],
)
def test_slots_go_on_every_thirty_seconds(moment: datetime) -> None:
    clock = VirtualClock(moment)
    time = FrameTime(clock, follows_camera=False)
    slots = []
    for _ in range(5):
        slots.append(time.next_slot(every_s=30.0))
        clock.advance(time.real_seconds_until(slots[-1]) + 1.0)
    assert slots[0] - moment <= timedelta(seconds=1)
    assert all(slot.timestamp() % 30.0 == 0.0 for slot in slots)
    assert [later - earlier for earlier, later in pairwise(slots)] == [timedelta(seconds=30)] * 4
