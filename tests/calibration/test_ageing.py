"""Uncertainty away from the sightings: what seasons do to a focal length, and nothing within a week."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from tests.fixtures.calibrations import chosen_calibration

from sunarc.calibration.answers.ageing import age_step_days, aged
from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.model.result import Calibration
from sunarc.formats.calibration_document import document_at, from_document, to_document
from sunarc.optics.camera import PARAMETER_NAMES, Camera
from sunarc.optics.forward import project

LENS = Camera(
    width=1748,
    height=1748,
    projection="equisolid",
    focal_length_px=(601.32, 601.32),
    principal_point_px=(871.96, 883.0),
    rotation_cam_enu=(0.02, -0.015, 2.1),
)
NAMES = (*PARAMETER_NAMES[:2], *PARAMETER_NAMES[3:8])
LAST = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
"""Noon of the last day of the sightings at the camera's site."""
GLASS, PLASTIC = 3e-4, 2.4e-3


@pytest.fixture
def served() -> Calibration:
    covariance = np.diag([1e-4, 1e-4, 1e-4, 1e-4, 1e-10, 1e-10, 1e-10])
    return chosen_calibration(LENS, names=NAMES, covariance=covariance, orders=np.array([[1, 1], [2, 1]]))


def of(calibration: Calibration, days: float) -> Calibration:
    return aged(calibration, age_step_days(calibration, (LAST + timedelta(days=days)).timestamp()))


def horizon_px2(calibration: Calibration) -> float:
    """Return the mean variance of both axes together 85 to 90 degrees off the zenith."""
    low = hemisphere(2000)
    low = low[low[:, 2] < np.cos(np.radians(85.0))]
    return float(np.nanmean(np.trace(project_with_covariance(calibration, low)[1], axis1=1, axis2=2)))


def test_a_fit_of_the_same_week_is_served_as_it_is(served: Calibration) -> None:
    for days in (-6.9, -1.0, 0.0, 3.0, 6.9):
        assert of(served, days) is served
    assert age_step_days(replace(served, evidence=replace(served.evidence, days=())), LAST.timestamp() + 1e9) == 0


@pytest.mark.parametrize("days", [180.0, -180.0])
def test_after_half_a_year_the_focal_length_is_that_of_the_other_season(served: Calibration, days: float) -> None:
    then = of(served, days)
    assert then.aged_days == pytest.approx(days, abs=5.0)
    low = hemisphere(2000)
    low = low[low[:, 2] < np.cos(np.radians(85.0))]
    radius = float(np.nanmean(np.linalg.norm(project(LENS, low) - np.array(LENS.principal_point_px), axis=-1)))
    # from one end of a wave of 1-sigma 3e-4 to the other, beside a tenth of it that years differ by
    share = np.sqrt(horizon_px2(then) - horizon_px2(served)) / radius
    assert 2.0 * GLASS <= share <= 2.4 * GLASS
    assert then.camera == served.camera
    assert then.sky_rms_deg > served.sky_rms_deg
    assert then.sky_max_deg >= then.sky_rms_deg


def test_the_uncertainty_never_shrinks_with_age(served: Calibration) -> None:
    found = [horizon_px2(of(served, days)) for days in (0.0, 8.0, 15.0, 30.0, 60.0, 100.0, 150.0, 200.0, 365.0, 2000.0)]
    assert all(later >= earlier for earlier, later in itertools.pairwise(found))
    assert found[-1] == pytest.approx(found[-2])


def test_a_season_of_plastic_is_allowed_for_where_the_sightings_prove_it(served: Calibration) -> None:
    def with_odds(glass: float, plastic: float) -> Calibration:
        odds = {"season": glass, "season_of_plastic": plastic}
        return replace(served, evidence=replace(served.evidence, log_odds=odds))

    usual = horizon_px2(of(served, 100.0)) - horizon_px2(served)
    for glass, plastic, expected in ((5.0, 80.0, PLASTIC / GLASS), (80.0, 70.0, 1.0), (-3.0, -4.0, 1.0)):
        found = with_odds(glass, plastic)
        more = horizon_px2(of(found, 100.0)) - horizon_px2(served)
        assert np.sqrt(more / usual) == pytest.approx(expected, rel=1e-6)


def test_a_document_states_the_uncertainty_of_a_time(served: Calibration) -> None:
    day = datetime(2013, 5, 14, tzinfo=UTC)
    stored = to_document(
        served,
        id="roof-1",
        camera="roof",
        state="current",
        created_at=day,
        valid_from=day,
        valid_until=None,
        pose_epoch="roof-1",
        software_version="0.1.0",
    )
    later = LAST + timedelta(days=100)
    assert document_at(stored, LAST) == stored
    then = json.loads(json.dumps(document_at(stored, later)))
    assert then["uncertainty"]["aged_days"] == 119
    read = from_document(then)
    assert read.aged_days == 119
    np.testing.assert_allclose(read.covariance, of(served, 100.0).covariance, rtol=1e-12)
    assert document_at(then, later) == then  # it does not grow twice
    assert {key for key in then if then[key] != stored[key]} == {"uncertainty"}
