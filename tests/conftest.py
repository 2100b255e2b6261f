"""Worlds that tests of several rooms share: `tests/fixtures` has them, a room's own `conftest.py` the others."""

from __future__ import annotations

from tests.fixtures.board import board, clock
from tests.fixtures.clear_day import calibrated, clear_day, lens_population, simulator, tilted
from tests.fixtures.command_line import sunarc
from tests.fixtures.lens_types import fitted, lens, unit
from tests.fixtures.settings_file import config

__all__ = [
    "board",
    "calibrated",
    "clear_day",
    "clock",
    "config",
    "fitted",
    "lens",
    "lens_population",
    "simulator",
    "sunarc",
    "tilted",
    "unit",
]
