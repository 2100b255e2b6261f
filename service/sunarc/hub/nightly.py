"""The nightly work of a hub: summaries, comparison of neighbouring cameras, retention."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import cache
from typing import Any

import numpy as np

from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.changes.daily_rotations import DailyRotations, daily_rotations
from sunarc.changes.fleet import FEWEST_AGREEING, agreeing, explain_step, find_steps, step_sizes
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.hub.archive import HubArchive
from sunarc.hub.clocks import ClockOffsets, Lag, clock_offsets
from sunarc.hub.cloud_edges import SunSeries, cloud_lag
from sunarc.hub.nightly_store import CrossCheck, Found, NightlyRun
from sunarc.imager.archive.values import CalibrationRecord, CameraRecord
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.status import StatusRegistry, condition
from sunarc.imager.workers.options import NightlyOptions
from sunarc.optics.inverse import unproject
from sunarc.sky.days import day_bounds_unix_s, day_to_date, solar_date, solar_days
from sunarc.sky.directions import wrapped_deg
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

_DAYS = timedelta(days=60)
"""Days compared at once; a step that is older counts as the usual state."""
_CLOUD_DAYS = 30
_NEAR_M = 50_000.0
"""Neighbours have the refraction of one air mass, and see the same clouds."""
_MOST = 6
_CYCLE_S = 5.0
"""Exposures of one cycle are no further apart, s."""
_CLOCK_SIGMAS = 5.0
"""By how many sigmas a clock must be off to be named: one in a million of normal errors, and winds err otherwise."""
_M_PER_DEG = 111_195.0
"""Of latitude, on a sphere of 6371 km."""


def cross_check_fleet(archive: HubArchive, *, now: datetime) -> tuple[CrossCheck, ...]:
    """Return the neighbours' results of each camera that has some within 50 km; some seconds of processor a camera.

    Parameters
    ----------
    archive : the fleet's.
    now : the last 60 days before it are compared.
    """
    reading = _CachedReader(archive, now)
    cameras = archive.cameras.all()
    groups = {one.name: (one, *_find_neighbours(one, cameras)) for one in cameras}
    return tuple(_check_camera(reading, group) for group in groups.values() if len(group) > 1)


def _find_neighbours(camera: CameraRecord, cameras: Sequence[CameraRecord]) -> list[CameraRecord]:
    """Return the nearest cameras that are near enough."""
    others = [one for one in cameras if one.name != camera.name]
    away = {one.name: float(np.linalg.norm(_east_north_m(camera, one))) for one in others}
    near = sorted((one for one in others if away[one.name] <= _NEAR_M), key=lambda one: away[one.name])
    return near[:_MOST]


def _east_north_m(origin: CameraRecord, camera: CameraRecord) -> FloatArray:
    """Return (2,): how far a camera stands east and north of another, on a sphere; for tens of kilometres."""
    east = float(wrapped_deg(camera.longitude - origin.longitude))
    level = math.cos(math.radians(0.5 * (camera.latitude + origin.latitude)))
    return _M_PER_DEG * np.array([east * level, camera.latitude - origin.latitude])


@dataclass(eq=False)
class _CachedReader:
    """Reader of cameras' days that reads each once.

    Parameters
    ----------
    archive : the fleet's.
    now : the end of what is read.
    """

    archive: HubArchive
    now: datetime

    def __post_init__(self) -> None:
        """Begin with an empty cache."""
        self.rotations = cache(self._read_rotations)
        self.series = cache(self._read_sun_series)
        self.lags = cache(self._compute_lags)

    def stated_sites(self, camera: CameraRecord, unix_s: FloatArray) -> list[Site]:
        """Return the site as it was stated at each time: by the calibrations until the newest, then by the camera."""
        made = sorted(self.archive.calibrations.find(camera.name), key=lambda record: record.created_at)
        sites = [*(_document_site(record, camera.site) for record in made), camera.site]
        since = [record.created_at.timestamp() for record in (*made[1:], *made[-1:])]
        return [sites[index] for index in np.searchsorted(since, unix_s, side="right").tolist()]

    def _read_rotations(self, camera: CameraRecord) -> DailyRotations:
        """Return how a camera stood turned on each day of its pose epoch against its current calibration."""
        model = self.archive.calibrations.current_model(camera.name)
        epochs = self.archive.epochs.find(camera.name)  # a turn that the imager found itself is nobody else's to find
        since = max([self.now - _DAYS, *(one.started_at for one in epochs)])
        columns = self.archive.sightings.columns(
            camera.name, since=since, until=self.now, largest_clock_error_s=MAX_CLOCK_ERROR_S
        )
        day = solar_days(columns.unix_s, longitude=camera.longitude)
        expected = np.full((len(day), 3), np.nan)
        days = np.unique(day)
        first = np.array([columns.unix_s[day == one][0] for one in days.tolist()])
        for one, site in zip(days.tolist(), self.stated_sites(camera, first), strict=True):
            of_day = day == one
            expected[of_day] = sun_directions(
                columns.unix_s[of_day], site, temperature=columns.temperature[of_day], pressure=columns.pressure[of_day]
            )
        observed = expected * np.nan if model is None else unproject(model.camera, columns.pixels)
        return daily_rotations(day.astype(np.float64), observed=observed, expected=expected)

    def _read_sun_series(self, camera: CameraRecord) -> tuple[IntArray, SunSeries]:
        """Return when a camera looked for the sun, and whether a cycle showed it, with the days."""
        since = self.now - timedelta(days=_CLOUD_DAYS)
        times = self.archive.sightings.exposure_times(camera.name, since=since, until=self.now)
        times = np.sort(np.zeros(0) if times is None else times)
        accepted = self.archive.sightings.columns(camera.name, since=since, until=self.now).unix_s
        begins = np.flatnonzero(np.diff(times, prepend=-np.inf) > _CYCLE_S)
        seen = np.isin(times, accepted)
        cycle_s = times[begins]
        series = SunSeries(unix_s=cycle_s, seen=np.logical_or.reduceat(seen, begins) if len(begins) else seen)
        return solar_days(cycle_s, longitude=camera.longitude), series

    def _compute_lags(self, first: CameraRecord, second: CameraRecord) -> tuple[tuple[int, float, float], ...]:
        """Return the day, lag and 1-sigma of each day on which clouds passed both."""
        (days_a, a), (days_b, b) = self.series(first), self.series(second)
        found = []
        for day in np.intersect1d(days_a, days_b).tolist():
            lag = cloud_lag(*(_select_day(one, days == day) for one, days in ((a, days_a), (b, days_b))))
            if lag is not None:
                found.append((day, *lag))
        return tuple(found)


def _select_day(series: SunSeries, of_day: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> SunSeries:
    return SunSeries(unix_s=series.unix_s[of_day], seen=series.seen[of_day])


def _document_site(record: CalibrationRecord, otherwise: Site) -> Site:
    """Return the site that a calibration's document states."""
    site: Any = record.document.get("site")
    try:
        return Site(latitude=site["latitude"], longitude=site["longitude"], altitude=site["altitude"])
    except (TypeError, KeyError, ValueError):
        return otherwise


