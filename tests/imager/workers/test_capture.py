from __future__ import annotations

import re
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.cameras import INFO

from sunarc.common.errors import CameraError, CameraLostError, CameraTimeoutError
from sunarc.imager.cameras.frame import Frame, SkyCamera
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.capture import CaptureWorker
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.imager.workers.exposures import SunExposures
from sunarc.imager.workers.night.exposures import NightCapture, NightExposures
from sunarc.imager.workers.options import CaptureOptions
from sunarc.imaging.exposure import SunExposureOptions

if TYPE_CHECKING:
    from .conftest import FakeCamera

HDR = [3_000.0, 12_000.0, 48_000.0]
SUN = [20.0, 80.0]  # the controller's first bracket


@dataclass
class Bench:
    worker: CaptureWorker
    cycles: DropOldestQueue[Sequence[Frame]]
    sun_frames: DropOldestQueue[Frame]
    stop: threading.Event

    def run_until(self, reached: Callable[[], bool]) -> None:
        """Run the loop, and stop it from its own heartbeat."""
        turns = 0

        def heartbeat() -> None:
            nonlocal turns
            turns += 1
            if reached() or turns > 10_000:
                self.stop.set()

        self.worker.run(self.stop, heartbeat)
        assert reached(), "the loop ran without end"


MakeBench = Callable[..., Bench]


@pytest.fixture
def bench(clock: VirtualClock, board: StatusRegistry, camera: FakeCamera) -> MakeBench:
    def make(
        *,
        zenith: float = 20.0,
        open_camera: Callable[[], SkyCamera] = lambda: camera,
        night: NightCapture | None = None,
    ) -> Bench:
        cycles: DropOldestQueue[Sequence[Frame]] = DropOldestQueue(capacity=100)
        sun_frames: DropOldestQueue[Frame] = DropOldestQueue(capacity=100)
        worker = CaptureWorker(
            open_camera=open_camera,
            clock=clock,
            frame_time=FrameTime(clock, follows_camera=False),
            options=CaptureOptions(),
            name="roof",
            apparent_zenith=lambda: zenith,
            sun_exposures=SunExposures(SunExposureOptions()),
            cycles=cycles,
            sun_frames=sun_frames,
            board=board,
            night=night,
        )
        return Bench(worker, cycles, sun_frames, threading.Event())

    return make


def reasons(board: StatusRegistry) -> set[str]:
    return {reason.code for reason in board.snapshot().reasons}


def test_the_normal_exposures_come_first_at_their_slot_and_then_the_sun(bench: MakeBench, camera: FakeCamera) -> None:
    made = bench()
    made.run_until(lambda: len(camera.exposures) >= 10)
    assert [exposure for _, exposure in camera.exposures[:5]] == HDR + SUN
    starts = [at for at, exposure in camera.exposures if exposure == HDR[0]]
    assert starts == pytest.approx([20.0, 50.0])  # the test begins 10 s after a slot
    assert [frame.exposure_us for frame in made.cycles.get(timeout_s=0.0) or ()] == HDR
    assert len(made.sun_frames) == 4
    assert camera.closed == 1


def test_at_night_one_exposure_every_ten_minutes_shows_that_the_camera_lives(
    bench: MakeBench, camera: FakeCamera
) -> None:
    made = bench(zenith=120.0)
    made.run_until(lambda: len(camera.exposures) >= 3)
    starts = [at for at, _ in camera.exposures]
    assert starts[1] - starts[0] == pytest.approx(600.0)
    assert len(made.cycles) == 0
    assert len(made.sun_frames) == 0


@pytest.mark.parametrize(("zenith", "exposure_us", "count"), [(101.9, 48_000.0, 0), (102.1, 5e6, 4)])
def test_stars_are_looked_at_once_the_sun_is_twelve_degrees_below_the_horizon(
    bench: MakeBench, camera: FakeCamera, zenith: float, exposure_us: float, count: int
) -> None:
    frames: DropOldestQueue[Frame] = DropOldestQueue(capacity=100)
    camera.info = replace(INFO, exposure_max_us=60e6)
    made = bench(zenith=zenith, night=NightCapture(NightExposures(), frames))
    made.run_until(lambda: len(camera.exposures) >= 4)
    assert [exposure for _, exposure in camera.exposures] == [exposure_us] * 4
    assert len(frames) == count
    assert len(made.cycles) == 0


