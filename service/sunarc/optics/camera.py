"""The camera as a value: everything that says where a direction lands (see docs/conventions.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.errors import InputError
from sunarc.optics.displacement import Displacement
from sunarc.optics.projections import PROJECTIONS, Projection, angle_limit

RADIAL_ORDERS = tuple(range(2, 10))
"""Powers n of the radial coefficients k_n (Eq. 9; a k_1 would be the focal length once more)."""


class Param(IntEnum):
    """Place of each parameter in the paper's β (Eq. 13); rotations in radians, translations in sun distances."""

    FOCAL_LENGTH_X_PX = 0
    FOCAL_LENGTH_Y_PX = 1
    SKEW_PX = 2
    PRINCIPAL_POINT_X_PX = 3
    PRINCIPAL_POINT_Y_PX = 4
    ROTATION_X = 5
    ROTATION_Y = 6
    ROTATION_Z = 7
    TRANSLATION_X = 8
    TRANSLATION_Y = 9
    TRANSLATION_Z = 10
    K2 = 11
    K3 = 12
    K4 = 13
    K5 = 14
    K6 = 15
    K7 = 16
    K8 = 17
    K9 = 18
    P1 = 19
    P2 = 20
    P3 = 21
    P4 = 22


PARAMETER_NAMES = tuple(one.name.lower() for one in Param)
FOCAL_LENGTH = slice(Param.FOCAL_LENGTH_X_PX, Param.SKEW_PX)
PRINCIPAL_POINT = slice(Param.PRINCIPAL_POINT_X_PX, Param.ROTATION_X)
POSE = slice(Param.ROTATION_X, Param.TRANSLATION_X)
TRANSLATION = slice(Param.TRANSLATION_X, Param.K2)
RADIAL = slice(Param.K2, Param.P1)
DECENTERING = slice(Param.P1, Param.P4 + 1)


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
    displacement : of the image with respect to the lens; None without one.
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
    displacement: Displacement | None = None

    def __post_init__(self) -> None:
        """Refuse an invalid camera."""
        if self.projection not in tuple(PROJECTIONS):  # what a document holds here need not be hashable
            raise InputError(
                field="projection", problem=f"{self.projection!r} is unknown", remedy=f"use one of {tuple(PROJECTIONS)}"
            )
        if self.width < 1 or self.height < 1:
            raise InputError(field="image size", problem="not positive", remedy="give width and height in px")
        if len(self.radial) != len(RADIAL_ORDERS) or len(self.decentering) != 4:
            raise InputError(field="radial, decentering", problem="wrong length", remedy="give k2 … k9 and p1 … p4")
        if not np.all(np.isfinite(self.to_vector())) or not math.isfinite(self.max_angle):
            raise InputError(field="camera", problem="a parameter is not finite", remedy="give finite numbers")

    def lens_alone(self) -> Camera:
        """Return this camera without its displacement."""
        return self if self.displacement is None else replace(self, displacement=None)

    def at_every_angle(self) -> Camera:
        """Return this camera answering at every angle that its projection has."""
        return replace(self, max_angle=angle_limit(self.projection) * (1.0 - 1e-6))

    def to_vector(self) -> FloatArray:
        """Return the 23 parameters in the order of `Param`."""
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

    def replace_parameters(self, vector: ArrayLike) -> Camera:
        """Return this camera with the 23 parameters of `vector`."""
        v = np.asarray(vector, dtype=np.float64).tolist()
        if len(v) != len(PARAMETER_NAMES):
            raise InputError(
                field="parameters", problem=f"{len(v)} numbers", remedy=f"give {len(PARAMETER_NAMES)} numbers"
            )
        return replace(
            self,
            focal_length_px=tuple(v[FOCAL_LENGTH]),
            skew_px=v[Param.SKEW_PX],
            principal_point_px=tuple(v[PRINCIPAL_POINT]),
            rotation_cam_enu=tuple(v[POSE]),
            translation=tuple(v[TRANSLATION]),
            radial=tuple(v[RADIAL]),
            decentering=tuple(v[DECENTERING]),
        )


def inside_image(pixels: FloatArray, image_size: tuple[int, int], *, beyond_px: float = 0.0) -> BoolArray:
    """Return (...): whether pixels (..., 2) lie within the outer edges of the outer pixels, or so far beyond these."""
    least, most = -0.5 - beyond_px, np.array(image_size) - 0.5 + beyond_px
    return np.asarray(np.all((pixels >= least) & (pixels <= most), axis=-1))


def camera_sees(camera: Camera, pixels: FloatArray) -> BoolArray:
    """Return (...): whether pixels (..., 2) lie within a camera's image."""
    return inside_image(pixels, (camera.width, camera.height))
