"""The factor between a stated sigma and the scatter of the inliers."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.offline.learned_sigma import sigma_factor

COUNT = 400


def scattered(sigma_px: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.random.default_rng(8).normal(0.0, sigma_px, (COUNT, 2))


@pytest.mark.parametrize("true", [1.3, 1.5, 3.0])
def test_the_factor_is_that_of_the_scatter(true: float) -> None:
    stated = np.random.default_rng(9).uniform(1.0, 4.0, COUNT)
    factor = sigma_factor(true * stated[:, None] * scattered(1.0), stated)
    assert factor == pytest.approx(true, rel=0.1)


def test_outliers_and_unknown_sigmas_do_not_count() -> None:
    residual, stated = scattered(2.0), np.ones(COUNT)
    residual[::4] += 80.0
    residual[1::40] = np.nan
    stated[2::40] = np.nan
    assert sigma_factor(residual, stated) == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize("true", [0.1, 0.5, 0.95, 1.0, 1.05])
def test_a_sigma_that_is_enough_is_left(true: float) -> None:
    assert sigma_factor(scattered(true), np.ones(COUNT)) is None


@pytest.mark.parametrize("true", [6.0, 20.0])
def test_what_no_detector_is_wrong_by_is_not_learned(true: float) -> None:
    assert sigma_factor(scattered(true), np.ones(COUNT)) is None


def test_few_sightings_teach_nothing() -> None:
    assert sigma_factor(scattered(2.0)[:19], np.ones(19)) is None
    assert sigma_factor(np.zeros((0, 2)), np.zeros(0)) is None
