"""Measures of sightings and of their fit, which `verdict` compares with its limits.

A measure returns the numbers of a finding; None where it does not apply.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sunarc.calibration.answers.covariance import sigma_deg
from sunarc.calibration.model.options import USUAL_OPTIONS, CalibrationOptions
from sunarc.calibration.model.result import Calibration, probability, proves
from sunarc.calibration.model.sightings import Kind, Sightings, grid_steps_px
from sunarc.calibration.quality.day_arcs import Unexplained, arc_length_deg, unexplained_days
from sunarc.calibration.quality.tilt import proposed_limit_deg, tilt_question
from sunarc.common.findings import Data, Finding
from sunarc.optics.camera import PARAMETER_NAMES, POSE
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import right_jacobian, rotation_matrix
from sunarc.sky.days import day_bounds_unix_s, day_to_date
from sunarc.sky.directions import angular_distance
from sunarc.sky.sun import sun_angles

FEWEST_BELOW = 4
"""Sightings of a sun below the horizon that show a wrong site or clock; fewer may be false ones at dusk."""
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
UNDETERMINED = frozenset(
    {
        *("direction_sigma_too_large", "projection_ambiguous", "projection_chosen"),
        *("sightings_determine", "hours_missing", "declinations_alike"),
    }
)
"""Codes of refusals that contradict nothing."""
_OF_A_TILT = {"sightings_below_horizon", "camera_sees_sun_below_horizon", "tilt_too_large"}
"""Codes of refusals that the mistake behind a tilt explains."""
_SURELY_TILTED = 5.0
"""Stated sigmas of the pose: 23 suns of a morning tilted cameras that are level to 3 degrees by up to 4.0 of them."""
TILT = "tilt"
"""Name of the tilt among the log odds of a fit."""
_MOST_ODDS = 1e4
"""Powers of ten above which odds are not given any more."""
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
_MOST_EXCESS = 0.9
"""Errors of predicted parts over what chance allows, see `Doubts`. Right fits of real-like tracks reach 0.88, those of
clear days 0.79; days on which a camera moved, or of a radius with a corner, mostly 0.94 to 2.8."""
_MOST_EXCESS_BESIDE_STARS = 1.1
"""The same where stars hold the camera, and the rest of the errors shows."""


_NO_SIGHTINGS = Sightings.of(unix_s=(), pixels=())


@dataclass(frozen=True, kw_only=True, eq=False)
class Given:
    """Usable sightings, and the options whose limits apply to them."""

    usable: Sightings = _NO_SIGHTINGS
    options: CalibrationOptions = USUAL_OPTIONS


@dataclass(frozen=True, kw_only=True, eq=False)
class JudgedFit(Given):
    """Fit that is to be judged, with its usable sightings."""

    calibration: Calibration
    tilt_known: bool = False
    """Former acceptance of the camera at this site by this clock: its tilt is not asked about."""
    against: tuple[Finding, ...] = ()
    """Findings by which it is refused already."""

    @cached_property
    def question(self) -> Finding | None:
        """The mistake that may be behind a tilt; None of a camera that is level."""
        return tilt_question(self.calibration.camera, self.calibration.site)

    @cached_property
    def unexplained(self) -> Unexplained | None:
        """The days that the fit does not explain; None where that is not asked."""
        return None if self.options.max_unexplained >= 1.0 else unexplained_days(self.calibration, self.usable)

    @property
    def free(self) -> str:
        """The unknowns of the fit: "all" of the camera, or those of a known lens."""
        return str(self.calibration.evidence.options.get("free", "all"))

    @property
    def tried_mirrored(self) -> bool | None:
        """The handedness that was found by trying both; None where one was stated."""
        return self.calibration.camera.mirrored if self.options.mirrored == "auto" else None

    def log_odds(self, error: str) -> float:
        """Return the log odds of an error that sightings share."""
        return self.calibration.evidence.log_odds.get(error, -math.inf)


# Sightings


def not_moving(given: Given) -> Data | None:
    """Return the count and the positions of sightings that do not move; None where all move."""
    n_static = sum(position.n for position in given.usable.filtering.static)
    if not n_static:
        return None
    return {"n": n_static, "n_all": int(np.sum(given.usable.count)) + n_static, "places": positions(given.usable)}


def count(given: Given) -> Data:
    """Return the number of usable sightings."""
    return {"n": len(given.usable)}


def arc(given: Given) -> Data:
    """Return the total length of the days' arcs."""
    usable = given.usable
    return {"arc_deg": sum(arc_length_deg(usable.directions[usable.day == day]) for day in np.unique(usable.day))}


