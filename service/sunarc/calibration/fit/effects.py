"""Errors that many sightings share: blocks of unknowns with a Gaussian prior of unit variance, linear in px.

`_displacements` gives each by its name: how all sightings are displaced at 1-sigma of each of its unknowns. They are
computed about a camera near the one sought. The camera that is sought is that of the day in
the assumed air with a right clock: in its pose the sun is predicted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.answers.ageing import SEASONS, season_columns
from sunarc.calibration.evidence import RECORD, linear_evidence, products_by_part
from sunarc.calibration.fit.marginal_likelihood import LOOSE_DECENTERING_PX, LOOSE_RADIAL_PX, prior_precision
from sunarc.calibration.model.options import USUAL_OPTIONS
from sunarc.calibration.model.result import STRONG_EVIDENCE, TURN_ASKED
from sunarc.calibration.model.sightings import Kind, Sightings, grid_steps_px
from sunarc.calibration.noise import lag_one, neighbours
from sunarc.calibration.solve.priors import LENS, STRETCH, free_pixel_aspect
from sunarc.calibration.solve.problem import Block, FitProblem, by_elevation
from sunarc.common.array_types import BoolArray, FloatArray, IntArray, even_parts
from sunarc.common.robust_statistics import CUT, counted_roots, robust_sigma
from sunarc.optics.camera import Param
from sunarc.optics.forward import by_direction, project_with_rows_fast
from sunarc.optics.projections import ideal_radius

POSE_DIFFERENCE_DEG = 0.02
"""1-sigma about each axis of how far the camera of the night is turned against that of the day. A bracket of 10 cm and
5 cm across of aluminium (23e-6 a kelvin), one side of it 5 K warmer by day, bends by 0.013 degrees."""
OFFSET_POWERS = (1, 2, 3)
"""Of the radius. Coma grows with the radius at first, and higher orders of it faster; on the axis it is zero."""
OFFSET_PX = 0.15
"""1-sigma of each coefficient, 0.26 px at the edge together. The simulated lens has 0.13 px there."""
DECENTRED_PX = 0.03
"""1-sigma at the edge of the part of the offset that grows as the cosine and as the sine of the azimuth: of lenses that
are not centred, whose coma is not either. It grows as the square of the radius, as decentering distortion does."""
N_RADIAL = len(OFFSET_POWERS)
CLOCK_OFFSET_S, CLOCK_DRIFT_S_PER_H = 2.0, 0.35
"""1-sigma of a clock of which nothing is stated: how far it is off on a day, and its drift. A quartz that nothing
corrects drifts by 0.1 s an hour, and by several times that in the cold and the heat."""
_HOURS = 6.0
"""Of a clear day's half: a clock whose bound is stated drifts within it at most."""
_NEGLIGIBLE_PX = 1e-4
PIXELS = "pixels"
_RUNS = 6
"""Parts of the days with a clock of their own, at most."""
_TURNS = 16
"""Parts of the days with a turn of their own, at most: two days of one part that stand otherwise look like noise."""
TURNING = "turning"
TURNING_DEG = 0.1
"""1-sigma about each axis of how far the mount turns in a quarter of a day, on every day alike, as the sun warms it."""
TURNING_POWERS = (1.0, 0.3, 0.5)
"""1-sigma of the first, second and third power of the hours since the middle of the day, in that of the turn."""
PICTURE = "picture"
PICTURE_SCALE, PICTURE_PX = 2e-3, 2.0
"""1-sigma of how a picture is scaled, and shifted along each axis, between two days: by a program that scales and crops
it, by another focus or lens."""
_STEP_DEG = 0.1
"""1-sigma about each axis of a turn between two days."""
_LARGEST_STEP_DEG = 0.5
"""Turn beyond which displacements are not linear: sightings of two poses are parted first."""
_PASSES = 3
_MOST_ALIKE = 0.6
"""Correlation of neighbours' residuals above which a step explains too little."""
SWAYS = "sways"
SWAY_DEG = 0.05
"""1-sigma about each axis of how far the mount is turned on a day: masts bend by hundredths, and settle by tenths."""
_DAYS_OF_SEASON = 6
"""Days, as many as the waves of a season have unknowns and one more: fewer are met by any season."""


