"""The compiled equations of the paper's fit against those of numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.calibration.paper.equations_reference import equations as equations_in_numpy
from tests.calibration.solve.solve_reference import damped_step
from tests.fixtures.calibration import observed, small_camera, spread_directions

from sunarc import _kernels
from sunarc.calibration.model.options import EllipseScope, PaperOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.paper import make_penalties
from sunarc.optics.camera import Camera
from sunarc.optics.forward import kernel_optics
from sunarc.optics.projections import Projection

FALLING = (0.0, 0.0, -0.9, 0.0, 0.0, 0.0, 0.0, 0.0)


def _fitted(
    camera: Camera, seen: Sightings, options: PaperOptions, *, steps: int, damping: float = 1e-3
) -> tuple[np.ndarray, float, np.ndarray]:
    optics, weighed = kernel_optics(camera.at_every_angle()), make_penalties(camera.projection, options)
    assert seen.information.flags.c_contiguous
    sightings = seen.directions, seen.pixels, seen.information
    moving, start = np.arange(23), camera.to_vector()
    return _kernels.paper_fit(*optics, *sightings, *weighed, start, moving, steps, 0.0, damping)  # type: ignore[arg-type]


@pytest.mark.parametrize("scope", ["focal_lengths", "with_decentering"])
@pytest.mark.parametrize("hand", ["as it is", "mirrored"])
@pytest.mark.parametrize("radial", [small_camera().radial, FALLING])
@pytest.mark.parametrize("projection", ["equisolid", "orthographic", "perspective"])
def test_the_cost_and_a_step_are_those_of_the_rows(
    scope: EllipseScope, hand: str, radial: tuple[float, ...], projection: Projection
) -> None:
    mirrored = hand == "mirrored"
    options = PaperOptions(ellipse_scope=scope, monotony_weight=50.0)
    camera = replace(small_camera(projection, mirrored=mirrored), radial=radial, translation=(0.01, -0.02, 0.005))
    seen = observed(small_camera(projection, mirrored=mirrored), spread_directions(150, widest_deg=55.0), sigma_px=0.5)
    seen = replace(seen, information=np.linspace(0.5, 3.0, 150))
    rows = equations_in_numpy(camera, seen, options)
    start, cost, normal = _fitted(camera, seen, options, steps=0)
    np.testing.assert_array_equal(start, camera.to_vector())
    assert cost == pytest.approx(0.5 * float(rows.misfit @ rows.misfit), rel=1e-10)
    expected = rows.jacobian.T @ rows.jacobian
    root = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(normal / root / root[:, None], expected / root / root[:, None], atol=1e-11)
    for damping in (1e-2, 1.0, 1e3):
        expected = damped_step(rows.jacobian.T @ rows.jacobian, -(rows.misfit @ rows.jacobian), damping)
        found, after, _ = _fitted(camera, seen, options, steps=1, damping=damping)
        there = equations_in_numpy(camera.replace_parameters(start + expected), seen, options).misfit
        if 0.5 * float(there @ there) < cost:  # else the damping was raised
            np.testing.assert_allclose(found - start, expected, rtol=1e-5, atol=1e-7 * np.max(np.abs(expected)))
    assert after < cost  # the last one is short enough to gain
    falls = bool(np.any(rows.misfit[-181:] != 0.0))
    assert falls == (radial == FALLING and projection != "perspective")


def test_a_sighting_that_the_lens_cannot_show_costs_and_pulls_nothing() -> None:
    options = PaperOptions()
    camera = replace(small_camera("perspective"), radial=(0.0,) * 8)
    behind = observed(small_camera(), -spread_directions(3), sigma_px=0.0)
    empty = behind.select(slice(0, 0))
    (_, none, _), (_, cost, _) = (_fitted(camera, seen, options, steps=0) for seen in (empty, behind))
    assert cost - none == pytest.approx(3 * 1e8)
    (alone, *_), (both, *_) = (_fitted(camera, seen, options, steps=1, damping=1e4) for seen in (empty, behind))
    np.testing.assert_array_equal(both, alone)
