from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.cameras import INFO

from sunarc.detection.values import Detection
from sunarc.imager.workers.exposures import SPOILED_AFTER, SunExposures
from sunarc.imaging.exposure import SunExposureOptions

if TYPE_CHECKING:
    from sunarc.imager.runtime.clock import VirtualClock
    from sunarc.imager.runtime.status import StatusRegistry

    from .conftest import FakeCamera


def seen(*, accepted: bool, peak: float, saturated_px: int) -> Detection:
    return Detection(
        method="disc",
        accepted=accepted,
        verdict="clear" if accepted else "hidden",
        findings=(),
        x_px=4.0,
        y_px=3.0,
        peak_fraction=peak,
        saturated_px=saturated_px,
    )


def test_the_exposure_comes_down_to_where_the_disc_is_not_saturated(camera: FakeCamera) -> None:
    exposures = SunExposures(SunExposureOptions(first_us=400.0))
    for _ in range(6):
        for exposure_us in exposures.choose(INFO):
            level = exposure_us / 50.0
            exposures.report(camera.expose(exposure_us), seen(accepted=True, peak=level, saturated_px=int(level > 1)))
    (steady,) = exposures.choose(INFO)
    assert 20.0 <= steady <= 40.0


def test_a_disc_too_bright_to_be_believed_still_shortens_the_exposure(camera: FakeCamera) -> None:
    exposures = SunExposures(SunExposureOptions())
    first = exposures.choose(INFO)
    for exposure_us in first:
        exposures.report(camera.expose(exposure_us), seen(accepted=False, peak=50.0, saturated_px=90))
    assert min(exposures.choose(INFO)) < min(first)


def test_a_cycle_that_was_not_looked_at_yet_changes_nothing(camera: FakeCamera, clock: VirtualClock) -> None:
    del camera, clock
    exposures = SunExposures(SunExposureOptions())
    assert exposures.choose(INFO) == exposures.choose(INFO)


@pytest.mark.parametrize("fitted", [None, 0.016])  # what a disc fitted to a streak says of its peak
def test_a_sun_that_burns_out_the_shortest_exposure_is_told_with_the_remedy(
    camera: FakeCamera, board: StatusRegistry, fitted: float | None
) -> None:
    exposures = SunExposures(SunExposureOptions(), board=board)
    burnt = np.zeros((60, 80), np.uint16)
    burnt[:, 30:40] = 4095  # blooming along the columns

    def cycle(*, accepted: bool) -> list[str]:
        for exposure_us in exposures.choose(INFO):
            frame = replace(camera.expose(exposure_us), image=burnt)
            streak = replace(seen(accepted=False, peak=0.0, saturated_px=215), peak_fraction=fitted)
            exposures.report(frame, seen(accepted=True, peak=0.9, saturated_px=0) if accepted else streak)
        return [reason.code for reason in board.snapshot().reasons]

    told = [cycle(accepted=False) for _ in range(2 * SPOILED_AFTER)]
    assert told[SPOILED_AFTER - 2] == []
    assert told[-1] == ["sun_too_bright"]
    assert "neutral filter" in board.snapshot().reasons[0].remedy
    cycle(accepted=True)
    assert cycle(accepted=True) == []


def test_clouds_are_no_burnt_sun(camera: FakeCamera, board: StatusRegistry) -> None:
    exposures = SunExposures(SunExposureOptions(first_us=5.0), board=board)
    for _ in range(50):
        for exposure_us in exposures.choose(INFO):
            exposures.report(camera.expose(exposure_us), seen(accepted=False, peak=0.0, saturated_px=0))
    assert board.snapshot().reasons == ()
