from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.lab.studies.figures import PARAMETER_SHEET_PX, RMSE_SHEET_PX
from sunarc.lab.studies.reports import write_uncertainty
from sunarc.lab.studies.trials import QUANTITIES, Trial, run_trials
from sunarc.lab.studies.uncertainty import UncertaintyStudy, distribution_rows, study_uncertainty, trial_rows

if TYPE_CHECKING:
    from .conftest import PngSize


@pytest.fixture(scope="module")
def study() -> UncertaintyStudy:
    return study_uncertainty(methods=("robust", "paper"), levels=2, trials=2, seed=7)


def test_a_study_is_the_same_again_by_its_seed_in_another_process_too(study: UncertaintyStudy) -> None:
    elsewhere = run_trials([Trial(method="robust", sigma_px=10.0, seed=(7, 1, 1))], jobs=2)
    # to rounding: what is compiled here and read from the cache there need not round alike
    np.testing.assert_allclose(elsewhere[0], study.trials["robust"][1, 1], rtol=1e-9)
    other = run_trials([Trial(method="robust", sigma_px=10.0, seed=(8, 1, 1))])
    assert not np.allclose(other[0], study.trials["robust"][1, 1], rtol=1e-6)


def test_every_fit_is_counted() -> None:
    counted: list[int] = []
    study_uncertainty(methods=("robust",), levels=2, trials=1, after_each=lambda: counted.append(1))
    assert len(counted) == 2


def test_without_noise_both_methods_find_the_true_camera(study: UncertaintyStudy) -> None:
    for method in study.methods:
        assert np.all(study.trials[method][0, :, QUANTITIES.index("arc_rmse_px")] < 1e-3)
        assert np.all(study.trials[method][0, :, QUANTITIES.index("sky_rmse_px")] < 0.05)


def test_the_quantiles_rise_and_the_noise_is_from_0_to_10_px(study: UncertaintyStudy) -> None:
    rows = distribution_rows(study)
    assert len(rows) == 2 * 2 * len(QUANTITIES)
    assert sorted({float(row["sigma_px"]) for row in rows}) == [0.0, 10.0]
    for row in rows:
        quantiles = [float(row[name]) for name in ("p05", "p25", "median", "p75", "p95")]
        assert quantiles == sorted(quantiles)


def test_the_files_have_the_stated_columns_and_sizes(
    study: UncertaintyStudy, tmp_path: Path, png_size: PngSize
) -> None:
    files = write_uncertainty(study, folder=tmp_path)
    assert [file.name for file in files] == [
        "uncertainty.csv", "uncertainty_trials.csv", "uncertainty_rmse.png", "uncertainty_parameters.png",
    ]  # fmt: skip
    assert [png_size(file) for file in files[2:]] == [RMSE_SHEET_PX, PARAMETER_SHEET_PX]
    with files[0].open() as file:
        header, *rows = csv.reader(file)
    assert header[:6] == ["method", "sigma_px", "quantity", "n_trials", "truth", "mean"]
    assert header[6:] == ["p05", "p25", "median", "p75", "p95", "bound"]
    assert len(rows) == len(distribution_rows(study))
    with files[1].open() as file:
        header, *rows = csv.reader(file)
    assert header == ["method", "sigma_px", "trial", *QUANTITIES]
    assert len(rows) == len(trial_rows(study))
    assert float(rows[0][3]) == pytest.approx(float(study.trials["robust"][0, 0, 0]), rel=1e-8)
