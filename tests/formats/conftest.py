from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibrations import chosen_calibration

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.model.result import Calibration
from sunarc.formats.calibration_document import to_document
from sunarc.formats.exported import Exported
from sunarc.formats.formats import export
from sunarc.optics.camera import Camera, camera_sees
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]

LENS = Camera(
    width=1748,
    height=1600,
    projection="equisolid",
    focal_length_px=(601.32, 600.9),
    principal_point_px=(871.96, 803.0),
    rotation_cam_enu=(0.05, -0.035, 2.1),
    skew_px=0.2,
    radial=(0.004, -0.009, 0.003, 0.0, 0.0, 0.0, 0.0, 0.0),
    decentering=(1e-4, -5e-5, 0.0, 0.0),
)


def document_of(camera: Camera) -> dict[str, Any]:
    """Return the document of a calibration whose every number is chosen."""
    return document_of_fit(
        chosen_calibration(
            camera,
            names=("principal_point_x_px", "rotation_z"),
            covariance=np.array([[1e-4, 1e-8], [1e-8, 1e-10]]),
            orders=np.array([[1, 1]]),
        )
    )


def document_of_fit(made: Calibration) -> dict[str, Any]:
    """Return the document of a calibration, current since 2013-05-13."""
    day = datetime(2013, 5, 13, tzinfo=UTC)
    return to_document(
        made,
        id="one",
        camera="the roof's",
        state="current",
        created_at=day,
        valid_from=day,
        valid_until=None,
        pose_epoch="1",
        software_version="0.1.0",
    )


@pytest.fixture(scope="session", params=["straight", "mirrored"])
def camera(request: pytest.FixtureRequest) -> Camera:
    return replace(LENS, mirrored=request.param == "mirrored")


@pytest.fixture(scope="session")
def document(camera: Camera) -> dict[str, Any]:
    return document_of(camera)


@pytest.fixture(scope="session")
def straight() -> dict[str, Any]:
    return document_of(LENS)


@pytest.fixture(scope="session")
def small() -> dict[str, Any]:
    """Return the document of a small camera: a map of it is made in a moment."""
    return document_of(
        replace(LENS, width=180, height=164, focal_length_px=(61.9, 61.8), principal_point_px=(90.0, 82.0))
    )


@pytest.fixture(scope="session")
def sky(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return directions (n, 3) above 1 degree, and their pixels (n, 2) in the image."""
    directions = hemisphere(3001)
    directions = directions[directions[:, 2] > np.sin(np.radians(1.0))]
    pixels = project(camera, directions)
    seen = camera_sees(camera, pixels)
    return directions[seen], pixels[seen]


Export = Callable[[str], Exported]


@pytest.fixture(scope="session")
def exported(document: dict[str, Any]) -> Export:
    """Return the camera's calibration in a format; each is made once."""
    return cache(partial(export, document))


def worst_stated_px(error: str) -> float:
    """Return the largest error from a direction to a pixel that a sentence states."""
    return float(error.split(" px RMS and ")[1].split(" px", maxsplit=1)[0])


def worst_stated_deg(error: str) -> float:
    """Return the largest error from a pixel to a direction that a sentence states."""
    return float(error.split(" degrees RMS and ")[1].split(" degrees", maxsplit=1)[0])


def apart_deg(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles between unit vectors (n, 3)."""
    across = np.linalg.norm(np.cross(first, second), axis=-1)
    return np.asarray(np.degrees(np.arctan2(across, np.sum(first * second, axis=-1))))
