"""Clocks of days: one that differs from day to day refuses a fit, and nothing else is taken for one."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import population as pop
import pytest

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import FloatArray
from sunarc.common.utc import DAY_S
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

SITE = Site(latitude=46.95, longitude=7.45)
DAYS = 12
START_S = datetime(2026, 4, 1, tzinfo=UTC).timestamp()


def _codes_and_scatter(
    seed: int, *, ahead_s: FloatArray | None = None, turned_deg: float = 0.0, outwards_px: float = 0.0
) -> tuple[list[str], float]:
    """Return the codes of a fit and the scatter of its clock that is found.

    ahead_s (12,): the clock's error on each day. turned_deg, outwards_px: by which the camera is turned about every
    axis, and the sun is displaced along the radius, 1-sigma from day to day.
    """
    rng = np.random.default_rng(seed)
    camera, ahead_s = pop.random_camera(rng), np.zeros(DAYS) if ahead_s is None else ahead_s
    seen: list[tuple[FloatArray, FloatArray]] = []
    for day in range(DAYS):
        times = START_S + DAY_S * day + 3600.0 * np.arange(6.0, 18.0)
        directions = sun_directions(times, SITE) @ rotation_matrix(tuple(np.radians(rng.normal(0.0, turned_deg, 3)))).T
        pixels = project(camera, directions) + rng.normal(0.0, 0.3, (times.size, 2))
        outwards = pixels - np.array(camera.principal_point_px)
        pixels += rng.normal(0.0, outwards_px) * outwards / np.linalg.norm(outwards, axis=-1, keepdims=True)
        fine = np.all(np.isfinite(pixels) & (np.abs(pixels - 0.5 * pop.SIZE) < 0.5 * pop.SIZE), axis=-1)
        seen.append((times[fine] + ahead_s[day], pixels[fine]))
    times, pixels = (np.concatenate(column) for column in zip(*seen, strict=True))
    found = calibrate(
        Sightings.of(unix_s=times, pixels=pixels),
        site=SITE,
        image_size=(pop.SIZE, pop.SIZE),
        options=CalibrationOptions(projection="equisolid", mirrored="no"),
    )
    scatter = [float(one.data["scatter_s"]) for one in found.verdict.findings if one.code == "clock_unsteady"]
    assert not (found.verdict.accepted and scatter)
    return [one.code for one in found.verdict.findings], scatter[0] if scatter else 0.0


@pytest.mark.parametrize("amplitude_s", [60.0, 210.0])
def test_a_clock_that_loses_time_and_is_set_weekly_is_named_with_its_scatter(amplitude_s: float) -> None:
    ahead_s = np.asarray(-amplitude_s * (np.arange(DAYS) % 7) / 7.0, dtype=np.float64)
    codes, scatter_s = _codes_and_scatter(1, ahead_s=ahead_s)
    assert codes[0] == "clock_unsteady"
    assert scatter_s == pytest.approx(float(np.std(ahead_s)), rel=0.2)


def test_a_clock_within_ten_seconds_is_not_refused() -> None:
    ahead_s = 5.0 * np.cos(np.arange(DAYS))
    assert "clock_unsteady" not in _codes_and_scatter(2, ahead_s=ahead_s)[0]


@pytest.mark.parametrize("seed", [3, 4, 5])
@pytest.mark.parametrize("other", [(0.0, 0.0), (0.1, 0.0), (0.0, 2.0)])
def test_no_other_error_of_days_is_taken_for_the_clock(seed: int, other: tuple[float, float]) -> None:
    turned_deg, outwards_px = other
    assert "clock_unsteady" not in _codes_and_scatter(seed, turned_deg=turned_deg, outwards_px=outwards_px)[0]
