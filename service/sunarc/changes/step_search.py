"""Steps of the pose in a long record: daily rotations tell where to look, fits of a few days whether and when.

A record of years costs one rotation a day, and one search of a few days for every place where these step.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.change_points import best_row, calibrate_moved
from sunarc.calibration.evidence import DAYS_GAIN
from sunarc.calibration.model.options import USUAL_OPTIONS, CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import Calibration, Move
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.projection_choice import options_as_served
from sunarc.changes.daily_rotations import DailyRotations, daily_pose_offset, step_gains
from sunarc.common.array_types import IntArray
from sunarc.sky.site import Site

_PER_DAY = 150
"""Sightings of a day that the search looks at; the step itself is dated among all."""
_FEWEST_PER_DAY = 20
_LENS_DAYS = 3
_LENS_TRIALS = 4
"""Places of the record that a lens is sought at where none is known: a step may lie in any of them."""
_BESIDE = 3
"""Days on either side of a step of the daily rotations that are fitted."""
_MOST = 24
"""Places that are looked at in one search; the clearest steps come first."""


class PoseStep(NamedTuple):
    """A turn of the camera: between which sightings (seconds since 1970-01-01 UTC), and by which angle, degrees."""

    before_unix_s: float
    after_unix_s: float
    turn_deg: float


def find_pose_steps(
    points: Sightings,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions = USUAL_OPTIONS,
    circle: ImageCircle | None = None,
    lens: Calibration | None = None,
) -> tuple[PoseStep, ...]:
    """Return the steps of the pose within the epochs of a record, in the order of time.

    Parameters
    ----------
    points, site, image_size, options, circle : as `calibrate` takes them; epochs are searched one by one.
    lens : a calibration of the same lens; sought in the record where None.

    Returns
    -------
    None are found by the paper's method, or where no lens fits any few days.
    """
    if options.method != "robust":
        return ()
    search = StepSearch(site=site, image_size=image_size, options=options, circle=circle)
    steps: list[PoseStep] = []
    for epoch in np.unique(points.epoch).tolist():
        in_epoch = points.select(points.epoch == epoch)
        steps += search.steps(replace(in_epoch, epoch=np.zeros(len(in_epoch), dtype=np.int64)), lens)
    return tuple(sorted(steps))


class StepSearch(NamedTuple):
    """What a search for steps of the pose knows of the record."""

    site: Site
    image_size: tuple[int, int]
    options: CalibrationOptions
    circle: ImageCircle | None

    def steps(self, points: Sightings, lens: Calibration | None) -> list[PoseStep]:
        """Return the steps within one epoch."""
        stated = options_as_served(self.options, lens)
        if stated != self.options:
            return self._replace(options=stated).steps(points, lens)
        thin, day = _thinned(points, self.site)
        days = np.unique(day)
        if days.size <= 2 * _BESIDE:
            spans = [(days[0], days[-1])] if days.size else []
        else:
            if lens is None:
                lens = self._lens(thin, day, days)
                return [] if lens is None else self.steps(points, lens)
            spans = step_spans(self._daily(thin, day, lens))
        found: list[PoseStep] = []
        for first, last in spans:
            found += self._verified(points, thin.select((day >= first) & (day <= last)))
        return distinct_steps(found)

    def _lens(self, thin: Sightings, day: IntArray, days: IntArray) -> Calibration | None:
        """Return the fit of a few days that scatters least; a step within them makes it scatter."""
        fits = []
        for begin in np.unique(np.linspace(0, days.size - _LENS_DAYS, _LENS_TRIALS).astype(int)):
            some = thin.select(np.isin(day, days[begin : begin + _LENS_DAYS]))
            solved = calibrate(some, **self._asdict(), parts=False)
            if solved.verdict.accepted:
                fits.append((solved.metrics.rmse_px, solved.evidence.n_rejected, solved))
        return min(fits, key=lambda item: item[:2])[2] if fits else None

    def _daily(self, thin: Sightings, day: IntArray, lens: Calibration) -> DailyRotations:
        """Return the rotation of each day, the lens's errors allowed for: another focus is no rotation."""
        days = np.unique(day)
        offsets = [daily_pose_offset(thin.select(day == one), calibration=lens, site=self.site) for one in days]
        known = [(one, offset) for one, offset in zip(days.tolist(), offsets, strict=True) if offset is not None]
        sigma = np.array([offset.sigma_deg for _, offset in known]).reshape(-1, 3, 1)
        return DailyRotations(
            day=np.array([one for one, _ in known], dtype=np.float64),
            rotation_deg=np.array([offset.turn_deg for _, offset in known]).reshape(-1, 3),
            covariance_deg2=sigma**2 * np.eye(3),
        )

    def _verified(self, points: Sightings, some: Sightings) -> list[PoseStep]:
        """Return the steps that a fit of a few days finds, dated among all sightings."""
        solved, _ = calibrate_moved(some, **self._asdict(), parts=False)
        moves = solved.evidence.moves
        poses = [*(move.pose_before for move in moves), solved.camera.rotation_cam_enu]
        return [
            self._dated(move, points, replace(solved, poses=(poses[number], poses[number + 1])))
            for number, move in enumerate(moves)
        ]

    def _dated(self, move: Move, points: Sightings, solved: Calibration) -> PoseStep:
        """Return the step between the sightings of the whole record that it came between."""
        near = (points.unix_s >= move.before_unix_s) & (points.unix_s <= move.after_unix_s)
        usable = filter_sightings(points.select(near), site=self.site)
        cameras = [replace(solved.camera, rotation_cam_enu=pose) for pose in solved.poses]
        row = min(max(best_row(slice(0, len(usable)), usable, cameras), 1), len(usable) - 1)
        return PoseStep(float(usable.unix_s[row - 1]), float(usable.unix_s[row]), move.turn_deg)


def _thinned(points: Sightings, site: Site) -> tuple[Sightings, IntArray]:
    """Return some of each day's usable sightings, in the order of time, and the solar day of each."""
    usable = filter_sightings(points, site=site)
    retained = []
    for day in np.unique(usable.day):
        rows = np.flatnonzero(usable.day == day)
        if rows.size >= _FEWEST_PER_DAY:
            retained.append(rows[:: -(-rows.size // _PER_DAY)])
    rows = np.concatenate(retained) if retained else np.zeros(0, dtype=np.int64)
    return points.select(usable.index[rows]), usable.day[rows]


def step_spans(days: DailyRotations) -> list[tuple[int, int]]:
    """Return the first and last day about each step of the daily rotations, the clearest first."""
    gain = step_gains(days)
    found: list[tuple[int, int]] = []
    while len(found) < _MOST and gain.max(initial=0.0) > DAYS_GAIN:
        row = int(np.argmax(gain))
        first, last = max(row - _BESIDE, 0), min(row + _BESIDE, len(gain)) - 1
        found.append((int(days.day[first]), int(days.day[last])))
        gain[first + 1 : last + 1] = -np.inf
    return found


def distinct_steps(steps: list[PoseStep]) -> list[PoseStep]:
    """Return the steps without those that overlap one found in another place."""
    retained: list[PoseStep] = []
    for step in sorted(steps):
        if not retained or step.before_unix_s >= retained[-1].after_unix_s:
            retained.append(step)
    return retained
