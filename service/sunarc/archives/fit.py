"""Epochs and calibrations of a camera: the lens from all sightings of its lens, the pose from those of its own."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce
from typing import Any, NamedTuple

import numpy as np

import sunarc
from sunarc.archives.leaning import Leaning, leaning_fit
from sunarc.archives.states import (
    ArchiveCamera,
    Epoch,
    State,
    alternation,
    changed_states,
    correct_clock,
    find_epochs,
    find_states,
    joined,
    split_epochs,
    surely_held,
)
from sunarc.calibration.acceptance import apart_sigmas
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, Mirrored
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration, add_finding, refused_for
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.pose import estimate_pose
from sunarc.calibration.projection_choice import options_as_served
from sunarc.calibration.quality.fit_checks import JudgedFit, is_tilt_shown
from sunarc.calibration.quality.tilt import clock_behind_turn, tilt_question
from sunarc.calibration.quality.widening import add_pose_spread, scale_errors
from sunarc.calibration.selection import pick_surest_in_epochs, select_sightings
from sunarc.calibration.verdict import (
    ASKED,
    PARTS,
    SITE_ASSUMED,
    add_stated_clock,
    findings,
    fired,
    is_undetermined,
    provisional,
)
from sunarc.changes.epoch_changes import (
    EpochCause,
    agreeing_days,
    change_within,
    drift_finding,
    drift_within,
    estimate_daily_noise,
    is_lens_change,
    spread_deg,
)
from sunarc.common.array_types import FloatArray, IntArray, even_parts, stacked
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import finite, robust_sigma
from sunarc.common.utc import utc_time
from sunarc.formats.calibration_document import to_document
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast
from sunarc.sky.sun import sun_directions
from sunarc.sources.look import result_key

_MOST_CHANGES = 12
"""Changes that are found within states: each is sought anew in both of its sides."""


class FittedPose(NamedTuple):
    """Calibration of a pose, the rows of its suns, and its stars."""

    calibration: Calibration
    rows: IntArray
    stars: Sightings | None = None


def drop_small_changes(points: Sightings, states: Sequence[State], camera: ArchiveCamera) -> list[State]:
    """Return states without those of the changes that are smaller than a single sighting shows.

    Parameters
    ----------
    points : accepted sightings in the order of their stated times.
    states, camera : see there.
    """
    noise, found, settled = estimate_daily_noise(points, camera.site), list(states), set[tuple[int, int]]()
    for _ in range(_MOST_CHANGES):
        epochs, _ = find_epochs(points, found, camera)
        split = False
        for epoch in epochs:
            rows, state = slice(epoch.first, epoch.last + 1), found[epoch.state]
            if (epoch.first, epoch.last) in settled:
                continue
            settled.add((epoch.first, epoch.last))
            epoch_points = points.select(rows)
            change = change_within(
                camera.shifted(epoch_points, state.clock_offset_s), state.calibration.camera, camera.site, noise[rows]
            )
            if change is not None:
                late = epoch_points.unix_s - state.clock_offset_s >= change.time
                sides = epoch_points.select(~late), epoch_points.select(late)
                found += changed_states(found, state, sides, change.cause, camera)
                split = True
        if not split:
            break
    return found


def assign_lenses(
    points: Sightings, path: IntArray, states: Sequence[State], fitted: Mapping[int, FittedPose], camera: ArchiveCamera
) -> list[State]:
    """Return states, those that one lens explains with the state before given that lens, and others one of their own.

    A state is taken for a known lens in another pose within what is known of that lens, which is little at first; and
    for another lens where days of two states were fitted as one.

    Parameters
    ----------
    points : accepted sightings in the order of their stated times.
    path, states, camera : as `fit_poses` takes them.
    fitted : what it returns, one lens for all poses that are said to have it.
    """
    noise, found, epochs = estimate_daily_noise(points, camera.site), list(states), split_epochs(path, states, points)
    for number, (one, other) in enumerate(itertools.pairwise(epochs), 1):
        before, after = (found[each.state] for each in (one, other))
        if before.pose == after.pose:
            continue
        rows = [slice(each.first, each.last + 1) for each in (one, other)]
        seen = [
            camera.shifted(points.select(some), each.clock_offset_s)
            for some, each in zip(rows, (before, after), strict=True)
        ]
        calibrations = [fitted[each.pose].calibration for each in (before, after)]
        cameras = _share_lens(calibrations, seen, camera)
        sides = [(some, of_side, noise[of]) for some, of_side, of in zip(seen, cameras, rows, strict=True)]
        apart = is_lens_change(sides, camera.site)
        if apart is None or apart == (before.lens != after.lens):
            continue
        if not apart:
            found = [state._replace(lens=before.lens) if state.lens == after.lens else state for state in found]
            continue
        free = 1 + max(state.lens for state in found)
        earlier = {found[each.state].pose for each in epochs[:number]}
        later = {each.state for each in epochs[number:]}
        for place in later:
            if found[place].lens == before.lens and found[place].pose not in earlier:
                found[place] = found[place]._replace(lens=free)
    return found


def _share_lens(calibrations: Sequence[Calibration], seen: Sequence[Sightings], camera: ArchiveCamera) -> list[Camera]:
    """Return the cameras of two sides of a change, that of fewer sightings with the lens of the other in its pose.

    Where no pose fits them, each keeps its own.
    """
    fewer = int(len(seen[1]) <= len(seen[0]))
    posed = estimate_pose(seen[fewer], start=calibrations[1 - fewer], site=camera.site, options=camera.loosely())
    fits = posed.evidence.n_used > 0
    return [posed.camera if side == fewer and fits else solved.camera for side, solved in enumerate(calibrations)]


def fit_poses(
    points: Sightings,
    path: IntArray,
    states: Sequence[State],
    camera: ArchiveCamera,
    *,
    stars: Sightings | None = None,
) -> dict[int, FittedPose]:
    """Return the calibration of each pose that has sightings, by its number.

    Parameters
    ----------
    points, path : sightings of the sun at their stated times, and the state of each.
    states, camera : see there.
    stars : of the night, at their true times, with poses as epochs; with them, only the poses whose lens has some.
    """
    together = joined(points, path, states)
    lens_of = {state.pose: state.lens for state in states}
    lenses = np.array([lens_of[int(pose)] for pose in together.epoch], dtype=np.int64)
    fitted, options_of = {}, dict[int, CalibrationOptions]()
    for pose in np.unique(together.epoch).tolist():
        rows = np.flatnonzero(lenses == lens_of[pose])
        of_lens = together.select(rows)
        # the calibration is of the last epoch: this pose goes last, the others before it in any order
        order = [*(one for one in np.unique(of_lens.epoch).tolist() if one != pose), pose]
        ordered = _numbered(of_lens, order)
        beside = None if stars is None else _stars_beside(stars, order, camera)
        if stars is not None and beside is None:
            continue
        selection = select_sightings(ordered, site=camera.site, slot_s=1.0)
        selected = ordered.select(selection.index)
        given = selected if beside is None else _merged(selected, beside)
        # the poses of a lens are fitted to the same sightings: projection and handedness are sought once
        options = options_of.get(lens_of[pose], camera.options)
        # the tilt is asked about where all poses are known, see `_held_to_level`
        fit = partial(calibrate, given, site=camera.site, image_size=camera.size, options=options, tilt_known=True)
        solved = fit()
        # the search for a start may have ended elsewhere; a start of some projection does not make it known
        undecided = options.projection == "auto" and is_undetermined(solved.verdict)
        if not solved.verdict.accepted and not undecided:
            near = next(state.calibration.camera for state in states if state.pose == pose)
            again = fit(start=near)
            solved = again if again.verdict.accepted else solved
        if solved.verdict.accepted:
            options_of[lens_of[pose]] = options_as_served(options, solved)
        evidence = replace(solved.evidence, selection=selection.counts())
        fitted[int(pose)] = FittedPose(replace(solved, evidence=evidence), rows[selection.index], beside)
    return fitted


def _numbered(points: Sightings, order: Sequence[int]) -> Sightings:
    """Return sightings whose epochs are the places of their poses in an order."""
    number = {one: place for place, one in enumerate(order)}
    return replace(points, epoch=np.array([number[one] for one in points.epoch.tolist()], dtype=np.int64))


def _stars_beside(stars: Sightings, order: Sequence[int], camera: ArchiveCamera) -> Sightings | None:
    """Return the stars that a fit of some poses uses, the last pose's first; None where they have none."""
    of_lens = stars.select(np.isin(stars.epoch, np.array(order)))
    if len(of_lens) == 0:
        return None
    numbered = _numbered(of_lens, order)
    return numbered.select(pick_surest_in_epochs(numbered.pixels, numbered.sigma_px, numbered.epoch, camera.size))