def test_a_night_exposure_that_fails_is_no_frame_and_the_camera_goes_on(bench: MakeBench, camera: FakeCamera) -> None:
    frames: DropOldestQueue[Frame] = DropOldestQueue(capacity=100)
    camera.info = replace(INFO, exposure_max_us=1e6)
    camera.faults = [None, CameraTimeoutError("late"), CameraTimeoutError("late")]
    made = bench(zenith=120.0, night=NightCapture(NightExposures(), frames))
    made.run_until(lambda: len(camera.exposures) >= 5)
    assert {exposure for _, exposure in camera.exposures} == {1e6}
    assert len(frames) == 3


def test_a_low_sun_gets_no_exposures_of_its_own(bench: MakeBench, camera: FakeCamera) -> None:
    made = bench(zenith=92.0)
    made.run_until(lambda: len(camera.exposures) >= 3)
    assert len(made.sun_frames) == 0
    assert len(made.cycles) == 1


def test_a_frame_that_fails_once_is_taken_again(bench: MakeBench, camera: FakeCamera) -> None:
    camera.faults = [None, CameraTimeoutError("late")]
    made = bench()
    made.run_until(lambda: len(made.cycles) >= 1)
    assert [frame.exposure_us for frame in made.cycles.get(timeout_s=0.0) or ()] == HDR
    assert [exposure for _, exposure in camera.exposures[:4]] == [3_000.0, 12_000.0, 12_000.0, 48_000.0]


def test_a_cycle_that_lacks_an_exposure_makes_no_composite_but_still_looks_at_the_sun(
    bench: MakeBench, camera: FakeCamera, board: StatusRegistry
) -> None:
    camera.faults = [None, CameraTimeoutError("late"), CameraError("torn"), None]
    made = bench()
    made.run_until(lambda: len(made.sun_frames) == 2)
    assert [exposure for _, exposure in camera.exposures] == [3_000.0, 12_000.0, 12_000.0, 48_000.0, *SUN]
    assert len(made.cycles) == 0
    assert "exposures_failing" in reasons(board)


def test_a_lost_camera_is_closed_shown_and_opened_again_ever_less_often(
    bench: MakeBench, camera: FakeCamera, board: StatusRegistry, clock: VirtualClock
) -> None:
    opened: list[float] = []
    shown: list[bool] = []

    def open_camera() -> SkyCamera:
        opened.append(clock.monotonic())
        shown.append("camera_lost" in reasons(board))
        if len(opened) in {2, 3, 4}:
            raise CameraLostError("no answer")
        return camera

    camera.faults = [CameraLostError("gone")]
    made = bench(open_camera=open_camera)
    made.run_until(lambda: len(made.cycles) >= 1)
    pauses = [later - earlier for earlier, later in pairwise(opened[1:])]
    assert pauses == pytest.approx([2.0, 4.0, 8.0])
    assert shown == [False, True, True, True, True]
    assert reasons(board) == set()
    assert camera.closed == 2


def test_a_camera_that_answers_nothing_for_a_whole_cycle_is_opened_anew(bench: MakeBench, camera: FakeCamera) -> None:
    opened: list[None] = []

    def open_camera() -> SkyCamera:
        opened.append(None)
        return camera

    camera.faults = [CameraTimeoutError("late")] * 8
    made = bench(open_camera=open_camera)
    made.run_until(lambda: len(made.cycles) >= 1)
    assert len(opened) == 2


@pytest.mark.parametrize("step_s", [4.0, -4.0, 7 * 3600.0 + 11.0, -7 * 3600.0 - 11.0])
def test_cycles_neither_stall_nor_burst_when_the_clock_is_set(
    bench: MakeBench, camera: FakeCamera, clock: VirtualClock, step_s: float
) -> None:
    made = bench()
    made.run_until(lambda: len(made.cycles) >= 2)
    clock.advance(3.0)
    clock.step(step_s)
    made.stop.clear()
    made.run_until(lambda: len(made.cycles) >= 7)
    starts = [at for at, exposure in camera.exposures if exposure == HDR[0]]
    gaps = [later - earlier for earlier, later in pairwise(starts)]
    assert sum(gap != pytest.approx(30.0) for gap in gaps) == 1  # the one in which the new alignment is found
    assert max(gaps) < 60.0


