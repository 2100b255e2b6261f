"""The camera as a value: everything that says where a direction lands (see docs/conventions.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sunarc.errors import InputError
from sunarc.optics.projections import PROJECTIONS, Projection

RADIAL_ORDERS = tuple(range(2, 10))
"""Powers n of the radial coefficients k_n (Eq. 9; a k_1 would be the focal length once more)."""

PARAMETER_NAMES: tuple[str, ...] = (
    "focal_length_x_px",
    "focal_length_y_px",
    "skew_px",
    "principal_point_x_px",
    "principal_point_y_px",
    "rotation_x",
    "rotation_y",
    "rotation_z",
    "translation_x",
    "translation_y",
    "translation_z",
    *(f"k{n}" for n in RADIAL_ORDERS),
    "p1",
    "p2",
    "p3",
    "p4",
)
"""The paper's β (Eq. 13), in its order; rotations in radians, distances in sun distances."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A central camera of any fixed focal length (Urquhart et al. 2016, section 2).

    Attributes
    ----------
    width, height : image size, px.
    projection : the ideal projection g0.
    focal_length_px : αx, αy.
    principal_point_px : x0, y0; (0, 0) is the centre of the top-left pixel.
    rotation_cam_enu : rotation vector in radians that takes east-north-up to the camera frame
        (x right, y down, z out of the lens).
    skew_px : s of the calibration matrix.
    translation : t of Eq. 3; unobservable for the sun, 0 unless the paper's method is asked to fit it.
    radial : k2 … k9; k_n multiplies (theta / (pi/2))^n.
    decentering : p1 … p4 of Eq. 12.
    mirrored : the image is a mirror image: x becomes width - 1 - x before the model.
    max_angle : radians off the axis up to which the model answers.
    """

    width: int
    height: int
    projection: Projection
    focal_length_px: tuple[float, float]
    principal_point_px: tuple[float, float]
    rotation_cam_enu: tuple[float, float, float]
    skew_px: float = 0.0
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radial: tuple[float, ...] = (0.0,) * 8
    decentering: tuple[float, ...] = (0.0,) * 4
    mirrored: bool = False
    max_angle: float = math.radians(100.0)

    def __post_init__(self) -> None:
        """Refuse what is no camera."""
        if self.projection not in PROJECTIONS:
            raise InputError(
                field="projection", problem=f"{self.projection!r} is unknown", remedy=f"use one of {PROJECTIONS}"
            )
        if self.width < 1 or self.height < 1:
            raise InputError(field="image size", problem="not positive", remedy="give width and height in px")
        if len(self.radial) != len(RADIAL_ORDERS) or len(self.decentering) != 4:
            raise InputError(field="radial, decentering", problem="wrong length", remedy="give k2 … k9 and p1 … p4")
        if not np.all(np.isfinite(self.to_vector())) or not math.isfinite(self.max_angle):
            raise InputError(field="camera", problem="a parameter is not finite", remedy="give finite numbers")

    def to_vector(self) -> NDArray[np.float64]:
        """Return the 23 parameters in the order of `PARAMETER_NAMES`."""
        return np.array(
            [
                *self.focal_length_px,
                self.skew_px,
                *self.principal_point_px,
                *self.rotation_cam_enu,
                *self.translation,
                *self.radial,
                *self.decentering,
            ]
        )

    def with_parameters(self, vector: ArrayLike) -> Camera:
        """Return this camera with the 23 parameters of `vector`."""
        v = [float(x) for x in np.asarray(vector, dtype=np.float64)]
        if len(v) != len(PARAMETER_NAMES):
            raise InputError(
                field="parameters", problem=f"{len(v)} numbers", remedy=f"give {len(PARAMETER_NAMES)} numbers"
            )
        return replace(
            self,
            focal_length_px=(v[0], v[1]),
            skew_px=v[2],
            principal_point_px=(v[3], v[4]),
            rotation_cam_enu=(v[5], v[6], v[7]),
            translation=(v[8], v[9], v[10]),
            radial=tuple(v[11:19]),
            decentering=tuple(v[19:23]),
        )
