"""Error of the clock in the stated uncertainty: once, in the pose, and in no comparison by the same clock."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from tests.calibration.quality.test_unstated_tilt import ATHENS, fitted
from tests.fixtures.calibration import current_document
from tests.fixtures.finding_codes import codes

from sunarc.calibration.acceptance import apart_sigmas
from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance, sigma_deg, without_clock
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import time_step_s
from sunarc.calibration.verdict import add_stated_clock
from sunarc.formats.calibration_document import from_document

STATED_S = 120.0


@pytest.fixture(scope="module")
def fit() -> Calibration:
    return fitted(ATHENS, ATHENS)


def test_a_stated_clock_turns_directions_about_the_pole(fit: Calibration) -> None:
    stated = add_stated_clock(fit, STATED_S)
    sky = hemisphere(300)
    more = np.sqrt(sigma_deg(stated, sky) ** 2 - sigma_deg(fit, sky) ** 2)
    latitude = math.radians(ATHENS.latitude)
    off_pole = np.linalg.norm(np.cross(sky, [0.0, math.cos(latitude), math.sin(latitude)]), axis=-1)
    turn_deg = math.degrees(7.292e-5 * STATED_S)
    np.testing.assert_allclose(more, turn_deg * off_pole / math.sqrt(2.0), rtol=1e-3, atol=1e-5)
    assert stated.sky_rms_without_clock_deg == fit.sky_rms_deg
    assert (stated.evidence.clock_error_s, stated.evidence.clock_stated) == (STATED_S, True)
    assert stated.camera == fit.camera
    assert "clock_unbounded" not in codes(stated.verdict.findings)


def test_a_clock_that_nothing_bounds_is_said_and_changes_no_digit(fit: Calibration) -> None:
    said = add_stated_clock(fit, None)
    assert said.verdict.accepted
    assert said.verdict.findings[-1].code == "clock_unbounded"
    assert said.verdict.findings[-1].data["clock_error_s"] == 2.0
    assert said.verdict.findings[-1].data["turn_deg_per_minute"] == pytest.approx(0.25, abs=0.001)
    np.testing.assert_array_equal(said.covariance, fit.covariance)
    assert (said.evidence.clock_error_s, said.evidence.clock_stated) == (2.0, False)


def test_half_a_minute_is_assumed_of_times_without_seconds_and_said(fit: Calibration) -> None:
    said = add_stated_clock(fit, None, step_s=60.0)
    by_code = {one.code: one.data for one in said.verdict.findings}
    assert by_code["times_without_seconds"]["clock_error_s"] == by_code["clock_unbounded"]["clock_error_s"] == 30.0
    np.testing.assert_array_equal(said.covariance, add_stated_clock(fit, 30.0).covariance)
    assert not said.evidence.clock_stated
    assert "times_without_seconds" not in codes(add_stated_clock(fit, None).verdict.findings)


@pytest.mark.parametrize(
    ("seconds", "step_s"), [((0.0,), 60.0), ((0.0, 30.0), 0.0), ((0.0, 0.25), 0.0), ((37.0,), 0.0), ((), 0.0)]
)
def test_times_are_on_the_minute_where_all_are(seconds: tuple[float, ...], step_s: float) -> None:
    minutes = 1_368_403_200.0 + 120.0 * np.arange(25.0)
    assert time_step_s((minutes[:, None] + np.array(seconds)).ravel()) == step_s
    assert time_step_s(minutes[:19]) == 0.0


@pytest.mark.parametrize(
    ("every", "first", "step_s"), [(1, 0, 60.0), (4, 0, 60.0), (5, 0, 0.0), (20, 0, 0.0), (20, 3, 60.0)]
)
def test_times_of_a_schedule_begin_on_the_minute(every: int, first: int, step_s: float) -> None:
    """Cut times are multiples of the schedule's minutes by chance alone."""
    assert time_step_s(1_368_403_200.0 + 60.0 * (first + every * np.arange(25.0))) == step_s


def test_comparisons_by_one_clock_do_not_have_it(fit: Calibration) -> None:
    stated = add_stated_clock(fit, STATED_S)
    np.testing.assert_allclose(without_clock(stated).covariance, fit.covariance, rtol=1e-6, atol=1e-15)
    assert without_clock(stated).sky_rms_deg == fit.sky_rms_deg
    other = fitted(ATHENS, ATHENS, sigma_px=0.2)
    assert apart_sigmas(stated, add_stated_clock(other, STATED_S)) == pytest.approx(apart_sigmas(fit, other), rel=1e-4)


def test_the_document_has_the_bound_and_both_uncertainties(fit: Calibration) -> None:
    document = json.loads(json.dumps(current_document(add_stated_clock(fit, STATED_S))))
    sky = document["uncertainty"]
    assert sky["sky_rms_without_clock_deg"] < 0.5 * sky["sky_rms_deg"]
    assert (document["evidence"]["clock_error_s"], document["evidence"]["clock_stated"]) == (STATED_S, True)
    read, sky_directions = from_document(document), hemisphere(50)
    np.testing.assert_allclose(
        project_with_covariance(without_clock(read), sky_directions)[1],
        project_with_covariance(fit, sky_directions)[1],
        rtol=1e-3,
        atol=1e-6,
    )
    assert without_clock(read).sky_rms_deg == pytest.approx(fit.sky_rms_deg)