def test_a_clock_set_while_a_slot_is_waited_for_costs_one_slot_at_most(
    bench: MakeBench, camera: FakeCamera, clock: VirtualClock
) -> None:
    class Stepping(threading.Event):
        def is_set(self) -> bool:
            if len(camera.exposures) == 10 and clock.monotonic() > 60.0 and not self.stepped:
                self.stepped = True
                clock.step(-3600.0 - 17.0)
            return super().is_set()

        stepped = False

    made = bench()
    made.stop = Stepping()
    made.run_until(lambda: len(made.cycles) >= 7)
    starts = [at for at, exposure in camera.exposures if exposure == HDR[0]]
    gaps = [later - earlier for earlier, later in pairwise(starts)]
    assert sum(gap != pytest.approx(30.0) for gap in gaps) <= 2
    assert max(gaps) < 60.0
    assert gaps[-2:] == pytest.approx([30.0, 30.0])


def test_a_camera_that_changed_its_settings_is_opened_anew_and_its_cycle_is_not_kept(
    bench: MakeBench, camera: FakeCamera, board: StatusRegistry
) -> None:
    camera.changed = [None, CameraLostError("GainAuto is Continuous, not Off")]  # before the slot, after the cycle
    made = bench()
    made.run_until(lambda: len(made.cycles) >= 1)
    assert camera.closed == 2
    assert len(camera.exposures) == 2 * len(HDR + SUN)
    assert len(made.sun_frames) == 2
    status = board.snapshot().capture
    assert status is not None
    assert (status.cycles, status.complete, status.openings) == (1, 1, 2)


def test_a_change_before_the_slot_is_mended_before_the_slot(bench: MakeBench, camera: FakeCamera) -> None:
    camera.changed = [CameraLostError("TriggerMode is Off, not On")]
    made = bench()
    made.run_until(lambda: len(made.cycles) >= 1)
    assert camera.closed == 2
    assert camera.exposures[0][0] == pytest.approx(20.0)  # the first slot


def test_what_went_wrong_is_counted(bench: MakeBench, camera: FakeCamera, board: StatusRegistry) -> None:
    camera.faults = [None, CameraTimeoutError("late"), CameraError("torn"), None, CameraTimeoutError("late")]
    made = bench()
    made.run_until(lambda: len(made.cycles) >= 1)
    status = board.snapshot().capture
    assert status is not None
    assert (status.losses, status.refusals, status.retries, status.failures) == (2, 1, 2, 1)
    assert (status.cycles, status.complete, status.missed) == (2, 1, 0)
    assert status.jitter_s == pytest.approx(0.0, abs=1e-6)
    assert status.hdr_s == pytest.approx(0.063)


def test_slots_that_pass_while_the_camera_is_away_are_counted(
    bench: MakeBench, camera: FakeCamera, board: StatusRegistry, clock: VirtualClock
) -> None:
    camera.faults = [None] * 5 + [CameraLostError("gone")]
    opened: list[None] = []

    def open_camera() -> SkyCamera:
        opened.append(None)
        if len(opened) == 2:
            clock.advance(70.0)  # two slots go by
        return camera

    made = bench(open_camera=open_camera)
    made.run_until(lambda: len(made.cycles) >= 2)
    status = board.snapshot().capture
    assert status is not None
    assert status.missed == 2


