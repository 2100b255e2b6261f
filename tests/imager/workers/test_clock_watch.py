"""The clock that dates the frames, set and left without its time service."""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from tests.fixtures.archive import new_archive, store_sun_point
from tests.fixtures.calibrations import SITE

from sunarc.common.errors import InputError, OutsideError
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.runtime.clock import ClockState, VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.clock_watch import (
    LEAST_ERROR_S,
    SETTLE_S,
    SHOW_STEP_S,
    UNKNOWN_ERROR_S,
    ClockWatch,
    FrameTime,
)
from sunarc.imager.workers.options import ClockOptions

from .conftest import NOON

UNSYNCHRONISED = ClockState(synchronised=False, error_bound_s=16.0)
HOUR_S = 3600.0


@pytest.fixture
def archive(tmp_path: Path) -> Archive:
    return new_archive(tmp_path)


MakeWatch = Callable[..., ClockWatch]


@pytest.fixture
def watch_with(clock: VirtualClock, archive: Archive, board: StatusRegistry) -> MakeWatch:
    def make(
        *,
        options: ClockOptions | None = None,
        frame_time: FrameTime | None = None,
        camera_error_s: float | None = None,
        finds_steps: bool = True,
    ) -> ClockWatch:
        made = ClockWatch(
            frame_time=frame_time or FrameTime(clock, follows_camera=False),
            camera=CameraArchive(archive, name="roof", site=SITE),
            options=options or ClockOptions(),
            camera_error_s=camera_error_s,
            finds_steps=finds_steps,
            board=board,
        )
        made.check()
        return made

    return make


@pytest.fixture
def watch(watch_with: MakeWatch) -> ClockWatch:
    return watch_with()


def reasons(board: StatusRegistry) -> set[str]:
    return {reason.code for reason in board.snapshot().reasons}


def test_a_sighting_carries_the_kernels_bound_and_never_less_than_the_least(
    watch: ClockWatch, clock: VirtualClock
) -> None:
    clock.set_state(ClockState(synchronised=True, error_bound_s=0.3))
    assert watch.error_s(clock.now()) == 0.3
    clock.set_state(ClockState(synchronised=True, error_bound_s=0.0))  # as systemd-timesyncd leaves it
    assert watch.error_s(clock.now()) == LEAST_ERROR_S


def test_a_clock_without_its_time_service_has_no_bound_stops_calibration_and_says_so(
    watch: ClockWatch, clock: VirtualClock, board: StatusRegistry
) -> None:
    assert watch.trusted()
    assert reasons(board) == set()
    clock.set_state(UNSYNCHRONISED)
    watch.check()
    assert not watch.trusted()
    assert watch.error_s(clock.now()) == UNKNOWN_ERROR_S
    assert reasons(board) == {"clock_unsynchronised"}
    clock.set_state(ClockState(synchronised=True, error_bound_s=0.01))
    watch.check()
    assert watch.trusted()
    assert reasons(board) == set()


def test_an_operator_may_vouch_for_a_clock_that_the_kernel_knows_nothing_of(
    watch_with: MakeWatch, clock: VirtualClock, board: StatusRegistry
) -> None:
    clock.set_state(UNSYNCHRONISED)
    watch = watch_with(options=ClockOptions(assumed_error_s=0.05))
    assert watch.trusted()
    assert watch.error_s(clock.now()) == 0.05
    assert reasons(board) == set()


@pytest.mark.parametrize("step_s", [3.0, -3.0, 5 * HOUR_S, -5 * HOUR_S, 0.2])
def test_a_step_is_found_remembered_and_shown_for_a_while(
    watch: ClockWatch, clock: VirtualClock, archive: Archive, board: StatusRegistry, step_s: float
) -> None:
    clock.advance(1.0)
    watch.check()
    clock.advance(0.4)
    clock.step(step_s)
    clock.advance(0.6)
    watch.check()
    (event,) = archive.events.find("roof")
    assert event.kind == "clock_step"
    assert event.details["step_s"] == pytest.approx(step_s, abs=1e-6)
    assert event.details["noticed_within_s"] == pytest.approx(1.0)
    assert event.time == clock.now()
    status = board.snapshot().clock
    assert status is not None
    assert status.last_step_s == pytest.approx(step_s, abs=1e-6)
    assert reasons(board) - {"clock_settling"} == {"clock_stepped"}
    assert ("clock_settling" in reasons(board)) == (abs(step_s) >= 60.0)
    clock.advance(SHOW_STEP_S + 86_400.0)
    watch.check()
    assert reasons(board) == set()
    assert len(archive.events.find("roof")) == 1


