from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from sunarc.common.errors import InputError
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.workers.clock_watch import FrameTime

HOST = datetime(2026, 3, 1, 12, tzinfo=UTC)
SIMULATED = datetime(2013, 5, 13, 18, 0, 7, tzinfo=UTC)


def test_the_hosts_time_is_known_at_once() -> None:
    frame_time = FrameTime(VirtualClock(HOST), follows_camera=False)
    assert frame_time.is_known
    assert frame_time.now() == HOST


def test_the_cameras_time_is_known_after_its_first_frame_and_runs_on_at_its_speed() -> None:
    clock = VirtualClock(HOST)
    frame_time = FrameTime(clock, follows_camera=True, speed=60.0)
    assert not frame_time.is_known
    frame_time.note(SIMULATED)
    clock.advance(2.0)
    assert frame_time.now() == SIMULATED + timedelta(minutes=2)


def test_a_night_skipped_by_the_camera_is_followed() -> None:
    frame_time = FrameTime(VirtualClock(HOST), follows_camera=True, speed=60.0)
    frame_time.note(SIMULATED)
    frame_time.note(SIMULATED + timedelta(hours=10))
    assert frame_time.now() == SIMULATED + timedelta(hours=10)


def test_slots_are_whole_multiples_of_the_cadence_across_midnight_and_new_year() -> None:
    frame_time = FrameTime(VirtualClock(datetime(2025, 12, 31, 23, 59, 45, tzinfo=UTC)), follows_camera=False)
    assert frame_time.next_slot(every_s=30.0) == datetime(2026, 1, 1, tzinfo=UTC)


def test_the_wait_for_a_slot_is_shorter_for_a_faster_camera() -> None:
    frame_time = FrameTime(VirtualClock(HOST), follows_camera=True, speed=10.0)
    frame_time.note(SIMULATED)
    slot = frame_time.next_slot(every_s=30.0)
    assert slot == datetime(2013, 5, 13, 18, 0, 30, tzinfo=UTC)
    assert frame_time.real_seconds_until(slot) == pytest.approx(2.3)


def test_the_hosts_clock_cannot_be_made_faster() -> None:
    with pytest.raises(InputError, match=r"capture\.speed"):
        FrameTime(VirtualClock(HOST), follows_camera=False, speed=10.0)


def test_a_camera_that_is_slowed_is_followed_without_a_step() -> None:
    clock = VirtualClock(HOST)
    frame_time = FrameTime(clock, follows_camera=True, speed=60.0)
    frame_time.note(SIMULATED)
    clock.advance(2.0)
    frame_time.set_speed(30.0)
    assert frame_time.now() == SIMULATED + timedelta(seconds=120)
    clock.advance(2.0)
    assert frame_time.now() == SIMULATED + timedelta(seconds=180)
    assert frame_time.real_seconds_until(SIMULATED + timedelta(seconds=210)) == pytest.approx(1.0)
