"""Black frames by day make the service not ready; by night they say nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sunarc.common.errors import InputError
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.capture_status import CaptureReport
from sunarc.imager.workers.options import CaptureOptions

from .conftest import FakeCamera


def frame(clock: VirtualClock, *, light: bool) -> Frame:
    image = np.full((64, 64), 30, dtype=np.uint16)
    if light:
        image[:, 32:] = 400
    return replace(FakeCamera(clock).expose(48_000.0), image=image)


def test_ten_black_slots_by_day_are_not_ready_and_light_ends_it(clock: VirtualClock, board: StatusRegistry) -> None:
    watch = CaptureReport(board, name="roof")
    for _ in range(9):
        watch.normal_frames([frame(clock, light=False)], apparent_zenith=40.0)
    assert board.snapshot().health == "ready"
    watch.normal_frames([frame(clock, light=False)], apparent_zenith=40.0)
    (reason,) = board.snapshot().reasons
    assert (reason.code, reason.severity) == ("black_frames", "not_ready")
    assert reason.data == {"slots": 10, "exposure_us": 48000.0}
    watch.normal_frames([frame(clock, light=False)], apparent_zenith=95.0)
    assert board.snapshot().health == "not_ready"  # the cap is still on after sunset
    watch.normal_frames([frame(clock, light=True)], apparent_zenith=85.0)
    assert board.snapshot().health == "ready"


def test_black_frames_at_dusk_and_in_the_night_say_nothing(clock: VirtualClock, board: StatusRegistry) -> None:
    watch = CaptureReport(board, name="roof")
    for _ in range(50):
        watch.normal_frames([frame(clock, light=False)], apparent_zenith=81.0)
    assert board.snapshot().health == "ready"


def test_the_longest_exposure_decides(clock: VirtualClock, board: StatusRegistry) -> None:
    watch = CaptureReport(board, name="roof")
    short = replace(frame(clock, light=False), exposure_us=3000.0)
    for _ in range(20):
        watch.normal_frames([short, frame(clock, light=True)], apparent_zenith=40.0)
    assert board.snapshot().health == "ready"


@pytest.mark.parametrize("exposures", [(3.0, 12.0, 48.0), (3.0,), (15.0, 60.0)])
def test_exposures_in_milliseconds_are_refused_in_one_line(exposures: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"\d+000") as caught:
        CaptureOptions(hdr_exposures_us=exposures)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("exposures", [(3000.0, 12_000.0), (10.0,), (50.0, 200.0)])
def test_short_exposures_in_microseconds_are_taken(exposures: tuple[float, ...]) -> None:
    assert CaptureOptions(hdr_exposures_us=exposures).hdr_exposures_us == exposures