def extent(given: Given) -> Data:
    """Return the extent of the sightings over the image, px."""
    return {"spread_px": float(np.linalg.norm(np.ptp(given.usable.pixels, axis=0)))}


def below_horizon(given: Given) -> Data | None:
    """Return how many sightings are of times with the sun below the horizon; None of so few that they may be false."""
    usable, below = given.usable, given.usable.filtering.n_below_horizon
    n_all = below + int(np.sum(usable.count[~usable.alone])) + sum(position.n for position in usable.filtering.static)
    return None if below < FEWEST_BELOW else {"n": below, "n_all": n_all, "share": below / n_all}


def positions(usable: Sightings) -> str:
    """Return the positions of static sightings as text: counts and pixels."""
    named = [f"{one.n} at x {one.x:.0f}, y {one.y:.0f}" for one in usable.filtering.static[:_POSITIONS_NAMED]]
    further = len(usable.filtering.static) - len(named)
    return "; ".join([*named, *([f"and {further} more positions"] if further else [])])


# Fit against its sightings


def seen_below_horizon(judged: JudgedFit) -> Data | None:
    """Return how many sightings are where the camera sees a sun that was below the horizon; None of too many below."""
    found = below_horizon(judged)
    if found is not None and float(found["n"]) > judged.options.max_below_horizon * float(found["n_all"]):
        return None
    pixels, directions = judged.usable.filtering.below
    off_deg = np.degrees(angular_distance(unproject(judged.calibration.camera, pixels), directions))
    return {"n": int(np.sum(off_deg < _SEEN_BELOW_DEG)), "n_all": int(np.sum(judged.usable.count)) + len(pixels)}


def scatter(judged: JudgedFit) -> Data:
    """Return the RMSE of the used sightings."""
    return {"rmse_px": judged.calibration.metrics.rmse_px}


def largest_rmse_px(judged: JudgedFit) -> float:
    """Return `max_rmse_px`, or 1.5 times the 2-D distance that the sightings state of themselves, if larger."""
    stated, limit = _OVER_STATED * math.sqrt(2.0) * judged.usable.filtering.stated_sigma_px, judged.options.max_rmse_px
    return max(limit, stated) if math.isfinite(stated) else limit


def rejected(judged: JudgedFit) -> Data:
    """Return the share of sightings that the fit rejected."""
    return {"share": 1.0 - judged.calibration.evidence.n_used / max(len(judged.usable), 1)}


def held_out(judged: JudgedFit) -> Data | None:
    """Return the errors on parts of the sightings left out of the fit; None where no part was left out."""
    return judged.calibration.evidence.held_out or None


def largest_excess(judged: JudgedFit) -> float:
    """Return 0.9; 1.1 with other bodies than the sun."""
    return _MOST_EXCESS if np.all(judged.usable.kind == Kind.SUN) else _MOST_EXCESS_BESIDE_STARS


def measure_part_turn(judged: JudgedFit) -> Data | None:
    """Return by how much the camera of one part is turned, where parts contradict the fit."""
    found = judged.calibration.evidence.held_out
    if not found or found["excess"] <= largest_excess(judged):
        return None
    return {"turn_deg": found["turn_deg"], "chi_square": found["turned"]}


def measure_left_out_share(judged: JudgedFit) -> Data | None:
    """Return the share of the sightings of clear days that does not count."""
    return judged.unexplained and judged.unexplained.left_out


def far_half_days(judged: JudgedFit) -> Data | None:
    """Return how many half-days lie far off the fit."""
    return judged.unexplained and judged.unexplained.far


# Uncertainty over the sky


def unknown_sigma(judged: JudgedFit) -> Data | None:
    """Return the sightings of a fit whose uncertainty cannot be computed."""
    if math.isfinite(judged.calibration.sky_rms_deg):
        return None
    return {"n": judged.calibration.metrics.n, "days": len(judged.calibration.evidence.days)}


def sky_sigma(judged: JudgedFit) -> Data | None:
    """Return the uncertainty over the sky."""
    sigma, evidence = judged.calibration.sky_rms_deg, judged.calibration.evidence
    if not math.isfinite(sigma):
        return None
    n, days = judged.calibration.metrics.n, len(evidence.days)
    return {"sigma_deg": sigma, "n": n, "days": days, "scatter_px": evidence.sigma_px}