def _merged(suns: Sightings, stars: Sightings) -> Sightings:
    """Return sightings of both in the order of time."""
    merged = stacked([suns, stars])
    return merged.select(np.argsort(merged.unix_s, kind="stable"))


def choose_better_calibrations(
    fitted: Mapping[int, FittedPose], both: Mapping[int, FittedPose]
) -> dict[int, FittedPose]:
    """Return the calibrations by suns and stars, that by suns alone of a pose where the other is refused or not there.

    Parameters
    ----------
    fitted : by suns alone, by pose.
    both : by suns and stars.
    """
    return {
        pose: _as_steady(both[pose], one) if pose in both and not _is_worse(both[pose], one) else one
        for pose, one in fitted.items()
    }


def _is_worse(both: FittedPose, one: FittedPose) -> bool:
    accepted = one.calibration.verdict.accepted and not both.calibration.verdict.accepted
    return accepted or _drifts(one.calibration) or one.calibration.evidence.turning is not None


def _as_steady(both: FittedPose, one: FittedPose) -> FittedPose:
    """Return a calibration that allows for the drift of the pose that another one does."""
    spread = one.calibration.evidence.pose_spread_deg
    return both if spread is None else both._replace(calibration=add_pose_spread(both.calibration, spread))


def make_epoch_document(
    fitted: FittedPose,
    points: Sightings,
    epoch: Epoch,
    *,
    camera: str,
    name: str,
    evidence: Mapping[str, object],
    clock_error_s: float | None = None,
) -> dict[str, Any]:
    """Return the calibration document of an epoch, valid from its first to its last sighting.

    Its id is made of the sightings, so that the same archive gives the same one.
    """
    solved, offset = add_stated_clock(fitted.calibration, clock_error_s), points
    rows = fitted.rows
    stars = fitted.stars
    beside = () if stars is None else (stars.unix_s.tobytes(), stars.pixels.tobytes())
    identity = result_key((camera, name, offset.unix_s[rows].tobytes(), offset.pixels[rows].tobytes(), *beside))
    selection = {**solved.evidence.selection, **evidence, **({} if stars is None else {"n_stars": len(stars)})}
    last = utc_time(epoch.end_unix_s)
    return to_document(
        replace(solved, evidence=replace(solved.evidence, selection=selection)),
        id=identity,
        camera=camera,
        state="candidate" if solved.verdict.accepted or solved.sigma_limit_deg is not None else "refused",
        created_at=last,
        valid_from=utc_time(epoch.start_unix_s),
        valid_until=last,
        pose_epoch=name,
        software_version=sunarc.__version__,
    )


