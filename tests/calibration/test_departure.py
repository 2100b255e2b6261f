"""The test of contradiction: its rate of false alarms, and that it sees what is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.calibration.departure import compute_departure, largest_departure


def test_one_determined_quantity_is_judged_by_its_normal_distribution() -> None:
    found = compute_departure(np.array([2.0, 0.0]), np.diag([0.0, 1.0]))
    assert found.rms == pytest.approx(2.0)
    assert found.limit == pytest.approx(3.29, abs=0.01)  # 0.1 % two-sided
    assert not found.contradicts
    assert compute_departure(np.array([3.4, 0.0]), np.diag([0.0, 1.0])).contradicts


def test_right_priors_are_refused_as_rarely_as_stated() -> None:
    rng = np.random.default_rng(1)
    remaining = np.diag(rng.uniform(0.0, 1.0, 12))
    changes = rng.standard_normal((20_000, 12)) * np.sqrt(1.0 - np.diag(remaining))
    rate = np.mean([compute_departure(change, remaining).contradicts for change in changes])
    assert 0.0004 < rate < 0.003
    wrong = np.mean([compute_departure(change + 2.0, remaining).contradicts for change in changes[:500]])
    assert wrong > 0.5


PARTS = {"focal length": np.array([0]), "centre": np.array([1, 2])}


def test_one_quantity_far_off_shows_in_its_part() -> None:
    # five sigmas of one of twelve known quantities: the sum of squares of twelve is above 32.9 in one of 1000 cases
    change = np.r_[5.0, np.full(11, 0.5)]
    prior, posterior = np.diag(np.full(12, 4.0)), np.diag(np.full(12, 1e-9))
    found = largest_departure(2.0 * change, prior, posterior, parts=PARTS)
    assert found.part == "focal length"
    assert found.rms == pytest.approx(5.0)
    assert found.limit == pytest.approx(3.29, abs=0.01)
    assert found.contradicts
    assert not largest_departure(2.0 * change, prior, posterior, parts={}).contradicts


def test_many_quantities_somewhat_off_show_in_the_whole() -> None:
    found = largest_departure(np.full(12, 1.9), np.eye(12), np.zeros((12, 12)), parts=PARTS)
    assert found.part == "lens"
    assert found.contradicts


def test_a_part_is_judged_by_its_own_sigmas_whatever_it_is_correlated_with() -> None:
    prior = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = largest_departure(np.array([3.0, 2.7, 0.0]), prior, 1e-9 * np.eye(3), parts={"one": np.array([1])})
    assert found.part == "one"
    assert found.rms == pytest.approx(2.7)
    assert not found.contradicts


def test_all_tests_of_a_right_prior_together_refuse_one_in_two_hundred_at_most() -> None:
    rng = np.random.default_rng(2)
    posterior = np.diag(rng.uniform(0.0, 1.0, 12))
    changes = rng.standard_normal((10_000, 12)) * np.sqrt(1.0 - np.diag(posterior))
    parts = {**PARTS, "radial distortion": np.arange(3, 8), "decentering": np.arange(8, 12)}
    rate = np.mean([largest_departure(one, np.eye(12), posterior, parts=parts).contradicts for one in changes])
    assert 0.001 < rate < 0.006


def test_without_information_nothing_is_contradicted() -> None:
    assert not compute_departure(np.array([5.0]), np.eye(1)).contradicts


def test_a_change_within_a_prior_that_is_hardly_improved_contradicts_nothing() -> None:
    assert not compute_departure(np.array([1.0, 0.5]), np.diag([0.999, 0.99])).contradicts
    assert compute_departure(np.array([3.4, 0.0]), np.diag([0.999, 0.99])).contradicts
