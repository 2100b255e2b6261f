"""A fit by all that is stated: sightings, a start or a prior, a type of lens, a bound of the clock's error."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.lens_library.lens_type import LensType
from sunarc.calibration.model.options import USUAL_OPTIONS, CalibrationOptions, ImageCircle, Mirrored
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S, Kind, Sightings, time_step_s
from sunarc.calibration.normal_points import dense_record
from sunarc.calibration.pose import estimate_pose
from sunarc.calibration.quality.tilt import require_level
from sunarc.calibration.stated_prior import PriorTolerances, calibrate_with_prior
from sunarc.calibration.verdict import add_stated_clock, provisional
from sunarc.changes.record import Moved, calibrate_moved, calibrate_with_lens
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.formats.view import View, closest_camera
from sunarc.optics.camera import Camera
from sunarc.sky.site import Site
from sunarc.sources.files import require_inside


class StatedStart(NamedTuple):
    """Stated camera to begin a fit at: file name, view, and the calibration where the file is a document."""

    name: str
    view: View
    known: Calibration | None


def fit_as_stated(
    points: Sightings,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions,
    name: str = "sightings",
    circle: ImageCircle | None = None,
    start: StatedStart | None = None,
    pose_only: bool = False,
    within: PriorTolerances | None = None,
    lens: LensType | None = None,
    keep_provisional: bool = False,
    clock_error_s: float | None = None,
) -> Moved:
    """Fit a camera to sightings; return the calibration, and the sightings with their pose epochs.

    `sunarc calibrate FILE` and `sunarc.calibrate` are this function.

    Parameters
    ----------
    points, site, image_size, options, circle : as `calibrate` takes them.
    name : of the sightings, for errors.
    start : a camera of any format that is read. A projection that is not stated comes from it, or is chosen by the
        sightings.
    pose_only : whether its lens is kept, see `_estimate_pose`.
    within : tolerances that make it a prior.
    lens : the camera's type of lens, in place of a start.
    keep_provisional : see `provisional`.
    clock_error_s : the bound of the clock's error; that of the sightings unless given.

    Raises
    ------
    InputError
        Where two statements contradict each other, by the name of the command's option.
    """
    require_inside(points.pixels, image_size, name=name)
    points, clock_error_s = without_clock_column(points, clock_error_s)
    if clock_error_s is not None:  # as far as a fit allows for one; `add_stated_clock` adds what is beyond
        points = replace(points, clock_error_s=np.full(1, min(clock_error_s, MAX_CLOCK_ERROR_S)))
    _require_suns(points, options)
    dense = dense_record(points, site=site, image_size=image_size, options=options, circle=circle)
    given = points if dense is None else dense.normal
    known = None if start is None else _require_accepted_at(start.known, site)
    if start is not None and known is not None:
        require_level(known.pose.theta_zz_deg, options.level_within_deg, field="--level-within", name=start.name)
    if lens is not None:
        require_lens(lens, image_size=image_size, options=options)
        solved, given = calibrate_with_lens(given, lens=lens, site=site, options=options, circle=circle)
    elif start is not None and pose_only:
        solved = _estimate_pose(given, start, image_size=image_size, site=site, options=options)
    elif start is not None and within is not None:
        prior = start_camera(start, image_size, options, posed=within.pose_deg is not None)
        solved = calibrate_with_prior(given, prior=prior, tolerances=within, site=site, options=options)
    else:
        begin = None if start is None else start_camera(start, image_size, options)
        if begin is not None:  # the file states the handedness
            options = replace(options, mirrored="yes" if begin.mirrored else "no")
        solved, given = calibrate_moved(
            given,
            site=site,
            image_size=image_size,
            options=options,
            circle=circle,
            start=begin,
            tilt_known=known is not None,
        )
    if start is not None or lens is not None:
        solved = _add_handedness_finding(solved, given, options=options, circle=circle)
    if keep_provisional:
        solved = provisional(solved, limit_deg=options.max_sky_deg)
    if dense is None:
        points = given
    else:
        solved, points = dense.fit_as_all_sightings(solved, given)
    return Moved(add_stated_clock(solved, clock_error_s, step_s=time_step_s(points.unix_s)), points)


_SAME_SITE_DEG = 0.1
"""Difference of latitude or longitude up to which a camera was accepted at the same site."""


def _require_accepted_at(known: Calibration | None, site: Site) -> Calibration | None:
    """Return a calibration that was accepted at a site; None where it was accepted at another one, or not at all."""
    if known is None:
        return None
    off_deg = abs(known.site.latitude - site.latitude), abs(known.site.longitude - site.longitude)
    return known if known.verdict.accepted and max(off_deg) < _SAME_SITE_DEG else None


def _add_handedness_finding(
    solved: Calibration, points: Sightings, *, options: CalibrationOptions, circle: ImageCircle | None
) -> Calibration:
    """Return a calibration by a known lens; its verdict says where the sightings alone fit the other handedness."""
    if solved.verdict.accepted or any(one.code.startswith("other_handedness") for one in solved.verdict.findings):
        return solved
    stated: Mirrored = "yes" if solved.camera.mirrored else "no"
    size = (solved.camera.width, solved.camera.height)
    free = replace(options, mirrored="auto", projection=solved.camera.projection)
    alone = calibrate(points, site=solved.site, image_size=size, options=free, circle=circle)
    if not alone.verdict.accepted or alone.camera.mirrored == solved.camera.mirrored:
        return solved
    other: Mirrored = "no" if stated == "yes" else "yes"
    found = Finding("other_handedness_fits", {"mirrored": other, "stated": stated, "latitude": -solved.site.latitude})
    return replace(solved, verdict=replace(solved.verdict, findings=(found, *solved.verdict.findings)))


_LENS_WITHIN_PX, _LARGEST_LENS_PX = 1.0, 10.0
"""1-sigma of the image near the horizon by a lens of which a file states no uncertainty; no lens is kept by more."""


def _estimate_pose(
    points: Sightings, start: StatedStart, *, image_size: tuple[int, int], site: Site, options: CalibrationOptions
) -> Calibration:
    """Return the lens of a file in the pose that sightings ask for.

    That of a calibration document is kept within its own uncertainty; that of another format, which states none, within
    a pixel, and as far as our model differs from its description.
    """
    if start.known is not None:
        _require_size(start.known.camera, image_size)
        return estimate_pose(points, start=start.known, site=site, options=options)
    camera, difference = closest_camera(start.view)
    _require_size(camera, image_size)
    lens_px = math.hypot(_LENS_WITHIN_PX, difference.total.rms_px)
    if not lens_px <= _LARGEST_LENS_PX:
        raise InputError(
            field="--pose-only",
            problem=f"the lens of {start.name} is none of ours to {difference.total.rms_px:.0f} px",
            remedy="name a calibration that describes the whole image",
        )
    camera = replace(camera, max_angle=math.radians(options.max_angle_deg))
    return calibrate_with_prior(
        points, prior=camera, tolerances=PriorTolerances(lens_px=lens_px), site=site, options=options
    )


def _require_suns(points: Sightings, options: CalibrationOptions) -> None:
    """Raise InputError where a bias of the sun's detection is stated, and no sighting is of the sun."""
    if options.outwards_px != USUAL_OPTIONS.outwards_px and not np.any(points.kind == Kind.SUN):
        raise InputError(
            field="--outwards-px",
            problem=f"{options.outwards_px:g} px of the sun's detection, where no sighting is of the sun",
            remedy="leave it out",
        )