class _SightingsInView(NamedTuple):
    """Sightings as a camera near the one sought shows them.

    outwards_px: see `CalibrationOptions`.
    stretch (n, 2, 2): px by the wide prior's aspect and skew. by_direction (n, 2, 3), rise (n, 2): px per unit of the
    direction, and per radian that it rises. focal (n, 2): px by a focal length twice as long. outwards (n, 2), radius
    (n,): unit vectors away from the principal point, and the distance to it over that of the horizon. off (n, 2): px by
    which the sightings lie next to it. n_days: how many days. hours (n,): from the mean time of each day's
    sightings. day (n,): number of the day. by_unknowns (n, 2, p): px by the camera's unknowns, which
    are at (p,) and have the prior precision (p,).
    """

    seen: Sightings
    outwards_px: float
    stretch: FloatArray
    by_direction: FloatArray
    rise: FloatArray
    focal: FloatArray
    outwards: FloatArray
    radius: FloatArray
    off: FloatArray
    n_days: int
    hours: FloatArray
    day: IntArray
    by_unknowns: FloatArray
    at: FloatArray
    precision: FloatArray

    def runs(self, most: int) -> BoolArray:
        """Return (n, k): which sightings are of each run of days, of so many at most."""
        part = even_parts(self.seen.day, most=most)
        return np.asarray(part[:, None] == np.arange(part.max() + 1))

    def turned(self, sd_deg: float) -> FloatArray:
        """Return (n, 2, 3): displacements where the camera is turned about east, north and up by an angle."""
        # a camera that is turned by d sees the direction u where the one that is not sees u - d x u
        return np.cross(self.by_direction, self.seen.directions[:, None, :]) * math.radians(sd_deg)


def _displacements(view: _SightingsInView) -> Iterator[tuple[str, FloatArray]]:
    """Yield the shared errors that may act: the name, and the displacements (n, 2, k) by each of its unknowns."""
    seen, outwards, radius = view.seen, view.outwards, view.radius[:, None]
    night = seen.night & ~np.all(seen.night)
    if np.any(night):  # beside a day
        # A Gaussian fitted to a star is displaced along the radius where the lens has coma, and lateral colour
        # displaces the star as a whole; the sun's disc, much wider than both, is not. By powers of the radius, and by
        # its square over the azimuth.
        size = [OFFSET_PX * radius ** np.array(OFFSET_POWERS), DECENTRED_PX * radius**2 * outwards]
        of_stars = np.concatenate(size, axis=-1) * (night & (seen.kind == Kind.STAR))[:, None]
        yield "night_offset", outwards[:, :, None] * of_stars[:, None]
        # the cold bends what the camera stands on
        yield "night_pose", view.turned(POSE_DIFFERENCE_DEG) * night[:, None, None]
    yield "air", view.rise[:, :, None] * seen.refraction_sd[:, None, :]
    yield "outwards", view.outwards_px * (outwards * (seen.kind == Kind.SUN)[:, None])[..., None]
    # pixels on a grid may have been cut: all are then half a step too small
    of_sun = seen.kind == Kind.SUN
    yield "grid", np.diag(0.5 * grid_steps_px(seen.pixels[of_sun])) * of_sun[:, None, None]
    # A clock that is off, and that drifts on every day alike, where its bound allows it. That it is off within a stated
    # bound turns the pose, see `answers.covariance.pose_error`. No sighting tells one from a lens that is another, nor
    # a drift that is the same on every day; the clock of a night is in the night's turn.
    unknown = np.isnan(seen.clock_error_s)
    drift = np.where(unknown, CLOCK_DRIFT_S_PER_H, np.nan_to_num(seen.clock_error_s) / _HOURS)
    by_time = (np.einsum("nai,ni->na", view.by_direction, seen.motion) * ~seen.night[:, None])[:, :, None]
    yield "clock", by_time * np.stack([CLOCK_OFFSET_S * unknown, drift * view.hours], axis=-1)[:, None]
    if view.n_days > 1:  # otherwise on each run of days than what all have in common, whatever the bound
        in_run = view.runs(_RUNS)
        apart = in_run - 1.0 / in_run.shape[1]
        daily = [CLOCK_OFFSET_S * apart, CLOCK_DRIFT_S_PER_H * view.hours[:, None] * apart]
        yield "daily_clock", by_time * np.concatenate(daily, axis=-1)[:, None]
    yield PIXELS, view.stretch
    if _seems_to_turn(view, by_hour := _turn_columns_by_hour(view)):
        yield TURNING, by_hour
    if view.n_days > 1 and (before := _find_days_before_change(view)) is not None:
        columns = np.concatenate([_picture_columns(view), view.turned(_STEP_DEG)], axis=-1)
        yield PICTURE, columns * before[:, None, None]
    if view.n_days >= _DAYS_OF_SEASON and np.any(seasons := season_columns(seen.unix_s)):
        for name, share in SEASONS.items():
            yield name, share * view.focal[:, :, None] * seasons[:, None]
    if view.n_days > 2:  # a mount that is turned otherwise on each run of days
        in_run, turns = view.runs(_TURNS), view.turned(SWAY_DEG)
        if _seems_to_sway(view, in_run, turns):
            yield SWAYS, (turns[:, :, None] * in_run[:, None, :, None]).reshape(len(seen), 2, -1)


