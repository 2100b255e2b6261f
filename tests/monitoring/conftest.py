"""The simulated imager of the calibration's tests, its clear day and the fit of it."""

from tests.calibration.conftest import calibrated, clear_day, simulator

__all__ = ["calibrated", "clear_day", "simulator"]
