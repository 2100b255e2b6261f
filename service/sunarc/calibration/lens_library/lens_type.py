"""A type of lens: its mean, the spread of a unit about it, and the coordinates of both."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Gt, Le

from sunarc.calibration.model.options import ImageCircle, LensTolerances
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.solve import priors
from sunarc.common.array_types import FloatArray
from sunarc.common.bounds import require_bounds
from sunarc.optics.camera import PARAMETER_NAMES, Camera, Param

# Coordinates of a lens in which what differs between units, and what sightings say, is of the order of 1.
#
# They are those of the fit's priors (`solve.priors`): px of focal length, principal point, residual radial
# distortion and decentering near the horizon, and the usual tolerances of aspect, skew, p3 and p4.

LENS_NAMES = tuple(PARAMETER_NAMES[i] for i in priors.LENS)
"""Names of a lens's 17 parameters, in order."""
IN_FREE = np.isin(priors.FREE, priors.LENS)
"""Which of a calibration's 20 parameters are the lens's."""
_RIGHT_ANGLE = math.pi / 2
_BROAD = [priors.Whitened.FOCAL_LENGTH, priors.Whitened.CENTER_X, priors.Whitened.CENTER_Y]
"""Directions in which a fit's prior is broad, or rests on the image circle, which was measured."""


class Gaussian(NamedTuple):
    """A lens in the coordinates of a frame: mean (17,) and covariance (17, 17)."""

    mean: FloatArray
    covariance: FloatArray


class Information(NamedTuple):
    """Information about a lens: matrix (17, 17), the inverse covariance, and its product with the mean, (17,)."""

    matrix: FloatArray
    vector: FloatArray


def lens_frame(camera: Camera) -> priors.LensPrior:
    """Return the frame about a lens, by its projection and focal length; all are px or usual tolerances."""
    tolerances = LensTolerances(circle_center_px=1.0, circle_focal_length_px=1.0)
    # a circle of 1 px makes both absolute; its place and radius do not count
    circle = ImageCircle(x=(camera.width - 1) / 2.0, y=(camera.height - 1) / 2.0, radius=1.0)
    return priors.lens_prior(camera, tolerances=tolerances, circle=circle, field_angle=_RIGHT_ANGLE)


def lens_gaussian(calibration: Calibration, frame: priors.LensPrior) -> Gaussian:
    """Return a calibration's lens in a frame."""
    indices = [calibration.parameter_names.index(name) for name in LENS_NAMES]
    return _convert_to_frame(calibration.camera, calibration.covariance[np.ix_(indices, indices)], frame)


def _convert_to_frame(camera: Camera, covariance: FloatArray, frame: priors.LensPrior) -> Gaussian:
    whitened = np.linalg.solve(frame.basis, np.linalg.solve(frame.basis, covariance).T)
    return Gaussian(frame.whitened(camera), 0.5 * (whitened + whitened.T))


def usual_precision(radial_px: float) -> FloatArray:
    """Return (17,): the precisions of a lens about the ideal one before any sighting, by its radial distortion's scale.

    Of NaN, the usual scale.
    """
    usual = LensTolerances()
    result = priors.precisions(radial_px if radial_px > 0.0 else usual.radial_px, usual.decentering_px)
    result[_BROAD] = 0.0
    return result


def infer_prior_precision(posterior: Gaussian, radial_px: float) -> FloatArray:
    """Return (17,): the precisions of the prior that a fit had, as its posterior allows them.

    The scales of radial distortion and decentering are averaged over in a fit, and not all of that is in its document:
    where a posterior is wider than the usual prior, the prior was at least as wide.
    """
    result = usual_precision(radial_px)
    for group in (
        priors.RADIAL,
        slice(priors.DECENTERING.start, priors.HIGHER.stop),
        slice(priors.Whitened.ASPECT, priors.Whitened.SKEW + 1),
    ):
        root = np.sqrt(result[group])
        wider = np.linalg.eigvalsh(posterior.covariance[group, group] * root * root[:, None])[-1]
        result[group] /= max(float(wider), 1.0)
    return result