def doubts(calibration: Calibration, camera: ArchiveCamera) -> tuple[Finding, ...]:
    """Return the findings of a camera's first fit against the site or the times; none of a tilt that its suns show."""
    found = []
    wanted = camera.options.mirrored
    if wanted != "auto" and calibration.camera.mirrored != (wanted == "yes"):
        found.append(Finding("camera_mirrored", {"mirrored": "yes" if calibration.camera.mirrored else "no"}))
    tilted = None if is_tilt_shown(calibration) else tilt_question(calibration.camera, camera.site)
    return (*found, tilted) if tilted is not None else tuple(found)


_SIGMA_FLOOR_PX = 0.05
_FAILED = 3.0
"""Scatter about a refused fit, in that of the state that it began with, from which the fit has failed."""


class CameraSightings(NamedTuple):
    """Accepted sightings of a camera at their stated times, and the states that are known so far."""

    points: Sightings
    camera: ArchiveCamera
    states: tuple[State, ...] = ()


class Rough(NamedTuple):
    """States and epochs after the first pass, and their findings."""

    states: tuple[State, ...] = ()
    epochs: tuple[Epoch, ...] = ()
    findings: tuple[Finding, ...] = ()


class Final(NamedTuple):
    """States and epochs after the second pass, the state of each sighting (n,), and the calibration of each pose."""

    states: tuple[State, ...]
    epochs: tuple[Epoch, ...]
    path: IntArray
    fitted: dict[int, FittedPose]

    def drop_uncalibrated(self) -> Final:
        """Return the outcome without epochs of poses that have neither sun nor star."""
        kept = tuple(one for one in self.epochs if self.states[one.state].pose in self.fitted)
        return self._replace(epochs=kept)


