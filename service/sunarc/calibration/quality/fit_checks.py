"""Checks that refuse a fit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sunarc.calibration.answers.covariance import seen_sky, sigma_deg
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration, Verdict, proves, refused_for
from sunarc.calibration.model.sightings import Kind, Sightings, grid_steps_px
from sunarc.calibration.quality.day_arcs import arc_length_deg, unexplained_days
from sunarc.calibration.quality.day_clocks import unsteady_clock
from sunarc.calibration.quality.tilt import proposed_limit_deg, tilt_question
from sunarc.common.findings import Finding
from sunarc.optics.camera import PARAMETER_NAMES, POSE, Camera
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import right_jacobian, rotation_matrix
from sunarc.sky.days import date_of_day, day_bounds_unix_s
from sunarc.sky.directions import angular_distance
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

_FEWEST = 20
_FEWEST_BELOW = 4
"""Sightings of a sun below the horizon that show a wrong site or clock; fewer may be false ones at dusk."""
_SHORTEST_ARC_DEG = 10.0
_SMALLEST_SPREAD_PX = 10.0
_MOST_STATIC = 0.5
"""Share of the sightings that may stand still: a detector that finds an overlay more often than the sun is at fault."""
_POSITIONS_NAMED = 3
_OVER_STATED = 1.5
"""RMSE over that of the stated sigmas that is no fault of the camera: detectors state theirs to a factor of 1.5."""
_KNOWN_LENS_SKY_DEG = 2.0
"""1-sigma over the sky that may be stated where the lens is known: such a pose is there until a full fit is."""
_HOUR_S = 3600.0
_FEW_HOURS = 0.2
"""Share of the hours of sun that a whole day may lack."""
_ALIKE_DEG = 5.0
"""Range of declinations up to which the sun runs over one band of the sky: two days a fortnight apart in spring."""
_UNDETERMINED = frozenset(
    {
        *("direction_sigma_too_large", "projection_ambiguous", "projection_chosen"),
        *("sightings_determine", "hours_missing", "declinations_alike"),
    }
)
"""Codes of refusals that contradict nothing."""
TILT = "tilt"
"""Name of the tilt among the log odds of a fit."""
_MOST_ODDS = 1e4
"""Powers of ten above which odds are not given any more."""
_LEAST_SHARE = 0.05
"""Share of the sky in the image that a provisional calibration answers for at least."""
_SURELY_TILTED = 5.0
"""Stated sigmas of the pose: 23 suns of a morning tilted cameras that are level to 3 degrees by up to 4.0 of them."""
TILT_SHOWN = 2.0 * math.log(10.0)
"""Log odds of a tilt against a level camera at another place from which on refraction and horizon show the tilt."""
_SEEN_BELOW_DEG = 1.0
"""Angle from where the camera sees a sun that was below the horizon, within which a sighting is of the sun."""
_LOW_SUN_DEG = 85.0
"""Zenith angle, degrees, up to which a sun is expected to be seen."""
_OFF_CENTER = 0.04
"""Share of the image's shorter side by which lenses lie off their sensor's middle at most."""
_NARROW_DEG, _RING_DEG = 3.0, 90.0
"""Range of angles from the axis (5 to 95 %) that shows the radius at one place alone, and part of the circle about the
axis from which on the sightings are a ring. A shorter arc is short: its fit states a large uncertainty."""
_LEAST_ANGLE_DEG = 20.0
"""Angle from the axis up to which the radius of any fisheye rises."""


_MOST_EXCESS = 0.9
"""Errors of predicted parts over what chance allows, see `Doubts`. Right fits of real-like tracks reach 0.88, those of
clear days 0.79; days on which a camera moved, or of a radius with a corner, mostly 0.94 to 2.8."""
_MOST_EXCESS_BESIDE_STARS = 1.1
"""The same where stars hold the camera, and the rest of the errors shows."""
_TURNED = 20.0
"""Chi-square of the turn of one part's camera from which on it is named: three numbers reach it once in 6,000."""


