from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.calibration.quality.day_quality import DayMeasure, measure_day
from sunarc.lab.simulation.truth import SGP
from sunarc.lab.studies.published import CASES, Case
from sunarc.lab.studies.reports import write_tables
from sunarc.lab.studies.tables import (
    COLUMNS,
    SD_OF_DISTANCE,
    clear_noise,
    cloud_noise,
    fitted_row,
    published_row,
    simulated_case,
    truth_row,
)
from sunarc.lab.studies.trials import QUANTITIES

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"case {case.number}")
def test_the_published_sd_is_that_of_the_distance(case: Case) -> None:
    """RMSE² = MAE² + SD² holds in every row of Table 3 to the digits printed: what SD means there."""
    row = published_row(case)
    total = math.hypot(float(row["mae_px"]), float(row["sd_of_distance_px"]))
    assert total == pytest.approx(float(row["rmse_px"]), abs=0.011)


@pytest.mark.parametrize("case", CASES[::4], ids=lambda case: f"case {case.number}")
def test_a_simulated_case_has_the_paper_s_count_and_scatter(case: Case) -> None:
    _, points = simulated_case(case, np.random.default_rng(3))
    measured: DayMeasure = measure_day(points, site=SGP)
    assert len(points) == case.n_points
    assert measured.sd_px == pytest.approx(case.sd_m_px, rel=0.06)


def test_clouds_come_in_episodes_and_are_as_wide_as_asked_for() -> None:
    noise = cloud_noise(np.random.default_rng(5), 4000, inlier_px=0.43, share=0.22, sd_px=5.21)
    distance = np.linalg.norm(noise, axis=-1)
    assert np.std(distance) == pytest.approx(5.21, rel=1e-6)
    assert np.abs(noise).max() <= 50.0
    bad = distance > 2.5
    assert 0.1 < bad.mean() < 0.25
    assert np.mean(bad[1:][bad[:-1]]) > 2.0 * bad.mean()


def test_clear_noise_scatters_in_distance_by_the_sd_asked_for() -> None:
    noise = clear_noise(np.random.default_rng(5), 200_000, sd_px=0.43)
    assert np.std(np.linalg.norm(noise, axis=-1)) == pytest.approx(0.43, rel=0.01)
    assert abs(SD_OF_DISTANCE - 0.655) < 5e-4


def test_case_5_is_found_far_better_by_the_robust_method_though_both_leave_the_same_residuals() -> None:
    paper, robust = (fitted_row(CASES[4], method=method, seed=1) for method in ("paper", "robust"))
    assert robust["rmse_px"] == pytest.approx(float(paper["rmse_px"]), rel=0.05)
    assert float(robust["true_arc_rmse_px"]) < 0.1
    assert float(robust["true_arc_rmse_px"]) < 0.25 * float(paper["true_arc_rmse_px"])
    assert fitted_row(CASES[4], method="paper", seed=1) == paper


def test_the_file_has_the_stated_columns_and_leaves_empty_what_a_source_does_not_tell(tmp_path: Path) -> None:
    (file,) = write_tables([published_row(CASES[0]), truth_row(CASES[0])], folder=tmp_path)
    with file.open() as opened:
        published, truth = csv.DictReader(opened)
    assert tuple(published) == COLUMNS
    assert published["rmse_px"] == "0.94"
    assert published["sd_px"] == ""
    assert truth["focal_length_x_px"] == "601.32"
    assert truth["rmse_px"] == ""


def test_the_command_prints_json_and_writes_its_files(sunarc: Sunarc, tmp_path: Path) -> None:
    arguments = ("uncertainty", "--trials", "1", "--levels", "2", "--method", "robust", "--out", str(tmp_path))
    as_json = sunarc("study", *arguments, "--json")
    assert as_json.code == 0
    told = json.loads(as_json.out)
    assert len(told["rows"]) == 2 * len(QUANTITIES)
    assert all(Path(file).stat().st_size > 0 for file in told["files"])
    assert "sky_rmse_px" in sunarc("study", *arguments).out


def test_an_unknown_method_and_a_folder_that_cannot_be_are_one_line_and_exit_2(sunarc: Sunarc, tmp_path: Path) -> None:
    unknown = sunarc("study", "tables", "--method", "best", "--out", str(tmp_path))
    assert (unknown.code, unknown.err.count("\n")) == (2, 1)
    assert "--method: 'best' is unknown" in unknown.err
    file = tmp_path / "file"
    file.write_text("")
    refused = sunarc("study", "tables", "--out", str(file))
    assert (refused.code, refused.err.count("\n")) == (2, 1)
