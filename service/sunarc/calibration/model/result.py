"""A calibration: a camera, its uncertainty, its residuals, and its verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sunarc.calibration.model.options import Method
from sunarc.calibration.model.pose_change import PoseChange, SteadyTurn
from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.findings import Finding
from sunarc.optics.backward import BackwardModel
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import PoseAngles
from sunarc.sky.directions import angular_distance
from sunarc.sky.site import Site

STRONG_EVIDENCE = math.log(20.0)
"""Log odds from which on sightings prove something: 20 to 1, the usual "strong" evidence."""
_SUSPICION, _PROOF = math.log(100.0), 10.0
"""Log odds of an error that sightings share and that is there in one camera of a hundred: as probable as not, and
proven. A residual radius outside a lens's eight coefficients looks like a bias along it with log odds of 4, and
on one day a decentering of 5 px like pixels that are not square with 8."""

_CERTAINLY_NOT = 100.0
"""Log odds against an error beyond which its probability is zero to all digits."""


_PROOF_OF = {"air": STRONG_EVIDENCE, "sways": 40.0}
"""Other air is usual. An error common to hours is another turn on every day: up to 32 where no mount sways."""
_SUSPICION_OF = {"turning": 1.5, "season": 1.5, "season_of_plastic": 1.5}
"""Masts that the sun warms on one side are usual; noise that is alike for hours reaches 1.3. A lens has a season."""
TURN_ASKED = -2.0
"""Log odds from which on a verdict says that the mount may turn within the day: seven to one against it."""


def suspects(error: str, log_odds: float) -> bool:
    """Return whether log odds are large enough to allow for an error, see `proves`."""
    return log_odds > _SUSPICION_OF.get(error, _SUSPICION)


def probability(log_odds: float, *, odds_against: float) -> float:
    """Return the probability of an error from the log odds, and from the odds against it before any sighting."""
    return 1.0 / (1.0 + math.exp(min(math.log(odds_against) - log_odds, _CERTAINLY_NOT)))


def proof_threshold(error: str) -> float:
    """Return the log odds beyond which an error that sightings share is proven, see `fit.effects`."""
    return _PROOF_OF.get(error, _PROOF)


def proves(error: str, log_odds: float) -> bool:
    """Return whether log odds prove an error that sightings share."""
    return log_odds > proof_threshold(error)


# How well a fit meets the sightings (Eq. 27), and both readings of SD.


@dataclass(frozen=True, slots=True, kw_only=True)
class Metrics:
    """Eq. 27 over a set of sightings; NaN without sightings.

    Attributes
    ----------
    n : sightings used.
    rmse_px, mae_px : root of the mean square, and mean, of the 2-D distance of the sightings used.
    rmse_all_px : the same over all sightings supplied that have a time and a pixel.
    sd_px : Eq. 27c as written: about the mean distance vector.
    sd_of_distance_px : standard deviation of the scalar distance, which the paper's tables contain
        (RMSE² = MAE² + SD²).
    rmse_deg : root of the mean square angle between sighted and true direction.
    held_out_rmse_px : the same as rmse_px on days that were left out in turn; None with fewer than two days.
    held_out_expected_px : what the fits without those days expected it to be.
    """

    n: int
    rmse_px: float
    rmse_all_px: float
    mae_px: float
    sd_px: float
    sd_of_distance_px: float
    rmse_deg: float
    held_out_rmse_px: float | None = None
    held_out_expected_px: float | None = None


NO_METRICS = Metrics(
    n=0,
    rmse_px=math.nan,
    rmse_all_px=math.nan,
    mae_px=math.nan,
    sd_px=math.nan,
    sd_of_distance_px=math.nan,
    rmse_deg=math.nan,
)


def measures(residual: FloatArray) -> tuple[float, float, float, float]:
    """Return RMSE, MAE, SD as written in Eq. 27c, and SD of the distance, of residuals (n, 2) in px."""
    if residual.shape[0] == 0:
        return math.nan, math.nan, math.nan, math.nan
    distance = np.hypot(residual[:, 0], residual[:, 1])
    # Eq. 27c takes the scatter about the mean vector, so a common shift does not count
    about_mean = np.linalg.norm(residual - residual.mean(axis=0), axis=-1)
    return (
        float(np.sqrt(np.mean(distance**2))),
        float(np.mean(distance)),
        float(np.sqrt(np.mean(about_mean**2))),
        float(np.std(distance)),
    )


def fit_metrics(residual: FloatArray, used: BoolArray, angle: FloatArray) -> Metrics:
    """Return the metrics of a fit.

    Parameters
    ----------
    residual : (n, 2) observed minus modelled, px.
    used : (n,) whether a sighting counted.
    angle : (n,) radians between sighted and true direction, NaN where the camera sees nothing.
    """
    rmse, mae, sd, sd_of_distance = measures(residual[used])
    valid_angle = angle[used & np.isfinite(angle)]
    return Metrics(
        n=int(used.sum()),
        rmse_px=rmse,
        rmse_all_px=measures(residual)[0],
        mae_px=mae,
        sd_px=sd,
        sd_of_distance_px=sd_of_distance,
        rmse_deg=math.degrees(float(np.sqrt(np.mean(valid_angle**2)))) if valid_angle.size else math.nan,
    )


def residual_angles(camera: Camera, pixels: FloatArray, directions: FloatArray) -> FloatArray:
    """Return (n,): radians between where pixels look and where the sun was."""
    return angular_distance(unproject(camera, pixels), directions)


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Verdict of a calibration, and its reasons: at least one finding.

    A marginal one is not used, but nothing is wrong with it: it is kept as a candidate that a person may serve.
    """

    accepted: bool
    findings: tuple[Finding, ...]
    marginal: bool = False

    @property
    def reasons(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(finding.text for finding in self.findings)


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Inputs of a fit, so that it can be made again.

    Attributes
    ----------
    days : local mean solar dates, ISO 8601.
    n_supplied, n_used, n_rejected : sightings given, used (with any weight), left out.
    options : the options of the fit, by name; "free" is what was fitted: "all" of the camera, a known lens's "pose", or
        the camera about a stated "prior", whose tolerances are then in "prior".
    sigma_px : noise of a sighting, px per axis, as found.
    inflation : by how much neighbours erring alike inflates a sighting's variance (mean).
    radial_px : scale of the residual radial distortion, as found.
    clock_error_s : the largest stated bound of the clock's error, s; the one that is assumed where none is stated.
    clock_stated : whether it is stated, with the sightings or for all of them.
    clock_beyond_s : 1-sigma of the clock by which the pose was widened beyond what is stated with the sightings.
    circle : the image circle that was given, by name; None without one.
    start : the camera that the fit began at, by name; None where it was sought.
    selection : how the sightings were picked from a longer record: limits and counts; empty where all were given.
    pose_spread_deg : the spread of daily poses that the uncertainty allows for, about east, north and up; None: none.
    turning : steady turn of the camera through the sightings, whose pose is that of its time; None of one that stands.
    moves : moves of the camera that were found among the sightings, in the order of time.
    log_odds : natural log odds of each part of the lens model against its being zero (`skew`, `radial`, `decentering`)
        and of a field, how many `radial_terms` are needed, and of the errors that sightings share, see `fit.effects`;
        `season_share`: by how much of itself the focal length changed within the record; `picture_scale`,
        `picture_shift_px`: of the picture before `picture_day`, counted from 1970; where these are proven. Empty where
        the method does not compare them.
    held_out : doubts by parts of the sightings, by name, see `Doubts`; the covariance is widened by the
        square of its `widening`. Empty where no part was held against the fit.
    """

    days: tuple[str, ...]
    n_supplied: int
    n_used: int
    n_rejected: int
    options: Mapping[str, object]
    sigma_px: float
    inflation: float
    radial_px: float
    clock_error_s: float
    circle: Mapping[str, object] | None = None
    start: Mapping[str, object] | None = None
    selection: Mapping[str, object] = field(default_factory=dict)
    pose_spread_deg: tuple[float, float, float] | None = None
    turning: SteadyTurn | None = None
    moves: tuple[PoseChange, ...] = ()
    log_odds: Mapping[str, float] = field(default_factory=dict)
    held_out: Mapping[str, float] = field(default_factory=dict)
    clock_stated: bool = False
    clock_beyond_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class NightDifference:
    """Difference of the sightings of the night from those of the day, by a fit of both; the calibration is the day's.

    Attributes
    ----------
    n : sightings of the night that were used: stars, planets and the moon.
    pose_difference_deg, pose_sigma_deg : turn of the camera at night against the day, about east, north and up, with
        the 1-sigma of each. The prior's 1-sigma is 0.02 degrees.
    star_offset_px, star_offset_sigma_px : by how much the centres of stars lie outside of where the sun's would, at a
        right angle off the axis, with its 1-sigma. The prior's 1-sigma is 0.26 px.
    """

    n: int
    pose_difference_deg: tuple[float, float, float]
    pose_sigma_deg: tuple[float, float, float]
    star_offset_px: float
    star_offset_sigma_px: float


_NEWTON_STEPS = 100
_SAME = 1e-12
_NOMINAL = 0.95


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorMixture:
    """Spread of the errors about the stated Gaussian: a mixture of c Gaussians, at n places over the image.

    Attributes
    ----------
    shares : (c,) probabilities of the classes, from small errors to large ones; they sum to 1.
    pixels_px : (n, 2) the places.
    scales : (n, c) 1-sigma of each class there, in units of the one that is stated.
    """

    shares: FloatArray
    pixels_px: FloatArray
    scales: FloatArray

    def at(self, pixels: FloatArray) -> FloatArray:
        """Return the classes' scales (k, c) at pixels (k, 2): their mean over all places, by 1 / (1 + distance²)²."""
        square = np.sum((pixels[:, None] - self.pixels_px) ** 2, axis=-1)
        weight = (1.0 + square) ** -2.0
        return np.asarray((weight / weight.sum(axis=1, keepdims=True)) @ self.scales)

    def sigma_factors(self, pixels: FloatArray, share: float) -> FloatArray:
        """Return (k,): the factor of the stated 1-sigma at pixels (k, 2) for a share's ellipse.

        The ellipse of a share q of a Gaussian is that of its 1-sigma, times √(-2 log(1 - q)).
        """
        held = distances_holding(self.shares, self.at(pixels), share)
        return np.asarray(held / math.sqrt(-2.0 * math.log1p(-share)))

    def sigma_factor(self) -> float:
        """Return the factor of all stated 1-sigmas with which 95 % lie in their ellipses over all places."""
        count = self.scales.shape[0]
        held = distances_holding(np.tile(self.shares / count, count), self.scales.reshape(1, -1), _NOMINAL)
        return float(held[0]) / math.sqrt(-2.0 * math.log1p(-_NOMINAL))

    def about(self, factor: float) -> ErrorMixture:
        """Return the same errors relative to a 1-sigma that is larger by a factor."""
        return replace(self, scales=self.scales / factor)

    def beside(self, ratio: FloatArray) -> ErrorMixture:
        """Return the mixture after an added Gaussian error, from the mixture's share (n,) of the total variance."""
        return replace(self, scales=np.sqrt(1.0 + ratio[:, None] * (self.scales**2 - 1.0)))


def distances_holding(shares: FloatArray, scales: FloatArray, share: float) -> FloatArray:
    """Return (n,): the distances within which a share of mixtures of round Gaussians in the plane lies.

    Parameters
    ----------
    shares, scales : of the Gaussians, (c,), and their 1-sigmas, (n, c).
    share : below 1.
    """
    square, rates = np.zeros(scales.shape[0]), 0.5 / np.maximum(scales, _SAME) ** 2
    # Newton's method on the log of what is outside: it is convex and falls, so that the steps never go too far
    for _ in range(_NEWTON_STEPS):
        outside = shares * np.exp(-rates * square[:, None])
        total = outside.sum(axis=1)
        step = total * (np.log(total) - math.log1p(-share)) / np.sum(rates * outside, axis=1)
        square = square + step
        if np.all(step <= _SAME * square):
            break
    return np.asarray(np.sqrt(square))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """A fitted camera with its uncertainty and its evidence.

    Attributes
    ----------
    camera : the camera of the latest pose epoch.
    poses : rotation vectors of all pose epochs, radians.
    parameter_names : what the covariance speaks of, in its order (see `PARAMETER_NAMES`).
    covariance : (p, p), clock and site errors folded into the pose.
    field : what no lens model says: its mean is in `camera.displacement`, what is not known of it in the uncertainty.
    sky_rms_deg, sky_max_deg : 1-sigma per axis over the upper hemisphere that the camera resolves.
    sky_rms_without_clock_deg : the former without the clock's error that is stated for all sightings; None where none
        is.
    pose : the Table 2 angles.
    mixture : how the errors are spread about covariance and field; None: as a Gaussian's.
    left_out : (k,) rows of the sightings supplied that did not count; None where they are not at hand (of a calibration
        that was read).
    night : how the night differs from the day, of which the calibration is; None without sightings of a night.
    sigma_limit_deg : directions of a larger 1-sigma per axis are answered as beyond the camera's field; None: none are.
    aged_days : the uncertainty is that so many days after the last sighting, see `ageing`; negative before it; 0: that
        of the fit.
    """

    camera: Camera
    poses: tuple[tuple[float, float, float], ...]
    parameter_names: tuple[str, ...]
    covariance: FloatArray
    field: Field
    sky_rms_deg: float
    sky_max_deg: float
    metrics: Metrics
    pose: PoseAngles
    backward: BackwardModel
    evidence: Provenance
    verdict: Verdict
    method: Method
    site: Site
    mixture: ErrorMixture | None = None
    left_out: IntArray | None = None
    night: NightDifference | None = None
    sigma_limit_deg: float | None = None
    sky_rms_without_clock_deg: float | None = None
    aged_days: int = 0


def residuals_by_pose(camera: Camera, poses: Sequence[tuple[float, float, float]], usable: Sightings) -> FloatArray:
    """Return (n, 2) px: observed minus predicted by a camera in the pose of each epoch (the last one beyond)."""
    predicted, epoch = np.empty(usable.pixels.shape), np.minimum(usable.epoch, len(poses) - 1)
    for number, pose in enumerate(poses):
        of_pose = epoch == number
        predicted[of_pose] = project_fast(replace(camera, rotation_cam_enu=pose), usable.directions[of_pose])
    return usable.pixels - predicted


def add_finding(calibration: Calibration, finding: Finding) -> Calibration:
    """Return a calibration with one more finding in its verdict."""
    verdict = calibration.verdict
    return replace(calibration, verdict=replace(verdict, findings=(*verdict.findings, finding)))


def refused_for(calibration: Calibration, *findings: Finding) -> Calibration:
    """Return a calibration that is refused for findings, and for those that refused it before."""
    others = () if calibration.verdict.accepted else calibration.verdict.findings
    return replace(calibration, verdict=Verdict(accepted=False, findings=(*findings, *others)))


def state_options(calibration: Calibration, **more: object) -> Calibration:
    """Return a calibration whose evidence states further options."""
    evidence = calibration.evidence
    return replace(calibration, evidence=replace(evidence, options={**evidence.options, **more}))
