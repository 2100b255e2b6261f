"""Findings about the clock that dates the frames."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest

from sunarc.imager.workers.clock_watch import ClockStep, camera_offset, clock_cost_text, stepped

AT = datetime(2013, 5, 13, 18, 30, 0, 250_000, tzinfo=UTC)


def step(at: datetime, *, gradual: bool) -> ClockStep:
    return ClockStep(step_s=-2.5, at=at, found_s=10.0, doubted=((AT, AT + timedelta(seconds=8)),), gradual=gradual)


@pytest.mark.parametrize("at", [AT, AT.astimezone(timezone(timedelta(hours=-6)))])
@pytest.mark.parametrize(("gradual", "within"), [(False, False), (True, True)])
def test_a_step_states_the_clock_its_size_and_its_time_in_utc(at: datetime, *, gradual: bool, within: bool) -> None:
    found = stepped("clock_stepped", "host", step(at, gradual=gradual))
    assert (found.data["clock"], found.data["step_s"], found.data["at"]) == ("host", -2.5, "2013-05-13T18:30:00Z")
    assert ("8 s" in str(found.data["how"])) == within
    assert found.text != f"clock_stepped {dict(found.data)}"


@pytest.mark.parametrize(
    ("offset_s", "scale"), [(37.2, "tai"), (-36.9, "utc"), (35.9, None), (38.1, None), (-3600.0, None)]
)
def test_an_offset_of_tai_less_utc_is_named_with_the_setting(offset_s: float, scale: str | None) -> None:
    found = camera_offset(offset_s, limit_s=0.5)
    remedy = str(found.data["remedy"])
    assert (found.data["offset_s"], found.data["limit_s"]) == (offset_s, 0.5)
    assert (f'camera.timestamp_scale = "{scale}"' in remedy) == (scale is not None)
    assert ("camera.timestamp_offset_s" in remedy) == (scale is None)


def test_a_clock_that_nothing_corrects_is_priced_in_degrees() -> None:
    """The sun turns by 360 degrees in a day: 0.0042 in a second; 50 ppm are 4.3 s and 0.02 degrees a day."""
    assert "0.0042°" in clock_cost_text(None)
    assert "1-sigma" not in clock_cost_text(None)
    calibrated = clock_cost_text(0.0123, error_s=16.0)
    for value in ("1-sigma of 0.012°", "16 s off", "0.07° off", "0.02° more each day"):
        assert value in calibrated
    assert "°" not in clock_cost_text(None, error_s=1.4e9)