def largest_sky_deg(judged: JudgedFit) -> float:
    """Return `max_sky_deg`; 2 of a known lens, if larger."""
    return max(judged.options.max_sky_deg, _KNOWN_LENS_SKY_DEG if judged.free != "all" else 0.0)


def _is_sky_sigma_too_large(judged: JudgedFit) -> bool:
    return len(judged.usable) > 0 and not judged.calibration.sky_rms_deg <= largest_sky_deg(judged)


def determined(judged: JudgedFit) -> Data | None:
    """Return how well the sightings determine a camera that is too uncertain."""
    if not _is_sky_sigma_too_large(judged):
        return None
    usable = judged.usable
    along = sigma_deg(judged.calibration, usable.directions[usable.epoch == np.max(usable.epoch)])
    seen = along[np.isfinite(along)]
    arc_deg = math.sqrt(float(np.mean(seen**2))) if seen.size else math.nan
    pose_deg = pose_sigma_deg(judged.calibration)
    return {"arc_deg": arc_deg, "pose_deg": pose_deg} if math.isfinite(arc_deg) and math.isfinite(pose_deg) else None


def pose_sigma_deg(calibration: Calibration) -> float:
    """Return the 1-sigma of the pose about the least certain axis, 180 at most; NaN where it is not known."""
    places = [calibration.parameter_names.index(name) for name in PARAMETER_NAMES[POSE]]
    turn = right_jacobian(calibration.camera.rotation_cam_enu)
    spread = turn @ calibration.covariance[np.ix_(places, places)] @ turn.T
    if not np.all(np.isfinite(spread)):
        return math.nan
    return min(math.degrees(math.sqrt(max(float(np.max(np.linalg.eigvalsh(spread))), 0.0))), 180.0)


def hours_missing(judged: JudgedFit) -> Data | None:
    """Return the hours of sun without a sighting, of the day with most; None where few are missing."""
    if not _is_sky_sigma_too_large(judged):
        return None
    usable, site = judged.usable, judged.calibration.site
    days, counts = np.unique(usable.day, return_counts=True)
    day = day_to_date(int(days[np.argmax(counts)]))
    first, last = day_bounds_unix_s(day, longitude=site.longitude)
    hours = np.arange(math.ceil(first / _HOUR_S), math.ceil(last / _HOUR_S))
    up = hours[sun_angles((hours + 0.5) * _HOUR_S, site).apparent_zenith < _LOW_SUN_DEG]
    missing = np.setdiff1d(up, np.floor(usable.unix_s / _HOUR_S))
    if missing.size <= _FEW_HOURS * up.size:
        return None
    runs = np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1)
    text = ", ".join(f"{int(run[0]) % 24:02d}:00 to {(int(run[-1]) + 1) % 24:02d}:00" for run in runs)
    covered = float(up.size - missing.size)
    return {"date": str(day), "covered_h": covered, "up_h": float(up.size), "missing": text}


def declinations_alike(judged: JudgedFit) -> Data | None:
    """Return the declinations, where the sun runs over one band of the sky on all days; None of other bodies."""
    usable, of_sun = judged.usable, judged.usable.kind == Kind.SUN
    if not _is_sky_sigma_too_large(judged) or judged.free != "all" or not np.any(of_sun):
        return None
    _, north, up = usable.directions[of_sun].T
    latitude = math.radians(judged.calibration.site.latitude)
    # the refraction lifts a low sun by half a degree
    declination = np.degrees(np.arcsin(np.clip(up * math.sin(latitude) + north * math.cos(latitude), -1.0, 1.0)))
    days = np.unique(usable.day[of_sun])
    daily = [float(np.median(declination[usable.day[of_sun] == day])) for day in days]
    if max(daily) - min(daily) >= _ALIKE_DEG:
        return None
    return {"days": days.size, "least_deg": min(daily), "most_deg": max(daily), "limit_deg": _ALIKE_DEG}


# Camera


def tilt(judged: JudgedFit) -> Data | None:
    """Return the tilt, where its limit is stated."""
    tilt_deg = judged.calibration.pose.theta_zz_deg
    if judged.options.level_within_deg is None:
        return None
    return {"tilt_deg": tilt_deg, "level_within_deg": proposed_limit_deg(tilt_deg)}


def outside(judged: JudgedFit) -> Data | None:
    """Return the principal point where it is outside the image."""
    camera, (x, y) = judged.calibration.camera, judged.calibration.camera.principal_point_px
    return None if 0.0 <= x <= camera.width and 0.0 <= y <= camera.height else {"x_px": x, "y_px": y}