def without_suns(rough: Rough) -> Final:
    """Return the result for a camera without an accepted sun: calibrations by stars."""
    return Final(rough.states, rough.epochs, np.zeros(0, dtype=np.int64), {})


def first_analysis(given: CameraSightings) -> Rough:
    """Return the states and epochs of a camera by its first pass.

    Offsets of clocks are against the clock that most sightings have; where states are known, against theirs.
    """
    found = find_states(given.points, given.camera, given.states)
    if found.finding is not None:
        return Rough(findings=(found.finding,))
    alternate = alternation(given.points, found.states, given.camera)
    if alternate is not None:
        return Rough(findings=(alternate,))
    if found.states and not len(given.points):  # the state that is known holds
        return Rough(found.states, (Epoch(0, "start", 0, -1, -math.inf, math.inf),))
    epochs, path = find_epochs(given.points, found.states, given.camera)
    states = list(found.states) if given.states else correct_clock(found.states, path, given.camera.site)
    largest = max(range(len(states)), key=lambda number: int((path == number).sum()))
    of_largest = given.points.select(path == largest)
    return Rough(tuple(states), tuple(epochs), _check_state(states[largest], of_largest, given.camera))


def _check_state(state: State, points: Sightings, camera: ArchiveCamera) -> tuple[Finding, ...]:
    """Return the findings against site or times that a whole fit of a state's sightings leaves.

    A state is a quick fit: it asks neither the horizon about a tilt nor the mount about the hand.
    """
    first = doubts(state.calibration, camera)
    either = camera._replace(options=replace(camera.options, mirrored="auto"))
    fitted = fit_poses(points, np.zeros(len(points), dtype=np.int64), [state], either) if first else {}
    whole = next((one.calibration for one in fitted.values() if one.calibration.evidence.n_used), None)
    return first if whole is None else doubts(whole, camera)


def final_analysis(given: CameraSightings) -> Final:
    """Return the epochs and calibrations of a camera by its second pass."""
    points, camera = given.points, given.camera
    states = drop_small_changes(points, given.states, camera)
    _, path = find_epochs(points, states, camera)
    fitted = fit_poses(points, path, states, camera)
    named = assign_lenses(points, path, states, fitted, camera)
    if [one.lens for one in named] != [one.lens for one in states]:
        states, fitted = named, fit_poses(points, path, named, camera)
    # a state that no sighting is left to has no calibration that a later one could be given
    held = [(state, points.select(path == number)) for number, state in enumerate(states) if np.any(path == number)]
    refined = [_refined(state, fitted, of_state, camera) for state, of_state in held]
    epochs, path = find_epochs(points, refined, camera)
    noise = estimate_daily_noise(points, camera.site)
    found, given = _without_drifts(Final(tuple(refined), tuple(epochs), path, fitted), given, noise)
    found = _held_to_parts(_allowing_for_drift(_held_to_days(found, given, noise), given, noise), given)
    found = _held_to_level(found)
    return found._replace(epochs=surely_held(found.epochs, given.points, found.states, camera))


_SUMMER_S = 3600.0
"""Step of a clock that follows summer time."""
_NEAR_HOUR_S = 600.0
"""Error of such a step where a lean of some degrees is about the celestial pole."""
_DRIFTS = {"mount_drifts", "clock_drifts_on"}


def _drifts(calibration: Calibration) -> bool:
    return any(one.code in _DRIFTS for one in calibration.verdict.findings)


class _Run(NamedTuple):
    """Consecutive epochs: rows, sightings by a clock that is ahead by offsets (n,), and the changes within them."""

    rows: slice
    seen: Sightings
    offsets_s: FloatArray
    camera: Camera
    changes: list[tuple[int, EpochCause]]

    def drift(self, given: CameraSightings, noise: FloatArray) -> PoseChange | None:
        """Return the drift that the sightings show about the camera of the longest epoch."""
        site = given.camera.site
        return drift_within(self.seen, self.camera, site, noise[self.rows], changes=self.changes)


