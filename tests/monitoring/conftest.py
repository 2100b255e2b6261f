"""The simulated imager of the calibration's tests, its clear day and the fit of it."""

from __future__ import annotations

import pytest
from tests.calibration.conftest import SIZE, Simulated, Simulator, simulate

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration


@pytest.fixture(scope="session")
def clear_day() -> Simulated:
    return simulate()


@pytest.fixture(scope="session")
def calibrated(clear_day: Simulated) -> Calibration:
    return calibrate(clear_day.points, site=clear_day.site, image_size=SIZE)


@pytest.fixture(scope="session")
def simulator() -> Simulator:
    return simulate