def _check_camera(reading: _CachedReader, group: Sequence[CameraRecord]) -> CrossCheck:
    """Return the cross-check of a group's first camera by the others."""
    rotations = [reading.rotations(one) for one in group]
    step = find_steps(rotations)[0]
    clocks = _estimate_clocks(reading, group)
    found, causes = dict[str, Any](), list[Found]()
    if step is not None:
        found = _step_fields(reading, group[0], step) | {"agreeing": agreeing(rotations, 0, step)}
        cause: Found = found.pop("cause")
        causes.append(cause if found["agreeing"] >= FEWEST_AGREEING else "unconfirmed")
    offset, sigma = float(clocks.offset_s[0]), float(clocks.sigma_s[0])
    if math.isfinite(offset):
        found |= {"cloud_clock_s": offset, "cloud_clock_sigma_s": sigma}
        sigmas = np.nan_to_num(np.abs(clocks.offset_s / clocks.sigma_s))
        if sigmas[0] > _CLOCK_SIGMAS and np.argmax(sigmas) == 0 and _is_confirmed_by_clouds(reading, group, offset):
            causes.append("clock_by_clouds")
    return CrossCheck(
        camera=group[0].name,
        neighbours=tuple(one.name for one in group[1:]),
        n_days=len(rotations[0].day),
        found=tuple(causes),
        **found,
    )


def _is_confirmed_by_clouds(reading: _CachedReader, group: Sequence[CameraRecord], offset_s: float) -> bool:
    """Return whether enough others, and more than half of the group, have lags of about the offset."""
    lags = [reading.lags(group[0], one) for one in group[1:]]
    shares = [-float(np.median([lag_s for _, lag_s, _ in of_pair])) / offset_s for of_pair in lags if of_pair]
    n_shown = sum(abs(share - 1.0) < 0.5 for share in shares)
    return n_shown >= FEWEST_AGREEING and 2 * n_shown > len(shares) + 1


def _estimate_clocks(reading: _CachedReader, group: Sequence[CameraRecord]) -> ClockOffsets:
    lags = [
        Lag(day=day, first=a, second=b, lag_s=lag_s, sigma_s=sigma_s)
        for a in range(len(group))
        for b in range(a + 1, len(group))
        for day, lag_s, sigma_s in reading.lags(group[a], group[b])
    ]
    return clock_offsets(lags, east_north_m=np.array([_east_north_m(group[0], one) for one in group]))