def _turn_columns_by_hour(view: _SightingsInView) -> FloatArray:
    """Return displacements (n, 2, 9) of a mount that turns about three axes by powers of the hour of the day."""
    share = view.hours * ~view.seen.night / _HOURS
    powers = share[:, None] ** np.arange(1, len(TURNING_POWERS) + 1) * TURNING_POWERS
    return (view.turned(TURNING_DEG)[..., None] * powers[:, None, None]).reshape(len(share), 2, -1)


def _seems_to_turn(view: _SightingsInView, by_hour: FloatArray) -> bool:
    """Return whether displacements (n, 2, k) by the hour explain the sightings hardly worse than none, or better."""
    distance = np.linalg.norm(view.off, axis=-1) * np.sqrt(view.seen.information)
    root = counted_roots(distance, view.seen.information, floor=_NEGLIGIBLE_PX)
    size = view.at.size
    rows = np.concatenate([view.by_unknowns, by_hour, view.off[..., None]], axis=-1) * root[:, None, None]
    flat = rows.reshape(-1, rows.shape[-1])
    products = flat.T @ flat / _residual_variance(view, rows[..., -1], root > 0.0)[0]
    information = products[:-1, :-1] + np.diag(np.r_[view.precision, np.ones(by_hour.shape[-1])])
    pull = products[:-1, -1] - np.r_[view.precision * view.at, np.zeros(by_hour.shape[-1])]
    with_turns, without = (float(linear_evidence(information[:k, :k], pull[:k])[0]) for k in (len(pull), size))
    return with_turns - without > TURN_ASKED


def _picture_columns(view: _SightingsInView) -> FloatArray:
    """Return displacements (n, 2, 3) by another scale of the picture, and by a shift along each axis."""
    shift = np.broadcast_to(PICTURE_PX * np.eye(2), (len(view.seen), 2, 2))
    return np.concatenate([PICTURE_SCALE * view.focal[:, :, None], shift], axis=-1)


def _find_days_before_change(view: _SightingsInView) -> BoolArray | None:
    """Return which sightings (n,) are of the days before another picture; None where a turn or nothing explains them.

    The camera, a turn and another picture are columns of one linear model; each boundary of two days is tried.
    """
    n_camera = view.by_unknowns.shape[-1]
    rows = np.concatenate([view.by_unknowns, _picture_columns(view), view.turned(_STEP_DEG)], axis=-1)
    picture, turn = n_camera + np.arange(3), n_camera + np.arange(3, 6)
    left, variance, at = view.off, 1.0, 0
    for _ in range(_PASSES):
        distance = np.linalg.norm(left, axis=-1) * np.sqrt(view.seen.information)
        root = worst_day_roots(distance, view.seen)
        weighed = np.concatenate([rows, view.off[..., None]], axis=-1) * root[:, None, None]
        daily = products_by_part(weighed, view.day)
        # by the variance of the former pass, whose scale was another one
        steps = _DayStepEvidence(daily / variance, view.at, view.precision)
        both, step = steps.evidences(np.concatenate([picture, turn]))
        at = int(np.argmax(both))
        if both[at] - steps.none < STRONG_EVIDENCE:
            return None
        of_camera, of_step = rows[..., :n_camera] @ step[at][:n_camera], rows[..., n_camera:] @ step[at][n_camera:]
        left = view.off - of_camera - of_step * (view.day <= at)[:, None]
        variance, alike = _residual_variance(view, left * root[:, None], root > 0.0)
    # both together always gain by the errors of the linear model
    alone, turned = (float(np.max(steps.evidences(one)[0])) for one in (picture, turn))
    turn_deg = _STEP_DEG * float(np.linalg.norm(step[at][turn]))
    if alone - max(turned, steps.none) < STRONG_EVIDENCE or alike > _MOST_ALIKE or turn_deg > _LARGEST_STEP_DEG:
        return None
    return np.asarray(view.day <= at)