def _make_run(final: Final, given: CameraSightings, epochs: Sequence[Epoch], *, hourly: bool = False) -> _Run | None:
    """Return consecutive epochs as a run by the clock of the longest.

    With `hourly` clocks, which differ by whole hours, the run is by these and without their changes; None where clocks
    are alike, or not near whole hours.
    """
    rows, state = slice(epochs[0].first, epochs[-1].last + 1), final.states[_longest(epochs).state]
    clocks = np.array([one.clock_offset_s for one in final.states])[final.path[rows]]
    right_s = float(clocks[np.argmin(np.abs(clocks))]) if hourly else state.clock_offset_s
    hours = np.rint((clocks - right_s) / _SUMMER_S)
    if hourly and (not np.any(hours) or np.max(np.abs(clocks - right_s - _SUMMER_S * hours)) > _NEAR_HOUR_S):
        return None
    offsets = right_s + (_SUMMER_S * hours if hourly else np.zeros(hours.size))
    seen = replace(given.points.select(rows), unix_s=given.points.unix_s[rows] - offsets)
    changes = [(one.first - epochs[0].first, one.cause) for one in epochs[1:]]
    changes = [one for one in changes if not (hourly and one[1] == "clock")]
    return _Run(rows, seen, offsets, state.calibration.camera, changes)


def _drifting_run(
    final: Final, given: CameraSightings, noise: FloatArray, epochs: Sequence[Epoch]
) -> tuple[_Run, Finding, Leaning | None] | None:
    """Return consecutive epochs with the drift that makes them those of no one camera, and the steady turn that it is.

    A lean makes steps of a clock seem to be of no whole hours: those that are near are whole with a steady turn alone.
    """
    for hourly in (False, True):
        run = _make_run(final, given, epochs, hourly=hourly)
        drift = None if run is None else run.drift(given, noise)
        finding = None if drift is None else drift_finding(drift)
        if run is None or drift is None or finding is None:
            continue
        steady = drift.cause == "slow_turn"
        leaning = leaning_fit(run.seen, given.camera, noise[run.rows], drift, run.camera) if steady else None
        if leaning is not None or not hourly:
            return run, finding, leaning
    return None


def _without_drifts(final: Final, given: CameraSightings, noise: FloatArray) -> tuple[Final, CameraSightings]:
    """Return epochs, those in which mount or clock drifted taken together: refused, or a camera with a steady turn.

    The sightings of a steady turn are returned as the camera would have had them without it.
    """
    epochs = final.epochs[:_MOST_CHANGES]
    states, path, fitted = list(final.states), final.path.copy(), dict(final.fitted)
    pixels, taken = given.points.pixels.copy(), set[int]()
    for count in range(len(epochs), 0, -1):
        for begin in range(len(epochs) - count + 1):
            members = epochs[begin : begin + count]
            found = None if taken & set(range(begin, begin + count)) else _drifting_run(final, given, noise, members)
            if found is None:
                continue
            run, finding, leaning = found
            taken |= set(range(begin, begin + count))
            new = states[_longest(members).state]
            pose = 1 + max(one.pose for one in states)
            fitted[pose] = _refuse(fitted[new.pose], finding)
            new = new._replace(pose=pose)
            if leaning is not None:
                pixels[run.rows] = leaning.pixels
                fitted[pose] = FittedPose(leaning.calibration, run.rows.start + leaning.rows)
                new = new._replace(calibration=leaning.calibration)
            for offset_s in np.unique(run.offsets_s).tolist():
                path[run.rows][run.offsets_s == offset_s] = len(states)
                states.append(new._replace(clock_offset_s=offset_s))
    upright = given._replace(points=replace(given.points, pixels=pixels))
    return _finish_epochs(final, Final(tuple(states), (), path, fitted), given.points), upright


def _longest(run: Sequence[Epoch]) -> Epoch:
    return max(run, key=lambda one: one.last - one.first)


def _refuse(fitted: FittedPose, *findings: Finding) -> FittedPose:
    return fitted._replace(calibration=refused_for(fitted.calibration, *findings))


def _finish_epochs(former: Final, final: Final, points: Sightings) -> Final:
    """Return epochs by the states of sightings, with the causes of former ones; of one pose the clock's."""
    causes: dict[int, EpochCause] = {one.first: one.cause for one in former.epochs}
    epochs = split_epochs(final.path, final.states, points)
    return final._replace(
        epochs=tuple(
            one if one.cause == "clock" else one._replace(cause=causes.get(one.first, "unexplained")) for one in epochs
        )
    )


