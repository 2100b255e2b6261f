"""From an error of the direction to height, shadow and ramp: closed forms, brute force, and what is written."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from tests.fixtures.calibration import current_document, small_camera, stated_calibration
from tests.fixtures.command_line import Sunarc

from sunarc.calibration.answers.covariance import sigma_deg
from sunarc.lab.studies import shadow as module
from sunarc.lab.studies.reports import write_shadow
from sunarc.lab.studies.shadow import (
    RAMP_W_M2,
    WIND_M_S,
    WINDOW_S,
    ShadowRow,
    overhead_height_sigma_m,
    pair_height,
    ramp_error,
    shadow_place,
    study_calibrated_shadow,
    study_shadow,
)
from sunarc.sky.directions import direction_from_angles

FloatArray = NDArray[np.float64]


def to(place: list[float], *, from_east_m: float = 0.0) -> FloatArray:
    vector = np.array(place) - [from_east_m, 0.0, 0.0]
    return np.asarray(vector / np.linalg.norm(vector))


@pytest.mark.parametrize("place", [[300.0, 200.0, 1500.0], [-900.0, 40.0, 800.0], [500.0, 0.0, 1000.0]])
def test_rays_that_meet_give_the_height_where_they_do(place: list[float]) -> None:
    found = pair_height(to(place), to(place, from_east_m=700.0), baseline_m=700.0)
    assert float(found) == pytest.approx(place[2])


def test_rays_that_miss_one_another_give_the_closest_approach() -> None:
    first, second = to([300.0, 200.0, 1500.0]), to([320.0, 260.0, 1480.0], from_east_m=700.0)

    def apart(lengths: FloatArray) -> FloatArray:
        return np.asarray(lengths[0] * first - [700.0, 0.0, 0.0] - lengths[1] * second)

    best = least_squares(apart, np.array([1500.0, 1500.0]), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    expected = 0.5 * (best[0] * first[2] + best[1] * second[2])
    assert float(pair_height(first, second, baseline_m=700.0)) == pytest.approx(expected, rel=1e-6)
    assert math.isnan(pair_height(first, first, baseline_m=700.0))


def test_the_height_of_a_cloud_above_the_middle_scatters_as_the_closed_form_says() -> None:
    height, baseline, sigma = 1200.0, 800.0, 0.05
    middle = [0.5 * baseline, 0.0, height]
    seen = module.turned_errors(sigma, draws=4000, seed=3)
    first, second = seen(to(middle)[None], 0), seen(to(middle, from_east_m=baseline)[None], 1)
    found = pair_height(first, second, baseline_m=baseline)[:, 0]
    expected = overhead_height_sigma_m(sigma_deg=sigma, height_m=height, baseline_m=baseline)
    assert expected == pytest.approx(math.sqrt(2.0) * height**2 / baseline * (1.0 + 1.0 / 9.0) * math.radians(sigma))
    assert 0.95 < np.std(found) / expected < 1.05


def test_a_shadow_falls_away_from_the_sun() -> None:
    sun = direction_from_angles(zenith_deg=45.0, azimuth_deg=180.0)
    overhead = shadow_place(np.array([[0.0, 0.0, 1.0]]), np.array([1000.0]), sun)
    np.testing.assert_allclose(overhead, [[0.0, 1000.0]], atol=1e-9)
    east = shadow_place(to([500.0, 0.0, 1000.0])[None], np.array([1000.0]), sun)
    np.testing.assert_allclose(east, [[500.0, 1000.0]], atol=1e-9)


def test_the_shadow_of_a_known_height_overhead_moves_by_height_times_the_turn() -> None:
    seen = module.turned_errors(0.1, draws=4000, seed=4)
    sun = direction_from_angles(zenith_deg=40.0, azimuth_deg=180.0)
    place = shadow_place(seen(np.array([[0.0, 0.0, 1.0]]), 0), np.full((4000, 1), 2000.0), sun)[:, 0]
    assert np.std(place, axis=0) == pytest.approx(2000.0 * math.radians(0.1), rel=0.05)


def test_a_ramp_that_comes_too_late_is_wrong_for_as_long() -> None:
    steps = np.arange(-0.5 * WINDOW_S, 0.5 * WINDOW_S, 0.05) + 0.025
    for displacement in (0.0, 37.0, -450.0, 1e5):
        delay = displacement / WIND_M_S
        wrong = np.abs(np.where(steps > 0.0, RAMP_W_M2, 0.0) - np.where(steps > delay, RAMP_W_M2, 0.0)).mean()
        assert float(ramp_error(np.array([displacement, 5.0]))) == pytest.approx(wrong, abs=0.06)


def test_errors_grow_in_proportion_and_a_longer_baseline_gives_a_better_height() -> None:
    rows = study_shadow(draws=300, seed=1, sigmas_deg=(0.02, 0.04))
    by = {(row.sigma_deg, row.height_m, row.baseline_m): row for row in rows}
    assert len(rows) == 2 * len(module.HEIGHTS_M) * len(module.BASELINES_M)
    for height in module.HEIGHTS_M[:2]:
        small, large = by[0.02, height, 1000.0], by[0.04, height, 1000.0]
        assert 1.9 < large.shadow_sigma_m / small.shadow_sigma_m < 2.1
        assert 1.8 < large.height_sigma_m / small.height_sigma_m < 2.2
        heights = [by[0.02, height, baseline].height_sigma_m for baseline in (250.0, 500.0, 1000.0)]
        assert heights == sorted(heights, reverse=True)
        assert small.shadow_pair_sigma_m > small.shadow_sigma_m
        # the mean size of a Gaussian delay, where the height is off by little: √(2/π) σ
        expected = RAMP_W_M2 * math.sqrt(2.0 / math.pi) * small.shadow_pair_sigma_m / WIND_M_S / WINDOW_S
        assert 0.5 < small.ramp_error_w_m2 / expected < 2.5


def test_the_errors_of_a_calibration_are_those_it_states() -> None:
    made = replace(stated_calibration(small_camera()), sky_rms_deg=0.2)
    rows = study_calibrated_shadow(made, draws=300, seed=1)
    known = {row.height_m: row.shadow_sigma_m for row in rows}
    sky = direction_from_angles(zenith_deg=np.linspace(0.0, 60.0, 40), azimuth_deg=np.linspace(0.0, 360.0, 40))
    stated = math.radians(float(np.median(sigma_deg(made, sky))))
    # seen at 0 to 60 degrees a direction's error is stretched by 1 to 4 on the ground
    assert stated < known[1000.0] / 1000.0 < 4.0 * stated
    assert known[2000.0] / known[1000.0] == pytest.approx(2.0)
    assert {row.sigma_deg for row in rows} == {0.2}


def test_what_is_written(tmp_path: Path) -> None:
    rows = study_shadow(draws=20, seed=1, sigmas_deg=(0.1, 1.0))
    files = write_shadow(rows, folder=tmp_path / "study")
    assert [file.name for file in files] == ["shadow.csv", "shadow.png"]
    with files[0].open(encoding="utf-8") as file:
        read = list(csv.DictReader(file))
    assert len(read) == len(rows)
    assert float(read[0]["height_sigma_m"]) == pytest.approx(rows[0].height_sigma_m)
    assert files[1].read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_the_command_prints_and_writes_with_the_errors_of_a_document(sunarc: Sunarc, tmp_path: Path) -> None:
    document = current_document(replace(stated_calibration(small_camera()), sky_rms_deg=0.2))
    (tmp_path / "calibration.json").write_text(json.dumps(document), encoding="utf-8")
    command = ["study", "shadow", "--out", str(tmp_path / "study"), "--draws", "20", "--json"]
    for options, count in (([], 7 * 20), (["--calibration", str(tmp_path / "calibration.json")], 20)):
        answer = sunarc(*command, *options)
        assert answer.code == 0, answer.err
        rows = [ShadowRow(**row) for row in json.loads(answer.out)["rows"]]
        assert len(rows) == count
