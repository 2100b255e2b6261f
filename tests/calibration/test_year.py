"""A year of days: millions in information, against which a smooth field must not explain the noise away."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sunarc.calibration.calibrate import calibrate

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulator

SIZE = (1748, 1748)


def test_a_year_of_noise_is_not_taken_for_a_field(simulator: Simulator) -> None:
    days = tuple(float(day) for day in np.arange(0, 360, 6))
    seen = simulator(days=days, sigma_px=0.5, cadence_s=900.0)
    found = calibrate(seen.points, site=seen.site, image_size=SIZE)
    assert found.verdict.accepted
    assert found.field.amplitude_px < 0.1
    assert abs(found.evidence.sigma_px - 0.5) < 0.03
    assert seen.sky_error_px(found.camera) < 0.12