def test_slots_that_a_busy_host_misses_are_a_condition_until_it_keeps_up(
    bench: MakeBench, camera: FakeCamera, clock: VirtualClock, board: StatusRegistry
) -> None:
    made, expose, slow = bench(), camera.expose, [True]

    def exposing(exposure_us: float) -> Frame:
        clock.advance(70.0 if slow[0] and exposure_us == SUN[0] else 0.0)  # every cycle takes three slots
        return expose(exposure_us)

    camera.expose = exposing  # type: ignore[method-assign]
    made.run_until(lambda: len(made.cycles) >= 3)
    assert reasons(board) == set()  # too few slots to tell
    made.stop.clear()
    made.run_until(lambda: len(made.cycles) >= 6)
    (reason,) = board.snapshot().reasons
    assert (reason.code, reason.severity) == ("slots_missed", "degraded")
    assert re.search(r"\d+ of the last 1\d slots", reason.text)
    status = board.snapshot().capture
    assert status is not None
    assert status.missed == status.sun_missed == 10
    slow[0] = False
    made.stop.clear()
    made.run_until(lambda: len(made.cycles) >= 30)
    assert reasons(board) == {"slots_missed"}
    made.stop.clear()
    made.run_until(lambda: len(made.cycles) >= 50)
    assert reasons(board) == set()


def test_black_frames_by_day_make_the_service_not_ready(
    bench: MakeBench, camera: FakeCamera, board: StatusRegistry
) -> None:
    made, expose, light = bench(), camera.expose, np.zeros((64, 64))

    def exposing(exposure_us: float) -> Frame:
        return replace(expose(exposure_us), image=(light * exposure_us).astype(np.uint16))

    camera.expose = exposing  # type: ignore[method-assign]
    made.run_until(lambda: len(made.cycles) >= 11)
    assert board.snapshot().health == "not_ready"
    assert reasons(board) == {"black_frames"}
    light[:, 40:] = 0.01
    made.stop.clear()
    made.run_until(lambda: not reasons(board))
    assert board.snapshot().health == "ready"


def test_a_simulated_camera_that_is_slowed_has_its_slots_further_apart(bench: MakeBench, camera: FakeCamera) -> None:
    made = bench()
    check = camera.check
    camera.check = lambda: replace(check(), speed=0.5)  # type: ignore[method-assign]
    made.run_until(lambda: len(made.cycles) >= 3)
    starts = [at for at, exposure in camera.exposures if exposure == HDR[0]]
    assert starts[2] - starts[1] == pytest.approx(60.0, abs=1.0)


def test_exposures_that_the_camera_cannot_take_are_refused_and_nothing_is_taken(
    bench: MakeBench, camera: FakeCamera, board: StatusRegistry
) -> None:
    camera.info = replace(INFO, exposure_max_us=20_000.0)
    made = bench()
    made.run_until(lambda: "camera_refused" in reasons(board))
    (reason,) = board.snapshot().reasons
    assert reason.severity == "not_ready"
    assert "48000 µs is beyond the camera's 5 to 20000 µs" in reason.text
    assert camera.exposures == []
    camera.info = INFO
    made.stop.clear()
    made.run_until(lambda: len(made.cycles) >= 1)
    assert reasons(board) == set()


def test_no_attempt_begins_that_would_run_into_the_next_slot(
    bench: MakeBench, camera: FakeCamera, clock: VirtualClock
) -> None:
    class SlowError(CameraTimeoutError):
        def __init__(self) -> None:
            super().__init__("late")
            clock.advance(15.0)

    made = bench()
    expose = camera.expose
    slow = iter([False, True, True])

    def exposing(exposure_us: float) -> Frame:
        if next(slow, False):
            raise SlowError
        return expose(exposure_us)

    camera.expose = exposing  # type: ignore[method-assign]
    made.run_until(lambda: len(made.cycles) >= 1)
    starts = [at for at, exposure in camera.exposures if exposure == HDR[0]]
    assert starts == pytest.approx([20.0, 80.0])  # 30 s were lost; the slot at 50 s was not begun late


def test_a_leap_second_that_the_clock_repeats_makes_no_cycle_of_its_own(
    bench: MakeBench, camera: FakeCamera, clock: VirtualClock
) -> None:
    made = bench()
    stepped: list[None] = []

    def reached() -> bool:
        if clock.monotonic() >= 79.0 and not stepped:  # a second before a slot
            stepped.append(None)
            clock.step(-1.0)
        return len(made.cycles) >= 5

    made.run_until(reached)
    starts = [at for at, exposure in camera.exposures if exposure == HDR[0]]
    assert stepped
    assert all(29.0 <= later - earlier <= 31.5 for earlier, later in pairwise(starts))