def before_fit(usable: Sightings, options: CalibrationOptions) -> tuple[Finding, ...]:
    """Return the findings that make a fit pointless: few sightings, a short arc, a sun below the horizon or still."""
    n_static = sum(position.n for position in usable.filtering.static)
    n_all = len(usable) + n_static
    if n_static > _MOST_STATIC * n_all:
        return (Finding("static_sightings", {"n": n_static, "n_all": n_all, "places": _positions(usable)}),)
    if len(usable) < _FEWEST:
        few = Finding("too_few_sightings", {"n": len(usable), "least": _FEWEST})
        return (*below_horizon(usable, options), few, *usable.filtering.dropped)
    problems = []
    arc = sum(arc_length_deg(usable.directions[usable.day == day]) for day in np.unique(usable.day))
    if arc < _SHORTEST_ARC_DEG:
        problems.append(Finding("arc_too_short", {"arc_deg": arc, "least_deg": _SHORTEST_ARC_DEG}))
    spread = float(np.linalg.norm(np.ptp(usable.pixels, axis=0)))
    if spread < _SMALLEST_SPREAD_PX:
        problems.append(Finding("spread_too_small", {"spread_px": spread, "least_px": _SMALLEST_SPREAD_PX}))
    return tuple(problems)


def below_horizon(usable: Sightings, options: CalibrationOptions) -> tuple[Finding, ...]:
    """Return the finding of more sightings below the horizon than false detections are; none where they are fewer."""
    below, limit = usable.filtering.n_below_horizon, options.max_below_horizon
    n_all = below + int(np.sum(~usable.alone)) + sum(position.n for position in usable.filtering.static)
    if below < _FEWEST_BELOW or below <= limit * n_all:
        return ()
    return (Finding("sightings_below_horizon", {"n": below, "n_all": n_all, "share": below / n_all, "limit": limit}),)


def _seen_below_horizon(calibration: Calibration, usable: Sightings) -> tuple[Finding, ...]:
    """Return the finding of sightings where the camera sees a sun that was below the horizon; none of false ones."""
    pixels, directions = usable.filtering.below
    off_deg = np.degrees(angular_distance(unproject(calibration.camera, pixels), directions))
    n, n_all = int(np.sum(off_deg < _SEEN_BELOW_DEG)), len(usable) + len(pixels)
    if n < _FEWEST_BELOW:
        return ()
    return (Finding("camera_sees_sun_below_horizon", {"n": n, "n_all": n_all}),)


def _positions(usable: Sightings) -> str:
    """Return where sightings stand still: counts and pixels."""
    named = [f"{one.n} at x {one.x:.0f}, y {one.y:.0f}" for one in usable.filtering.static[:_POSITIONS_NAMED]]
    further = len(usable.filtering.static) - len(named)
    return "; ".join([*named, *([f"and {further} more positions"] if further else [])])


def fit_verdict(
    calibration: Calibration,
    usable: Sightings,
    options: CalibrationOptions,
    *,
    others: Sequence[Finding] = (),
    tilt_known: bool = False,
) -> Verdict:
    """Return whether a fit may be used, judged by itself.

    Parameters
    ----------
    calibration : the fit.
    usable : its sightings.
    options : the limits.
    others : findings about other cameras that refuse it.
    tilt_known : whether the camera was accepted before at this site by this clock: its tilt is not asked about.
    """
    question = tilt_question(calibration.camera, calibration.site)
    against = [*others, *_against(calibration, usable, options, question=question, tilt_known=tilt_known)]
    if against:
        within = partial(_within_image, camera=calibration.camera)
        return Verdict(accepted=False, findings=tuple(map(within, against)))
    metrics, days = calibration.metrics, len(calibration.evidence.days)
    found = [
        Finding("fit_rmse", {"n": metrics.n, "days": days, "rmse_px": metrics.rmse_px}),
        Finding("direction_sigma", {"sigma_deg": calibration.sky_rms_deg}),
        *usable.filtering.dropped,
    ]
    if calibration.evidence.held_out.get("widening", 1.0) > 1.0:
        found.append(Finding("sigma_of_parts", {"factor": calibration.evidence.held_out["widening"]}))
    if usable.filtering.static:
        found.append(Finding("static_positions", {"places": _positions(usable)}))
    if calibration.evidence.options.get("free") == "pose":
        found.append(Finding("provisional"))
    if options.mirrored == "auto":
        found.append(Finding("mirrored" if calibration.camera.mirrored else "not_mirrored"))
    found += [*_off_center(calibration), *_proven_effects(calibration), *_on_grid(usable)]
    if question is not None:
        found.insert(0, _tilt_shown(calibration) or question)
    if not tilt_known:
        found += site_assumed(calibration)
    return Verdict(accepted=True, findings=tuple(found))


