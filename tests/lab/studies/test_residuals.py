"""Residuals of a calibration, and the scales of their figures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sunarc.calibration.answers.direction_table import lookup
from sunarc.calibration.answers.residuals import compute_residuals
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.public.plots import (
    contour_levels,
    draw_arrows,
    draw_uncertainty,
    key,
    letter,
    new_sheet,
    nice_number,
    panel_limit,
    residual_figure,
    sky_figure,
    some_rows,
)
from sunarc.sky.directions import angular_distance, direction_from_angles
from sunarc.sky.sun import sun_directions


@pytest.mark.parametrize(
    ("value", "nice"),
    [
        (1.0, 1.0),
        (1.4, 1.0),
        (1.5, 2.0),
        (3.0, 2.0),
        (3.3, 5.0),
        (7.0, 5.0),
        (7.2, 10.0),
        (0.03, 0.02),
        (250.0, 200.0),
        (0.0, 1.0),
        (-3.0, 1.0),
    ],
)
def test_the_nearest_of_one_two_and_five(value: float, nice: float) -> None:
    assert nice_number(value) == pytest.approx(nice)


@pytest.mark.parametrize(("count", "drawn"), [(0, 0), (200, 200), (201, 101), (1000, 200), (1001, 167)])
def test_at_most_200_arrows_evenly_chosen(count: int, drawn: int) -> None:
    rows = some_rows(np.ones(count, np.bool_))
    assert rows.size == drawn
    assert rows.size == 0 or rows[0] == 0


def test_only_what_belongs_is_chosen() -> None:
    assert some_rows(np.array([False, True, False, True])).tolist() == [1, 3]


@pytest.mark.parametrize(
    ("size", "used", "limit"),
    [
        ([1.0, 9.0], [True, False], 1.4),
        ([1.0, 9.0], [False, False], 12.6),
        ([0.0, 9.0], [True, False], 1.0),
        ([math.nan, 2.0], [True, True], 2.8),
        ([], [], 1.0),
    ],
)
def test_the_used_sightings_set_the_limit_of_a_panel(size: list[float], used: list[bool], limit: float) -> None:
    assert panel_limit(np.array(size), np.array(used, np.bool_)) == pytest.approx(limit)


@pytest.mark.parametrize(
    ("low", "high", "levels"),
    [
        (0.9, 2.5, [1.0, 1.5, 2.0]),
        (1.0, 2.0, [1.5]),
        (0.06, 0.12, [0.07, 0.1]),
        (2.0, 1.0, []),
        (-1.0, 1.0, []),
    ],
)
def test_contours_are_strictly_between_the_bounds(low: float, high: float, levels: list[float]) -> None:
    assert contour_levels(low, high) == pytest.approx(levels)


def test_a_sheet_has_its_size_and_room_for_labels() -> None:
    sheet = new_sheet(width_px=640, height_px=480)
    assert (sheet.get_size_inches() * sheet.dpi).tolist() == [640.0, 480.0]
    axes = sheet.subplots()
    letter(axes, x="time", y="error (px)", title="errors")
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title(loc="left")) == ("time", "error (px)", "errors")
    key(axes)
    assert axes.get_legend() is None  # nothing was drawn with a label
    axes.plot([0.0], [0.0], label="a")
    key(axes, location="upper left")
    assert axes.get_legend() is not None


def test_residuals_are_observed_minus_predicted(cloudy_fit: Calibration, cloudy_points: Sightings) -> None:
    found = compute_residuals(cloudy_fit, cloudy_points)
    directions = sun_directions(cloudy_points.unix_s, cloudy_fit.site)
    camera = replace(cloudy_fit.camera, rotation_cam_enu=cloudy_fit.poses[0])
    assert len(found.used) == len(cloudy_points)
    assert found.offset_px == pytest.approx(cloudy_points.pixels - project(camera, directions))
    expected = np.degrees(angular_distance(unproject(camera, cloudy_points.pixels), directions))
    assert found.offset_deg == pytest.approx(expected)


def test_sightings_that_are_not_finite_or_below_the_horizon_are_left_out(
    cloudy_fit: Calibration, cloudy_points: Sightings
) -> None:
    times, pixels = cloudy_points.unix_s.copy(), cloudy_points.pixels.copy()
    times[0], pixels[1, 0] = math.nan, math.nan
    times[2] -= 6 * 3600.0  # at night
    found = compute_residuals(cloudy_fit, replace(cloudy_points, unix_s=times, pixels=pixels))
    assert len(found.used) == len(cloudy_points) - 3
    assert np.isfinite(found.offset_px).all()


def test_of_other_sightings_the_nearest_count_as_used(cloudy_fit: Calibration, cloudy_points: Sightings) -> None:
    found = compute_residuals(replace(cloudy_fit, left_out=None), cloudy_points)
    distance = np.linalg.norm(found.offset_px, axis=-1)
    assert found.used.sum() == cloudy_fit.evidence.n_used
    assert distance[found.used].max() <= distance[~found.used].min()


def test_rejected_sightings_beyond_a_panel_stand_on_its_edge(cloudy_fit: Calibration, cloudy_points: Sightings) -> None:
    figure = residual_figure(cloudy_fit, compute_residuals(cloudy_fit, cloudy_points))
    panel = figure.axes[0]
    low, high = panel.get_ylim()
    assert low == -high
    beyond = [line for line in panel.lines if "beyond the edge" in str(line.get_label())]
    assert beyond
    assert max(float(np.abs(np.asarray(line.get_ydata())).max()) for line in beyond) == pytest.approx(0.97 * high)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_map_of_the_sky_has_north_and_east_where_the_picture_has_them(
    cloudy_fit: Calibration, cloudy_points: Sightings, *, mirrored: bool
) -> None:
    fit = replace(cloudy_fit, camera=replace(cloudy_fit.camera, mirrored=mirrored))
    figure = sky_figure(fit, compute_residuals(fit, cloudy_points))
    axes = figure.axes[0]
    azimuth_deg = np.arange(0.0, 360.0, 45.0)
    places = axes.transData.transform(np.column_stack([np.radians(azimuth_deg), np.full(8, 30.0)]))
    around = places - axes.transData.transform((0.0, 0.0))
    pixels = project(
        fit.camera, direction_from_angles(zenith_deg=np.r_[0.0, np.full(8, 5.0)], azimuth_deg=np.r_[0.0, azimuth_deg])
    )
    in_picture = (pixels[1:] - pixels[0]) * [1.0, -1.0]  # y is down in the picture
    turned = np.angle((around @ [1.0, 1j]) / (in_picture @ [1.0, 1j]))
    assert np.all(np.abs(turned) < math.radians(6.0))  # a tilt of 2.5 degrees turns parts of so small a ring


def test_the_map_of_the_sky_shows_the_suns_that_were_used(cloudy_fit: Calibration, cloudy_points: Sightings) -> None:
    axes = sky_figure(cloudy_fit, compute_residuals(cloudy_fit, cloudy_points)).axes[0]
    drawn = next(line for line in axes.lines if line.get_label() == "the sun, where it was used")
    assert len(np.asarray(drawn.get_xdata())) == cloudy_fit.evidence.n_used


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_image_s_maps_are_as_the_picture_with_the_horizon_s_letters_at_their_pixels(
    cloudy_fit: Calibration, cloudy_points: Sightings, *, mirrored: bool
) -> None:
    fit = replace(cloudy_fit, camera=replace(cloudy_fit.camera, mirrored=mirrored))
    east = project(fit.camera, direction_from_angles(zenith_deg=90.0, azimuth_deg=90.0))
    sheet = new_sheet(width_px=500, height_px=500)
    for axes in (
        draw_arrows(sheet.add_subplot(1, 2, 1), fit.camera, compute_residuals(fit, cloudy_points)),
        draw_uncertainty(sheet.add_subplot(1, 2, 2), fit, lookup(fit)),
    ):
        assert axes.get_xlim() == (-0.5, 1747.5)
        assert axes.get_ylim() == (1747.5, -0.5)
        (letter_,) = [one for one in axes.texts if one.get_text() == "E"]
        assert np.hypot(*(np.array(letter_.get_position()) - east)) < 60.0
