"""The test of contradiction: its rate of false alarms, and that it sees what is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.calibration.lens_library.departure import departure_of


def test_one_determined_quantity_is_judged_by_its_normal_distribution() -> None:
    found = departure_of(np.array([2.0, 0.0]), np.diag([0.0, 1.0]))
    assert found.rms == pytest.approx(2.0)
    assert found.limit == pytest.approx(3.29, abs=0.01)  # 0.1 % two-sided
    assert not found.contradicts
    assert departure_of(np.array([3.4, 0.0]), np.diag([0.0, 1.0])).contradicts


def test_right_priors_are_refused_as_rarely_as_stated() -> None:
    rng = np.random.default_rng(1)
    remaining = np.diag(rng.uniform(0.0, 1.0, 12))
    changes = rng.standard_normal((20_000, 12)) * np.sqrt(1.0 - np.diag(remaining))
    rate = np.mean([departure_of(change, remaining).contradicts for change in changes])
    assert 0.0004 < rate < 0.003
    wrong = np.mean([departure_of(change + 2.0, remaining).contradicts for change in changes[:500]])
    assert wrong > 0.5


def test_without_information_nothing_is_contradicted() -> None:
    assert not departure_of(np.array([5.0]), np.eye(1)).contradicts