_DISTANCES = frozenset({"rmse_px", "stated_px", "off_px", "scatter_px"})


def _within_image(finding: Finding, *, camera: Camera) -> Finding:
    """Return a finding whose distances are at most the image's diagonal: nothing in an image is farther off."""
    most = math.hypot(camera.width, camera.height)
    data = {name: min(float(value), most) if name in _DISTANCES else value for name, value in finding.data.items()}
    return replace(finding, data=data)


def _against(
    calibration: Calibration,
    usable: Sightings,
    options: CalibrationOptions,
    *,
    question: Finding | None,
    tilt_known: bool,
) -> list[Finding]:
    """Return what refuses a fit; a tilt that is asked about with what else may be behind it."""
    below = below_horizon(usable, options) or _seen_below_horizon(calibration, usable)
    unsteady = unsteady_clock(calibration, usable)
    against = [
        *below,
        *([] if unsteady is None else [unsteady]),
        *_against_scatter(calibration, usable, options),
        *_against_camera(calibration, options),
    ]
    against += _against_ring(calibration, usable)
    beyond = any(one.code == "tilt_too_large" for one in against) and _tilt_shown(calibration) is None
    if (below or beyond) and question is not None:
        return [question, *against]  # the mistake would bring the sun above the horizon, or the tilt within its limit
    doubt = None if tilt_known else tilt_in_doubt(calibration)
    if doubt is None or question is None:
        return against
    # a tilt that the sightings hardly determine explains no other refusal
    sure = float(doubt.data["tilt_deg"]) > _SURELY_TILTED * float(doubt.data["pose_deg"])
    asked = not against or (sure and {one.code for one in against} <= _UNDETERMINED)
    return [question, doubt, *against] if asked else against


def _proven_effects(calibration: Calibration) -> Iterator[Finding]:
    """Yield the shared errors that the sightings prove."""
    log_odds, (fx, fy) = calibration.evidence.log_odds, calibration.camera.focal_length_px
    proven = {name: odds for name, odds in log_odds.items() if proves(name, odds)}
    if "pixels" in proven:
        yield Finding("pixels_not_square", {"log_odds": proven["pixels"], "aspect": fx / fy})
    if "daily_clock" in proven:
        yield Finding("clock_drifts", {"log_odds": proven["daily_clock"]})
    if "outwards" in proven:
        yield Finding("detections_biased", {"log_odds": proven["outwards"]})
    if "season_share" in log_odds:
        odds = max(value for name, value in proven.items() if name.startswith("season"))
        yield Finding("focal_length_changes", {"log_odds": odds, "share": log_odds["season_share"]})
    spread = calibration.evidence.pose_spread_deg
    if "sways" in proven and spread is not None:
        of_days = dict(zip(("east_deg", "north_deg", "up_deg"), spread, strict=True))
        yield Finding("mount_sways", {"log_odds": proven["sways"], **of_days})


def _on_grid(usable: Sightings) -> Iterator[Finding]:
    """Yield that the sun's pixels are on a grid."""
    step_px = float(np.max(grid_steps_px(usable.pixels[usable.kind == Kind.SUN])))
    if step_px > 0.0:
        yield Finding("pixels_on_grid", {"step_px": step_px})


