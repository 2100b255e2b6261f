"""Several cameras of one type of lens: fits together, and the mean of the type and the spread of its units.

The epochs of one camera share its lens exactly: their sightings are fitted together, each with a pose of its own. The
cameras share it up to the spread between units: with the lenses' posteriors Gaussian, the joint posterior of each is
its own fit given the information of all the others (`further_unit`); no system of all unknowns has to be solved.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.evidence import linear_evidence
from sunarc.calibration.lens_library import lens_type
from sunarc.calibration.lens_library.conditioning import apply_lens_prior
from sunarc.calibration.model.options import CalibrationOptions, LensTolerances
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import N_LENS
from sunarc.common.array_types import FloatArray, stacked
from sunarc.common.errors import InputError
from sunarc.optics.camera import Camera
from sunarc.sky.site import Site

# Several cameras of one type of lens: the mean of the type, and the spread between its units.
#
# The model has two levels: the lenses β_i of the units are normal about the mean μ of the type with the spread's
# covariance S, and the sightings of each unit say D_i, d_i of its lens (`Information`). All is Gaussian, so that μ, and
# what the type says of a further unit, follow in closed form. The spread's four scales are averaged over their
# posterior where there are enough units; their prior is the stated spread, to a factor.

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


def estimate_lens_type(units: Sequence[Unit], *, spread: lens_type.UnitSpread | None = None) -> lens_type.LensType:
    """Return the type of lens of calibrations of several cameras.

    Parameters
    ----------
    units : one calibration a camera, accepted ones; from 3 on the spread between them is estimated.
    spread : between units, as it is stated.

    Raises
    ------
    InputError
        Where the cameras cannot be of one type: another projection, image size or handedness; or where a calibration
        does not state the covariance of its lens.
    """
    stated = lens_type.UnitSpread() if spread is None else spread
    require_one_type(units)
    first = units[0].calibration.camera
    frame = lens_type.lens_frame(first)
    fits = [one.calibration for one in units]
    known = [
        lens_type.sighting_information(lens_type.lens_gaussian(fit, frame), fit.evidence.radial_px) for fit in fits
    ]
    focal = float(np.mean(first.focal_length_px))
    spreads = estimated_spread(known, stated, focal_px=focal) if len(units) >= ENOUGH_UNITS else stated
    unit = further_unit(known, spreads.scales(focal), radial_px=_largest_radial_px(units))
    camera = lens_type.type_camera(frame, unit.mean, first, max_angle=min(fit.camera.max_angle for fit in fits))
    fields = [fit.field for fit in fits]
    return lens_type.LensType(
        camera=camera,
        covariance=frame.basis @ unit.covariance @ frame.basis.T,
        spread=spreads,
        field_px=float(np.sqrt(np.mean([field.amplitude_px**2 for field in fields]))),
        field_length_px=float(np.median([field.length_px for field in fields])),
        cameras=tuple(one.camera for one in units),
        days=tuple(sorted({day for fit in fits for day in fit.evidence.days})),
    )


def require_one_type(units: Sequence[Unit]) -> None:
    """Raise InputError unless calibrations can be of one type of lens, and state its covariance."""
    if not units:
        raise InputError(field="lens prior", problem="no calibration", remedy="name accepted calibrations")
    _require_alike([(one.camera, _lens_kind(one.calibration.camera)) for one in units])
    for one in units:
        if any(name not in one.calibration.parameter_names for name in lens_type.LENS_NAMES):
            raise InputError(
                field=one.camera,
                problem="the calibration does not state the covariance of its whole lens",
                remedy="calibrate it with --method robust",
            )


def _lens_kind(camera: Camera) -> dict[str, object]:
    handedness = "mirrored" if camera.mirrored else "not mirrored"
    return {"image size": (camera.width, camera.height), "projection": camera.projection, "handedness": handedness}


def _require_alike(kinds: Sequence[tuple[str, Mapping[str, object]]]) -> None:
    """Raise InputError where cameras, each with its name, differ in a property that those of one type share."""
    first, common = kinds[0]
    for name, kind in kinds:
        for what, value in kind.items():
            if value != common[what]:
                raise InputError(
                    field=name,
                    problem=f"{what} {value}, that of {first} is {common[what]}",
                    remedy="combine cameras of one type of lens on one kind of sensor",
                )


def _largest_radial_px(units: Sequence[Unit]) -> float:
    """Return the largest scale of residual radial distortion among units; that of the prior where none was measured."""
    found = [one.calibration.evidence.radial_px for one in units]
    return max([one for one in found if math.isfinite(one)], default=LensTolerances().radial_px)


def further_unit(known: Sequence[lens_type.Information], scales: FloatArray, *, radial_px: float) -> lens_type.Gaussian:
    """Return the lens of a further, unmeasured unit of a type.

    Parameters
    ----------
    known : what the sightings of each of the others say.
    scales : (17,) 1-sigma between units.
    radial_px : scale of the residual radial distortion of the type's mean, of which nothing else is known.
    """
    precision, vector, _ = _mean_precision(known, scales[None], lens_type.usual_precision(radial_px))
    covariance = np.linalg.inv(0.5 * (precision[0] + precision[0].T))
    return lens_type.Gaussian(covariance @ vector[0], np.asarray(covariance + np.diag(scales**2)))


def _mean_precision(
    known: Sequence[lens_type.Information], scales: FloatArray, usual: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the precision of the type's mean, its product with the mean, and the log evidence given a mean of 0.

    Parameters
    ----------
    scales : (k, 17) 1-sigma between units, tried each: (k, 17, 17), (k, 17) and (k,), the last but for a constant.
    """
    precision = np.broadcast_to(np.diag(usual + _TINY), (len(scales), N_LENS, N_LENS)).copy()
    vector, value = np.zeros((len(scales), N_LENS)), np.zeros(len(scales))
    for one in known:
        # the unit's own lens is integrated out
        inner = np.linalg.inv(one.matrix + scales[:, :, None] ** -2.0 * np.eye(N_LENS))
        passed = np.eye(N_LENS) - one.matrix @ inner
        precision += passed @ one.matrix
        vector += passed @ one.vector
        both = np.eye(N_LENS) + scales[:, :, None] * one.matrix * scales[:, None, :]
        value += linear_evidence(both, scales * one.vector)[0]
    return precision, vector, value


