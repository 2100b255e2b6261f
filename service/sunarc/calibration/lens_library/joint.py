"""Several cameras of one type of lens, and several epochs of each, in one fit.

The epochs of one camera share its lens exactly: their sightings are fitted together, each with a pose of its own. The
cameras share it up to the spread between units: with the lenses' posteriors Gaussian, the joint posterior of each is
its own fit given what all the others say of the type (`further_unit`); no system of all unknowns has to be solved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import stacked
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.lens_library.combination import Unit, lens_type_of, require_one_type
from sunarc.calibration.lens_library.conditioning import with_lens
from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import SunPoints
from sunarc.errors import InputError
from sunarc.sky.site import Site


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Entry:
    """Sightings of one pose of one camera.

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
    points: SunPoints
    site: Site
    image_size: tuple[int, int]
    options: CalibrationOptions


class Joint(NamedTuple):
    """The calibration of every entry, in their order, and the type of lens; None where no camera was accepted."""

    calibrations: tuple[Calibration, ...]
    lens: LensType | None


def calibrate_jointly(
    entries: Sequence[Entry], *, spread: UnitSpread | None = None, calibrate: Callable[..., Calibration] = calibrate
) -> Joint:
    """Return the calibrations of cameras of one type of lens, and the type.

    A camera whose fit is refused, or whose lens contradicts that of the others, is refused and says so; it says nothing
    of the type.

    Parameters
    ----------
    entries : at least one.
    spread : between units, as it is stated; estimated from 3 cameras on.
    calibrate : the fit of one camera.

    Raises
    ------
    InputError
        Where cameras cannot share a lens, or epochs of one camera not a site; names the entry.
    """
    _require_shared(entries)
    names = list(dict.fromkeys(entry.camera for entry in entries))
    together = {name: [entry for entry in entries if entry.camera == name] for name in names}
    alone = {id(entry): _of_epoch(together[entry.camera], entry, calibrate) for entry in entries}
    # all epochs of a camera have one lens: any of its calibrations tells it
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
            lens = lens_type_of(others, spread=spread)
            one = with_lens(one, lens, points=_stacked(together[entry.camera], entry), options=entry.options)
        found.append(one)
    agreeing = {e.camera for e, one in zip(entries, found, strict=True) if one.verdict.accepted}
    kept = [unit for unit in accepted if unit.camera in agreeing]
    return Joint(tuple(found), lens_type_of(kept, spread=spread) if kept else None)


def _require_shared(entries: Sequence[Entry]) -> None:
    """Raise InputError where entries cannot share a lens, or those of one camera not a site."""
    if not entries:
        raise InputError(field="entry", problem="none", remedy="name cameras and their sightings")
    first, sites = entries[0], {entry.camera: entry.site for entry in reversed(entries)}
    for entry in entries:
        name = f"{entry.camera} {entry.epoch}".strip()
        for what, one, other in (
            ("image size", entry.image_size, first.image_size),
            ("projection", entry.options.projection, first.options.projection),
            ("mirrored", entry.options.mirrored, first.options.mirrored),
        ):
            if one != other:
                raise InputError(
                    field=name,
                    problem=f"{what} {one}, that of {first.camera} is {other}",
                    remedy="fit cameras of one type of lens on one kind of sensor together",
                )
        if entry.site != sites[entry.camera]:
            raise InputError(
                field=name,
                problem="another site than that of an earlier epoch of the camera",
                remedy="give a camera that was moved to another site a name of its own",
            )


def _of_epoch(entries: Sequence[Entry], latest: Entry, fit: Callable[..., Calibration]) -> Calibration:
    """Return the calibration of one epoch of a camera, by the sightings of all."""
    return fit(_stacked(entries, latest), site=latest.site, image_size=latest.image_size, options=latest.options)


def _stacked(entries: Sequence[Entry], latest: Entry) -> SunPoints:
    """Return the sightings of all epochs of a camera, one of them numbered last: a fit is of the last one's pose."""
    ordered = [*(entry for entry in entries if entry is not latest), latest]
    parts = [replace(entry.points, epoch=np.full(len(entry.points), k)) for k, entry in enumerate(ordered)]
    return stacked(parts)