def _off_center(calibration: Calibration) -> Iterator[Finding]:
    """Yield that the image size is doubtful, where the lens surely lies far off the middle of the image."""
    camera, names = calibration.camera, calibration.parameter_names
    offset = np.subtract(camera.principal_point_px, [(camera.width - 1) / 2.0, (camera.height - 1) / 2.0])
    places = [names.index(name) for name in ("principal_point_x_px", "principal_point_y_px") if name in names]
    sigma = math.sqrt(float(np.sum(np.diag(calibration.covariance)[places])))
    off, side = float(np.linalg.norm(offset)), min(camera.width, camera.height)
    if places and off - 2.0 * sigma > _OFF_CENTER * side:
        yield Finding("image_size_doubtful", {"off_px": off, "share": off / side})


def _against_scatter(calibration: Calibration, usable: Sightings, options: CalibrationOptions) -> Iterator[Finding]:
    rmse = calibration.metrics.rmse_px
    # the largest that is no fault: that of the options, or 2-D distances by what the sightings state of themselves
    stated = _OVER_STATED * math.sqrt(2.0) * usable.filtering.stated_sigma_px
    limit = max(options.max_rmse_px, stated) if math.isfinite(stated) else options.max_rmse_px
    if not rmse <= limit:
        yield Finding("rmse_too_large", {"rmse_px": rmse, "limit_px": limit})
    rejected = 1.0 - calibration.evidence.n_used / max(len(usable), 1)
    if rejected > options.max_rejected:
        yield Finding("too_many_rejected", {"share": rejected, "limit": options.max_rejected})
    held_out = calibration.evidence.held_out
    most = _MOST_EXCESS if np.all(usable.kind == Kind.SUN) else _MOST_EXCESS_BESIDE_STARS
    if held_out and not held_out["excess"] <= most:
        yield Finding("held_out_contradicts", {**held_out, "limit": most})
        if held_out["turned"] > _TURNED:
            of_turn = {"turn_deg": held_out["turn_deg"], "chi_square": held_out["turned"], "limit": _TURNED}
            yield Finding("camera_turned", of_turn)
    if options.max_unexplained < 1.0:
        yield from unexplained_days(calibration, usable, options.max_unexplained)
    yield from too_uncertain(calibration, usable, options)


def too_uncertain(calibration: Calibration, usable: Sightings, options: CalibrationOptions) -> Iterator[Finding]:
    """Yield that the uncertainty over the sky is too large, with what the sightings determine."""
    sigma = calibration.sky_rms_deg
    known = calibration.evidence.options.get("free", "all") != "all"
    largest_deg = max(options.max_sky_deg, _KNOWN_LENS_SKY_DEG if known else 0.0)
    seen = {"n": calibration.metrics.n, "days": len(calibration.evidence.days)}
    if not math.isfinite(sigma):
        yield Finding("direction_sigma_unknown", seen)
    elif sigma > largest_deg:
        scatter = {"scatter_px": calibration.evidence.sigma_px}
        limits = {"sigma_deg": sigma, "limit_deg": largest_deg}
        yield Finding("direction_sigma_too_large", {**limits, **seen, **scatter})
    if not sigma <= largest_deg:
        yield from determined(calibration, usable)


def determined(calibration: Calibration, usable: Sightings) -> Iterator[Finding]:
    """Yield how far the sightings determine a camera that is too uncertain, and which hours and days are missing."""
    if len(usable) == 0:
        return
    latest = usable.directions[usable.epoch == np.max(usable.epoch)]
    along = sigma_deg(calibration, latest)
    seen = along[np.isfinite(along)]
    arc = math.sqrt(float(np.mean(seen**2))) if seen.size else math.nan
    pose_deg = _pose_sigma_deg(calibration)
    if math.isfinite(arc) and math.isfinite(pose_deg):
        yield Finding("sightings_determine", {"arc_deg": arc, "pose_deg": pose_deg})
    yield from missing_hours(usable, calibration.site)
    if calibration.evidence.options.get("free", "all") == "all":
        yield from _alike_days(usable, calibration.site)


