"""Evidence of a tilt against a level camera at another place: of the sun alone, and at the poles as elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from tests.fixtures.calibration import SGP, spread_directions

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.fit.level_evidence import _places_around
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.fit_checks import TILT
from sunarc.calibration.quality.tilt import Place, distance_deg, tilt_deg
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles

TILTED = Camera(
    width=1000,
    height=1000,
    projection="equidistant",
    focal_length_px=(310.0, 310.0),
    principal_point_px=(499.5, 499.5),
    rotation_cam_enu=rotation_from_pose_angles(PoseAngles(phi_xz_deg=20.0, theta_zz_deg=15.0, psi_z_deg=140.0)),
)


def test_stars_alone_say_nothing_of_the_air_above_another_place() -> None:
    directions = spread_directions(300, seed=1, widest_deg=70.0)
    pixels = project(TILTED, directions) + np.random.default_rng(2).normal(0.0, 0.2, (300, 2))
    points = Sightings.of(unix_s=np.full(300, 1.4e9), pixels=pixels, directions=directions)
    options = CalibrationOptions(projection="equidistant", mirrored="no")
    found = calibrate(points, site=SGP, image_size=(1000, 1000), options=options)
    assert tilt_deg(found.camera) == pytest.approx(15.0, abs=0.1)
    assert TILT not in found.evidence.log_odds


@pytest.mark.parametrize("latitude", [87.99999999376726, -88.00000001711145, 86.0, 0.0])
def test_the_places_around_one_whose_ring_meets_a_pole_are_as_far_from_it_as_elsewhere(latitude: float) -> None:
    level = Place(latitude, 10.0)  # of the first two the sine of the ring's latitude exceeds 1 by rounding
    off = [distance_deg(level, place) for place in _places_around(level)]
    assert off == pytest.approx([0.0, *[2.0] * 8, *[4.0] * 8], abs=1e-5)
