"""How a camera stands: level, towards which azimuth, and how sure one is of that."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.pose.error_model import error_model_of
from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix, rotation_vector


def level(camera: Camera, azimuth_rad: float) -> Camera:
    """Return a camera that looks at the zenith, the top of its image towards an azimuth (clockwise from north)."""
    sine, cosine = math.sin(azimuth_rad), math.cos(azimuth_rad)
    # rows: image right, down and out of the lens in east, north, up; looking up, east is left of north
    matrix = np.array([[-cosine, sine, 0.0], [-sine, -cosine, 0.0], [0.0, 0.0, 1.0]])
    return replace(camera, rotation_cam_enu=rotation_vector(matrix))


def levelling(camera: Camera) -> FloatArray:
    """Return the smallest rotation (3,) about a camera's own axes, radians, that points it at the zenith."""
    zenith = rotation_matrix(camera.rotation_cam_enu) @ np.array([0.0, 0.0, 1.0])
    axis = np.cross(zenith, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    return np.asarray(axis * (math.atan2(sine, float(zenith[2])) / max(sine, 1e-12)))


def apart_rad(first: Camera, second: Camera) -> float:
    """Return the angle between two poses, radians."""
    turn = rotation_matrix(first.rotation_cam_enu) @ rotation_matrix(second.rotation_cam_enu).T
    return float(np.linalg.norm(rotation_vector(turn)))


def top_azimuth_deg(camera: Camera) -> float:
    """Return the azimuth at the top of the image, degrees clockwise from north: that of 30 degrees off the axis."""
    focal = camera.focal_length_px[1]
    x, y = camera.principal_point_px
    x = camera.width - 1.0 - x if camera.mirrored else x
    east, north, _ = unproject(camera, np.array([x, y - 0.5 * focal]))
    return math.degrees(math.atan2(east, north)) % 360.0


def north_sigma_deg(calibration: Calibration) -> float:
    """Return the 1-sigma of the camera's rotation about the vertical, degrees."""
    error_model = error_model_of(calibration)
    about_up = rotation_matrix(calibration.camera.rotation_cam_enu) @ np.array([0.0, 0.0, 1.0])
    covariance = error_model.covariance[np.ix_(error_model.rotation, error_model.rotation)]
    return math.degrees(math.sqrt(max(float(about_up @ covariance @ about_up), 0.0)))