@pytest.mark.parametrize("step_s", [7.0, -7.0])
def test_sightings_around_a_step_carry_its_size_whether_they_were_stored_before_or_after_it_was_found(
    watch: ClockWatch, clock: VirtualClock, archive: Archive, step_s: float
) -> None:
    long_before = clock.now() - timedelta(minutes=5)
    clock.advance(0.5)
    just_before = clock.now()
    for moment in (long_before, just_before):
        store_sun_point(archive, moment, clock_error_s=0.01)
    clock.step(step_s)
    just_after = clock.now()
    assert watch.error_s(just_after) == pytest.approx(7.0)
    assert watch.error_s(just_before) == pytest.approx(7.0)
    watch.check()
    assert {p.time: p.clock_error_s for p in archive.sightings.find("roof")} == {
        long_before: 0.01,
        just_before: pytest.approx(7.0),
    }
    clock.advance(20.0)
    assert watch.error_s(clock.now()) == LEAST_ERROR_S


def test_a_slew_of_500_ppm_for_a_day_is_no_step(watch: ClockWatch, clock: VirtualClock, archive: Archive) -> None:
    for _ in range(2000):
        clock.advance(30.0)
        clock.step(30.0 * 500e-6)
        watch.check()
    assert archive.events.find("roof") == ()


@pytest.mark.parametrize("step_s", [-1.0, 1.0])
def test_a_leap_second_is_no_step_but_its_second_is_in_doubt(
    watch: ClockWatch, clock: VirtualClock, archive: Archive, board: StatusRegistry, step_s: float
) -> None:
    clock.set_state(ClockState(synchronised=True, error_bound_s=0.01, leap_second=True))
    clock.advance(0.5)
    clock.step(step_s)
    within = clock.now()
    watch.check()
    assert archive.events.find("roof") == ()
    assert reasons(board) == set()
    assert watch.error_s(within) == pytest.approx(1.0)