def _allowing_for_drift(final: Final, given: CameraSightings, noise: FloatArray) -> Final:
    """Return calibrations whose uncertainty allows for the drift that their epochs' sightings show."""
    fitted = dict(final.fitted)
    spread = {pose: np.zeros(3) for pose, one in fitted.items() if one.calibration.verdict.accepted}
    for epoch in final.epochs:
        pose = final.states[epoch.state].pose
        run = _make_run(final, given, [epoch]) if pose in spread else None
        drift = None if run is None else run.drift(given, noise)
        if drift is None:
            continue
        spread[pose] = np.maximum(spread[pose], spread_deg(drift))
        finding = drift_finding(drift)
        if finding is not None:
            fitted[pose] = _refuse(fitted[pose], finding)
    for pose, largest in spread.items():
        fitted[pose] = fitted[pose]._replace(calibration=add_pose_spread(fitted[pose].calibration, largest.tolist()))
    return final._replace(fitted=fitted)


_FEWEST_OF_PART = 30
"""Sightings of a part of an epoch that a camera of its own is fitted to."""


def _held_to_parts(final: Final, given: CameraSightings) -> Final:
    """Return calibrations compared with fits of parts of their sightings: with larger errors, or refused.

    What all days share (a bias of detection, a wrong lens) no part of them shows; what differs among them does.
    """
    fitted, camera = dict(final.fitted), given.camera
    together = joined(given.points, final.path, final.states)
    for pose, one in fitted.items():
        whole = one.calibration
        of_pose = together.select(one.rows[together.epoch[one.rows] == pose])
        if not whole.verdict.accepted or len(of_pose) < 2 * _FEWEST_OF_PART:
            continue
        hand: Mirrored = "yes" if whole.camera.mirrored else "no"
        options = replace(camera.options, mirrored=hand, projection=whole.camera.projection)
        apart = [0.0]
        for part in _split_parts(replace(of_pose, epoch=np.zeros(len(of_pose), dtype=np.int64))):
            alone = calibrate(
                part, site=camera.site, image_size=camera.size, options=options, circle=camera.circle, parts=False
            )
            apart.append(apart_sigmas(alone, whole) if alone.verdict.accepted else 0.0)
        fitted[pose] = _held_to(one, max(apart))
    return final._replace(fitted=fitted)


def _split_parts(points: Sightings) -> Iterator[Sightings]:
    """Yield the halves and thirds of sightings in the order of time, and those by turns, where they are enough."""
    rows = np.arange(len(points))
    for parts in (even_parts(rows, most=2), even_parts(rows, most=3), rows % 2):
        for part in np.unique(parts):
            if np.count_nonzero(parts == part) >= _FEWEST_OF_PART:
                yield points.select(parts == part)


def _held_to(fitted: FittedPose, sigmas: float) -> FittedPose:
    """Return a calibration from which that of some part lies so many stated sigmas."""
    for check, finding in fired(PARTS, sigmas):
        if check.effect == "refuse":
            return _refuse(fitted, finding)
        return fitted._replace(calibration=scale_errors(fitted.calibration, sigmas))
    return fitted


_CLOCK_IN_DOUBT = 0.1
"""Odds of a wrong clock from which on a tilted pose is not that of a camera that was level before."""


def _held_to_level(final: Final) -> Final:
    """Return calibrations, those refused whose tilt is not stated, unless the camera stood level in another pose.

    The site is that of all poses, and so is the clock unless it may have gone ahead where the camera seems turned.
    """
    accepted = {pose: one for pose, one in final.fitted.items() if one.calibration.verdict.accepted}
    judged = {pose: JudgedFit(calibration=one.calibration) for pose, one in accepted.items()}
    asked = {pose: findings(ASKED, one) for pose, one in judged.items()}
    fitted = dict(final.fitted)
    level = [one.calibration.camera for pose, one in accepted.items() if not asked[pose]]
    for pose, one in accepted.items():
        site, seen = one.calibration.site, one.calibration.camera
        by_clock = any(clock_behind_turn(camera, seen, site).odds > _CLOCK_IN_DOUBT for camera in level)
        if asked[pose] and (by_clock or not level):
            fitted[pose] = _refuse(one, *asked[pose])
        else:
            said = reduce(add_finding, findings(SITE_ASSUMED, judged[pose]), one.calibration)
            fitted[pose] = one._replace(calibration=said)
    return final._replace(fitted=fitted)


_OF_DAYS = {
    "epoch_does_not_explain_its_days",
    "half_days_deviate",
    "held_out_contradicts",
    "too_many_rejected",
    "rmse_too_large",
}
"""Findings by which the sightings of an epoch are not of one camera."""


