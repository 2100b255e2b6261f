"""Where a lens stops resolving angles: an orthographic one at 90 degrees, at which its radius stands still."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from tests.fixtures.calibration import stated_calibration
from tests.fixtures.clear_day import SGP, SIZE, TRUTH, times_of

from sunarc.calibration.answers.covariance import hemisphere, sigma_deg, sky_sigma_deg
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project, resolved_limit
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles, rotation_matrix
from sunarc.optics.projections import Projection
from sunarc.sky.sun import sun_directions

IDEAL = replace(TRUTH, projection="orthographic", focal_length_px=(850.0, 850.0), radial=(0.0,) * 8)


def _tilted(psi_deg: float) -> Camera:
    turn = rotation_from_pose_angles(PoseAngles(phi_xz_deg=20.0, theta_zz_deg=3.0, psi_z_deg=psi_deg))
    return replace(IDEAL, decentering=(0.0,) * 4, rotation_cam_enu=turn)


@pytest.mark.parametrize(("method", "psi_deg", "seed"), [("robust", 90.0, 2), ("paper", 180.0, 7)])
def test_a_sun_that_the_fitted_lens_does_not_reach_is_set_apart(
    method: Literal["robust", "paper"], psi_deg: float, seed: int
) -> None:
    """The sun stands at 89.9 to 90 degrees off the axis for a minute; half a pixel decides whether the fit shows it."""
    truth, times = _tilted(psi_deg), times_of((0.0,), cadence_s=60.0)

    def off_axis(unix_s: FloatArray) -> FloatArray:
        axis = rotation_matrix(truth.rotation_cam_enu)[2]
        return np.asarray(np.degrees(np.arccos(sun_directions(unix_s, SGP) @ axis)))

    crossing = times[np.flatnonzero(np.diff(np.sign(off_axis(times) - 90.0)))[0]]
    times = np.sort(np.r_[times, crossing + np.arange(0.0, 60.0, 2.0)])
    times = times[off_axis(times) < 90.0]
    pixels = project(truth, sun_directions(times, SGP))
    pixels += np.random.default_rng(seed).normal(0.0, 0.5, pixels.shape)
    options = CalibrationOptions(projection="orthographic", method=method)
    found = calibrate(Sightings.of(unix_s=times, pixels=pixels), site=SGP, image_size=SIZE, options=options)
    assert found.verdict.accepted, found.verdict.reasons
    assert found.metrics.rmse_px == pytest.approx(0.5 * math.sqrt(2.0), rel=0.05)
    off = np.linalg.norm(project(found.camera.at_every_angle(), sun_directions(times, SGP)) - pixels, axis=-1)
    missed = np.flatnonzero(~np.isfinite(off))
    assert missed.size > 0
    assert found.left_out is not None
    assert set(missed) <= set(found.left_out)
    assert found.evidence.n_used == times.size - found.left_out.size
    assert found.left_out.size < 30


def test_the_sky_s_sigma_leaves_out_the_edge_that_no_calibration_resolves() -> None:
    stated = stated_calibration(_tilted(0.0), amplitude_px=1.0)
    rms, most = sky_sigma_deg(stated)
    directions = hemisphere()
    cosine = directions @ rotation_matrix(stated.camera.rotation_cam_enu)[2]
    resolved = sigma_deg(stated, directions[cosine > 0.1])
    assert rms == pytest.approx(float(np.sqrt(np.mean(resolved**2))), rel=1e-3)
    assert most == pytest.approx(float(np.max(resolved)), rel=1e-3)
    # what is stated of the directions there is as it was
    assert np.max(sigma_deg(stated, directions[(cosine > 0.0) & (cosine < 0.1)])) > 3.0 * most


@pytest.mark.parametrize("projection", ["equidistant", "equisolid", "stereographic", "perspective"])
def test_lenses_that_resolve_their_edge_are_judged_whole(projection: Projection) -> None:
    camera = replace(IDEAL, projection=projection, max_angle=1.5)
    assert resolved_limit(camera) == 1.5


def test_an_orthographic_lens_resolves_to_where_its_radius_grows_by_a_tenth_of_the_center_s() -> None:
    assert math.cos(resolved_limit(IDEAL)) == pytest.approx(0.1, abs=1e-3)
    assert resolved_limit(replace(IDEAL, max_angle=1.2)) == 1.2


def test_a_flat_part_within_the_radius_is_no_edge() -> None:
    """A lens whose radius stands still in the midst of the sky cannot be judged by the rest of it."""
    # r = theta - 3 (2 theta / pi)² + 2 (2 theta / pi)³: the slope is below a tenth from 35 to 55 degrees alone
    camera = replace(IDEAL, projection="equidistant", radial=(-3.0, 2.0, *(0.0,) * 6), max_angle=1.57)
    assert resolved_limit(camera) == 1.57
