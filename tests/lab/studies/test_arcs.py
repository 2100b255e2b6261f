"""Arcs of the sun at the paper's site, and the true error of a camera, on small cases."""

from __future__ import annotations

from dataclasses import replace
from datetime import date

import numpy as np
import pandas as pd
import pvlib
import pytest

from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.lab.studies.trials import (
    LARGEST_ZENITH_DEG,
    SYNTHETIC_DAY,
    Trial,
    arcs,
    found_circle,
    run_trials,
    true_error,
)
from sunarc.optics.forward import project
from sunarc.sky.days import solar_date
from sunarc.sky.directions import direction_from_angles

CAMERA = true_camera(0)
COARSE = arcs(CAMERA, [SYNTHETIC_DAY], cadence_s=600.0)


def test_an_arc_has_a_sighting_every_cadence_of_one_solar_day() -> None:
    assert np.diff(COARSE.unix_s) == pytest.approx(600.0)
    assert {solar_date(float(t), longitude=SGP.longitude) for t in COARSE.unix_s} == {SYNTHETIC_DAY}


def test_the_arc_lasts_as_long_as_pvlibs_sun_is_up() -> None:
    minutes = pd.date_range("2013-05-13 06:30", periods=1440, freq="1min", tz="UTC")
    angles = pvlib.solarposition.get_solarposition(minutes, SGP.latitude, SGP.longitude, SGP.altitude)
    up_min = int((angles["apparent_zenith"] < LARGEST_ZENITH_DEG).sum())
    assert len(COARSE) * 10 == pytest.approx(up_min, abs=11)


def test_directions_are_unit_vectors_above_the_horizon_and_pixels_their_projection() -> None:
    assert np.linalg.norm(COARSE.directions, axis=-1) == pytest.approx(1.0)
    assert COARSE.directions[:, 2].min() > np.cos(np.radians(LARGEST_ZENITH_DEG)) - 1e-4
    assert COARSE.pixels == pytest.approx(project(CAMERA, COARSE.directions))


def test_several_days_are_joined_in_order() -> None:
    two = arcs(CAMERA, [SYNTHETIC_DAY, date(2013, 6, 2)], cadence_s=600.0)
    assert len(two) > len(COARSE)
    assert two.unix_s[: len(COARSE)] == pytest.approx(COARSE.unix_s)
    assert (np.diff(two.unix_s) > 0.0).all()


def test_a_selection_is_of_all_columns() -> None:
    part = COARSE.select(np.array([3, 1]))
    assert part.unix_s.tolist() == COARSE.unix_s[[3, 1]].tolist()
    assert (part.directions == COARSE.directions[[3, 1]]).all()
    assert (part.pixels == COARSE.pixels[[3, 1]]).all()


def test_a_camera_has_no_error_against_itself() -> None:
    assert true_error(CAMERA, CAMERA, COARSE.directions) == 0.0


@pytest.mark.parametrize(("dx", "dy"), [(3.0, 4.0), (0.0, -2.0)])
def test_a_moved_principal_point_is_an_error_of_its_length(dx: float, dy: float) -> None:
    x, y = CAMERA.principal_point_px
    moved = replace(CAMERA, principal_point_px=(x + dx, y + dy))
    assert true_error(moved, CAMERA, COARSE.directions) == pytest.approx(np.hypot(dx, dy))


def test_a_longer_focal_length_is_an_error_that_grows_with_the_radius() -> None:
    fx, fy = CAMERA.focal_length_px
    longer = replace(CAMERA, focal_length_px=(1.01 * fx, 1.01 * fy))
    errors = [
        true_error(longer, CAMERA, direction_from_angles(zenith_deg=[z], azimuth_deg=[80.0])) for z in (20, 40, 80)
    ]
    radii = [
        float(
            np.linalg.norm(
                project(CAMERA, direction_from_angles(zenith_deg=[z], azimuth_deg=[80.0])) - CAMERA.principal_point_px
            )
        )
        for z in (20, 40, 80)
    ]
    assert np.array(errors) == pytest.approx(0.01 * np.array(radii), rel=0.02)


def test_a_fit_with_a_narrow_limit_is_judged_over_the_whole_arc() -> None:
    narrow = replace(CAMERA, max_angle=0.5)
    assert true_error(narrow, CAMERA, COARSE.directions) == 0.0


def test_the_image_circle_is_off_by_two_pixels_in_each_coordinate() -> None:
    rng = np.random.default_rng(0)
    drawn = [found_circle(rng, CAMERA) for _ in range(800)]
    truth = (*CAMERA.principal_point_px, CAMERA.focal_length_px[0] * np.sqrt(2.0))
    off = np.array([(circle.x, circle.y, circle.radius) for circle in drawn]) - truth
    assert off.mean(axis=0) == pytest.approx(0.0, abs=4.0 * 2.0 / np.sqrt(800))
    assert off.std(axis=0) == pytest.approx(2.0, rel=0.1)


def test_no_trials_are_an_empty_table() -> None:
    assert run_trials([]).shape == (0, 6)


def test_a_trial_is_counted_when_it_is_done() -> None:
    counted: list[int] = []
    run_trials([], after_each=lambda: counted.append(1))
    assert counted == []
    assert Trial(method="paper", sigma_px=1.0, seed=(1, 2)).seed == (1, 2)
