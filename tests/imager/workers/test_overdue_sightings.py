"""Ten slots with the sun up and nothing stored are a condition, whatever the cause."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta

import pytest

from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.capture_status import OverdueSightings
from sunarc.imager.workers.clock_watch import FrameTime

CADENCE_S = 30.0


@dataclass
class Sky:
    stored: int = 0
    zenith: float = 40.0


def overdue(
    clock: VirtualClock, board: StatusRegistry, sky: Sky, frame_time: FrameTime | None = None
) -> OverdueSightings:
    return OverdueSightings(
        stored=lambda: sky.stored,
        apparent_zenith=lambda: sky.zenith,
        clock=clock,
        frame_time=frame_time or FrameTime(clock, follows_camera=False),
        cadence_s=CADENCE_S,
        board=board,
    )


def codes(board: StatusRegistry) -> list[str]:
    return [reason.code for reason in board.snapshot().reasons]


def test_ten_slots_without_a_sighting_are_degraded_and_one_ends_it(clock: VirtualClock, board: StatusRegistry) -> None:
    sky = Sky()
    check = overdue(clock, board, sky).check
    check()
    clock.advance(10.0 * CADENCE_S - 1.0)
    check()
    assert codes(board) == []
    clock.advance(1.0)
    check()
    (reason,) = board.snapshot().reasons
    assert (reason.code, reason.severity) == ("no_sightings", "degraded")
    assert reason.data == {"slots": 10}
    sky.stored = 1
    check()
    assert codes(board) == []


@pytest.mark.parametrize(("zenith", "expected"), [(79.0, ["no_sightings"]), (81.0, [])])
def test_only_slots_with_the_sun_up_count(
    clock: VirtualClock, board: StatusRegistry, zenith: float, expected: list[str]
) -> None:
    sky = Sky(zenith=zenith)
    check = overdue(clock, board, sky).check
    check()
    clock.advance(3600.0)
    check()
    assert codes(board) == expected
    sky.zenith = 85.0
    check()
    assert codes(board) == []  # nothing is due any more


def test_a_stepped_wall_clock_says_nothing(clock: VirtualClock, board: StatusRegistry) -> None:
    check = overdue(clock, board, Sky()).check
    check()
    clock.step(7200.0)
    check()
    assert codes(board) == []


def test_nothing_is_due_before_a_camera_has_told_its_time(clock: VirtualClock, board: StatusRegistry) -> None:
    frame_time = FrameTime(clock, follows_camera=True, speed=10.0)
    check = overdue(clock, board, Sky(), frame_time).check
    clock.advance(3600.0)
    check()
    assert codes(board) == []
    frame_time.note(clock.now() + timedelta(seconds=1))
    clock.advance(CADENCE_S - 1.0)  # ten slots of a camera that is ten times as fast
    check()
    assert codes(board) == []
    clock.advance(1.0)
    check()
    assert codes(board) == ["no_sightings"]
