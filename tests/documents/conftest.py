"""A type of lens, as the tests of the library have it."""

from tests.calibration.lens_library.conftest import lens

__all__ = ["lens"]