def estimated_spread(
    known: Sequence[lens_type.Information], stated: lens_type.UnitSpread, *, focal_px: float
) -> lens_type.UnitSpread:
    """Return the root mean square spread between units over its posterior.

    The four scales are tried at five factors of the stated ones each.
    """
    usual = lens_type.usual_precision(math.nan)
    factors = np.array(list(product(_FACTORS, repeat=4)))
    base = np.array([stated.focal_length * focal_px, stated.center_px, stated.radial_px, stated.decentering_px])
    log_weight = log_evidences(known, factors * base, usual)
    log_weight = log_weight - 0.5 * np.sum((np.log(factors) / _FACTOR_LOG_SIGMA) ** 2, axis=1)
    weight = np.exp(log_weight - log_weight.max())
    found = np.sqrt(weight @ factors**2 / weight.sum())
    return lens_type.UnitSpread(
        focal_length=min(stated.focal_length * float(found[0]), 0.1),
        center_px=min(stated.center_px * float(found[1]), 200.0),
        radial_px=min(stated.radial_px * float(found[2]), 20.0),
        decentering_px=min(stated.decentering_px * float(found[3]), 20.0),
    )


def log_evidences(known: Sequence[lens_type.Information], spreads: FloatArray, usual: FloatArray) -> FloatArray:
    """Return (k,): the log evidence of spreads (k, 4), but for a constant."""
    precision, vector, value = _mean_precision(
        known, np.stack([lens_type.spread_scales(*one) for one in spreads.tolist()]), usual
    )
    return value + linear_evidence(precision, vector)[0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Entry:
    """Sightings of one pose of one camera, for a joint fit.

    Attributes
    ----------
    camera, epoch : names; entries of one camera share its lens.
    points : the sightings; all are of this pose, whatever their own epochs say.
    site : where the camera stands, the same for all of its epochs.
    image_size : width and height, px.
    options : how to fit; projection and handedness are those of the lens.
    """

    camera: str
    epoch: str
    points: Sightings
    site: Site
    image_size: tuple[int, int]
    options: CalibrationOptions


class Joint(NamedTuple):
    """The calibration of every entry, in their order, and the type of lens; None where no camera was accepted."""

    calibrations: tuple[Calibration, ...]
    lens: lens_type.LensType | None


def calibrate_jointly(entries: Sequence[Entry], *, spread: lens_type.UnitSpread | None = None) -> Joint:
    """Return the calibrations of cameras of one type of lens, and the type.

    A camera whose fit is refused, or whose lens contradicts that of the others, is refused and says so; it says nothing
    of the type.

    Parameters
    ----------
    entries : at least one.
    spread : between units, as it is stated; estimated from 3 cameras on.

    Raises
    ------
    InputError
        Where cameras cannot share a lens, or epochs of one camera not a site; names the entry.
    """
    _require_shared(entries)
    names = list(dict.fromkeys(entry.camera for entry in entries))
    together = {name: [entry for entry in entries if entry.camera == name] for name in names}
    alone = {id(entry): _calibrate_epoch(together[entry.camera], entry) for entry in entries}
    options = _take_surest_projection(list(alone.values()), entries[0].options)
    for entry in entries:  # of one type of lens
        if alone[id(entry)].camera.projection != options.assumed_projection:
            alone[id(entry)] = _calibrate_epoch(together[entry.camera], entry, options)
    # all epochs of a camera have one lens: any of its calibrations states it
    units = {name: Unit(name, alone[id(together[name][-1])]) for name in names}
    accepted = [unit for unit in units.values() if unit.calibration.verdict.accepted]
    if not accepted:
        return Joint(tuple(alone[id(entry)] for entry in entries), None)
    require_one_type(accepted)
    found = []
    for entry in entries:
        others = [unit for unit in accepted if unit.camera != entry.camera]
        one = alone[id(entry)]
        if others and one.evidence.n_used:
            lens = estimate_lens_type(others, spread=spread)
            one = apply_lens_prior(
                one, lens, points=_stack_epochs(together[entry.camera], entry), options=entry.options
            )
        found.append(one)
    agreeing = {e.camera for e, one in zip(entries, found, strict=True) if one.verdict.accepted}
    kept = [unit for unit in accepted if unit.camera in agreeing]
    return Joint(tuple(found), estimate_lens_type(kept, spread=spread) if kept else None)


def _require_shared(entries: Sequence[Entry]) -> None:
    """Raise InputError where entries cannot share a lens, or those of one camera not a site."""
    if not entries:
        raise InputError(field="entry", problem="none", remedy="name cameras and their sightings")
    names = [f"{entry.camera} {entry.epoch}".strip() for entry in entries]
    kinds = [
        {"image size": e.image_size, "projection": e.options.projection, "mirrored": e.options.mirrored}
        for e in entries
    ]
    _require_alike(list(zip(names, kinds, strict=True)))
    sites = {entry.camera: entry.site for entry in reversed(entries)}
    for name, entry in zip(names, entries, strict=True):
        if entry.site != sites[entry.camera]:
            raise InputError(
                field=name,
                problem="another site than that of an earlier epoch of the camera",
                remedy="give a camera that was moved to another site a name of its own",
            )


def _take_surest_projection(fits: Sequence[Calibration], options: CalibrationOptions) -> CalibrationOptions:
    """Return options with the projection of the accepted fit of smallest uncertainty, where they state none."""
    accepted = [one for one in fits if one.verdict.accepted] or fits
    surest = min(accepted, key=lambda one: one.sky_rms_deg)
    return replace(options, projection=surest.camera.projection) if options.projection == "auto" else options


def _calibrate_epoch(entries: Sequence[Entry], latest: Entry, options: CalibrationOptions | None = None) -> Calibration:
    """Return the calibration of one epoch of a camera, by the sightings of all; options are its own unless given."""
    points = _stack_epochs(entries, latest)
    return calibrate(points, site=latest.site, image_size=latest.image_size, options=options or latest.options)


def _stack_epochs(entries: Sequence[Entry], latest: Entry) -> Sightings:
    """Return the sightings of all epochs of a camera, one of them numbered last: a fit is of the last one's pose."""
    ordered = [*(entry for entry in entries if entry is not latest), latest]
    parts = [replace(entry.points, epoch=np.full(len(entry.points), k)) for k, entry in enumerate(ordered)]
    return stacked(parts)
