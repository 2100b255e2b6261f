"""Steps of daily rotations in records of any length: their evidence by brute force, their day, and what is none."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.calibration.evidence import DAYS
from sunarc.changes.daily_rotations import DailyRotations, step_gains
from sunarc.common.array_types import FloatArray

SIGMA_DEG = np.array([0.004, 0.006, 0.01])


def days_of(rotation_deg: FloatArray, day: FloatArray) -> DailyRotations:
    covariance = np.broadcast_to(np.diag(SIGMA_DEG**2), (len(day), 3, 3)).copy()
    return DailyRotations(day=day, rotation_deg=rotation_deg, covariance_deg2=covariance)


def profile(values: FloatArray, design: FloatArray, covariance: FloatArray) -> float:
    """Return the log likelihood of values (n,) with free coefficients and a free scale, but for a constant."""
    inverse = np.linalg.inv(covariance)
    fitted = design @ np.linalg.solve(design.T @ inverse @ design, design.T @ inverse @ values)
    left = float((values - fitted) @ inverse @ (values - fitted))
    return float(-0.5 * len(values) * np.log(left) - 0.5 * np.linalg.slogdet(covariance).logabsdet)


def test_the_gain_of_a_step_is_the_ratio_of_the_largest_likelihoods() -> None:
    rng = np.random.default_rng(2)  # no day stands off so far that it is moved near
    day = np.array([0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 7.0, 9.0, 10.0])
    rotation = rng.uniform(-1.0, 1.0, (9, 3)) * SIGMA_DEG + np.outer(day >= 5.0, [0.0, 0.01, 0.02])
    walk = np.minimum.outer(day, day)
    expected = np.zeros(9)
    for axis, sigma in enumerate(SIGMA_DEG):
        each = [sigma**2 * (np.eye(9) + ratio * walk) for ratio in (0.0, 0.003, 0.03, 0.3, 3.0)]
        one = np.ones((9, 1))
        none = max(profile(rotation[:, axis], one, c) for c in each)
        for row in range(1, 9):
            stepped = np.column_stack([one, day >= day[row]])
            expected[row] += max(profile(rotation[:, axis], stepped, c) for c in each) - none
    found = step_gains(days_of(rotation, day))
    assert found[0] == -np.inf
    np.testing.assert_allclose(found[1:], expected[1:], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("at", [3, 40, 87])
def test_a_step_in_a_long_record_is_the_clearest_where_it_is(at: int) -> None:
    rng = np.random.default_rng(at)
    day = np.arange(90.0)
    season = np.outer(np.sin(day / 58.0), [0.02, -0.03, 0.05])
    step = np.outer(day >= at, [0.05, -0.04, 0.08])
    gain = step_gains(days_of(season + step + rng.normal(0.0, SIGMA_DEG, (90, 3)), day))
    assert int(np.argmax(gain)) == at
    assert gain[at] > DAYS.gain


@pytest.mark.parametrize("seed", range(4))
def test_a_season_single_days_and_a_mast_that_leans_are_no_step(seed: int) -> None:
    rng = np.random.default_rng(seed)
    day = np.arange(90.0)
    rotation = np.outer(np.sin(day / 58.0), [0.02, -0.03, 0.05]) + np.outer(0.001 * day, [0.5, 0.5, 0.7])
    rotation += rng.normal(0.0, SIGMA_DEG, (90, 3))
    rotation[[20, 61]] += 0.3
    assert float(step_gains(days_of(rotation, day)).max()) < DAYS.gain


@pytest.mark.parametrize("n", [0, 1, 4])
def test_too_few_days_have_no_step(n: int) -> None:
    assert np.all(np.isneginf(step_gains(days_of(np.zeros((n, 3)), np.arange(float(n))))))
