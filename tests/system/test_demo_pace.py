"""The demo slows the simulated time on a host that is too busy for it, and says so."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

DEMO = Path(__file__).parents[2] / "deploy" / "demo.py"


@pytest.fixture(scope="module")
def demo() -> ModuleType:
    specification = importlib.util.spec_from_file_location("sunarc_demo", DEMO)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules["sunarc_demo"] = module
    specification.loader.exec_module(module)
    return module


def counts(*, cycles: int, missed: int = 0, sun_missed: int = 0, sun_dropped: int = 0) -> dict[str, int]:
    return {"cycles": cycles, "missed": missed, "sun_missed": sun_missed, "sun_dropped": sun_dropped}


def test_many_missed_slots_halve_the_speed_and_few_do_not(demo: ModuleType) -> None:
    pace = demo.Pace(500.0)
    assert pace.too_fast(counts(cycles=10, missed=10, sun_missed=20)) is None  # the service starts
    assert pace.too_fast(counts(cycles=30, missed=10, sun_missed=29)) is None  # less than half
    assert pace.too_fast(counts(cycles=35, missed=14, sun_missed=38)) is None  # too few slots to tell
    said = pace.too_fast(counts(cycles=40, missed=20, sun_missed=35, sun_dropped=4))
    assert said == (
        "this host is too busy: 10 of the last 20 slots had no sun exposure; "
        "slowing the simulated time to 250 times real"
    )
    assert pace.speed == 250.0
    assert pace.too_fast(counts(cycles=50, missed=30, sun_missed=55, sun_dropped=4)) is None  # it settles again
    assert pace.speed == 250.0


def test_the_speed_has_a_lower_bound(demo: ModuleType) -> None:
    pace = demo.Pace(80.0)
    for number in range(1, 30):
        pace.too_fast(counts(cycles=50 * number, missed=50 * number, sun_missed=100 * number))
    assert pace.speed == 10.0


@pytest.mark.parametrize(
    ("nights", "refit", "ends"),
    [
        ([], "accepted", False),
        (["night_without_calibration"], "accepted", False),  # the calibration came after its stars
        (["night_images", "night_without_calibration"], "accepted", True),
        (["night_images"], "running", False),
        (["night_without_calibration"] * 2, "accepted", False),
        (["night_without_calibration"] * 3, "accepted", True),  # there will be none
    ],
)
def test_the_demo_ends_with_a_night_whose_stars_were_named(
    demo: ModuleType, monkeypatch: pytest.MonkeyPatch, nights: list[str], refit: str, *, ends: bool
) -> None:
    events = [{"details": {"findings": [{"code": code}]}} for code in nights]
    answers = {"events?kind=night": {"events": events}, "refits": {"refits": [{"state": refit}]}}
    monkeypatch.setattr(demo, "get", lambda url: answers[url.rpartition("/")[2]])
    assert demo.ended("http://h", [], argparse.Namespace(nights=True, days=1)) is ends
