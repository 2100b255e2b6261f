"""A hub's work by night: summaries of solar days, cross-checks, retention, and how the last nights went."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, date, datetime
from typing import Annotated, Any, Literal

from pydantic import TypeAdapter, ValidationError
from sqlalchemy import BigInteger, Connection, Row, and_, bindparam, case, delete, func, or_, select, text

from sunarc.changes.values import FleetCause
from sunarc.common.utc import to_microseconds, utc_time
from sunarc.hub.feeds import stated_sky_rms
from sunarc.imager.archive.database.store import Part, given, upsert
from sunarc.imager.archive.database.tables import calibration, camera, day, day_summary, event, nightly_run, sun_point
from sunarc.imager.archive.day_digests import LEAST_KEPT
from sunarc.imager.runtime.json_fields import EXAMPLE_TIME, Returned, SolarDate, Time, described
from sunarc.sky.days import day_bounds_unix_s

Found = FleetCause | Literal["clock_by_clouds", "unconfirmed"]
NO_ALARMS: frozenset[Found] = frozenset({"slow_turn", "unconfirmed"})
"""Causes that are found and that nobody has to correct."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossCheck(Returned):
    """Result of a camera's neighbours about it."""

    camera: Annotated[str, described("Its name.", "roof")]
    neighbours: Annotated[tuple[str, ...], described("Cameras it was compared with.", ["mast", "gate"])]
    n_days: Annotated[int, described("Days that showed how it stood turned, a count.", 34)]
    found: Annotated[
        tuple[Found, ...],
        described(
            "What is wrong or changed; empty: nothing. `clock_by_clouds`: edges of clouds come early or late. "
            "`unconfirmed`: a change that fewer than three neighbours show, or no more than half of all. This and "
            "`slow_turn` are no alarms."
        ),
    ]
    agreeing: Annotated[int, described("Neighbours of which each shows it by itself, a count.", 5)] = 0
    confidence: Annotated[
        float | None, described("Probability of the cause among all that were weighed, no change among them.", 0.98)
    ] = None
    since: Annotated[date | None, described("First solar date after a step of its rotation.", "2026-06-26")] = None
    clock_s: Annotated[float | None, described("The step, as a clock that is ahead, s; the same as:", 2.1)] = None
    clock_sigma_s: Annotated[float | None, described("Its 1-sigma, s.", 0.2)] = None
    longitude_deg: Annotated[float | None, described("as a longitude stated too far east.", 0.0088)] = None
    longitude_sigma_deg: Annotated[float | None, described("Its 1-sigma, degrees.", 0.0008)] = None
    north_deg: Annotated[float | None, described("The step about the vertical, counter-clockwise.", 0.1)] = None
    north_sigma_deg: Annotated[float | None, described("Its 1-sigma, degrees.", 0.001)] = None
    rotation_deg: Annotated[tuple[float, ...] | None, described("About east, north and up.", [0.0, 0.0, 0.1])] = None
    rotation_sigma_deg: Annotated[tuple[float, ...] | None, described("1-sigma of each.", [0.001] * 3)] = None
    cloud_clock_s: Annotated[
        float | None,
        described("By how much its clock is ahead if its neighbours' are right, by edges of clouds, s.", 1.5),
    ] = None
    cloud_clock_sigma_s: Annotated[float | None, described("Its 1-sigma, mostly of the wind, s.", 12.0)] = None

    @property
    def alarms(self) -> tuple[Found, ...]:
        """Results that somebody has to correct."""
        return tuple(one for one in self.found if one not in NO_ALARMS)

    def as_json(self) -> dict[str, Any]:
        """Return the fields by name, as JSON has them."""
        return asdict(self) | {"since": None if self.since is None else self.since.isoformat()}


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossChecks(Returned):
    """The newest cross-checks of a fleet."""

    night: Annotated[date | None, described("Solar date of the night that made them; null: none did.", "2026-06-30")]
    time: Annotated[Time | None, described("When that night's work began.", EXAMPLE_TIME)]
    checks: Annotated[tuple[CrossCheck, ...], described("Cameras with alarms first, then those that turn slowly.")]


_CHECK: TypeAdapter[CrossCheck] = TypeAdapter(CrossCheck)


