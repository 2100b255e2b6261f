from __future__ import annotations

from typing import TYPE_CHECKING

from sunarc.detection import Detection
from sunarc.imaging import SunExposureOptions
from sunarc.workers import SunExposures

from .conftest import INFO

if TYPE_CHECKING:
    from sunarc.clock import VirtualClock

    from .conftest import FakeCamera


def seen(*, accepted: bool, peak: float, saturated_px: int) -> Detection:
    return Detection(
        method="disc",
        accepted=accepted,
        verdict="clear" if accepted else "hidden",
        reason="",
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