def sighting_information(posterior: Gaussian, radial_px: float) -> Information:
    """Return the information of the sightings of a fit: its posterior without its prior about the ideal lens.

    Directions in which a posterior is no narrower than the prior have no information.

    Parameters
    ----------
    posterior : the lens of the fit.
    radial_px : the scale of its residual radial distortion, as found; NaN takes the usual one.
    """
    precision = infer_prior_precision(posterior, radial_px)
    factor = np.linalg.cholesky(posterior.covariance)
    # in the posterior's own units the sightings' share of what is known lies between 0 and 1
    share, vectors = np.linalg.eigh(np.eye(priors.N_LENS) - (factor.T * precision) @ factor)
    axes = np.linalg.solve(factor.T, vectors)
    mean = (axes.T @ posterior.mean) * (share > 0.0)
    return Information((axes * np.clip(share, 0.0, 1.0)) @ axes.T, axes @ mean)


def spread_scales(focal_px: float, center_px: float, radial_px: float, decentering_px: float) -> FloatArray:
    """Return (17,): 1-sigma of the coordinates between units of a lens."""
    result = np.ones(priors.N_LENS)
    result[priors.Whitened.FOCAL_LENGTH] = focal_px
    result[[priors.Whitened.CENTER_X, priors.Whitened.CENTER_Y]] = center_px
    result[priors.RADIAL] = radial_px
    result[priors.DECENTERING] = decentering_px
    return result


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitSpread:
    """Spread of the units of one lens: 1-sigma.

    The defaults are guesses on the wide side, about a third of what a fit assumes of any lens: no survey of units of
    one fisheye lens is known. Three measured units replace them.

    Attributes
    ----------
    focal_length : relative.
    center_px : of the principal point from the image's centre, each axis.
    radial_px : of the residual radial distortion, near the horizon.
    decentering_px : of the decentering at the horizon.
    """

    focal_length: Annotated[float, Gt(0.0), Le(0.1)] = 0.01
    center_px: Annotated[float, Gt(0.0), Le(200.0)] = 15.0
    radial_px: Annotated[float, Gt(0.0), Le(20.0)] = 0.7
    decentering_px: Annotated[float, Gt(0.0), Le(20.0)] = 0.5

    def __post_init__(self) -> None:
        """Refuse an invalid spread."""
        require_bounds(self, section_path="spread")

    def scales(self, focal_px: float) -> FloatArray:
        """Return (17,): 1-sigma of a unit's coordinates in a frame (`lens_frame`)."""
        return spread_scales(self.focal_length * focal_px, self.center_px, self.radial_px, self.decentering_px)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensType:
    """A type of lens on one kind of sensor.

    Attributes
    ----------
    camera : the mean of the units, level, facing north.
    covariance : (17, 17) of the lens of a unit that was not measured about it: of the mean, and between units.
    spread : between units.
    field_px, field_length_px : 1-sigma and length of what the lens model does not describe, px.
    cameras : names of the units.
    days : local mean solar dates of the sightings, ISO 8601.
    """

    camera: Camera
    covariance: FloatArray
    spread: UnitSpread
    field_px: float
    field_length_px: float
    cameras: tuple[str, ...]
    days: tuple[str, ...]

    @property
    def frame(self) -> priors.LensPrior:
        """The coordinates of its lenses."""
        return lens_frame(self.camera)

    def in_frame(self) -> Gaussian:
        """Return a unit that was not measured, in the type's own frame."""
        return _convert_to_frame(self.camera, self.covariance, self.frame)

    def as_evidence(self) -> dict[str, Any]:
        """Return the information of a fit about the type that it was given."""
        return {"cameras": list(self.cameras), "days": list(self.days), "spread": asdict(self.spread)}


def type_camera(frame: priors.LensPrior, mean: FloatArray, like: Camera, *, max_angle: float) -> Camera:
    """Return the level camera of a lens in a frame, of the projection and the image of another one."""
    vector = np.zeros(len(Param))
    vector[priors.LENS] = frame.lens(mean)
    return replace(like.lens_alone(), max_angle=max_angle).replace_parameters(vector)
