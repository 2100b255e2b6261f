"""Where a calibration predicts the stars."""

from __future__ import annotations

import numpy as np
import pytest
from population import CASE_3
from tests.fixtures.calibrations import SITE, chosen_calibration

from sunarc.calibration.answers.covariance import project_with_covariance, sigma_px
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.night import NightSky
from sunarc.stars.views import predict_stars


def test_the_stars_of_the_image_with_their_uncertainty_and_the_air_s_extinction() -> None:
    names = ("focal_length_x_px", "focal_length_y_px")
    calibration = chosen_calibration(CASE_3, names=names, covariance=0.25 * np.eye(2), orders=np.array([[1, 1]]))
    assert calibration.site == SITE
    zenith = np.array([5.0, 60.0, 30.0, 87.0])
    directions = direction_from_angles(zenith_deg=zenith, azimuth_deg=[10.0, 100.0, 190.0, 280.0])
    sky = NightSky(
        names=np.array(["a", "b", "c", "d"]), directions=directions, magnitude=np.array([0.0, 1.0, 2.0, 3.0])
    )
    found = predict_stars(calibration, sky, within_px=2.0)
    assert found.names.tolist() == ["a", "b", "c"]
    pixels, covariance = project_with_covariance(calibration, directions[:3])
    np.testing.assert_allclose(found.pixels, pixels)
    np.testing.assert_allclose(found.sigma_px, np.hypot(sigma_px(covariance), 2.0))
    assert found.magnitude - sky.magnitude[:3] == pytest.approx(
        [0.001, 0.25, 0.039], abs=0.002
    )  # air masses 1, 2, 1.15
    np.testing.assert_allclose(found.azimuth_deg, [10.0, 100.0, 190.0])
    assert len(predict_stars(calibration, sky, furthest_deg=89.0)) == 4