def _step_fields(reading: _CachedReader, camera: CameraRecord, step: PoseChange) -> dict[str, Any]:
    """Return the fields of a step or a slow turn by name, with its cause."""
    days = reading.rotations(camera).day
    last = days[max(int(np.searchsorted(days, step.time)) - 1, 0)]
    noons_s = [
        sum(day_bounds_unix_s(day_to_date(int(day)), longitude=camera.longitude)) / 2 for day in (last, step.time)
    ]
    before, after = reading.stated_sites(camera, np.array(noons_s))
    change, confidence = explain_step(step, before=before, after=after)
    sigma = np.sqrt(np.diag(change.covariance_deg2))
    return step_sizes(change, before) | {
        "cause": change.cause,
        "confidence": confidence,
        "since": day_to_date(int(change.time)),
        "rotation_deg": tuple(change.rotation_deg.tolist()),
        "rotation_sigma_deg": tuple(sigma.tolist()),
    }


_log = logging.getLogger(__name__)
_AFTER_MIDNIGHT = timedelta(hours=2)
"""Of the fleet's mean longitude: imagers judge a day within minutes of its end."""
_TRY_AGAIN = timedelta(hours=1)
_FAILED = "nightly_failed"

Job = Callable[[datetime], Mapping[str, Any]]
"""Does the work that is due at a time, and returns a record of it, in JSON; done twice, it changes nothing."""


def nightly_jobs(archive: HubArchive, options: NightlyOptions) -> dict[str, Job]:
    """Return the jobs of a hub by name, in their order.

    Parameters
    ----------
    archive : the hub's.
    options : how long sightings are kept.
    """
    keep = timedelta(days=options.keep_sightings_days)
    return {
        "summaries": lambda _now: {"days": archive.nightly.summarise_days()},
        "cross_checks": lambda now: {"checks": [one.as_json() for one in cross_check_fleet(archive, now=now)]},
        "retention": lambda now: {"removed": archive.nightly.remove_sightings(before=now - keep, now=now)},
        "quarantine": lambda now: {"removed": archive.feeds.expire(now=now)},
    }


@dataclass(kw_only=True, eq=False)
class NightlyWork:
    """Runs the jobs of a night when they are due, and remembers in the archive how they went.

    A night is a solar date at the fleet's mean longitude. It is due from 2 h after midnight on until all its jobs
    succeeded; a job that failed, or was cut off, is tried again after an hour. Nights that were missed are made up by
    one, since jobs do whatever is due.

    Parameters
    ----------
    archive : the hub's.
    jobs : by name, in their order.
    clock : real time.
    board : where a failure is shown.
    """

    archive: HubArchive
    jobs: Mapping[str, Job]
    clock: Clock
    board: StatusRegistry

    def run_due(self) -> None:
        """Run the work that is due; to be called every minute."""
        now = self.clock.now()
        unix_s = (now - _AFTER_MIDNIGHT).timestamp()
        night = solar_date(unix_s, longitude=self.archive.nightly.mean_longitude())
        last = next(iter(self.archive.nightly.runs(limit=1, until=night)), None)
        if last is not None and last.night == night:
            done = last.finished_at is not None and not last.failed
            if done or timedelta(0) <= now - last.started_at < _TRY_AGAIN:
                self._show_failures(last)
                return
        succeeded = {} if last is None or last.night != night else last.results
        run = NightlyRun(night=night, started_at=now, results=_without_errors(succeeded))
        self.archive.nightly.save(run)
        for name, job in self.jobs.items():
            if name not in run.results:
                run = replace(run, results={**run.results, name: self._run_job(name, job)})
        run = replace(run, finished_at=self.clock.now())
        self.archive.nightly.save(run)
        self._show_failures(run)

    def _run_job(self, name: str, job: Job) -> Mapping[str, Any]:
        try:
            result = job(self.clock.now())
        except Exception as error:  # noqa: BLE001 - one job that fails must not keep the others from their work
            _log.exception("the nightly job %s failed", name)
            return {"error": f"{type(error).__name__}: {error}"}
        _log.info("nightly job %s: %s", name, dict(result))
        return result

    def _show_failures(self, run: NightlyRun) -> None:
        reason = None
        if run.failed:
            jobs, error = ", ".join(run.failed), next(iter(run.failed.values()))
            reason = condition(_FAILED, night=run.night.isoformat(), jobs=jobs, error=error)
        self.board.set_condition(_FAILED, reason)


def _without_errors(results: Mapping[str, Any]) -> dict[str, Any]:
    return {name: result for name, result in results.items() if "error" not in result}
