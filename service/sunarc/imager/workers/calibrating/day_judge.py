"""Verdicts of completed days by the images that were to be expected."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Container
from dataclasses import KW_ONLY, asdict, dataclass, field
from datetime import date, datetime, timedelta

import numpy as np

from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.calibration.quality.day_quality import DOUBTFUL_CLOCK_SHARE, decide_day, measure_day
from sunarc.changes.daily_rotations import DailyRotations, daily_pose_offset
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding
from sunarc.common.utc import utc_time
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.values import (
    Day,
    Refit,
    SunPointColumns,
)
from sunarc.imager.workers.calibrating.solver_process import columns_to_sightings
from sunarc.sky.days import day_bounds_unix_s, solar_date
from sunarc.sky.sun import sun_angles

_log = logging.getLogger(__name__)
_LEARNED_DAYS = timedelta(days=7)
_LONGEST_S = 3600.0
_FEWEST_BETWEEN = 3
_FIRST_S = 60.0


class LearnedCadence:
    """The seconds between images by day, learned from those of the last seven days; 60 until there are some.

    Parameters
    ----------
    camera : whose archive has the times.
    stated_s : as it is set; None learns it.
    """

    def __init__(self, camera: CameraArchive, stated_s: float | None) -> None:
        self._camera, self._stated_s = camera, stated_s
        self._learned: tuple[datetime, float] | None = None

    def at(self, time: datetime) -> float:
        """Return the cadence at a time, s; the archive is asked at most once an hour."""
        if self._stated_s is not None:
            return self._stated_s
        if self._learned is None or abs(time - self._learned[0]) >= timedelta(hours=1):
            learned_s = self._learn_cadence(time)
            if learned_s is None:
                return _FIRST_S if self._learned is None else self._learned[1]
            self._learned = (time, learned_s)
        return self._learned[1]

    def _learn_cadence(self, time: datetime) -> float | None:
        try:
            times = self._camera.archive.sightings.exposure_times(
                self._camera.name, since=time - _LEARNED_DAYS, until=time
            )
        except OutsideError as error:
            _log.warning("the cadence of the images cannot be learned: %s", error)
            return None
        between = np.diff(np.unique(times)) if times is not None else np.zeros(0)
        between = between[between <= _LONGEST_S]
        if between.size < _FEWEST_BETWEEN:
            return None
        return max(float(np.median(between)), 1.0)


_WORTH_A_REFIT = frozenset({"clear", "partly"})


@dataclass(eq=False)
class DayJudge:
    """Evaluates each completed day, and requests a refit after one that shows the sun.

    Parameters
    ----------
    camera : its archive and site.
    cadence_s, sun_zenith_deg : how often, and down to where, the sun is observed.
    now : frame time.
    request_refit : asks for a refit, with the reason.
    waiting : days of which sightings are still to come: they are judged later.
    hidden : at which times, s since 1970, the sun is behind an obstruction: nothing is expected then.
    """

    camera: CameraArchive
    _: KW_ONLY
    cadence_s: Callable[[], float]
    sun_zenith_deg: float
    now: Callable[[], datetime]
    request_refit: Callable[[str], Refit]
    waiting: Callable[[], Container[date]] = frozenset
    hidden: Callable[[FloatArray], BoolArray] = lambda unix_s: np.zeros(unix_s.shape, dtype=bool)
    _judged_before: date | None = field(default=None, init=False)
    _again: set[date] = field(default_factory=set, init=False)
    _looks_back: bool = field(default=False, init=False)

    def judge_ended_days(self) -> list[Day]:
        """Judge the due days and return the verdicts; one refit is asked for, however many days were clear."""
        longitude = self.camera.site.longitude
        today = solar_date(self.now().timestamp(), longitude=longitude)
        looks_back, self._looks_back = self._looks_back, False
        if looks_back or (self._judged_before is not None and self._judged_before > today):
            self._judged_before = None  # or the time went back
        archive, name, waiting = self.camera.archive, self.camera.name, self.waiting()
        again = {day for day in set(self._again) if day < today and day not in waiting}
        since = min([self._judged_before, *again]) if self._judged_before is not None else None
        judged = {day.date for day in archive.days.find(name, since=since) if self._is_still_valid(day)} - again
        observed = archive.sightings.dates(name, longitude=longitude, since=since)
        due = [day for day in observed if day < today and day not in judged]
        verdicts = [self._measure_day(day) for day in due if day not in waiting]
        worth = [day for day in verdicts if day.verdict in _WORTH_A_REFIT]
        if worth:
            self.request_refit("after " + ", ".join(f"{day.date} ({day.verdict})" for day in worth))
        for day in verdicts:
            self._store_day(day)
        self._again -= again
        self._judged_before = min([today, *(day for day in due if day in waiting)])
        return verdicts

    def judge_again(self, day: date) -> None:
        """Judge a day again where it has a verdict: sightings of it came late."""
        self._again.add(day)

    def look_back(self) -> None:
        """Have all earlier days without a verdict judged: sightings of them have arrived."""
        self._looks_back = True

    def _is_still_valid(self, day: Day) -> bool:
        """Return whether a verdict still holds: given after its day had ended and before now, by a right clock."""
        end = utc_time(day_bounds_unix_s(day.date, longitude=self.camera.site.longitude)[1])
        return end <= day.decided_at <= self.now()

    def _measure_day(self, date_: date) -> Day:
        start, end = day_bounds_unix_s(date_, longitude=self.camera.site.longitude)
        since, until, cadence_s = utc_time(start), utc_time(end), self.cadence_s()
        columns = self.camera.archive.sightings.columns(self.camera.name, since=since, until=until)
        doubtful = np.nan_to_num(columns.clock_error_s) > MAX_CLOCK_ERROR_S
        share = float(np.mean(doubtful)) if doubtful.size else 0.0
        largest_s = MAX_CLOCK_ERROR_S if share <= DOUBTFUL_CLOCK_SHARE else None
        if largest_s is not None:  # else the day is judged by its clock
            columns = columns.select(~doubtful)
        frames = np.arange(start, end, cadence_s)
        up = sun_angles(frames, self.camera.site).apparent_zenith < self.sun_zenith_deg
        observed = self.camera.archive.sightings.exposure_times(
            self.camera.name, since=since, until=until, largest_clock_error_s=largest_s
        )
        measure = measure_day(
            columns_to_sightings(columns),
            site=self.camera.site,
            n_possible=int(np.count_nonzero(up & ~self.hidden(frames))),
            observed_unix_s=None if observed is None else observed[~self.hidden(observed)],
            cadence_s=cadence_s,
            doubtful_clock=share,
        )
        decided = decide_day(measure)
        offset = self._measure_pose_offset(columns) if decided.kind in _WORTH_A_REFIT else None
        return Day(
            camera=self.camera.name,
            date=date_,
            verdict=decided.kind,
            findings=decided.findings,
            n=measure.n,
            n_cycles=measure.n_cycles,
            n_possible=measure.n_possible,
            n_observed=measure.n_observed,
            decided_at=self.now(),
            arc_deg=measure.arc_deg,
            solid_angle_sr=measure.solid_angle_sr,
            doubtful_clock=_finite_or_none(measure.doubtful_clock),
            sd_px=_finite_or_none(measure.sd_px),
            rmsd_px=_finite_or_none(measure.rmsd_px),
            pose_offset_deg=None if offset is None else _float_triple(offset.rotation_deg[0]),
            pose_offset_sigma_deg=None
            if offset is None
            else _float_triple(np.sqrt(np.diag(offset.covariance_deg2[0]))),
        )

    def _measure_pose_offset(self, columns: SunPointColumns) -> DailyRotations | None:
        """Return a day's rotation against the current calibration, where that is of the day's last pose epoch."""
        current = self.camera.archive.calibrations.current(self.camera.name)
        if current is None or not columns.epoch_ids or current.pose_epoch != columns.epoch_ids[-1]:
            return None
        calibration = self.camera.archive.calibrations.current_model(self.camera.name)
        if calibration is None:
            return None
        last = columns.select(columns.epoch == len(columns.epoch_ids) - 1)
        return daily_pose_offset(columns_to_sightings(last), calibration=calibration, site=self.camera.site)

    def _store_day(self, day: Day) -> None:
        self.camera.archive.days.save(day)
        offsets = {"pose_offset_deg": day.pose_offset_deg, "pose_offset_sigma_deg": day.pose_offset_sigma_deg}
        numbers = {key: value for key, value in asdict(day).items() if isinstance(value, int | float)}
        why = {"date": f"{day.date}", "verdict": day.verdict, "reasons": "; ".join(day.reasons)}
        found, details = Finding("day", {**numbers, **why}), {key: value for key, value in offsets.items() if value}
        self.camera.add_event(found, time=day.decided_at, severity="info", details=details)


def _float_triple(values: FloatArray) -> tuple[float, float, float]:
    east, north, up = values.tolist()
    return east, north, up


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