def _held_to_days(final: Final, given: CameraSightings, noise: FloatArray) -> Final:
    """Return epochs shortened to the days that agree on a camera, where not all days do.

    What is left of such an epoch keeps the calibration that was refused.
    """
    points, camera = given.points, given.camera
    states, path, fitted = list(final.states), final.path.copy(), dict(final.fitted)
    for epoch in final.epochs:
        state = states[epoch.state]
        refused = final.fitted[state.pose].calibration
        of_days = _OF_DAYS & {one.code for one in refused.verdict.findings}
        if refused.verdict.accepted or _drifts(refused) or not of_days:
            continue
        rows = slice(epoch.first, epoch.last + 1)
        seen = camera.shifted(points.select(rows), state.clock_offset_s)
        residual = seen.pixels - project_fast(refused.camera, sun_directions(seen.unix_s, camera.site))
        for run in agreeing_days(finite(residual), noise[rows], seen.unix_s, camera.site)[:1]:
            alone = calibrate(
                seen.select(run), site=camera.site, image_size=camera.size, options=camera.options, tilt_known=True
            )
            if not alone.verdict.accepted:
                continue
            pose, lens = (1 + max(getattr(one, name) for one in states) for name in ("pose", "lens"))
            path[epoch.first + run[0] : epoch.first + run[-1] + 1] = len(states)
            fitted[pose] = FittedPose(alone, epoch.first + run)
            states.append(state._replace(calibration=alone, pose=pose, lens=lens))
    return _finish_epochs(final, Final(tuple(states), (), path, fitted), points)


class StarFitInput(NamedTuple):
    """Input of a fit of sun and stars: accepted sightings, the outcome by the sun alone, and sightings of stars."""

    given: CameraSightings
    final: Final
    stars: Sightings


def starry_analysis(of: StarFitInput) -> Final:
    """Return epochs and calibrations, using suns and stars together where that is better."""
    final, given = of.final, of.given
    if not len(given.points):
        return final._replace(fitted=_fit_stars(of.stars, final.states, given.camera))
    both = fit_poses(given.points, final.path, final.states, given.camera, stars=of.stars)
    return final._replace(fitted=choose_better_calibrations(final.fitted, both))


def _fit_stars(stars: Sightings, states: Sequence[State], camera: ArchiveCamera) -> dict[int, FittedPose]:
    """Return the calibration of each pose by its stars alone, by its number; their hand is not in doubt."""
    fitted = {}
    for state in states:
        of_pose = stars.select(stars.epoch == state.pose)
        if len(of_pose) == 0 or state.pose in fitted:
            continue
        of_pose = replace(of_pose, epoch=np.zeros(len(of_pose), dtype=np.int64))
        used = of_pose.select(pick_surest_in_epochs(of_pose.pixels, of_pose.sigma_px, of_pose.epoch, camera.size))
        start = state.calibration.camera
        hand: Mirrored = "yes" if start.mirrored else "no"
        options = replace(camera.options, mirrored=hand)
        solved = calibrate(used, site=camera.site, image_size=camera.size, options=options, start=start)
        fitted[state.pose] = FittedPose(solved, np.zeros(0, dtype=np.int64), used)
    return fitted


def kept_provisional(final: Final, camera: ArchiveCamera) -> Final:
    """Return calibrations, those that their sightings do not determine as provisional, see `provisional`."""
    limit_deg = camera.options.max_sky_deg
    kept = {
        pose: one._replace(calibration=provisional(one.calibration, limit_deg=limit_deg))
        for pose, one in final.fitted.items()
    }
    return final._replace(fitted=kept)


def _refined(state: State, fitted: dict[int, FittedPose], points: Sightings, camera: ArchiveCamera) -> State:
    """Return a state with the calibration that was fitted to all of its sightings."""
    found = fitted.get(state.pose)
    if found is None or found.calibration.evidence.n_used == 0 or len(points) == 0:
        return state
    distance = camera.calibration_distances(found.calibration, points, state.clock_offset_s)
    scatter = robust_sigma(distance, floor=_SIGMA_FLOOR_PX)
    # a fit that failed says nothing of when the state held
    if not found.calibration.verdict.accepted and scatter > _FAILED * state.sigma_px:
        return state
    return state._replace(calibration=found.calibration, sigma_px=scatter)