def _pose_sigma_deg(calibration: Calibration) -> float:
    """Return the 1-sigma of the pose about the least certain axis, 180 at most; NaN where it is not known."""
    places = [calibration.parameter_names.index(name) for name in PARAMETER_NAMES[POSE]]
    turn = right_jacobian(calibration.camera.rotation_cam_enu)
    spread = turn @ calibration.covariance[np.ix_(places, places)] @ turn.T
    if not np.all(np.isfinite(spread)):
        return math.nan
    return min(math.degrees(math.sqrt(max(float(np.max(np.linalg.eigvalsh(spread))), 0.0))), 180.0)


def site_assumed(calibration: Calibration) -> tuple[Finding, ...]:
    """Return that a first fit takes the site for right, which no sighting shows; nothing of a pose of a known lens."""
    if calibration.evidence.options.get("free") == "pose":
        return ()
    site, tilt_deg = calibration.site, calibration.pose.theta_zz_deg
    return (Finding("site_assumed", {"tilt_deg": tilt_deg, "latitude": site.latitude, "longitude": site.longitude}),)


def unstated_tilt_deg(calibration: Calibration) -> float | None:
    """Return the tilt of a fit that is asked about; None where it is as good as level, or its limit is stated."""
    if calibration.evidence.options.get("level_within_deg") is not None:
        return None
    question = tilt_question(calibration.camera, calibration.site)
    return None if question is None else float(question.data["tilt_deg"])


def tilt_in_doubt(calibration: Calibration) -> Finding | None:
    """Return that a camera may be level at another place, by a tilt that is not stated; None where it is not.

    A pose of a known lens is not asked about, nor a tilt that refraction and horizon show.
    """
    tilt_deg = unstated_tilt_deg(calibration)
    if tilt_deg is None or calibration.evidence.options.get("free") == "pose" or _tilt_shown(calibration) is not None:
        return None
    limit_deg = proposed_limit_deg(tilt_deg)
    return Finding(
        "tilt_in_doubt",
        {"tilt_deg": tilt_deg, "pose_deg": _pose_sigma_deg(calibration), "level_within_deg": limit_deg},
    )


def is_tilt_shown(calibration: Calibration) -> bool:
    """Return whether refraction and horizon show that a camera is tilted."""
    return _tilt_shown(calibration) is not None


def _tilt_shown(calibration: Calibration) -> Finding | None:
    """Return that the sightings fit a level camera at another place worse; None where they do not show it."""
    log_odds = calibration.evidence.log_odds.get(TILT, 0.0)
    if log_odds < TILT_SHOWN:
        return None
    tilt_deg = calibration.pose.theta_zz_deg
    return Finding(
        "camera_tilted_shown", {"tilt_deg": tilt_deg, "log10_odds": min(log_odds / math.log(10.0), _MOST_ODDS)}
    )


def is_undetermined(verdict: Verdict) -> bool:
    """Return whether a fit is refused for what its sightings do not determine, and for nothing else."""
    refused = not verdict.accepted and not verdict.marginal
    return refused and {one.code for one in verdict.findings} <= _UNDETERMINED


def provisional(calibration: Calibration, *, limit_deg: float) -> Calibration:
    """Return a refused fit as provisional where it is refused for what its sightings do not determine, and that alone.

    It is then marginal, and answers for directions whose 1-sigma per axis is within a limit. All others are returned
    as they are; a tilt that nobody stated is refused, too: few sightings that contradict each other fit such a camera.
    """
    verdict = calibration.verdict
    if not is_undetermined(verdict):
        return calibration
    tilt_deg = unstated_tilt_deg(calibration)
    if tilt_deg is not None:
        return refused_for(calibration, Finding("provisional_tilted", {"tilt_deg": tilt_deg}))
    seen = seen_sky(calibration.camera)
    share = float(np.mean(sigma_deg(calibration, seen) <= limit_deg)) if len(seen) else 0.0
    if share < _LEAST_SHARE:
        return calibration
    found = Finding("provisional_where_sure", {"limit_deg": limit_deg, "share": share})
    kept = Verdict(accepted=False, marginal=True, findings=(found, *verdict.findings))
    return replace(calibration, verdict=kept, sigma_limit_deg=limit_deg)


