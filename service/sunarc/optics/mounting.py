"""Mounting of a camera: the azimuth at the top of its image and its tilt, in numbers and in words."""

from __future__ import annotations

import math

import numpy as np

from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import pose_angles

COMPASS_POINTS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
"""The eight points of the compass, clockwise."""
_LEVEL_DEG = 0.05
"""Tilt that rounds to 0.0 degrees: its direction is not stated."""


def top_azimuth_deg(camera: Camera) -> float:
    """Return the azimuth at the top of the image, degrees clockwise from north: that of 30 degrees off the axis."""
    focal = camera.focal_length_px[1]
    x, y = camera.principal_point_px
    x = camera.width - 1.0 - x if camera.mirrored else x
    east, north, _ = unproject(camera, np.array([x, y - 0.5 * focal]))
    return math.degrees(math.atan2(east, north)) % 360.0


def compass_point(azimuth_deg: float) -> str:
    """Return the nearest of the eight points of the compass, as "south-west"."""
    return COMPASS_POINTS[round(azimuth_deg / 45.0) % len(COMPASS_POINTS)]


def pose_text(camera: Camera) -> str:
    """Return the pose in words, as "image top points to azimuth 214°, tilted 1.2° to the south-west"."""
    angles = pose_angles(camera.rotation_cam_enu)
    top = f"image top points to azimuth {round(top_azimuth_deg(camera)) % 360}°"
    if angles.theta_zz_deg < _LEVEL_DEG:
        return f"{top}, level"
    return f"{top}, tilted {angles.theta_zz_deg:.1f}° to the {compass_point(angles.psi_z_deg)}"