def rising_to(judged: JudgedFit) -> Data:
    """Return the angle off the axis up to which the image radius rises."""
    return {"angle_deg": math.degrees(judged.calibration.camera.max_angle)}


def one_radius(judged: JudgedFit) -> Data | None:
    """Return the range of angles off the axis where it is too narrow to determine the lens."""
    usable = judged.usable
    if len(usable) == 0 or judged.free != "all":
        return None
    poses = np.array([rotation_matrix(pose) for pose in judged.calibration.poses])
    x, y, z = np.einsum("nij,nj->in", poses[np.minimum(usable.epoch, len(poses) - 1)], usable.directions)
    lowest, highest = np.quantile(np.degrees(np.arctan2(np.hypot(x, y), z)), (0.05, 0.95)).tolist()
    azimuth = np.sort(np.degrees(np.arctan2(y, x)))
    around = 360.0 - float(np.max(np.diff(azimuth, append=azimuth[0] + 360.0)))
    if highest - lowest >= _NARROW_DEG or around <= _RING_DEG:
        return None
    return {"lowest_deg": lowest, "highest_deg": highest, "least_deg": _NARROW_DEG}


# Tilt that nobody stated


def unstated_tilt_deg(calibration: Calibration) -> float | None:
    """Return the tilt of a fit that is asked about; None where it is as good as level, or its limit is stated."""
    if calibration.evidence.options.get("level_within_deg") is not None:
        return None
    question = tilt_question(calibration.camera, calibration.site)
    return None if question is None else float(question.data["tilt_deg"])


def tilt_in_doubt(judged: JudgedFit) -> Data | None:
    """Return the tilt of a camera that may be level at another place, which is not stated; None where it is known.

    A pose of a known lens is not asked about, nor a tilt that refraction and horizon show.
    """
    tilt_deg = unstated_tilt_deg(judged.calibration)
    if tilt_deg is None or judged.tilt_known or judged.free == "pose" or is_tilt_shown(judged.calibration):
        return None
    pose_deg = pose_sigma_deg(judged.calibration)
    return {"tilt_deg": tilt_deg, "pose_deg": pose_deg, "level_within_deg": proposed_limit_deg(tilt_deg)}


def tilt_to_refuse(judged: JudgedFit) -> Data | None:
    """Return the tilt in doubt where the fit is refused for no other reason but a lack of information."""
    doubt, codes = tilt_in_doubt(judged), {one.code for one in judged.against}
    if doubt is None or not codes <= UNDETERMINED:
        return None
    # a tilt that the sightings hardly determine explains no other refusal
    sure = float(doubt["tilt_deg"]) > _SURELY_TILTED * float(doubt["pose_deg"])
    return doubt if sure or not codes else None


def question_asked(judged: JudgedFit) -> Finding | None:
    """Return the likely mistake behind a tilt or another refusal, as a finding."""
    of_a_tilt = {one.code for one in judged.against} & _OF_A_TILT
    if is_tilt_shown(judged.calibration):
        of_a_tilt -= {"tilt_too_large"}
    return judged.question if of_a_tilt or tilt_to_refuse(judged) is not None else None


def question_left(judged: JudgedFit) -> Finding | None:
    """Return the likely mistake behind the tilt of an accepted fit; None for a tilt that is shown."""
    return None if is_tilt_shown(judged.calibration) else judged.question


def is_tilt_shown(calibration: Calibration) -> bool:
    """Return whether refraction and horizon show that a camera is tilted."""
    return calibration.evidence.log_odds.get(TILT, 0.0) >= TILT_SHOWN


def tilt_shown(judged: JudgedFit) -> Data | None:
    """Return the odds of a tilt that refraction and horizon show; None where they do not show one."""
    if judged.question is None or not is_tilt_shown(judged.calibration):
        return None
    log10_odds = min(judged.calibration.evidence.log_odds[TILT] / math.log(10.0), _MOST_ODDS)
    return {"tilt_deg": judged.calibration.pose.theta_zz_deg, "log10_odds": log10_odds}


# Accepted fit


def rmse(judged: JudgedFit) -> Data:
    """Return the RMSE with the counts of sightings and days."""
    metrics = judged.calibration.metrics
    return {"n": metrics.n, "days": len(judged.calibration.evidence.days), "rmse_px": metrics.rmse_px}


def measure_part_factor(judged: JudgedFit) -> Data:
    """Return by how much parts of the sightings make the stated errors larger."""
    return {"factor": judged.calibration.evidence.held_out.get("widening", 1.0)}