def _alike_days(usable: Sightings, site: Site) -> Iterator[Finding]:
    """Yield that the sun runs over one band of the sky on all days of the sightings; nothing of other bodies."""
    of_sun = usable.kind == Kind.SUN
    if not np.any(of_sun):
        return
    _, north, up = usable.directions[of_sun].T
    latitude = math.radians(site.latitude)
    # the refraction lifts a low sun by half a degree
    declination = np.degrees(np.arcsin(np.clip(up * math.sin(latitude) + north * math.cos(latitude), -1.0, 1.0)))
    days = np.unique(usable.day[of_sun])
    daily = [float(np.median(declination[usable.day[of_sun] == day])) for day in days]
    if max(daily) - min(daily) < _ALIKE_DEG:
        data = {"days": days.size, "least_deg": min(daily), "most_deg": max(daily), "limit_deg": _ALIKE_DEG}
        yield Finding("declinations_alike", data)


def missing_hours(usable: Sightings, site: Site) -> Iterator[Finding]:
    """Yield the hours of sun without a sighting, of the day with most sightings; nothing where few are missing."""
    days, counts = np.unique(usable.day, return_counts=True)
    if days.size == 0:
        return
    day = date_of_day(int(days[np.argmax(counts)]))
    first, last = day_bounds_unix_s(day, longitude=site.longitude)
    hours = np.arange(math.ceil(first / _HOUR_S), math.ceil(last / _HOUR_S))
    up = hours[sun_angles((hours + 0.5) * _HOUR_S, site).apparent_zenith < _LOW_SUN_DEG]
    missing = np.setdiff1d(up, np.floor(usable.unix_s / _HOUR_S))
    if missing.size <= _FEW_HOURS * up.size:
        return
    runs = np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1)
    text = ", ".join(f"{int(run[0]) % 24:02d}:00 to {(int(run[-1]) + 1) % 24:02d}:00" for run in runs)
    covered = float(up.size - missing.size)
    yield Finding("hours_missing", {"date": str(day), "covered_h": covered, "up_h": float(up.size), "missing": text})


def _against_ring(calibration: Calibration, usable: Sightings) -> Iterator[Finding]:
    """Yield that the sightings show the lens at one radius alone, as those of a camera at a pole or pointed at it."""
    if len(usable) == 0 or calibration.evidence.options.get("free", "all") != "all":
        return
    poses = np.array([rotation_matrix(pose) for pose in calibration.poses])
    x, y, z = np.einsum("nij,nj->in", poses[np.minimum(usable.epoch, len(poses) - 1)], usable.directions)
    lowest, highest = np.quantile(np.degrees(np.arctan2(np.hypot(x, y), z)), (0.05, 0.95)).tolist()
    azimuth = np.sort(np.degrees(np.arctan2(y, x)))
    around = 360.0 - float(np.max(np.diff(azimuth, append=azimuth[0] + 360.0)))
    if highest - lowest < _NARROW_DEG and around > _RING_DEG:
        data = {"lowest_deg": lowest, "highest_deg": highest, "least_deg": _NARROW_DEG}
        yield Finding("sightings_of_one_radius", data)


def _against_camera(calibration: Calibration, options: CalibrationOptions) -> Iterator[Finding]:
    camera, tilt = calibration.camera, calibration.pose.theta_zz_deg
    if options.level_within_deg is not None and tilt > options.level_within_deg:
        limits = {"limit_deg": options.level_within_deg, "level_within_deg": proposed_limit_deg(tilt)}
        yield Finding("tilt_too_large", {"tilt_deg": tilt, **limits})
    x, y = camera.principal_point_px
    if not (0.0 <= x <= camera.width and 0.0 <= y <= camera.height):
        yield Finding("principal_point_outside", {"x_px": x, "y_px": y})
    angle = math.degrees(camera.max_angle)
    if angle < _LEAST_ANGLE_DEG:
        yield Finding("radius_not_rising", {"angle_deg": angle, "least_deg": _LEAST_ANGLE_DEG})
