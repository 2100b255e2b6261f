"""The compiled equations of the paper's fit against those of numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures.calibration import observed, small_camera, spread_directions

from sunarc.calibration.model.options import CalibrationOptions, EllipseScope, PaperOptions
from sunarc.calibration.paper import compiled_equations, penalties_of, unlimited
from sunarc.calibration.paper import equations as equations_in_numpy
from sunarc.calibration.solve.levenberg_marquardt import as_seen
from sunarc.optics.camera import Camera
from sunarc.optics.forward import kernel_optics

FALLING = (0.0, 0.0, -0.9, 0.0, 0.0, 0.0, 0.0, 0.0)


def _compiled(camera: Camera, options: CalibrationOptions, count: int = 50) -> tuple[np.ndarray, np.ndarray, float]:
    seen = observed(small_camera(mirrored=camera.mirrored), spread_directions(count), sigma_px=0.5)
    normal, gradient = np.empty((23, 23)), np.empty(23)
    cost = compiled_equations(
        kernel_optics(unlimited(camera)),
        as_seen(seen.weighted(np.linspace(0.5, 3.0, count))),
        penalties_of(camera, options).weighed(),
        camera.to_vector(),
        normal,
        gradient,
    )
    return normal, gradient, cost


@pytest.mark.parametrize("scope", ["focal_lengths", "with_decentering"])
@pytest.mark.parametrize("hand", ["as it is", "mirrored"])
@pytest.mark.parametrize("radial", [small_camera().radial, FALLING])
def test_sums_and_squares_are_those_of_the_rows(scope: EllipseScope, hand: str, radial: tuple[float, ...]) -> None:
    mirrored = hand == "mirrored"
    options = CalibrationOptions(paper=PaperOptions(ellipse_scope=scope, monotony_weight=50.0))
    camera = replace(small_camera(mirrored=mirrored), radial=radial, translation=(0.01, -0.02, 0.005))
    normal, gradient, cost = _compiled(camera, options)
    seen = observed(small_camera(mirrored=mirrored), spread_directions(50), sigma_px=0.5)
    rows = equations_in_numpy(camera, seen.weighted(np.linspace(0.5, 3.0, 50)), options)
    expected = rows.jacobian.T @ rows.jacobian
    scale = np.sqrt(np.diag(expected) + 1e-300)
    np.testing.assert_allclose(normal / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-9)
    np.testing.assert_allclose(gradient / scale, -(rows.misfit @ rows.jacobian) / scale, atol=1e-6)
    assert cost == pytest.approx(float(rows.misfit @ rows.misfit), rel=1e-10)
    falls = bool(np.any(rows.misfit[-181:] != 0.0))
    assert falls == (radial == FALLING)


def test_a_sighting_that_the_lens_cannot_show_costs_and_pulls_nothing() -> None:
    options = CalibrationOptions()
    camera = replace(small_camera("perspective"), radial=(0.0,) * 8)
    behind = observed(small_camera(), -spread_directions(3), sigma_px=0.0)
    normal, gradient = np.empty((23, 23)), np.empty(23)
    args = kernel_optics(unlimited(camera)), penalties_of(camera, options).weighed()
    empty = behind.select(slice(0, 0))
    none = compiled_equations(args[0], as_seen(empty), args[1], camera.to_vector(), normal, gradient)
    alone = gradient.copy()
    cost = compiled_equations(args[0], as_seen(behind), args[1], camera.to_vector(), normal, gradient)
    assert cost - none == pytest.approx(3 * 2 * 1e8)
    np.testing.assert_array_equal(gradient, alone)
