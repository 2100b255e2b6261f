"""A cycle whose exposures share a wrong factor is thrown away; the first one waits for another that agrees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta

import numpy as np
import pytest
from tests.fixtures.cameras import INFO

from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.capture import CaptureWorker
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.imager.workers.cycles import Cycle, CycleConsistencyFilter
from sunarc.imager.workers.exposures import SunExposures
from sunarc.imager.workers.options import CaptureOptions
from sunarc.imaging.exposure import SunExposureOptions

from .conftest import NOON, FakeCamera, StopAfter

HDR_US = (3_000.0, 12_000.0, 48_000.0)
RATE = np.clip(np.linspace(-0.02, 0.05, 96), 0.0, None)[None, :] * np.ones((96, 1))  # counts in 1 µs


def frame(exposure_us: float, *, at_s: float = 0.0, factor: float = 1.0) -> Frame:
    return Frame(
        image=np.minimum(100.0 + RATE * exposure_us * factor, 4095.0).astype(np.uint16),
        time=NOON + timedelta(seconds=at_s),
        exposure_us=exposure_us,
        gain_db=0.0,
        pixel_format="Mono12",
        full_scale=4095,
        frame_id=1,
    )


def cycle(*, at_s: float, factor: float = 1.0) -> Cycle:
    return Cycle(
        normal=tuple(frame(e, at_s=at_s, factor=factor) for e in HDR_US), sun=(frame(20.0, at_s=at_s, factor=factor),)
    )


@pytest.fixture
def settled() -> CycleConsistencyFilter:
    vouching = CycleConsistencyFilter(cadence_s=30.0)
    assert vouching.accepted_cycles(cycle(at_s=-30.0)) == []
    assert len(vouching.accepted_cycles(cycle(at_s=0.0))) == 2
    return vouching


def test_the_first_cycle_is_handed_on_together_with_the_second_that_agrees() -> None:
    vouching, first, second = CycleConsistencyFilter(cadence_s=30.0), cycle(at_s=0.0), cycle(at_s=30.0, factor=1.4)
    assert vouching.accepted_cycles(first) == []
    assert vouching.accepted_cycles(second) == [first, second]
    third = cycle(at_s=60.0)
    assert vouching.contradiction(third.good) is None
    assert vouching.accepted_cycles(third) == [third]


def test_two_that_contradict_are_both_not_believed() -> None:
    vouching, third = CycleConsistencyFilter(cadence_s=30.0), cycle(at_s=60.0)
    assert vouching.accepted_cycles(cycle(at_s=0.0, factor=4.0)) == []
    second = cycle(at_s=30.0)
    assert vouching.accepted_cycles(second) == []
    assert vouching.accepted_cycles(third) == [second, third]


@pytest.mark.parametrize("factor", [0.25, 4.0, 16.0])
def test_a_factor_that_all_exposures_share_is_a_contradiction(settled: CycleConsistencyFilter, factor: float) -> None:
    told = settled.contradiction(cycle(at_s=30.0, factor=factor).good)
    assert told is not None
    assert "as bright as the previous cycle" in told


def test_a_light_that_stays_changed_is_believed_after_two_minutes(settled: CycleConsistencyFilter) -> None:
    assert settled.contradiction(cycle(at_s=120.0, factor=0.1).good) is not None
    later = [cycle(at_s=at_s, factor=0.1) for at_s in (150.0, 180.0)]
    assert settled.contradiction(later[0].good) is None
    assert settled.accepted_cycles(later[0]) == []
    assert settled.accepted_cycles(later[1]) == later


def test_cycles_that_became_too_far_apart_to_be_compared_are_not_lost() -> None:
    vouching, cycles = CycleConsistencyFilter(cadence_s=60.0), [cycle(at_s=at_s) for at_s in (0.0, 180.0, 360.0, 540.0)]
    let_go = [one for each in cycles for one in vouching.accepted_cycles(each)]
    assert let_go == cycles


def test_where_brightness_tells_nothing_no_cycle_waits(settled: CycleConsistencyFilter) -> None:
    dark = Cycle(normal=tuple(frame(e, at_s=600.0, factor=0.0) for e in HDR_US), sun=())
    assert settled.accepted_cycles(dark) == [dark]
    slow = CycleConsistencyFilter(cadence_s=61.0)
    only = cycle(at_s=0.0)
    assert slow.accepted_cycles(only) == [only]


def test_an_exposure_that_failed_does_not_keep_the_others_from_being_judged(settled: CycleConsistencyFilter) -> None:
    wrong = replace(cycle(at_s=30.0, factor=4.0), normal=(None, None, frame(HDR_US[2], at_s=30.0, factor=0.25)))
    assert settled.contradiction(wrong.good) is not None


@dataclass
class Sky(FakeCamera):
    """Shows a sky, and some of its exposures, by their number, with a factor that it does not state."""

    wrong: tuple[range, float] = (range(0), 1.0)

    def expose(self, exposure_us: float) -> Frame:
        number = len(self.exposures)
        bare = super().expose(exposure_us)
        factor = self.wrong[1] if number in self.wrong[0] else 1.0
        return replace(bare, image=frame(exposure_us, factor=factor).image)


@pytest.mark.parametrize(("length", "openings"), [(3, 1), (8, 2), (20, 4)])
def test_nothing_of_a_cycle_with_a_shared_factor_is_handed_on(
    clock: VirtualClock, board: StatusRegistry, length: int, openings: int
) -> None:
    camera = Sky(clock, info=INFO, wrong=(range(15, 15 + length), 4.0))
    cycles: DropOldestQueue[Sequence[Frame]] = DropOldestQueue(capacity=100)
    sun_frames: DropOldestQueue[Frame] = DropOldestQueue(capacity=100)
    worker = CaptureWorker(
        open_camera=lambda: camera,
        clock=clock,
        frame_time=FrameTime(clock, follows_camera=False),
        options=CaptureOptions(),
        name="roof",
        apparent_zenith=lambda: 20.0,
        sun_exposures=SunExposures(SunExposureOptions()),
        cycles=cycles,
        sun_frames=sun_frames,
        board=board,
    )
    worker.run(StopAfter(1000), lambda: None)
    kept = [one for _ in range(len(cycles)) for one in cycles.get(timeout_s=0.0) or ()]
    kept += [one for _ in range(len(sun_frames)) if (one := sun_frames.get(timeout_s=0.0)) is not None]
    assert len(kept) > 20
    for one in kept:
        assert np.array_equal(one.image, frame(one.exposure_us).image)
    status = board.snapshot().capture
    assert status is not None
    assert status.openings == openings
    assert status.doubts > 0