def checks_from_json(stored: object) -> tuple[CrossCheck, ...] | None:
    """Return the checks that a night stored, alarms first; None where it stored none.

    A check that cannot be read, as one of a newer hub with another word, is left out.
    """
    rows = stored.get("checks") if isinstance(stored, Mapping) else None
    if not isinstance(rows, list):
        return None
    return tuple(sorted(_parse_checks(rows), key=lambda one: (not one.alarms, not one.found, one.camera)))


def _parse_checks(rows: Iterable[object]) -> Iterable[CrossCheck]:
    for row in rows:
        try:
            yield _CHECK.validate_python(row)
        except ValidationError:
            continue


_NIGHTS = 31
"""Nights among which the newest cross-checks are looked for."""
_AT_ONCE = 200
"""Days that are summarised in one transaction: feeds of the same camera wait for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DaySummary(Returned):
    """A camera's solar day, as the hub has it."""

    camera: Annotated[str, described("Its name.", "imager")]
    date: SolarDate
    verdict: Annotated[str, described("The imager's.", "clear")]
    n_sightings: Annotated[int, described("Sightings stored, a count.", 2880)]
    n_accepted: Annotated[int, described("Accepted ones of them.", 1440)]
    clock_error_s: Annotated[float | None, described("Largest bound of the clock's error, s.", 0.01)] = None
    temperature_c: Annotated[
        float | None, described("Mean of the air's that was measured with sightings, degrees Celsius.", 31.5)
    ] = None
    n_warnings: Annotated[int, described("Events that are warnings or alarms, a count.", 0)] = 0
    calibration: Annotated[str | None, described("The one that answers for the day's end.", "20130514T…")] = None
    sky_rms_deg: Annotated[float | None, described("Its 1-sigma over the sky (RMS), degrees.", 0.01)] = None
    pose_offset_deg: Annotated[float | None, described("Rotation against the calibration, degrees.", 0.003)] = None
    decided_at: Annotated[Time, described("When the imager judged the day.", EXAMPLE_TIME)]


@dataclass(frozen=True, slots=True, kw_only=True)
class NightlyRun(Returned):
    """Run of the work of a night."""

    night: Annotated[date, described("Its solar date at the fleet's mean longitude.", "2013-05-13")]
    started_at: Time
    finished_at: Annotated[Time | None, described("Null while it runs, or where it was cut off.", EXAMPLE_TIME)] = None
    results: Annotated[
        Mapping[str, Any],
        described("By job: what it did; `error` where it failed.", {"summaries": {"days": 50}}),
    ]

    @property
    def failed(self) -> dict[str, str]:
        """The errors of the jobs that failed, by name."""
        return {
            str(job): str(result["error"])
            for job, result in self.results.items()
            if isinstance(result, Mapping) and "error" in result
        }


