"""Verdict of a fit: the table of checks by which it is refused, kept as a candidate or widened, and what it states.

A check compares the measure of a fit with a limit. The order of its rows is the order of a verdict's findings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import reduce
from typing import Any, Literal, NamedTuple

from sunarc.calibration import acceptance
from sunarc.calibration.acceptance import Succession
from sunarc.calibration.answers.covariance import sky_share_within, without_clock
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import TURN_ASKED, Calibration, Verdict, add_finding, proof_threshold, refused_for
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality import fit_checks as of
from sunarc.calibration.quality import widening
from sunarc.calibration.quality.day_clocks import allowed_clock_s, unsteady_clock
from sunarc.calibration.quality.fit_checks import FEWEST_BELOW, Given, JudgedFit
from sunarc.calibration.quality.tilt import LEVEL_DEG
from sunarc.common.findings import Data, Finding
from sunarc.optics.camera import Camera

_LEAST_SHARE = 0.05
"""Share of the sky in the image that a provisional calibration answers for at least."""


class Bound(NamedTuple):
    """Limit of a number of a measure."""

    of: str
    """Name of the number."""
    value: float | str | Callable[[Any], float]
    """The limit, the option that states it, or the function that returns it."""
    name: str = ""
    """Name of the limit among the data of the finding; empty where it is not there."""
    per: str = ""
    """Name of the number that the limit is a multiple of; empty where it is absolute."""
    least: bool = False
    """Whether the number must not be smaller; else it must not be larger."""


class FitCheck(NamedTuple):
    """Row of the table; its case is `Given`, `JudgedFit` or `Succession`."""

    code: str
    """Code of the finding."""
    measure: Callable[[Any], Data | Finding | None]
    """Function that returns the data of the finding, or one of a more exact code; None where it does not apply."""
    limit: Bound | None = None
    """Limit beyond which there is a finding; None where there is one wherever the check applies."""
    effect: Literal["refuse", "keep", "widen", "say"] = "say"
    """Effect on the fit: it is refused; it is kept as a candidate; its stated uncertainty is larger; or nothing."""

    def found(self, case: Any) -> Finding | None:  # noqa: ANN401 - of the table
        """Return the finding of a case; None where the check does not apply, or its limit is met."""
        data, limit = self.measure(case), self.limit
        if data is None or isinstance(data, Finding):
            return data
        if limit is None:
            return Finding(self.code, data)
        value = getattr(case.options, limit.value) if isinstance(limit.value, str) else limit.value
        value = value(case) if callable(value) else value
        number, bound = float(data[limit.of]), value * float(data[limit.per]) if limit.per else value
        if number >= bound if limit.least else number <= bound:
            return None
        return Finding(self.code, {**data, limit.name: value} if limit.name else data)


# Sightings, before a fit

STATIC = (FitCheck("static_sightings", of.not_moving, Bound("n", 0.5, per="n_all"), "refuse"),)
BELOW_HORIZON = (
    FitCheck(
        "sightings_below_horizon", of.below_horizon, Bound("n", "max_below_horizon", "limit", per="n_all"), "refuse"
    ),
)
FEW = (FitCheck("too_few_sightings", of.count, Bound("n", 20, "least", least=True), "refuse"),)
SHORT = (
    FitCheck("arc_too_short", of.arc, Bound("arc_deg", 10.0, "least_deg", least=True), "refuse"),
    FitCheck("spread_too_small", of.extent, Bound("spread_px", 10.0, "least_px", least=True), "refuse"),
)

# Fit by itself

ASKED = (
    FitCheck("camera_tilted", of.question_asked),
    FitCheck("tilt_in_doubt", of.tilt_to_refuse, Bound("tilt_deg", LEVEL_DEG), "refuse"),
    FitCheck("picture_changed", of.picture_behind),
)
"""Tilt that may be a wrong place or clock, which the other refusals (`JudgedFit.against`) may follow from."""
UNCERTAIN = (
    FitCheck("direction_sigma_unknown", of.unknown_sigma, None, "refuse"),
    FitCheck("direction_sigma_too_large", of.sky_sigma, Bound("sigma_deg", of.largest_sky_deg, "limit_deg"), "refuse"),
    FitCheck("sightings_determine", of.determined),
    FitCheck("hours_missing", of.hours_missing),
    FitCheck("declinations_alike", of.declinations_alike),
)
UNEXPLAINED = (
    FitCheck(
        "epoch_does_not_explain_its_days",
        of.measure_left_out_share,
        Bound("share", "max_unexplained", "limit"),
        "refuse",
    ),
    # smoke, a ladder on the mast; of ten days no half-day may be far off
    FitCheck("half_days_deviate", of.far_half_days, Bound("n_far", 0.05, per="n_half_days"), "refuse"),
)
AGAINST = (
    *BELOW_HORIZON,
    FitCheck("camera_sees_sun_below_horizon", of.seen_below_horizon, Bound("n", FEWEST_BELOW - 1.0), "refuse"),
    FitCheck("clock_unsteady", unsteady_clock, Bound("scatter_s", allowed_clock_s, "limit_s"), "refuse"),
    FitCheck("rmse_too_large", of.scatter, Bound("rmse_px", of.largest_rmse_px, "limit_px"), "refuse"),
    FitCheck("too_many_rejected", of.rejected, Bound("share", "max_rejected", "limit"), "refuse"),
    FitCheck("held_out_contradicts", of.held_out, Bound("excess", of.largest_excess, "limit"), "refuse"),
    # three numbers reach this chi-square once in 6,000
    FitCheck("camera_turned", of.measure_part_turn, Bound("chi_square", 20.0, "limit"), "say"),
    *UNEXPLAINED,
    *UNCERTAIN,
    FitCheck("tilt_too_large", of.tilt, Bound("tilt_deg", "level_within_deg", "limit_deg"), "refuse"),
    FitCheck("principal_point_outside", of.outside, None, "refuse"),
    # the radius of any fisheye rises so far
    FitCheck("radius_not_rising", of.rising_to, Bound("angle_deg", 20.0, "least_deg", least=True), "refuse"),
    FitCheck("sightings_of_one_radius", of.one_radius, None, "refuse"),
)
SITE_ASSUMED = (FitCheck("site_assumed", of.assumed_site),)
FOUND = (
    FitCheck("camera_tilted_shown", of.tilt_shown),
    FitCheck("camera_tilted", of.question_left),
    FitCheck("fit_rmse", of.rmse),
    FitCheck("direction_sigma", lambda judged: {"sigma_deg": judged.calibration.sky_rms_deg}),
)
"""Findings of an accepted fit; those of the sightings that were left out follow."""
NOTED = (
    FitCheck("sigma_of_parts", of.measure_part_factor, Bound("factor", 1.0), "widen"),
    FitCheck("static_positions", of.static_positions),
    FitCheck("provisional", lambda judged: {} if judged.free == "pose" else None),
    FitCheck("mirrored", lambda judged: {} if judged.tried_mirrored is True else None),
    FitCheck("not_mirrored", lambda judged: {} if judged.tried_mirrored is False else None),
    FitCheck("image_size_doubtful", of.off_center),
    FitCheck("pixels_not_square", of.aspect, Bound("log_odds", proof_threshold("pixels")), "say"),
    FitCheck("pixels_may_not_be_square", of.possible_stretch, Bound("probability", 0.02), "widen"),
    FitCheck("clock_drifts", of.measure_clock_drift, Bound("log_odds", proof_threshold("daily_clock")), "say"),
    FitCheck("detections_biased", of.bias_outwards, Bound("log_odds", proof_threshold("outwards")), "say"),
    FitCheck("focal_length_changes", of.measure_focal_change),
    FitCheck("picture_changed", of.picture),
    FitCheck("mount_turns", of.turn_by_hour, Bound("log_odds", proof_threshold("turning")), "widen"),
    FitCheck("mount_may_turn", of.possible_turn, Bound("log_odds", TURN_ASKED), "say"),
    FitCheck("mount_sways", of.sway, Bound("log_odds", proof_threshold("sways")), "widen"),
    FitCheck("pixels_on_grid", of.grid, Bound("step_px", 0.0)),
    *SITE_ASSUMED,
)

CLOCK = (
    FitCheck("times_without_seconds", widening.half_a_step, Bound("clock_error_s", 0.0), "widen"),
    FitCheck("clock_unbounded", widening.assumed_clock),
)
"""Findings of an accepted fit for whose clock no bound is stated."""

# Fit in place of the calibration in use

_GROWTH = Bound("now_deg", acceptance.allowed_growth, per="before_deg")
SUCCEEDS = (
    FitCheck("cross_validation_rmse", acceptance.cross_validation, Bound("rmse_px", 4.0, per="expected_px"), "refuse"),
    FitCheck("handedness_differs", acceptance.other_hand, None, "refuse"),
    FitCheck("contradicts_active", acceptance.contradiction, Bound("share", acceptance.SHOWN), "refuse"),
    FitCheck(
        "direction_sigma_increased", acceptance.growth, _GROWTH._replace(value=acceptance.largest_growth), "refuse"
    ),
    FitCheck("cross_validation_rmse", acceptance.cross_validation, Bound("rmse_px", 2.0, per="expected_px"), "keep"),
    FitCheck("no_change", acceptance.no_change, None, "keep"),
    FitCheck("change_not_confirmed", acceptance.unproven_change, Bound("change_px", 2.0, per="stated_px"), "keep"),
    FitCheck("direction_sigma_increased", acceptance.growth, _GROWTH, "keep"),
)

# Fit of all sightings against those of its halves, thirds and alternate suns, see `archives.fit`

PARTS = (
    # of 37 right ones at most 2.1, of those with pixels that are not square, which make up for a drift, 5 and 10
    FitCheck("parts_disagree", lambda sigmas: {"sigmas": sigmas}, Bound("sigmas", 2.5, "limit"), "refuse"),
    FitCheck("sigma_of_parts", lambda sigmas: {"factor": sigmas}, Bound("factor", 1.0), "widen"),
)

TABLE = {
    "Sightings, before a fit": (*STATIC, *BELOW_HORIZON, *FEW, *SHORT),
    "Refusals of a fit": (*ASKED, *AGAINST),
    "Findings of an accepted fit": (*FOUND, *NOTED, *CLOCK),
    "Fit in place of the calibration in use": SUCCEEDS,
    "Fit of an archive against those of its parts": PARTS,
}
"""The checks of each stage."""


def fired(checks: Iterable[FitCheck], case: object) -> Iterator[tuple[FitCheck, Finding]]:
    """Yield the checks whose limits are exceeded, each with its finding; of two with one code the first."""
    codes = set[str]()
    for check in checks:
        finding = None if check.code in codes else check.found(case)
        if finding is not None:
            codes.add(check.code)
            yield check, finding


def findings(checks: Iterable[FitCheck], case: object) -> tuple[Finding, ...]:
    """Return the findings of the checks whose limits are exceeded."""
    return tuple(finding for _, finding in fired(checks, case))


def before_fit(usable: Sightings, options: CalibrationOptions) -> tuple[Finding, ...]:
    """Return the findings that make a fit pointless: few sightings, a short arc, a sun below the horizon or still."""
    given = Given(usable=usable, options=options)
    if static := findings(STATIC, given):
        return static
    if few := findings(FEW, given):
        return (*findings(BELOW_HORIZON, given), *few, *usable.filtering.dropped)
    return findings(SHORT, given)


def below_horizon(usable: Sightings, options: CalibrationOptions) -> tuple[Finding, ...]:
    """Return the finding of more sightings below the horizon than false detections are; None where they are fewer."""
    return findings(BELOW_HORIZON, Given(usable=usable, options=options))


def fit_verdict(
    calibration: Calibration,
    usable: Sightings,
    options: CalibrationOptions,
    *,
    others: Iterable[Finding] = (),
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
    judged = JudgedFit(calibration=calibration, usable=usable, options=options, tilt_known=tilt_known)
    against = findings(AGAINST, judged)
    against = (*others, *findings(ASKED, replace(judged, against=against)), *against)
    found = against or (*findings(FOUND, judged), *usable.filtering.dropped, *findings(NOTED, judged))
    return Verdict(accepted=not against, findings=tuple(_within_image(one, calibration.camera) for one in found))


def add_stated_clock(
    calibration: Calibration, clock_error_s: float | None, *, assumed: bool = False, step_s: float = 0.0
) -> Calibration:
    """Return a calibration whose uncertainty holds an error of the clock that is stated for all of its sightings.

    The sun, the planets and the stars turn about the pole alike: no residual shows a constant error. Where none is
    stated, half a step of times on a grid is assumed, and an accepted verdict names what is assumed.

    Parameters
    ----------
    calibration : as it was fitted; the pose of a known lens has the clock of its sightings.
    clock_error_s : the bound, s; None where none is stated.
    assumed : whether the bound that the sightings carry is a default that nobody stated.
    step_s : see `time_step_s`; 0 of times on no grid.
    """
    if clock_error_s is not None:
        return widening.add_clock_error(calibration, clock_error_s)
    if step_s > 0.0:
        calibration = widening.add_clock_error(calibration, 0.5 * step_s)
    elif calibration.evidence.clock_stated and not assumed:
        return calibration
    unstated = replace(calibration, evidence=replace(calibration.evidence, clock_stated=False))
    said = findings(CLOCK, widening.UnboundedClock(unstated, step_s)) if calibration.verdict.accepted else ()
    return reduce(add_finding, said, unstated)


def _within_image(finding: Finding, camera: Camera) -> Finding:
    """Return a finding whose lengths are at most the image's diagonal: nothing in an image is farther off."""
    most = math.hypot(camera.width, camera.height)
    beyond = {
        name: math.copysign(most, value)
        for name, value in finding.data.items()
        if name.endswith("_px") and isinstance(value, int | float) and abs(value) > most
    }
    return replace(finding, data={**finding.data, **beyond}) if beyond else finding