class _DayStepEvidence:
    """Evidence of a step between two days, for every boundary, the camera's unknowns integrated out."""

    def __init__(self, daily: FloatArray, at: FloatArray, precision: FloatArray) -> None:
        """Take the products (d, k, k) of each day, those with the residuals as the last column."""
        self.size, self.precision = at.size, precision
        self.before, self.total = np.cumsum(daily, axis=0)[:-1], np.sum(daily, axis=0)
        self.pull = self.total[:-1, -1][: at.size] - precision * at
        self.none = float(self.evidences(np.zeros(0, dtype=np.int64))[0][0])

    def evidences(self, columns: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the log evidence (d - 1,) of a step with some columns, and the unknowns' places (d - 1, k - 1)."""
        k, p, q = len(self.before), self.size, columns.size
        information, pull = np.empty((k, p + q, p + q)), np.empty((k, p + q))
        information[:, :p, :p] = self.total[:p, :p] + np.diag(self.precision)
        information[:, :p, p:] = self.before[:, :p, columns]
        information[:, p:, :p] = information[:, :p, p:].swapaxes(1, 2)
        information[:, p:, p:] = self.before[:, columns[:, None], columns] + np.eye(q)
        pull[:, :p], pull[:, p:] = self.pull, self.before[:, columns, -1]
        evidence, mean = linear_evidence(information, pull)
        found = np.zeros((k, len(self.total) - 1))
        found[:, np.concatenate([np.arange(p), columns])] = mean
        return evidence, found


def worst_day_roots(distance: FloatArray, seen: Sightings) -> FloatArray:
    """Return the roots of the information (n,) at the scale of the day that is met worst: none is left out whole.

    `distance` (n,): of the sightings from where they are predicted, in their relative sigmas.
    """
    sigma = max(robust_sigma(distance[seen.day == day], floor=_NEGLIGIBLE_PX) for day in np.unique(seen.day))
    return np.asarray(np.sqrt(seen.information) * (distance < CUT * sigma) / sigma)


def _seems_to_sway(view: _SightingsInView, in_run: BoolArray, turns: FloatArray) -> bool:
    """Return whether turns (n, 2, 3) of each run (n, k) of days explain the sightings better than none and one move."""
    distance = np.linalg.norm(view.off, axis=-1) * np.sqrt(view.seen.information)
    root = counted_roots(distance, view.seen.information, floor=_NEGLIGIBLE_PX)
    rows = np.concatenate([turns, view.off[..., None]], axis=-1) * root[:, None, None]
    run = np.argmax(in_run, axis=1)
    products = products_by_part(rows, run)
    if not np.all(np.diagonal(products[:, :3, :3], axis1=1, axis2=2) > 0.0):
        return False
    left = rows[..., 3] - np.einsum("nap,np->na", rows[..., :3], _turns(products)[1][run])
    products = products / _residual_variance(view, left, root > 0.0)[0]
    summed = np.cumsum(products, axis=0)
    (early, before), (late, since) = (_turns(one) for one in (summed[:-1], summed[-1] - summed[:-1]))
    swaying, moved = float(np.sum(_turns(products)[0])), early + late
    if swaying < float(_turns(summed[-1:])[0][0]):
        return False
    at = int(np.argmax(moved))
    turn_deg = SWAY_DEG * float(np.linalg.norm(since[at] - before[at]))
    return swaying > moved[at] or turn_deg < RECORD.least_deg


def _turns(products: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the log evidence (r,) of turns against none, and these (r, 3), by products with the residuals at last."""
    return linear_evidence(products[:, :3, :3] + np.eye(3), products[:, :3, 3])


def _residual_variance(view: _SightingsInView, left: FloatArray, counted: BoolArray) -> tuple[float, float]:
    """Return the variance of residuals (n, 2), larger where neighbours err alike, and the correlation of these."""
    rho, error = lag_one(left, counted, neighbours(view.seen.unix_s, view.seen.day))
    alike = (1.0 + rho) / (1.0 - rho) if rho > 2.0 * error else 1.0
    return max(float(np.mean(left[counted] ** 2)) * alike, _NEGLIGIBLE_PX**2), rho


POSSIBLE = frozenset({"night_offset", "night_pose", "air", "outwards", "grid", "clock"})
"""The shared errors that are in the covariance though the sightings do not prove them."""


SHOWN_BY_STARS = frozenset({"night_offset", "night_pose", "air"})
"""Those that stars on all sides of the sky show: with them their means make the better camera."""


def add_effects(
    problem: FitProblem,
    unknowns: FloatArray,
    observed: Sightings,
    *,
    outwards_px: float = USUAL_OPTIONS.outwards_px,
) -> tuple[FitProblem, Sightings]:
    """Return the problem with the blocks that the sightings may have, and the sightings with their displacements.

    Parameters
    ----------
    problem, unknowns : a camera near the one sought, without blocks.
    observed : with times, kinds and nights.
    outwards_px : see `CalibrationOptions`.
    """
    view = _make_view(problem, unknowns, observed)._replace(outwards_px=outwards_px)
    blocks, columns, start = [], [], 0
    for name, found in _displacements(view):
        acts = np.any(np.abs(found) > _NEGLIGIBLE_PX, axis=(0, 1))
        if np.any(acts):
            columns.append(found if np.all(acts) else found[:, :, acts])
            blocks.append(Block(name, slice(start, start + int(acts.sum()))))
            start = blocks[-1].columns.stop
    together = np.concatenate([np.zeros((len(observed), 2, 0)), *columns], axis=-1)
    return replace(problem, blocks=tuple(blocks)), replace(observed, systematic_px=together)


def _make_view(problem: FitProblem, unknowns: FloatArray, observed: Sightings) -> _SightingsInView:
    """Return the sightings as the cameras of their epochs show them; 0 where one shows nothing."""
    n = len(observed)
    wide = free_pixel_aspect(problem.prior).basis[:, STRETCH]
    stretched = np.zeros((len(Param), 2))
    stretched[LENS] = wide * np.any(wide != problem.prior.basis[:, STRETCH])
    (days, day), times = np.unique(observed.day, return_inverse=True), np.nan_to_num(observed.unix_s)
    view = _SightingsInView(
        observed,
        0.0,
        np.zeros((n, 2, 2)),
        np.zeros((n, 2, 3)),
        np.zeros((n, 2)),
        np.zeros((n, 2)),
        np.zeros((n, 2)),
        np.zeros(n),
        np.zeros((n, 2)),
        days.size,
        (times - (np.bincount(day, times) / np.bincount(day))[day]) / 3600.0,
        day,
        problem.linearised(unknowns, observed)[1],
        unknowns,
        prior_precision(unknowns.size, LOOSE_RADIAL_PX, LOOSE_DECENTERING_PX),
    )
    for epoch in range(problem.n_epochs):
        rows = observed.epoch == epoch if problem.n_epochs > 1 else slice(None)
        camera, directions = problem.camera(unknowns, epoch), observed.directions[rows]
        pixels, by_parameters = project_with_rows_fast(camera, directions)
        view.stretch[rows] = by_parameters @ stretched
        view.by_direction[rows] = by_direction(camera, by_parameters)
        view.rise[rows] = by_elevation(directions, view.by_direction[rows])
        view.off[rows] = np.nan_to_num(observed.pixels[rows] - pixels)
        outwards = np.nan_to_num(pixels - np.array(camera.principal_point_px))
        far = np.linalg.norm(outwards, axis=-1)
        edge = camera.focal_length_px[0] * float(ideal_radius(camera.projection, min(camera.max_angle, math.pi / 2)))
        view.focal[rows] = outwards
        view.outwards[rows] = outwards / np.maximum(far, 1e-9)[:, None]
        view.radius[rows] = far / edge
    return view