def static_positions(judged: JudgedFit) -> Data | None:
    """Return where sightings that were left out stand still."""
    return {"places": positions(judged.usable)} if judged.usable.filtering.static else None


def off_center(judged: JudgedFit) -> Data | None:
    """Return the offset of the principal point from the image centre where it is certain; else None."""
    camera, names = judged.calibration.camera, judged.calibration.parameter_names
    offset = np.subtract(camera.principal_point_px, [(camera.width - 1) / 2.0, (camera.height - 1) / 2.0])
    places = [names.index(name) for name in ("principal_point_x_px", "principal_point_y_px") if name in names]
    sigma = math.sqrt(float(np.sum(np.diag(judged.calibration.covariance)[places])))
    off, side = float(np.linalg.norm(offset)), min(camera.width, camera.height)
    return {"off_px": off, "share": off / side} if places and off - 2.0 * sigma > _OFF_CENTER * side else None


def aspect(judged: JudgedFit) -> Data:
    """Return the ratio of pixel width to height, with the log odds."""
    fx, fy = judged.calibration.camera.focal_length_px
    return {"log_odds": judged.log_odds("pixels"), "aspect": fx / fy}


def possible_stretch(judged: JudgedFit) -> Data | None:
    """Return how probable pixels are that are not square, where the sightings do not prove them."""
    odds = judged.log_odds("pixels")
    against = judged.options.tolerances.square_odds
    return None if proves("pixels", odds) else {"probability": probability(odds, odds_against=against)}


def measure_clock_drift(judged: JudgedFit) -> Data:
    """Return the log odds of a clock error that differs from day to day."""
    return {"log_odds": judged.log_odds("daily_clock")}


def bias_outwards(judged: JudgedFit) -> Data:
    """Return the log odds of detections biased along the radius."""
    return {"log_odds": judged.log_odds("outwards")}


def measure_focal_change(judged: JudgedFit) -> Data | None:
    """Return the share of itself by which the focal length changes within the record, where that is proven."""
    log_odds = judged.calibration.evidence.log_odds
    if "season_share" not in log_odds:
        return None
    odds = max(value for name, value in log_odds.items() if name.startswith("season") and proves(name, value))
    return {"log_odds": odds, "share": log_odds["season_share"]}


def picture(judged: JudgedFit) -> Data | None:
    """Return scale and shift of earlier days' pictures against the last day's, where they are proven."""
    log_odds = judged.calibration.evidence.log_odds
    if "picture_scale" not in log_odds:
        return None
    of_change = {name: log_odds[f"picture_{name}"] for name in ("scale", "shift_px")}
    since = day_to_date(int(log_odds["picture_day"])).isoformat()
    return {"log_odds": log_odds["picture"], **of_change, "since": since}


def picture_behind(judged: JudgedFit) -> Data | None:
    """Return the change of the picture where the fit is refused."""
    return picture(judged) if judged.against else None


def turn_by_hour(judged: JudgedFit) -> Data | None:
    """Return how the mount turns by the hour of the day, where that is proven."""
    spread, odds = judged.calibration.evidence.pose_spread_deg, judged.log_odds("turning")
    if spread is None:
        return None
    return {"log_odds": odds, **dict(zip(("east_deg", "north_deg", "up_deg"), spread, strict=True))}


def possible_turn(judged: JudgedFit) -> Data | None:
    """Return the log odds of a mount that turns by the hour of the day, where they do not prove it."""
    odds = judged.log_odds("turning")
    return None if proves("turning", odds) else {"log_odds": odds}


def grid(judged: JudgedFit) -> Data:
    """Return the step of the grid on which the sun's pixels lie; 0 where there is no grid."""
    return {"step_px": float(np.max(grid_steps_px(judged.usable.pixels[judged.usable.kind == Kind.SUN])))}


def sway(judged: JudgedFit) -> Data | None:
    """Return the daily rotations of the mount (1-sigma), with the log odds."""
    spread = judged.calibration.evidence.pose_spread_deg
    if spread is None:
        return None
    east, north, up = spread
    return {"log_odds": judged.log_odds("sways"), "east_deg": east, "north_deg": north, "up_deg": up}


def assumed_site(judged: JudgedFit) -> Data | None:
    """Return the site of a first fit, which no sighting shows; None of a pose of a known lens."""
    if judged.tilt_known or judged.free == "pose":
        return None
    site, tilt_deg = judged.calibration.site, judged.calibration.pose.theta_zz_deg
    return {"tilt_deg": tilt_deg, "latitude": site.latitude, "longitude": site.longitude}