def is_undetermined(verdict: Verdict) -> bool:
    """Return whether a fit is refused for a lack of information, and for nothing else."""
    refused = not verdict.accepted and not verdict.marginal
    return refused and {one.code for one in verdict.findings} <= of.UNDETERMINED


def provisional(calibration: Calibration, *, limit_deg: float) -> Calibration:
    """Return a refused fit as provisional where it is refused for a lack of information, and that alone.

    It is then marginal, and answers for directions whose 1-sigma per axis is within a limit. All others are returned
    as they are; a tilt that nobody stated is refused, too: few sightings that contradict each other fit such a camera.
    """
    verdict = calibration.verdict
    if not is_undetermined(verdict):
        return calibration
    tilt_deg = of.unstated_tilt_deg(calibration)
    if tilt_deg is not None:
        return refused_for(calibration, Finding("provisional_tilted", {"tilt_deg": tilt_deg}))
    share = sky_share_within(calibration, limit_deg)
    if not share >= _LEAST_SHARE:
        return calibration
    found = Finding("provisional_where_sure", {"limit_deg": limit_deg, "share": share})
    kept = Verdict(accepted=False, marginal=True, findings=(found, *verdict.findings))
    return replace(calibration, verdict=kept, sigma_limit_deg=limit_deg)


def accept(
    candidate: Calibration,
    current: Calibration | None = None,
    *,
    same_pose: bool = True,
    unseen: Sightings | None = None,
) -> Verdict:
    """Return whether a candidate may become the current calibration.

    It may where its own verdict allows, where it predicts days left out about as well as it states, where it is not
    less sure of the sky than the current one (or knows more, and finds that one too sure of itself), and where the
    two agree within their stated errors: so the error served does not rise by more than twice the stated one.
    A larger change needs proof: that the sightings since are met far better. One that says the same again is
    marginal: the current one stays.

    Parameters
    ----------
    candidate : the new fit.
    current, same_pose, unseen : see `Succession`.
    """
    if not candidate.verdict.accepted:
        return candidate.verdict
    if current is not None:
        current = acceptance.allow_for_age(candidate, without_clock(current))
    succession = Succession(candidate=candidate, current=current, same_pose=same_pose, unseen=unseen)
    against = list(fired(SUCCEEDS, succession))
    if against:
        kept, camera = against[0][0].effect == "keep", candidate.camera
        said = tuple(_within_image(finding, camera) for _, finding in against)
        return Verdict(accepted=False, marginal=kept, findings=said)
    if current is None:
        return Verdict(accepted=True, findings=(Finding("first_calibration"), *candidate.verdict.findings))
    compared = Finding("direction_sigma_compared", acceptance.stated_sigmas(candidate, current))
    return Verdict(accepted=True, findings=(compared,))
