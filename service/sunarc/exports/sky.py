"""The sky on which another model is fitted to ours and compared with it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration import camera_sees, hemisphere
from sunarc.optics import Camera, local_stretch, project, rising_limit, rotation_matrix

_COUNT = 4000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sky:
    """Directions spread evenly over what the lens sees, and their pixels.

    Attributes
    ----------
    within : radians off the axis that they reach to.
    rays : (n, 3) unit vectors in the camera frame.
    directions : (n, 3) the same, east-north-up.
    pixels : (n, 2) where our model puts them, all in the image.
    """

    within: float
    rays: FloatArray
    directions: FloatArray
    pixels: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class FitError:
    """How far another model is from ours, over the sky within an angle of the lens's axis."""

    rms_px: float
    max_px: float
    rms_deg: float
    max_deg: float
    within_deg: float

    def __str__(self) -> str:
        """Say it in one sentence."""
        return (
            f"differs from the calibration by {self.rms_px:.2g} px RMS and {self.max_px:.2g} px at most "
            f"({self.rms_deg:.2g} and {self.max_deg:.2g} degrees), over the sky in the image within "
            f"{self.within_deg:.1f} degrees of the lens's axis"
        )


def sky_of(camera: Camera, *, within: float) -> Sky:
    """Return what a camera sees of the sky, up to an angle in radians off its axis."""
    limit = min(within, rising_limit(camera, up_to=camera.max_angle))
    rays = hemisphere(_COUNT)
    cosine = 1.0 - (1.0 - rays[:, 2]) * (1.0 - math.cos(limit))  # the hemisphere, stretched over the cap
    across = np.sqrt((1.0 - cosine**2) / (1.0 - rays[:, 2] ** 2))
    rays = np.stack([rays[:, 0] * across, rays[:, 1] * across, cosine], axis=-1)
    directions = rays @ rotation_matrix(camera.rotation_cam_enu)
    pixels = project(camera, directions)
    inside = camera_sees(camera, pixels)
    return Sky(within=limit, rays=rays[inside], directions=directions[inside], pixels=pixels[inside])


def fit_error(camera: Camera, sky: Sky, pixels: FloatArray) -> FitError:
    """Return how far another model's pixels (n, 2) for a sky are from ours; NaN where it has none is left out."""
    valid = np.all(np.isfinite(pixels), axis=-1)
    off = (pixels - sky.pixels)[valid]
    angle = np.linalg.solve(local_stretch(camera, sky.directions[valid]), off[..., None])[..., 0]
    off_px, off_deg = np.linalg.norm(off, axis=-1), np.degrees(np.linalg.norm(angle, axis=-1))
    # The error is stated up to the first direction for which the other model has no pixel.
    unknown = np.arccos(np.clip(sky.rays[~valid, 2], -1.0, 1.0))
    return FitError(
        rms_px=float(np.sqrt(np.mean(off_px**2))),
        max_px=float(np.max(off_px)),
        rms_deg=float(np.sqrt(np.mean(off_deg**2))),
        max_deg=float(np.max(off_deg)),
        within_deg=math.degrees(min(sky.within, float(np.min(unknown, initial=math.pi)))),
    )