def test_normal_exposures_that_leave_the_sun_no_time_are_told_with_the_remedy(
    bench: MakeBench, camera: FakeCamera, clock: VirtualClock, board: StatusRegistry
) -> None:
    made, expose, slow = bench(), camera.expose, [True]

    def exposing(exposure_us: float) -> Frame:
        clock.advance(9.5 if slow[0] else 0.0)
        return expose(exposure_us)

    camera.expose = exposing  # type: ignore[method-assign]
    made.run_until(lambda: len(made.cycles) >= 9)
    assert reasons(board) == set()
    made.stop.clear()
    made.run_until(lambda: len(made.cycles) >= 10)
    (reason,) = board.snapshot().reasons
    assert reason.code == "cycle_too_long"
    assert reason.data["cycles"] == 10
    slow[0] = False
    made.stop.clear()
    made.run_until(lambda: len(made.sun_frames) > 0)
    assert reasons(board) == set()


def test_an_exposure_that_fails_in_every_cycle_is_told_for_as_long_as_it_does(
    bench: MakeBench, camera: FakeCamera, board: StatusRegistry
) -> None:
    made, expose, broken = bench(), camera.expose, [True]

    def exposing(exposure_us: float) -> Frame:
        frame = expose(exposure_us)
        if broken[0] and exposure_us == HDR[2]:
            raise CameraTimeoutError("late")
        return frame

    camera.expose = exposing  # type: ignore[method-assign]
    made.run_until(lambda: len(camera.exposures) > 11 * len([*HDR, HDR[2], *SUN]))
    (reason,) = board.snapshot().reasons
    assert reason.code == "exposures_failing"
    assert reason.data == {"cycles": 12, "error": "late"}
    broken[0] = False
    made.stop.clear()
    made.run_until(lambda: len(made.cycles) > 0)
    assert reasons(board) == set()


def test_a_camera_that_is_lost_in_every_cycle_is_told_between_them_too(
    bench: MakeBench, camera: FakeCamera, board: StatusRegistry
) -> None:
    camera.faults = [CameraTimeoutError("packets were lost")] * 12  # two attempts at three exposures, in two cycles
    made = bench()
    made.run_until(lambda: len(camera.exposures) >= 12 and "camera_lost" not in reasons(board))
    (reason,) = board.snapshot().reasons
    assert reason.code == "exposures_failing"
    assert reason.data["cycles"] == 2
    assert str(reason.data["error"]).endswith("packets were lost")
    made.stop.clear()
    made.run_until(lambda: len(made.cycles) > 0)
    assert reasons(board) == set()


def test_sun_exposures_that_always_fail_are_told_and_the_normal_ones_go_on(
    bench: MakeBench, camera: FakeCamera, board: StatusRegistry
) -> None:
    made, expose, refuses = bench(), camera.expose, [True]

    def exposing(exposure_us: float) -> Frame:
        if refuses[0] and exposure_us in SUN:
            raise CameraError("the camera keeps an exposure of 48000 us")
        return expose(exposure_us)

    camera.expose = exposing  # type: ignore[method-assign]
    made.run_until(lambda: len(made.cycles) >= 2)
    assert reasons(board) == set()
    made.stop.clear()
    made.run_until(lambda: len(made.cycles) >= 5)
    assert reasons(board) == {"sun_exposures_failing"}
    assert len(made.sun_frames) == 0
    refuses[0] = False
    made.stop.clear()
    made.run_until(lambda: len(made.sun_frames) > 0)
    assert reasons(board) == set()


def test_a_camera_whose_large_packets_do_not_arrive_is_told_until_it_is_opened_without(
    bench: MakeBench, camera: FakeCamera, board: StatusRegistry
) -> None:
    camera.info = replace(INFO, packet_bytes=1500, packet_bytes_lost=8000)
    made = bench()
    made.run_until(lambda: len(made.cycles) >= 1)
    (reason,) = board.snapshot().reasons
    assert (reason.code, reason.data) == ("packets_too_large", {"lost": 8000, "used": 1500})
    camera.info = INFO
    made.stop.clear()
    made.run_until(lambda: len(made.cycles) >= 2)
    assert reasons(board) == set()
