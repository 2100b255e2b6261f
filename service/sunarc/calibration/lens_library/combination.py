"""Several cameras of one type of lens: the mean of the type, and the spread between its units.

The model has two levels: the lenses β_i of the units are normal about the mean μ of the type with the spread's
covariance S, and the sightings of each unit say D_i, d_i of its lens (`Information`). All is Gaussian, so that μ, and
what the type says of a further unit, follow in closed form. The spread's four scales are averaged over their
posterior where there are enough units; their prior is the stated spread, to a factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.least_squares.priors import N_LENS
from sunarc.calibration.lens_library.frame import (
    LENS_NAMES,
    Gaussian,
    Information,
    frame_of,
    gaussian_of,
    information_of,
    spread_scales,
    usual_precision,
)
from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread, type_camera
from sunarc.calibration.model.options import LensTolerances
from sunarc.calibration.model.result import Calibration
from sunarc.errors import InputError

ENOUGH_UNITS = 3
"""Units from which on the spread between them is estimated."""
_FACTORS = 2.0 ** np.arange(-2.0, 3.0)
_FACTOR_LOG_SIGMA = math.log(2.5)
"""The stated spread is taken to be right within a factor of 2.5, 1-sigma."""

_TINY = 1e-8
"""Precision, px⁻², of focal length and centre where no unit tells them: 10⁴ px."""


class Unit(NamedTuple):
    """A camera of a type: its name, and a calibration of it."""

    camera: str
    calibration: Calibration


def lens_type_of(units: Sequence[Unit], *, spread: UnitSpread | None = None) -> LensType:
    """Return what calibrations of several cameras say of their type of lens.

    Parameters
    ----------
    units : one calibration a camera, accepted ones; from 3 on the spread between them is estimated.
    spread : between units, as it is stated.

    Raises
    ------
    InputError
        Where the cameras cannot be of one type: another projection, image size or handedness; or where a calibration
        does not tell the covariance of its lens.
    """
    stated = UnitSpread() if spread is None else spread
    require_one_type(units)
    first = units[0].calibration.camera
    frame, known = frame_of(first), informations(units)
    focal = float(np.mean(first.focal_length_px))
    spreads = estimated_spread(known, stated, focal_px=focal) if len(units) >= ENOUGH_UNITS else stated
    unit = further_unit(known, spreads.scales(focal), radial_px=_radial_px(units))
    camera = type_camera(frame, unit.mean, first, max_angle=min(one.calibration.camera.max_angle for one in units))
    fields = [one.calibration.field for one in units]
    return LensType(
        camera=camera,
        covariance=frame.basis @ unit.covariance @ frame.basis.T,
        spread=spreads,
        field_px=float(np.sqrt(np.mean([field.amplitude_px**2 for field in fields]))),
        field_length_px=float(np.median([field.length_px for field in fields])),
        cameras=tuple(one.camera for one in units),
        days=tuple(sorted({day for one in units for day in one.calibration.evidence.days})),
    )


def require_one_type(units: Sequence[Unit]) -> None:
    """Raise InputError unless calibrations can be of one type of lens, and tell its covariance."""
    if not units:
        raise InputError(field="lens prior", problem="no calibration", remedy="name accepted calibrations")
    first = units[0]
    kind = _kind(first.calibration)
    for one in units:
        for name, value in _kind(one.calibration).items():
            if value != kind[name]:
                raise InputError(
                    field=one.camera,
                    problem=f"{name} {value}, that of {first.camera} is {kind[name]}",
                    remedy="combine cameras of one type of lens on one kind of sensor",
                )
        if any(name not in one.calibration.parameter_names for name in LENS_NAMES):
            raise InputError(
                field=one.camera,
                problem="the calibration does not tell the covariance of all of its lens",
                remedy="calibrate it with --method robust",
            )


def _kind(calibration: Calibration) -> dict[str, str]:
    camera = calibration.camera
    return {
        "projection": camera.projection,
        "image size": f"{camera.width}x{camera.height}",
        "handedness": "mirrored" if camera.mirrored else "not mirrored",
    }


def informations(units: Sequence[Unit]) -> list[Information]:
    """Return what the sightings of each say of its lens, in the frame of the first one."""
    frame = frame_of(units[0].calibration.camera)
    return [information_of(gaussian_of(one.calibration, frame), one.calibration.evidence.radial_px) for one in units]


def _radial_px(units: Sequence[Unit]) -> float:
    """Return the largest scale of residual radial distortion that was found: where nothing was seen it is the prior."""
    found = [one.calibration.evidence.radial_px for one in units]
    return max([one for one in found if math.isfinite(one)], default=LensTolerances().radial_px)


def further_unit(known: Sequence[Information], scales: FloatArray, *, radial_px: float) -> Gaussian:
    """Return the lens of a unit that was not measured, where others were.

    Parameters
    ----------
    known : what the sightings of each of the others say.
    scales : (17,) 1-sigma between units.
    radial_px : scale of the residual radial distortion of the type's mean, of which nothing else is known.
    """
    precision, vector = _of_mean(known, scales, usual_precision(radial_px))
    covariance = np.linalg.inv(precision)
    return Gaussian(covariance @ vector, np.asarray(covariance + np.diag(scales**2)))


def _of_mean(known: Sequence[Information], scales: FloatArray, usual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the precision (17, 17) of the type's mean, and its product with the mean."""
    precision, vector = np.diag(usual + _TINY), np.zeros(N_LENS)
    for one in known:
        # the unit's own lens is integrated out
        passed = np.eye(N_LENS) - one.matrix @ np.linalg.inv(one.matrix + np.diag(scales**-2.0))
        precision = precision + passed @ one.matrix
        vector = vector + passed @ one.vector
    return 0.5 * (precision + precision.T), vector


