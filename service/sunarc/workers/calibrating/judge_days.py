"""Evaluation of completed solar days without a verdict; idempotent, so that missed days are evaluated later."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from datetime import date, datetime

import numpy as np

from sunarc.archive.camera_archive import CameraArchive
from sunarc.archive.values import Day, Refit, SunPointColumns
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.calibration.pose.daily_offset import PoseOffset, daily_pose_offset
from sunarc.calibration.quality.day_quality import DOUBTFUL_CLOCK_SHARE, decide_day, measure_day
from sunarc.findings import Finding
from sunarc.sky.days import day_bounds_unix_s, solar_date
from sunarc.sky.sun import sun_angles
from sunarc.utc import utc_time
from sunarc.workers.fit_input import points_of
from sunarc.workers.messages import MESSAGES

_WORTH_A_REFIT = frozenset({"clear", "partly"})


class DayJudge:
    """Evaluates each completed day, and requests a refit after one that shows the sun.

    Parameters
    ----------
    camera : its archive and site.
    cadence_s, sun_zenith_deg : how often, and down to where, the sun is looked at.
    now : frame time.
    request_refit : asks for a refit, with the reason.
    """

    def __init__(
        self,
        camera: CameraArchive,
        *,
        cadence_s: float,
        sun_zenith_deg: float,
        now: Callable[[], datetime],
        request_refit: Callable[[str], Refit],
    ) -> None:
        self._camera = camera
        self._cadence_s = cadence_s
        self._sun_zenith_deg = sun_zenith_deg
        self._now = now
        self._request_refit = request_refit
        self._judged_before: date | None = None

    def judge_ended_days(self) -> list[Day]:
        """Judge what is due and return the verdicts; one refit is asked for, however many days were clear."""
        longitude = self._camera.site.longitude
        today = solar_date(self._now().timestamp(), longitude=longitude)
        if self._judged_before is not None and self._judged_before > today:
            self._judged_before = None  # the time went back
        judged = {day.date for day in self._camera.days(since=self._judged_before) if self._stands(day)}
        observed = self._camera.dates_with_points(longitude=longitude, since=self._judged_before)
        verdicts = [self._measure(day) for day in observed if day < today and day not in judged]
        worth = [day for day in verdicts if day.verdict in _WORTH_A_REFIT]
        if worth:
            self._request_refit("after " + ", ".join(f"{day.date} ({day.verdict})" for day in worth))
        for day in verdicts:
            self._remember(day)
        self._judged_before = today
        return verdicts

    def _stands(self, day: Day) -> bool:
        """Return whether a verdict was given after its day had ended and before now: else a wrong clock gave it."""
        end = utc_time(day_bounds_unix_s(day.date, longitude=self._camera.site.longitude)[1])
        return end <= day.decided_at <= self._now()

    def _measure(self, date_: date) -> Day:
        start, end = day_bounds_unix_s(date_, longitude=self._camera.site.longitude)
        since, until = utc_time(start), utc_time(end)
        columns = self._camera.sun_point_columns(since=since, until=until)
        doubtful = np.nan_to_num(columns.clock_error_s) > MAX_CLOCK_ERROR_S
        share = float(np.mean(doubtful)) if doubtful.size else 0.0
        largest_s = MAX_CLOCK_ERROR_S if share <= DOUBTFUL_CLOCK_SHARE else None
        if largest_s is not None:  # else the day is judged by its clock
            columns = columns.select(~doubtful)
        frames = np.arange(start, end, self._cadence_s)
        up = sun_angles(frames, self._camera.site).apparent_zenith < self._sun_zenith_deg
        measure = measure_day(
            points_of(columns),
            site=self._camera.site,
            n_possible=int(np.count_nonzero(up)),
            observed_unix_s=self._camera.observation_times(since=since, until=until, largest_clock_error_s=largest_s),
            cadence_s=self._cadence_s,
        )
        measure = replace(measure, doubtful_clock=share)
        decided = decide_day(measure)
        offset = self._pose_offset(columns) if decided.kind in _WORTH_A_REFIT else None
        return Day(
            camera=self._camera.name,
            date=date_,
            verdict=decided.kind,
            findings=decided.findings,
            n=measure.n,
            n_cycles=measure.n_cycles,
            n_possible=measure.n_possible,
            n_observed=measure.n_observed,
            decided_at=self._now(),
            arc_deg=measure.arc_deg,
            solid_angle_sr=measure.solid_angle_sr,
            doubtful_clock=_finite(measure.doubtful_clock),
            sd_px=_finite(measure.sd_px),
            rmsd_px=_finite(measure.rmsd_px),
            pose_offset_deg=None if offset is None else offset.turn_deg,
            pose_offset_sigma_deg=None if offset is None else offset.sigma_deg,
        )

    def _pose_offset(self, columns: SunPointColumns) -> PoseOffset | None:
        """Return how the camera stood turned against the current calibration, where that is of the day's last epoch."""
        current = self._camera.current_calibration()
        if current is None or not columns.epoch_ids or current.pose_epoch != columns.epoch_ids[-1]:
            return None
        calibration = self._camera.current_model()
        if calibration is None:
            return None
        last = columns.select(columns.epoch == len(columns.epoch_ids) - 1)
        return daily_pose_offset(points_of(last), calibration=calibration, site=self._camera.site)

    def _remember(self, day: Day) -> None:
        self._camera.archive.save_day(day)
        offsets = {"pose_offset_deg": day.pose_offset_deg, "pose_offset_sigma_deg": day.pose_offset_sigma_deg}
        numbers = {key: value for key, value in asdict(day).items() if isinstance(value, int | float)}
        why = {"date": f"{day.date}", "verdict": day.verdict, "reasons": "; ".join(day.reasons)}
        found, details = Finding("day", {**numbers, **why}), {key: value for key, value in offsets.items() if value}
        self._camera.add_event(found, MESSAGES, time=day.decided_at, severity="info", details=details)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
