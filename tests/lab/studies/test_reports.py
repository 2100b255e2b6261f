"""Files of the studies, and rows that are computed from trials."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from sunarc.common.errors import InputError
from sunarc.lab.simulation.truth import true_camera
from sunarc.lab.studies.figures import parameter_figure, rmse_figure
from sunarc.lab.studies.published import CASES, TRUE_RMSE
from sunarc.lab.studies.reports import make_folder, write_csv
from sunarc.lab.studies.tables import COLUMNS, published_row, truth_row
from sunarc.lab.studies.trials import QUANTITIES
from sunarc.lab.studies.uncertainty import UncertaintyStudy, distribution_rows, trial_rows, true_values
from sunarc.optics.pose import pose_angles
from sunarc.sources.files import writing_into

RNG = np.random.default_rng(0)
STUDY = UncertaintyStudy(
    methods=("paper", "robust"),
    sigma_px=np.array([0.0, 5.0, 10.0]),
    seed=3,
    trials={"paper": RNG.normal(size=(3, 21, 6)), "robust": RNG.normal(size=(3, 21, 6))},
    bound={"paper": RNG.uniform(0.1, 1.0, (3, 6)), "robust": RNG.uniform(0.1, 1.0, (3, 6))},
)


def test_a_folder_is_made_with_its_parents_and_may_exist(tmp_path: Path) -> None:
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()


def test_a_folder_that_is_a_file_is_refused_with_its_name(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(InputError) as error:
        make_folder(file / "below")
    assert error.value.field == str(file / "below")


def test_an_error_that_is_not_of_the_disk_passes(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), writing_into(tmp_path):
        _ = 1 / 0


def test_numbers_have_nine_digits_and_what_is_missing_is_empty(tmp_path: Path) -> None:
    rows: list[dict[str, str | int | float]] = [{"a": 1.0 / 3.0, "b": 12, "c": "x,y"}, {"a": 1e-7}]
    path = write_csv(tmp_path / "t.csv", ("a", "b", "c"), rows)
    assert path.read_text() == 'a,b,c\n0.333333333,12,"x,y"\n1e-07,,\n'
    with path.open(newline="") as file:
        assert next(csv.DictReader(file))["c"] == "x,y"


def test_quantiles_of_a_row_are_numpys() -> None:
    rows = {(r["method"], r["sigma_px"], r["quantity"]): r for r in distribution_rows(STUDY)}
    assert len(rows) == 2 * 3 * 6
    row, drawn = rows["robust", 5.0, "principal_point_y_px"], STUDY.trials["robust"][1, :, 5]
    assert [row[name] for name in ("p05", "p25", "median", "p75", "p95")] == pytest.approx(
        np.quantile(drawn, [0.05, 0.25, 0.5, 0.75, 0.95]).tolist()
    )
    assert row["mean"] == pytest.approx(float(drawn.mean()))
    assert row["bound"] == STUDY.bound["robust"][1, 5]
    assert (row["n_trials"], row["truth"]) == (21, true_camera(0).principal_point_px[1])


def test_every_fit_is_a_row_in_the_order_of_levels() -> None:
    rows = trial_rows(STUDY)
    assert len(rows) == 2 * 3 * 21
    assert [(r["method"], r["sigma_px"], r["trial"]) for r in (rows[0], rows[20], rows[21], rows[-1])] == [
        ("paper", 0.0, 0),
        ("paper", 0.0, 20),
        ("paper", 5.0, 0),
        ("robust", 10.0, 20),
    ]
    assert [rows[21][name] for name in QUANTITIES] == pytest.approx(STUDY.trials["paper"][1, 0].tolist())


def test_the_truth_has_no_error_and_the_true_cameras_parameters() -> None:
    truth = true_camera(0)
    assert true_values().tolist() == [0.0, 0.0, *truth.focal_length_px, *truth.principal_point_px]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"case {case.number}")
def test_rows_have_known_columns_and_the_cases_own_numbers(case: object) -> None:
    assert case in CASES
    number = CASES.index(case) + 1
    published, truth = published_row(CASES[number - 1]), truth_row(CASES[number - 1])
    assert {*published, *truth} <= set(COLUMNS)
    assert (published["case"], published["source"], truth["source"]) == (number, "published", "truth")
    assert published["n"] == truth["n"] == CASES[number - 1].n_points
    pose = pose_angles(true_camera(0).rotation_cam_enu)
    assert [truth[name] for name in COLUMNS[14:17]] == pytest.approx(list(pose))


def test_rmsd_of_the_published_arcs_is_not_below_their_sd() -> None:
    assert all(case.rmsd_m_px >= case.sd_m_px for case in CASES)
    assert [case.number for case in CASES] == [1, 2, 3, 4, 5]
    assert len({case.days for case in CASES}) == 5


def test_the_figure_of_errors_shows_bands_means_bounds_and_the_papers_values() -> None:
    on_arc, on_sky = rmse_figure(STUDY).axes
    lines = {str(line.get_label()): line for line in on_arc.lines}
    assert np.asarray(lines["paper, mean"].get_ydata()) == pytest.approx(STUDY.trials["paper"][1:, :, 0].mean(axis=1))
    assert np.asarray(lines["robust, bound"].get_ydata()) == pytest.approx(STUDY.bound["robust"][1:, 0])
    assert np.asarray(lines["robust, median"].get_xdata()) == pytest.approx([5.0, 10.0])
    assert len(on_arc.collections) >= 4  # two bands of each method
    assert [mean for _, mean, _ in TRUE_RMSE] in [np.asarray(line.get_ydata()).tolist() for line in on_arc.lines]
    assert (on_arc.get_xlim(), on_sky.get_yscale()) == ((0.0, 10.0), "log")


def test_the_figure_of_parameters_has_a_row_for_each_method() -> None:
    panels = parameter_figure(STUDY).axes
    assert len(panels) == 8
    truth = true_values()[2]
    line = next(line for line in panels[0].lines if line.get_label() == "paper, mean")
    assert np.asarray(line.get_ydata()) == pytest.approx(STUDY.trials["paper"][1:, :, 2].mean(axis=1) - truth)
    bound = next(line for line in panels[0].lines if line.get_label() == "paper, 90 % bound")
    assert np.asarray(bound.get_ydata()) == pytest.approx(1.645 * STUDY.bound["paper"][:, 2])
    low, high = panels[0].get_ylim()
    assert low == pytest.approx(-high)
