"""The numbers in the figures, against small cases made by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.quiver import Quiver
from tests.fixtures.calibration import ideal_camera, stated_calibration

from sunarc.calibration.answers.residuals import Residuals, compute_residuals, used_sightings
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.forward import project
from sunarc.public.plots import (
    draw_angles,
    draw_arrows,
    draw_components,
    draw_rejected,
    headline,
    new_sheet,
    sky_figure,
    sky_sigma,
    within_image,
)
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.sun import sun_directions

CAMERA = ideal_camera()  # level, 200 px per radian, its centre at (319.5, 239.5)
NOON_S = 1_368_469_800.0


def by_hand(offsets: list[tuple[float, float]], used: list[bool]) -> Residuals:
    n = len(offsets)
    number = np.arange(n, dtype=np.float64)
    return Residuals(
        sightings=Sightings(
            unix_s=NOON_S + 60.0 * number[::-1],  # the newest first
            pixels=np.column_stack([100.0 + 50.0 * np.arange(n), np.full(n, 200.0)]),
            directions=direction_from_angles(zenith_deg=20.0 + 5.0 * number, azimuth_deg=150.0 + 10.0 * number),
        ),
        offset_px=np.array(offsets, dtype=np.float64).reshape(n, 2),
        offset_deg=np.hypot(*np.array(offsets, dtype=np.float64).reshape(n, 2).T) * 0.1,
        used=np.array(used, dtype=np.bool_),
    )


THREE = by_hand([(1.0, -2.0), (0.5, 0.5), (30.0, 1.0)], [True, True, False])


@pytest.fixture
def axes() -> Axes:
    return new_sheet(width_px=400, height_px=300).subplots()


def drawn(axes: Axes) -> dict[str, list[tuple[float, float]]]:
    """Return the points of every line by the first words of its label."""
    return {
        str(line.get_label()): [(float(x), float(y)) for x, y in np.asarray(line.get_xydata())] for line in axes.lines
    }


def test_components_are_drawn_apart_and_the_used_ones_set_the_limit(axes: Axes) -> None:
    draw_components(axes, np.array([1.0, 2.0, 3.0]), THREE)
    lines = drawn(axes)
    assert lines["x, used"] == [(1.0, 1.0), (2.0, 0.5)]
    assert lines["y, used"] == [(1.0, -2.0), (2.0, 0.5)]
    assert axes.get_ylim() == pytest.approx((-2.8, 2.8))  # 1.4 times the largest used component
    np.testing.assert_allclose(lines["x, rejected (1 beyond the edge)"], [(3.0, 0.97 * 2.8)])
    assert lines["y, rejected"] == [(3.0, 1.0)]


def test_angles_are_drawn_from_zero(axes: Axes) -> None:
    draw_angles(axes, np.array([1.0, 2.0, 3.0]), THREE)
    expected = [(1.0, 0.1 * math.sqrt(5.0)), (2.0, 0.1 * math.sqrt(0.5))]
    np.testing.assert_allclose(drawn(axes)["used"], expected)
    assert axes.get_ylim() == pytest.approx((0.0, 0.14 * math.sqrt(5.0)))


@pytest.mark.parametrize(("off", "beyond"), [([0.9, -0.9], 0), ([0.98, -0.5], 1), ([2.0, -3.0], 2)])
def test_the_rejected_beyond_the_edge_are_counted(axes: Axes, off: list[float], beyond: int) -> None:
    draw_rejected(axes, np.arange(2.0), np.array(off), 1.0, mark="x", label="rejected")
    (line,) = axes.lines
    assert line.get_label() == ("rejected" if beyond == 0 else f"rejected ({beyond} beyond the edge)")
    np.testing.assert_allclose(np.asarray(line.get_ydata(), dtype=np.float64), np.clip(off, -0.97, 0.97))


def test_where_none_is_rejected_nothing_is_drawn(axes: Axes) -> None:
    draw_rejected(axes, np.zeros(0), np.zeros(0), 1.0, mark="x", label="rejected")
    assert len(axes.lines) == 0


def arrows_of(residuals: Residuals) -> tuple[Quiver, Quiver]:
    axes = new_sheet(width_px=400, height_px=300).subplots()
    draw_arrows(axes, CAMERA, residuals)
    rejected, used = (one for one in axes.collections if isinstance(one, Quiver))
    return rejected, used


def test_arrows_stand_at_the_sightings_and_show_their_offsets() -> None:
    rejected, used = arrows_of(THREE)
    np.testing.assert_allclose(np.column_stack([used.X, used.Y]), [(100.0, 200.0), (150.0, 200.0)])
    np.testing.assert_allclose(np.column_stack([used.U, used.V]), [(1.0, -2.0), (0.5, 0.5)])
    np.testing.assert_allclose(np.column_stack([rejected.X, rejected.Y]), [(200.0, 200.0)])


def test_an_arrow_is_cut_at_three_units_and_keeps_its_direction() -> None:
    rejected, _ = arrows_of(THREE)
    unit = 2.0  # the nearest of 1, 2, 5 to the rms distance of the used ones, 1.66 px
    shift = np.array([30.0, 1.0])
    drawn_shift = np.concatenate([np.asarray(rejected.U), np.asarray(rejected.V)])
    np.testing.assert_allclose(drawn_shift, 3.0 * unit * shift / np.linalg.norm(shift))


def test_a_unit_is_as_long_as_the_stated_share_of_the_image() -> None:
    _, used = arrows_of(THREE)
    assert used.scale is not None
    assert 2.0 / used.scale == pytest.approx(0.035 * CAMERA.width)


def test_the_map_has_the_images_edges_with_y_down() -> None:
    axes = new_sheet(width_px=400, height_px=300).subplots()
    draw_arrows(axes, CAMERA, THREE)
    assert axes.get_xlim() == (-0.5, 639.5)
    assert axes.get_ylim() == (479.5, -0.5)


@pytest.mark.parametrize(("accepted", "word"), [(True, "accepted"), (False, "refused")])
def test_the_headline_has_the_counts_and_the_verdict(*, accepted: bool, word: str) -> None:
    made = stated_calibration(CAMERA)
    made = replace(made, verdict=replace(made.verdict, accepted=accepted))
    words = headline(made)
    assert words.startswith(f"{made.evidence.n_used} of {made.evidence.n_supplied} ")
    assert word in words


def test_a_calibration_without_a_fit_has_no_scatter_in_its_headline() -> None:
    made = stated_calibration(CAMERA)
    assert "RMSE" not in headline(replace(made, metrics=replace(made.metrics, n=0)))


def points_of(offsets: list[tuple[float, float]], *, sigma: list[float] | None = None) -> tuple[Sightings, Any]:
    """Return sightings about noon with known offsets, and the calibration that they are held against."""
    made = stated_calibration(CAMERA)
    times = NOON_S + 600.0 * np.arange(len(offsets), dtype=np.float64)
    pixels = project(CAMERA, sun_directions(times, made.site)) + np.array(offsets)
    if sigma is None:
        return Sightings.of(unix_s=times, pixels=pixels), made
    return Sightings.of(unix_s=times, pixels=pixels, sigma_px=np.array(sigma)), made


def test_residuals_are_the_offsets_that_were_put_in() -> None:
    points, made = points_of([(0.5, -0.25), (0.0, 3.0)])
    found = compute_residuals(made, points)
    np.testing.assert_allclose(found.offset_px, [(0.5, -0.25), (0.0, 3.0)], atol=1e-9)


def test_a_radial_offset_of_a_pixel_is_the_inverse_of_the_focal_length() -> None:
    points, made = points_of([(0.0, 0.0)])
    outward = (points.pixels - np.array(CAMERA.principal_point_px)) / np.linalg.norm(
        points.pixels - np.array(CAMERA.principal_point_px)
    )
    moved = replace(points, pixels=points.pixels + outward)
    assert compute_residuals(made, moved).offset_deg == pytest.approx([math.degrees(1.0 / 200.0)], rel=1e-6)


def test_of_other_sightings_those_nearest_in_their_own_sigmas_were_used() -> None:
    points, made = points_of([(1.0, 0.0), (2.0, 0.0), (3.0, 0.0)], sigma=[0.1, 1.0, 10.0])
    made = replace(made, evidence=replace(made.evidence, n_used=2))
    offset = np.array([(1.0, 0.0), (2.0, 0.0), (3.0, 0.0)])
    assert used_sightings(made, points, offset).tolist() == [False, True, True]


def test_a_sighting_without_a_sigma_is_judged_by_the_median_of_the_others() -> None:
    points, made = points_of([(1.0, 0.0), (2.0, 0.0), (3.0, 0.0)], sigma=[0.5, math.nan, 1.5])
    made = replace(made, evidence=replace(made.evidence, n_used=1))
    # in sigmas: 2, 2 / 1.0, 3 / 1.5: all alike, so the first; a nearer one without a sigma is taken instead
    assert used_sightings(made, points, np.array([(1.0, 0.0), (2.0, 0.0), (3.0, 0.0)])).tolist() == [True, False, False]
    assert used_sightings(made, points, np.array([(1.0, 0.0), (1.9, 0.0), (3.0, 0.0)])).tolist() == [False, True, False]


def test_a_sighting_that_is_not_finite_was_never_used() -> None:
    points, made = points_of([(1.0, 0.0), (2.0, 0.0)])
    offset = np.array([(math.nan, 0.0), (2.0, 0.0)])
    assert used_sightings(made, points, offset).tolist() == [False, True]


@pytest.mark.parametrize(
    ("zenith_deg", "azimuth_deg", "inside"), [(0.0, 0.0, True), (80.0, 90.0, True), (80.0, 0.0, False)]
)
def test_the_sky_is_within_the_image_or_beyond_its_edges(
    zenith_deg: float, azimuth_deg: float, *, inside: bool
) -> None:
    """80 degrees are 279 px: within the 320 px to the sides, beyond the 240 px up and down."""
    direction = direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=azimuth_deg)
    assert bool(within_image(CAMERA, direction)) == inside


def test_a_pixel_of_doubt_of_the_principal_point_is_the_same_angle_along_the_radius() -> None:
    names = ("principal_point_x_px", "principal_point_y_px")
    made = stated_calibration(CAMERA, names=names, covariance=0.25 * np.eye(2))
    sigma = sky_sigma(made, zenith_deg=np.array([0.001]), azimuth_deg=np.array([0.0, 90.0]))
    assert sigma == pytest.approx(math.degrees(0.5 / 200.0), rel=1e-3)


def test_the_suns_way_is_drawn_in_the_order_of_time() -> None:
    figure = sky_figure(stated_calibration(CAMERA), THREE)
    (line,) = [one for one in figure.axes[0].lines if "sun" in str(one.get_label())]
    np.testing.assert_allclose(np.asarray(line.get_xdata()), np.radians([160.0, 150.0]))
    np.testing.assert_allclose(np.asarray(line.get_ydata()), [25.0, 20.0])
