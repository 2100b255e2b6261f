"""Units of one type of lens: the simulated imager's, with the spread that the type states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.calibration.conftest import SGP, TRUTH, FloatArray, simulate

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread, lens_frame, type_camera
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import LENS
from sunarc.optics.camera import Camera
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles

SPREAD = UnitSpread(focal_length=0.003, center_px=8.0, radial_px=0.4, decentering_px=0.3)
Units = Callable[[int], Camera]
Fitted = Callable[[int], tuple[Sightings, Calibration]]


def scales() -> FloatArray:
    """Spread of the units' coordinates; skew and aspect, which no sun tells, differ less."""
    result = SPREAD.scales(TRUTH.focal_length_px[0])
    result[[1, 2]] = 0.1
    return result


@pytest.fixture(scope="session")
def lens() -> LensType:
    """Return the type as it is."""
    frame = lens_frame(TRUTH)
    return LensType(
        camera=type_camera(frame, frame.whitened(TRUTH), TRUTH, max_angle=TRUTH.max_angle),
        covariance=frame.basis @ np.diag(scales() ** 2) @ frame.basis.T,
        spread=SPREAD,
        field_px=0.0,
        field_length_px=0.0,
        cameras=("one", "two"),
        days=("2013-05-13",),
    )


@pytest.fixture(scope="session")
def unit() -> Units:
    """Return a unit of the type by its number, mounted in some azimuth, nearly level."""

    def drawn(seed: int) -> Camera:
        rng, frame = np.random.default_rng(300 + seed), lens_frame(TRUTH)
        vector = TRUTH.to_vector()
        vector[LENS] = frame.lens(frame.whitened(TRUTH) + scales() * rng.standard_normal(17))
        pose = PoseAngles(rng.uniform(-180.0, 180.0), abs(rng.normal(0.0, 2.5)), rng.uniform(0.0, 360.0))
        return replace(TRUTH.replace_parameters(vector), rotation_cam_enu=rotation_from_pose_angles(pose))

    return drawn


@pytest.fixture(scope="session")
def fitted(unit: Units) -> Fitted:
    """Return a unit's clear day, one sighting in six minutes with 0.1 px of noise, and its fit."""
    done: dict[int, tuple[Sightings, Calibration]] = {}

    def of(number: int) -> tuple[Sightings, Calibration]:
        if number not in done:
            points = simulate(unit(number), cadence_s=360.0, sigma_px=0.1, seed=number).points
            points = replace(points, sigma_px=np.full(len(points), 0.1))
            done[number] = points, calibrate(points, site=SGP, image_size=(1748, 1748))
        return done[number]

    return of
