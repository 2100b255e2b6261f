"""Errors of sightings: their scatter, episodes, tails and limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import kstest, rayleigh

from sunarc.lab.studies.tables import SD_OF_DISTANCE, clear_noise, cloud_noise, episodes


def test_the_distance_of_round_errors_is_rayleighs() -> None:
    assert rayleigh.std() == pytest.approx(SD_OF_DISTANCE)
    noise = clear_noise(np.random.default_rng(0), 4000, sd_px=0.43)
    assert kstest(np.linalg.norm(noise, axis=-1) / 0.43 * SD_OF_DISTANCE, rayleigh.cdf).pvalue > 0.01


def test_clear_errors_have_no_mean_and_no_correlation() -> None:
    noise = clear_noise(np.random.default_rng(1), 20_000, sd_px=1.0)
    sigma = 1.0 / SD_OF_DISTANCE
    assert noise.mean(axis=0) == pytest.approx(0.0, abs=4.0 * sigma / math.sqrt(20_000))
    assert float(np.corrcoef(noise[:, 0], noise[:, 1])[0, 1]) == pytest.approx(0.0, abs=0.03)
    assert float(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) == pytest.approx(0.0, abs=0.03)


def test_without_noise_there_is_none() -> None:
    assert not clear_noise(np.random.default_rng(0), 5, sd_px=0.0).any()
    assert clear_noise(np.random.default_rng(0), 0, sd_px=1.0).shape == (0, 2)


@pytest.mark.parametrize("share", [0.05, 0.22, 0.6])
def test_episodes_cover_the_share_and_no_more_than_one_beyond(share: float) -> None:
    covered = episodes(np.random.default_rng(2), 5000, share)
    assert share <= covered.mean() < share + 0.03


def test_no_episodes_where_none_are_asked_for() -> None:
    assert not episodes(np.random.default_rng(2), 100, 0.0).any()


def test_episodes_last_twelve_frames_in_the_mean() -> None:
    covered = episodes(np.random.default_rng(3), 200_000, 0.02)
    begins = int(np.sum(np.diff(covered.astype(int)) == 1))
    assert covered.sum() / begins == pytest.approx(12.0, rel=0.15)  # those that touch count as one


@pytest.mark.parametrize(("share", "sd_px"), [(0.12, 2.49), (0.22, 5.21)])
def test_all_errors_scatter_as_asked_and_those_between_the_clouds_less(share: float, sd_px: float) -> None:
    noise = cloud_noise(np.random.default_rng(4), 3000, inlier_px=0.43, share=share, sd_px=sd_px)
    covered = _episodes_of(np.random.default_rng(4), 3000, share)
    assert np.std(np.linalg.norm(noise, axis=-1)) == pytest.approx(sd_px, rel=1e-6)
    assert noise[~covered].std() == pytest.approx(0.43, rel=0.05)
    assert noise[covered].std() > 3.0 * 0.43


def _episodes_of(rng: np.random.Generator, n: int, share: float) -> np.ndarray:
    """Return which sightings `cloud_noise` covers: it draws the core's errors first."""
    rng.normal(0.0, 0.43, (n, 2))
    return episodes(rng, n, share)


def test_errors_within_an_episode_are_correlated_and_bounded() -> None:
    noise = cloud_noise(np.random.default_rng(5), 4000, inlier_px=0.43, share=0.9, sd_px=20.0)
    assert np.abs(noise).max() <= 50.0
    assert float(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) == pytest.approx(0.7, abs=0.12)


def test_the_same_seed_draws_the_same() -> None:
    one, other = (cloud_noise(np.random.default_rng(6), 300, inlier_px=0.4, share=0.2, sd_px=3.0) for _ in range(2))
    assert (one == other).all()