def test_a_step_that_cannot_be_written_down_is_written_down_later(
    watch: ClockWatch, clock: VirtualClock, archive: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> int:
        raise OutsideError("cannot use the database: disk is full")

    clock.step(3.0)
    with monkeypatch.context() as patched:
        patched.setattr(archive.events, "add", full)
        watch.check()
    assert archive.events.find("roof") == ()
    watch.check()
    assert [event.kind for event in archive.events.find("roof")] == ["clock_step"]


@pytest.mark.parametrize(("days", "trusted"), [(1, True), (400, False)])
def test_a_start_long_after_the_record_is_distrusted_until_the_clock_has_settled(
    watch_with: MakeWatch, clock: VirtualClock, archive: Archive, *, days: int, trusted: bool
) -> None:
    store_sun_point(archive, clock.now() - timedelta(days=days), clock_error_s=0.01)
    watch = watch_with()
    assert watch.trusted() == trusted
    clock.advance(SETTLE_S + 1.0)
    watch.check()
    assert watch.trusted()


def test_a_clock_behind_the_record_is_distrusted_although_the_record_could_not_be_read_at_first(
    watch_with: MakeWatch, clock: VirtualClock, archive: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    def locked(*_: object, **__: object) -> None:
        raise OutsideError("cannot use the database: database is locked")

    store_sun_point(archive, clock.now() + timedelta(days=1), clock_error_s=0.01)
    with monkeypatch.context() as patched:
        patched.setattr(archive.database, "reading", locked)
        watch = watch_with()
    assert watch.trusted()
    watch.check()
    assert not watch.trusted()


def test_a_camera_whose_clock_falls_back_to_its_start_is_not_calibrated_with_until_it_is_right_again(
    watch_with: MakeWatch, clock: VirtualClock, archive: Archive, board: StatusRegistry
) -> None:
    frame_time = FrameTime(clock, follows_camera=True)
    frame_time.note(NOON)
    watch = watch_with(frame_time=frame_time, camera_error_s=0.001)
    for _ in range(20):  # frames come a little late
        clock.advance(30.0)
        frame_time.note(clock.now() - timedelta(seconds=0.3))
        watch.check()
    assert archive.events.find("roof") == ()
    frame_time.note(datetime.fromtimestamp(0.0, NOON.tzinfo))  # rebooted
    watch.check()
    assert watch.error_s(frame_time.now()) > 1e8
    assert not watch.trusted()
    assert reasons(board) == {"clock_stepped", "clock_unsynchronised"}
    frame_time.note(clock.now())  # has its PTP master again
    watch.check()
    assert watch.trusted()
    assert reasons(board) == {"clock_stepped"}
    clock.advance(60.0)
    assert watch.error_s(frame_time.now()) == 0.001


def dated_by_camera(
    watch_with: MakeWatch,
    clock: VirtualClock,
    *,
    offset_s: float,
    frames: int = 6,
    options: ClockOptions | None = None,
) -> tuple[ClockWatch, FrameTime]:
    """Return a watch after some frames of a camera whose clock is ahead of the host's."""
    frame_time = FrameTime(clock, follows_camera=True)
    frame_time.note(clock.now() + timedelta(seconds=offset_s), host_offset_s=offset_s)
    watch = watch_with(frame_time=frame_time, camera_error_s=0.001, options=options)
    for _ in range(frames):
        clock.advance(30.0)
        frame_time.note(clock.now() + timedelta(seconds=offset_s), host_offset_s=offset_s)
        watch.check()
    return watch, frame_time


def test_a_camera_that_tells_tai_is_named_with_the_setting_that_mends_it(
    watch_with: MakeWatch, clock: VirtualClock, archive: Archive, board: StatusRegistry
) -> None:
    watch, frame_time = dated_by_camera(watch_with, clock, offset_s=37.002)
    assert watch.error_s(frame_time.now()) == pytest.approx(37.002)
    assert not watch.trusted()
    (reason,) = board.snapshot().reasons
    assert reason.code == "camera_clock_offset"
    assert "TAI - UTC" in reason.text
    assert 'camera.timestamp_scale = "tai"' in reason.remedy
    assert [event.kind for event in archive.events.find("roof")] == ["camera_clock_offset"]
    clock.advance(30.0)
    for _ in range(4):  # after the setting was changed
        frame_time.note(clock.now(), host_offset_s=0.002)
    watch.check()
    assert "camera_clock_offset" not in reasons(board)


@pytest.mark.parametrize(
    ("offset_s", "bound_s", "shown", "trusted"),
    [
        (0.0004, 0.001, False, True),
        (0.3, 0.3, False, True),
        (0.7, 0.7, True, True),
        (-1.9, 1.9, True, True),
        (2.1, 2.1, True, False),
        (-37.0, 37.0, True, False),
    ],
)
def test_the_bound_of_a_camera_s_time_is_its_difference_from_the_host_s(
    watch_with: MakeWatch,
    clock: VirtualClock,
    board: StatusRegistry,
    *,
    offset_s: float,
    bound_s: float,
    shown: bool,
    trusted: bool,
) -> None:
    watch, frame_time = dated_by_camera(watch_with, clock, offset_s=offset_s)
    assert watch.error_s(frame_time.now()) == pytest.approx(bound_s)
    assert ("camera_clock_offset" in reasons(board)) == shown
    assert watch.trusted() == trusted
    assert ("TAI" in " ".join(r.text for r in board.snapshot().reasons)) == (abs(offset_s) > 30.0)


def test_one_late_trigger_widens_a_few_bounds_and_is_no_condition(
    watch_with: MakeWatch, clock: VirtualClock, board: StatusRegistry
) -> None:
    watch, frame_time = dated_by_camera(watch_with, clock, offset_s=0.002)
    frame_time.note(clock.now(), host_offset_s=0.9)
    watch.check()
    assert watch.error_s(frame_time.now()) == pytest.approx(0.9)
    assert reasons(board) == set()


def test_a_host_that_is_not_synchronised_says_nothing_of_the_camera(
    watch_with: MakeWatch, clock: VirtualClock, board: StatusRegistry
) -> None:
    clock.set_state(UNSYNCHRONISED)
    watch, frame_time = dated_by_camera(watch_with, clock, offset_s=100.0)
    assert watch.error_s(frame_time.now()) == 0.001
    assert reasons(board) == set()


@pytest.mark.parametrize("offset_s", [37.0, -37.0, 36.4])
@pytest.mark.parametrize("assumed_error_s", [None, 0.05, 5.0, 3600.0])
@pytest.mark.parametrize("synchronised", [True, False])
def test_tai_is_noticed_whatever_vouches_for_the_host(
    watch_with: MakeWatch,
    clock: VirtualClock,
    board: StatusRegistry,
    *,
    offset_s: float,
    assumed_error_s: float | None,
    synchronised: bool,
) -> None:
    clock.set_state(ClockState(synchronised=True, error_bound_s=0.01) if synchronised else UNSYNCHRONISED)
    options = ClockOptions(assumed_error_s=assumed_error_s)
    watch, frame_time = dated_by_camera(watch_with, clock, offset_s=offset_s, options=options)
    assert watch.error_s(frame_time.now()) >= 37.0
    assert not watch.trusted()
    (reason,) = board.snapshot().reasons
    assert reason.code == "camera_clock_offset"
    assert "camera.timestamp_scale" in reason.remedy


@pytest.mark.parametrize(
    ("offset_s", "bound_s", "shown"),
    [(0.04, 0.001, False), (0.3, 0.35, False), (0.7, 0.75, True), (-600.0, 600.05, True)],
)
def test_a_host_that_the_operator_vouches_for_is_compared_with_within_that_bound(
    watch_with: MakeWatch, clock: VirtualClock, board: StatusRegistry, *, offset_s: float, bound_s: float, shown: bool
) -> None:
    clock.set_state(UNSYNCHRONISED)
    options = ClockOptions(assumed_error_s=0.05)
    watch, frame_time = dated_by_camera(watch_with, clock, offset_s=offset_s, options=options)
    assert watch.error_s(frame_time.now()) == pytest.approx(bound_s)
    assert ("camera_clock_offset" in reasons(board)) == shown


@pytest.mark.parametrize("behind_s", [90.0, 1800.0, 6 * HOUR_S])
@pytest.mark.parametrize("assumed_error_s", [None, 0.5])
def test_a_camera_whose_clock_resumes_at_its_last_time_each_day_never_dates_a_sighting_surely(
    watch_with: MakeWatch, clock: VirtualClock, board: StatusRegistry, *, behind_s: float, assumed_error_s: float | None
) -> None:
    """Each day it is rebooted, and ten minutes later right again; the service goes on, or is started with it."""
    if assumed_error_s is not None:
        clock.set_state(UNSYNCHRONISED)
    options = ClockOptions(assumed_error_s=assumed_error_s)
    for day in range(4):
        if day != 2:
            frame_time = FrameTime(clock, follows_camera=True)
            frame_time.note(clock.now() - timedelta(seconds=behind_s), host_offset_s=-behind_s)
            watch = watch_with(frame_time=frame_time, camera_error_s=0.001, options=options)
        for slot in range(40):
            clock.advance(30.0)
            off_s = -behind_s if slot < 20 else 0.0
            frame_time.note(clock.now() + timedelta(seconds=off_s), host_offset_s=off_s)
            watch.check()
            error_s = watch.error_s(frame_time.now())
            assert error_s >= abs(off_s)
            if 5 < slot < 20:
                assert not watch.trusted()
                assert "camera_clock_offset" in reasons(board)
        assert watch.trusted()
        assert error_s < 1.0
        assert "camera_clock_offset" not in reasons(board)
        clock.advance(86_400.0 - 1200.0)


def test_a_replay_may_jump(watch_with: MakeWatch, clock: VirtualClock, archive: Archive) -> None:
    frame_time = FrameTime(clock, follows_camera=True)
    watch = watch_with(frame_time=frame_time, camera_error_s=0.001, finds_steps=False)
    for day in range(3):
        frame_time.note(NOON + timedelta(days=day))
        watch.check()
    assert archive.events.find("roof") == ()
    assert watch.trusted()


def test_it_runs_until_stopped(watch: ClockWatch, clock: VirtualClock) -> None:
    stop = threading.Event()
    watch.run(stop, lambda: stop.set() if clock.monotonic() > 10.0 else None)
    assert clock.monotonic() >= 10.0


def test_durations_that_are_none_are_refused() -> None:
    with pytest.raises(InputError, match="clock"):
        ClockOptions(step_s=0.0)