def estimated_spread(known: Sequence[Information], stated: UnitSpread, *, focal_px: float) -> UnitSpread:
    """Return the root mean square spread between units over its posterior.

    The four scales are tried at five factors of the stated ones each.
    """
    usual = usual_precision(math.nan)
    factors = np.array(list(product(_FACTORS, repeat=4)))
    base = np.array([stated.focal_length * focal_px, stated.center_px, stated.radial_px, stated.decentering_px])
    log_weight = _log_evidences(known, factors * base, usual)
    log_weight = log_weight - 0.5 * np.sum((np.log(factors) / _FACTOR_LOG_SIGMA) ** 2, axis=1)
    weight = np.exp(log_weight - log_weight.max())
    found = np.sqrt(weight @ factors**2 / weight.sum())
    return UnitSpread(
        focal_length=min(stated.focal_length * float(found[0]), 0.1),
        center_px=min(stated.center_px * float(found[1]), 200.0),
        radial_px=min(stated.radial_px * float(found[2]), 20.0),
        decentering_px=min(stated.decentering_px * float(found[3]), 20.0),
    )


def _log_evidences(known: Sequence[Information], spreads: FloatArray, usual: FloatArray) -> FloatArray:
    """Return (k,): the log evidence of spreads (k, 4), but for a constant."""
    scales = np.stack([spread_scales(*one) for one in spreads.tolist()])
    precision = np.broadcast_to(np.diag(usual + _TINY), (len(scales), N_LENS, N_LENS)).copy()
    vector, value = np.zeros((len(scales), N_LENS)), np.zeros(len(scales))
    for one in known:
        inner = np.linalg.inv(one.matrix + scales[:, :, None] ** -2.0 * np.eye(N_LENS))
        passed = np.eye(N_LENS) - one.matrix @ inner
        precision += passed @ one.matrix
        vector += passed @ one.vector
        value += 0.5 * np.einsum("p,kpq,q->k", one.vector, inner, one.vector)
        both = np.eye(N_LENS) + scales[:, :, None] * one.matrix * scales[:, None, :]
        value -= 0.5 * np.linalg.slogdet(both)[1]
    mean = np.linalg.solve(precision, vector[..., None])[..., 0]
    return np.asarray(value + 0.5 * np.sum(vector * mean, axis=1) - 0.5 * np.linalg.slogdet(precision)[1])
