from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
import pytest

from sunarc.calibration.answers.covariance import sigma_deg
from sunarc.calibration.answers.residuals import compute_residuals
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.lab.simulation.truth import SGP
from sunarc.public.plots import (
    RESIDUAL_SHEET_PX,
    SKY_SHEET_PX,
    contour_levels,
    residual_figure,
    sky_sigma,
    write_calibration_plots,
)
from sunarc.sky.directions import direction_from_angles

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

    from .conftest import PngSize


def test_a_calibration_s_figures_are_pngs_of_the_stated_size_and_leave_matplotlib_as_it_was(
    cloudy_fit: Calibration, cloudy_points: Sightings, tmp_path: Path, png_size: PngSize
) -> None:
    before = dict(mpl.rcParams)
    files = write_calibration_plots(cloudy_fit, cloudy_points, folder=tmp_path / "new" / "plots")
    assert [file.name for file in files] == ["residuals.png", "sky.png"]
    assert [png_size(file) for file in files] == [RESIDUAL_SHEET_PX, SKY_SHEET_PX]
    assert dict(mpl.rcParams) == before


def test_the_sightings_that_were_moved_are_the_rejected_ones(cloudy_fit: Calibration, cloudy_points: Sightings) -> None:
    residuals = compute_residuals(cloudy_fit, cloudy_points)
    moved = np.arange(len(cloudy_points)) % 10 == 0
    assert not np.any(residuals.used & moved)
    assert residuals.used.sum() == cloudy_fit.evidence.n_used
    assert np.median(residuals.offset_px[moved, 0]) == pytest.approx(15.0, abs=0.2)


def test_an_offset_of_a_pixel_is_about_a_tenth_of_a_degree(cloudy_fit: Calibration, cloudy_points: Sightings) -> None:
    """One px is 0.095° at the zenith of this lens, 0.135° across the radius at the horizon (equisolid, 601 px)."""
    residuals = compute_residuals(cloudy_fit, cloudy_points)
    scale = residuals.offset_deg / np.linalg.norm(residuals.offset_px, axis=-1)
    assert scale.min() > 0.06
    assert scale.max() < 0.14


def test_both_rejected_and_used_sightings_are_named_in_the_key(
    cloudy_fit: Calibration, cloudy_points: Sightings
) -> None:
    figure = residual_figure(cloudy_fit, compute_residuals(cloudy_fit, cloudy_points))
    labels = {text for axes in figure.axes for text in axes.get_legend_handles_labels()[1]}
    assert {"x, used", "y, used"} <= labels
    assert any(label.startswith("rejected") for label in labels)


def test_the_sky_map_is_the_calibration_s_own_sigma_and_empty_outside_the_image(cloudy_fit: Calibration) -> None:
    zenith, azimuth = np.array([20.0, 60.0]), np.array([0.0, 90.0, 180.0])
    sigma = sky_sigma(cloudy_fit, zenith_deg=zenith, azimuth_deg=azimuth)
    own = sigma_deg(cloudy_fit, direction_from_angles(zenith_deg=[60.0], azimuth_deg=[180.0]))
    assert sigma[1, 2] == pytest.approx(own[0], rel=1e-6)
    below = sky_sigma(cloudy_fit, zenith_deg=np.array([120.0]), azimuth_deg=azimuth)
    assert np.all(np.isnan(below))


@pytest.mark.parametrize("count", [0, 3])
def test_a_fit_that_was_refused_for_want_of_sightings_has_figures_too(
    cloudy_points: Sightings, tmp_path: Path, count: int, png_size: PngSize
) -> None:
    few = cloudy_points.select(slice(0, count))
    refused = calibrate(few, site=SGP, image_size=(1748, 1748))
    assert not refused.verdict.accepted
    files = write_calibration_plots(refused, few, folder=tmp_path)
    assert [png_size(file) for file in files] == [RESIDUAL_SHEET_PX, SKY_SHEET_PX]


def test_contours_stand_at_round_numbers_between_the_bounds() -> None:
    assert contour_levels(0.0021, 0.012) == [0.003, 0.005, 0.007, 0.01]
    assert contour_levels(1.0, 1.0) == []
    assert contour_levels(0.0, 1.0) == []
    assert len(contour_levels(1e-6, 10.0)) <= 9


def test_the_command_line_draws_into_a_folder_and_refuses_one_that_cannot_be(
    sunarc: Sunarc, cloudy_points: Sightings, tmp_path: Path, png_size: PngSize
) -> None:
    file = tmp_path / "points.csv"
    rows = zip(cloudy_points.unix_s.tolist(), cloudy_points.pixels.tolist(), strict=True)
    told = [f"{datetime.fromtimestamp(t, UTC).isoformat()},{x},{y}" for t, (x, y) in rows]
    file.write_text("\n".join(["time_utc,x_px,y_px", *told]))
    place = ("--latitude", str(SGP.latitude), "--longitude", str(SGP.longitude), "--image-size", "1748,1748")
    drawn = sunarc("calibrate", str(file), *place, "--plots", str(tmp_path / "plots"))
    assert drawn.code == 0
    assert "sky.png" in drawn.out
    assert png_size(tmp_path / "plots" / "sky.png") == SKY_SHEET_PX
    refused = sunarc("calibrate", str(file), *place, "--plots", str(file))
    assert refused.code == 2
    assert "name a folder that can be written to" in refused.err
    assert refused.err.count("\n") == 1