class NightlyStore(Part):
    """Store of a hub's work by night."""

    def summarise_days(self) -> int:
        """Summarise the judged days that have no summary, or were judged anew since, and return how many.

        An imager sends a day after its sightings: what comes late, comes with a day that has no summary yet.
        """
        s, d = day_summary.c, day.c
        same = and_(s.camera == d.camera, s.date == d.date, s.decided_at == d.decided_at)
        missing = (
            select(d.camera, d.date, d.verdict, d.decided_at, d.pose_offset_deg, camera.c.longitude)
            .join(camera, camera.c.name == d.camera)
            .outerjoin(day_summary, same)
            .where(s.camera.is_(None))
            .order_by(d.date.desc(), d.camera)
            .limit(_AT_ONCE)
        )
        n = 0
        while True:
            with self._database.writing() as connection:
                rows = connection.execute(missing).all()
                for row in rows:
                    upsert(connection, day_summary, _make_summary(connection, row), key=["camera", "date"])
            n += len(rows)
            if len(rows) < _AT_ONCE:
                return n

    def summaries(
        self, camera_name: str | None, *, since: date | None = None, until: date | None = None, limit: int | None = None
    ) -> tuple[DaySummary, ...]:
        """Return the summaries of days with `since` <= date < `until`, the newest first; None does not filter."""
        c = day_summary.c
        filters = given((c.camera.__eq__, camera_name), (c.date.__ge__, since), (c.date.__lt__, until))
        order = (c.date.desc(), c.camera)
        return self._database.records(select(day_summary).where(*filters).order_by(*order).limit(limit), DaySummary)

    def remove_sightings(self, *, before: datetime, now: datetime) -> int:
        """Remove the sightings of the months that ended before a time, and return how many months (SQLite: rows).

        On PostgreSQL their partitions are dropped, by a function that refuses what is younger than 90 days.
        """
        before = min(before, now - LEAST_KEPT)
        month = datetime(before.year, before.month, 1, tzinfo=UTC)
        with self._database.writing() as connection:
            if self._database.months is None:
                return connection.execute(delete(sun_point).where(sun_point.c.time < month)).rowcount
            drop = text("SELECT sunarc_drop_months(:before)").bindparams(bindparam("before", type_=BigInteger))
            n = int(connection.execute(drop, {"before": to_microseconds(month)}).scalar() or 0)
        self._database.months.forget()
        return n

    def mean_longitude(self) -> float:
        """Return the mean longitude of the cameras, degrees; 0 without any, or where they surround the earth."""
        with self._database.reading() as connection:
            found = connection.scalars(select(camera.c.longitude)).all()
        return _mean_angle_deg([float(one) for one in found])

    def save(self, run: NightlyRun) -> None:
        """Save the progress of a night's work, in place of the saved one."""
        row = {name: getattr(run, name) for name in ("night", "started_at", "finished_at")}
        with self._database.writing() as connection:
            upsert(connection, nightly_run, {**row, "results": dict(run.results)}, key=["night"])

    def runs(self, *, limit: int, until: date | None = None) -> tuple[NightlyRun, ...]:
        """Return how the last nights up to and with `until` went, the newest first."""
        c = nightly_run.c
        statement = select(nightly_run).where(*given((c.night.__le__, until)))
        return self._database.records(statement.order_by(c.night.desc()).limit(limit), NightlyRun)

    def cross_checks(self) -> CrossChecks:
        """Return the cross-checks of the newest night that made some."""
        for limit in (1, _NIGHTS):  # the newest has them, but while it runs, or where it failed
            for run in self.runs(limit=limit):
                checks = checks_from_json(run.results.get("cross_checks"))
                if checks is not None:
                    return CrossChecks(night=run.night, time=run.started_at, checks=checks)
        return CrossChecks(night=None, time=None, checks=())


def _make_summary(connection: Connection, judged: Row[Any, Any, Any, Any, Any, Any]) -> dict[str, Any]:
    """Return the columns of the summary of a judged day."""
    first, after = map(utc_time, day_bounds_unix_s(judged.date, longitude=judged.longitude))
    s, e, c = sun_point.c, event.c, calibration.c
    sightings = (
        connection.execute(
            select(
                func.count().label("n_sightings"),
                func.coalesce(func.sum(case((s.accepted, 1), else_=0)), 0).label("n_accepted"),
                func.max(s.clock_error_s).label("clock_error_s"),
                func.avg(s.temperature_c).label("temperature_c"),
            ).where(s.camera == judged.camera, s.time >= first, s.time < after)
        )
        .mappings()
        .one()
    )
    warnings = select(func.count()).where(
        e.camera == judged.camera, e.time >= first, e.time < after, e.severity != "info"
    )
    answers = and_(c.valid_from < after, or_(c.valid_until.is_(None), c.valid_until >= after))
    answering = connection.execute(
        select(c.id, c.document)
        .where(c.camera == judged.camera, c.state.in_(("current", "retired")), answers)
        .order_by(c.valid_from.desc())
        .limit(1)
    ).one_or_none()
    offset = judged.pose_offset_deg
    return {
        **sightings,
        "camera": judged.camera,
        "date": judged.date,
        "verdict": judged.verdict,
        "decided_at": judged.decided_at,
        "n_warnings": connection.scalar(warnings) or 0,
        "calibration": None if answering is None else answering.id,
        "sky_rms_deg": None if answering is None else stated_sky_rms(answering.document),
        "pose_offset_deg": None if offset is None else math.hypot(*offset),
    }


def _mean_angle_deg(angles_deg: list[float]) -> float:
    """Return the mean direction of angles, degrees; 0 of none."""
    angles = [math.radians(one) for one in angles_deg]
    return math.degrees(math.atan2(sum(map(math.sin, angles)), sum(map(math.cos, angles))))
