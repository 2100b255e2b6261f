"""A fit of sightings in a notebook: `sunarc.calibrate`."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import get_args

from sunarc.calibration.model.options import USUAL_OPTIONS, CalibrationOptions, ImageCircle, Method, Mirrored
from sunarc.calibration.model.result import Calibration as Solved
from sunarc.calibration.model.sightings import Sightings as Points
from sunarc.calibration.stated_prior import PriorTolerances
from sunarc.common.errors import InputError
from sunarc.common.utc import DAY_S
from sunarc.formats.formats import calibration_view
from sunarc.optics.projections import PROJECTIONS
from sunarc.public.calibration import Calibration, load
from sunarc.public.documents import as_documented, latest_times, new_document
from sunarc.public.inputs import check_image_size, choice, named_as_in_python, number, numbers
from sunarc.public.stated_fit import fit_as_stated
from sunarc.public.values import Sightings, Site, StrPath, require_sightings, require_site


def calibrate(
    sightings: Sightings,
    site: Site,
    *,
    image_size: tuple[int, int],
    projection: str = "auto",
    mirrored: str | None = None,
    method: str = "robust",
    image_circle: tuple[float, float, float] | None = None,
    level_within_deg: float | None = None,
    clock_error_s: float | None = None,
    outwards_px: float | None = None,
    start: Calibration | StrPath | None = None,
    pose_only: bool = False,
    lens_within_px: float | None = None,
    pose_within_deg: float | None = None,
    focal_within: float | None = None,
    provisional: bool = False,
    name: str | None = None,
) -> Calibration:
    """Fit a camera to sightings, as `sunarc calibrate` does: the same defaults and the same answer.

    A poor fit does not raise: it is a `Calibration` whose `verdict` is refused.

    Parameters
    ----------
    sightings : from one camera.
    site : where it stands.
    image_size : width and height, px.
    projection : the lens's ideal projection, as `equisolid`; `auto`: the one that the sightings make most probable.
    mirrored : whether the images are mirror images: `no`, `yes`, `auto`. Unless given they are not, and a fit is
        refused where they may be.
    method : `robust`, or `paper` (the reference).
    image_circle : x, y and radius of the lens's image circle, px.
    level_within_deg : largest tilt of the camera; unless given, a first fit tilted by more than 5 degrees is refused.
    clock_error_s : bound of the clock's error, which the uncertainty then holds; unless given 2 s are assumed.
    outwards_px : 1-sigma of how far the sun is detected from its place along the radius; unless given 0.07 px.
    start : a camera to begin at, or its file in any format that is read.
    pose_only : whether the lens of `start` is kept, and the pose alone fitted.
    lens_within_px, pose_within_deg, focal_within : `start` as a prior: 1-sigma of its image near the horizon, of its
        rotation, and of its focal length (relative).
    provisional : whether a fit is kept that lacks only hours or days; it answers where its 1-sigma is small.
    name : of the camera; that of the sightings' file unless given.

    Raises
    ------
    InputError
        Where an argument cannot be used, with the remedy.

    Examples
    --------
    >>> import sunarc
    >>> site = sunarc.Site(latitude=36.604, longitude=-97.485, altitude_m=318)
    >>> sightings = sunarc.read_sightings("sun.csv")
    >>> calibration = sunarc.calibrate(sightings, site, image_size=(1748, 1748))
    >>> calibration.verdict
    'accepted'
    """
    sightings = require_sightings(sightings)
    if pose_only and start is None:
        raise InputError(field="pose_only", problem="no lens to keep", remedy="name a calibration with start")
    limits = {"level_within_deg": level_within_deg, "clock_error_s": clock_error_s, "outwards_px": outwards_px}
    stated = {key: None if value is None else number(value, field=key) for key, value in limits.items()}
    begin = None if start is None else (start if isinstance(start, Calibration) else load(start))
    with named_as_in_python():
        options = CalibrationOptions(
            method=choice("method", method, get_args(Method)),
            projection=choice("projection", projection, (*PROJECTIONS, "auto")),
            mirrored=None if mirrored is None else choice("mirrored", mirrored, get_args(Mirrored)),
            level_within_deg=stated["level_within_deg"],
            outwards_px=USUAL_OPTIONS.outwards_px if stated["outwards_px"] is None else stated["outwards_px"],
        )
        points = sightings.at(require_site(site))
        solved, fitted = fit_as_stated(
            points,
            name=sightings.name,
            site=site.place,
            image_size=check_image_size(image_size),
            options=options,
            circle=_make_circle(image_circle),
            start=None if begin is None else begin.as_start(),
            pose_only=pose_only,
            within=_make_tolerances(
                lens_within_px, pose_within_deg, focal_within, usable=begin is not None and not pose_only
            ),
            keep_provisional=provisional,
            clock_error_s=_require_clock_bound(stated["clock_error_s"]),
        )
    return _make_calibration(solved, fitted, sightings, name=name or sightings.name)


def _make_circle(given: object) -> ImageCircle | None:
    """Return the image circle; InputError where it is no circle."""
    if given is None:
        return None
    found = numbers(given, field="image_circle")
    if found.shape != (3,):
        raise InputError(field="image_circle", problem=f"has shape {found.shape}", remedy="give x, y, radius in px")
    return ImageCircle(x=float(found[0]), y=float(found[1]), radius=float(found[2]))


def _make_tolerances(
    lens_px: float | None, pose_deg: float | None, focal_length: float | None, *, usable: bool
) -> PriorTolerances | None:
    """Return the tolerances of a start that is a prior; None where none is stated."""
    if lens_px is None and pose_deg is None and focal_length is None:
        return None
    if lens_px is None or not usable:
        remedy = "give lens_within_px with start, without pose_only"
        raise InputError(field="lens_within_px", problem="is missing, or no start is a prior", remedy=remedy)
    pose = None if pose_deg is None else number(pose_deg, field="pose_within_deg")
    focal = None if focal_length is None else number(focal_length, field="focal_within")
    return PriorTolerances(lens_px=number(lens_px, field="lens_within_px"), pose_deg=pose, focal_length=focal)


def _require_clock_bound(seconds: float | None) -> float | None:
    if seconds is not None and not 0.0 <= seconds <= DAY_S:
        problem = f"{seconds:g} s is not within 0 to {DAY_S:g}"
        raise InputError(field="clock_error_s", problem=problem, remedy="give the bound of the clock's error in s")
    return seconds


def _make_calibration(solved: Solved, points: Points, sightings: Sightings, *, name: str) -> Calibration:
    """Return a calibration that was fitted now."""
    now = datetime.now(UTC)  # noqa: TID251 - a notebook's calibration is dated by the machine
    document = new_document(solved, latest_times(points), created_at=now, camera=name)
    known = as_documented(document, solved)
    return Calibration(calibration_view(known), document=document, solved=known, sightings=sightings, name=name)