def without_clock_column(points: Sightings, clock_error_s: float | None) -> tuple[Sightings, float | None]:
    """Return sightings with one clock error common to all, and its bound: the option's, or the column's largest."""
    stated = points.clock_error_s[np.isfinite(points.clock_error_s)]
    if stated.size == 0:
        return points, clock_error_s
    largest_s = float(np.max(stated))
    if clock_error_s is not None and clock_error_s != largest_s:
        raise InputError(
            field="--clock-error",
            problem=f"{clock_error_s:g} s, where the column clock_error_s has {largest_s:g} s",
            remedy="leave out one of them",
        )
    return replace(points, clock_error_s=np.full(1, np.nan)), largest_s


def require_lens(lens: LensType, *, image_size: tuple[int, int], options: CalibrationOptions) -> None:
    """Raise InputError where a camera cannot be of a type of lens.

    Parameters
    ----------
    lens : the type.
    image_size : of the camera, px.
    options : of its fit.
    """
    camera = lens.camera
    hand = "yes" if camera.mirrored else "no"
    for what, given, stated in (
        ("image size", image_size, (camera.width, camera.height)),
        (
            "projection",
            camera.projection if options.projection == "auto" else options.projection,
            camera.projection,
        ),
        ("mirrored", options.mirrored if options.mirrored in {"no", "yes"} else hand, hand),
    ):
        if given != stated:
            raise InputError(
                field="--lens-prior",
                problem=f"{what} {stated}, where the camera's is {given}",
                remedy="name the lens prior of this type of lens and sensor",
            )


def start_camera(
    start: StatedStart, image_size: tuple[int, int], options: CalibrationOptions, *, posed: bool = False
) -> Camera:
    """Return the camera to begin at: a document's, or the one closest to another format's view.

    `posed` requires that the file has a pose.
    """
    view = start.view
    if posed and not view.has_pose:
        raise InputError(
            field="--pose-within", problem=f"{start.name} has no pose", remedy="leave it out: the pose is sought anew"
        )
    camera = view.camera
    if camera is None:
        closest, _ = closest_camera(view, projection=options.assumed_projection)
        camera = replace(closest, max_angle=math.radians(options.max_angle_deg))
    _require_size(camera, image_size)
    if options.projection not in {"auto", camera.projection}:
        raise InputError(
            field="--start",
            problem=f"its lens is {camera.projection}, where --projection {options.projection} is given",
            remedy="leave --projection out, or name a camera of this projection",
        )
    if options.mirrored in {"no", "yes"} and camera.mirrored != (options.mirrored == "yes"):
        hands = ("not mirrored", "mirrored")
        raise InputError(
            field="--start",
            problem=f"is {hands[camera.mirrored]}, where --mirrored {options.mirrored} is set",
            remedy="leave --mirrored out, or name a camera of this handedness",
        )
    return camera


def _require_size(camera: Camera, image_size: tuple[int, int]) -> None:
    """Raise InputError where a start is of other images: it would be no answer."""
    size = (camera.width, camera.height)
    if size != image_size:
        raise InputError(
            field="--start",
            problem=f"is of {size[0]}x{size[1]} images, not {image_size[0]}x{image_size[1]}",
            remedy="name a calibration of this camera",
        )
