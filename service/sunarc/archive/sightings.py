"""Cameras, their pose epochs, and the sightings made in them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, replace
from datetime import date, datetime

from sqlalchemy import (
    ColumnElement,
    Connection,
    Engine,
    func,
    insert,
    or_,
    select,
    text,
    update,
)

from sunarc.archive import tables
from sunarc.archive.columns import CandidateColumns, listed, read_candidates, read_columns, read_levels, read_times
from sunarc.archive.file import DatabaseFile
from sunarc.archive.rows import insert_new, upsert
from sunarc.archive.sighting_revisions import FROZEN
from sunarc.archive.store import Store, given, values_of
from sunarc.archive.tables import sun_point
from sunarc.archive.validity import SERVED
from sunarc.archive.values import CameraRecord, PoseEpoch, SunPoint, SunPointColumns
from sunarc.array_types import FloatArray, IntArray
from sunarc.errors import InputError
from sunarc.sky.days import SECONDS_PER_DEGREE, day_bounds_unix_s, solar_date
from sunarc.sky.night import SUN
from sunarc.utc import DAY_S

_FIRST_OF_EACH_DAY = text(
    """
    WITH RECURSIVE first(time) AS (
        SELECT min(time) FROM sun_point WHERE camera = :camera AND time >= :since AND body = 'sun'
        UNION ALL
        SELECT (
            SELECT min(time) FROM sun_point
            WHERE camera = :camera AND time >= ((first.time + :ahead) / :day + 1) * :day - :ahead AND body = 'sun'
        )
        FROM first WHERE first.time IS NOT NULL
    )
    SELECT time FROM first WHERE time IS NOT NULL
    """
)
"""One index lookup a day; five years take milliseconds."""


class Sightings(Store):
    """The part of the archive with cameras, pose epochs and sightings."""

    def __init__(self, engine: Engine, file: DatabaseFile | None) -> None:
        super().__init__(engine, file)
        self._saved: dict[str, CameraRecord] = {}

    def save_camera(self, record: CameraRecord) -> None:
        """Write a camera down, in place of what was known of the same name."""
        with self._writing() as connection:
            upsert(connection, tables.camera, asdict(record), key=["name"])
        self._saved = {**self._saved, record.name: record}

    def saved_cameras(self) -> tuple[CameraRecord, ...]:
        """Return the cameras that were written down by this object."""
        return tuple(self._saved.values())

    def cameras(self) -> tuple[CameraRecord, ...]:
        """Return the known cameras by name."""
        return self._values(select(tables.camera).order_by(tables.camera.c.name), CameraRecord)

    def camera(self, name: str) -> CameraRecord | None:
        """Return the camera of a name; None where it is not known."""
        return next(iter(self._values(select(tables.camera).where(tables.camera.c.name == name), CameraRecord)), None)

    def open_epoch(self, camera: str, *, at: datetime, reason: str) -> PoseEpoch:
        """Begin a new pose epoch: the one before ends, and sightings from `at` on move to the new one."""
        epochs = tables.pose_epoch.c
        # Read under the write lock, so that no other thread opens an epoch between the check and the row.
        with self._writing() as connection:
            statement = select(tables.pose_epoch).where(epochs.camera == camera)
            before = values_of(connection, statement, PoseEpoch)
            # a closed epoch has no duration, but its beginning stays unique
            if any(e.started_at >= at for e in before if e.ended_at != e.started_at or e.started_at == at):
                raise InputError(
                    field="at", problem="a pose epoch began at that time or later", remedy="give a later time"
                )
            epoch = PoseEpoch(id=_next_id(connection, camera), camera=camera, started_at=at, reason=reason)
            closing = update(tables.pose_epoch).where(epochs.camera == camera, epochs.ended_at.is_(None))
            connection.execute(closing.values(ended_at=at))
            connection.execute(insert(tables.pose_epoch).values(asdict(epoch)))
            moving = update(sun_point).where(sun_point.c.camera == camera, sun_point.c.time >= at)
            connection.execute(moving.values(pose_epoch=epoch.id))
        return epoch

    def split_epoch(self, camera: str, *, at: datetime, reason: str) -> tuple[PoseEpoch, PoseEpoch]:
        """Divide the pose epoch that `at` lies in, and return both parts; sightings go with their part.

        The part that calibrations answered for keeps the id: the later one where they all answer from `at` on, else
        the earlier one.

        Raises
        ------
        InputError : no epoch has `at` within it, or one that began at `at` was closed as wrong.
        """
        epochs = tables.pose_epoch.c
        with self._writing() as connection:
            statement = select(tables.pose_epoch).where(epochs.camera == camera).order_by(epochs.started_at)
            every = values_of(connection, statement, PoseEpoch)
            begun = [
                epoch for epoch in every if epoch.started_at < at and (epoch.ended_at is None or at < epoch.ended_at)
            ]
            if not begun:
                raise InputError(field="at", problem="not within a pose epoch", remedy="give a time within one")
            if any(epoch.started_at == at for epoch in every):
                raise InputError(
                    field="at",
                    problem="an epoch that began at that time was closed as wrong",
                    remedy="give another time",
                )
            divided, new = begun[-1], _next_id(connection, camera)
            first = _first_answered(connection, divided.id)
            keeps_later = first is not None and first >= at
            earlier = replace(divided, id=new if keeps_later else divided.id, ended_at=at)
            later = replace(divided, id=divided.id if keeps_later else new, started_at=at, reason=reason)
            remaining, added = (later, earlier) if keeps_later else (earlier, later)
            connection.execute(update(tables.pose_epoch).where(epochs.id == divided.id).values(asdict(remaining)))
            connection.execute(insert(tables.pose_epoch).values(asdict(added)))
            side = sun_point.c.time < at if keeps_later else sun_point.c.time >= at
            moving = update(sun_point).where(sun_point.c.camera == camera, sun_point.c.pose_epoch == divided.id, side)
            connection.execute(moving.values(pose_epoch=new))
        return earlier, later

    def epoch_at(self, camera: str, at: datetime, *, reason: str) -> PoseEpoch:
        """Return the pose epoch of a moment; the first one reaches back to the earliest moment asked for."""
        return self.current_epoch(camera, at=at) or self._first_epoch(camera, at, reason)

    def current_epoch(self, camera: str, *, at: datetime | None = None) -> PoseEpoch | None:
        """Return the pose epoch that goes on, or the one of the moment `at`; None before the first."""
        epochs = tables.pose_epoch.c
        newest = select(tables.pose_epoch).where(epochs.camera == camera, not_closed())
        newest = newest.order_by(epochs.started_at.desc()).limit(1)
        found = self._values(newest if at is None else newest.where(epochs.started_at <= at), PoseEpoch)
        return found[0] if found else None

    def epochs(self, camera: str, *, include_closed: bool = False) -> tuple[PoseEpoch, ...]:
        """Return a camera's pose epochs, the first one first; those closed by an operator only if asked."""
        epochs = tables.pose_epoch.c
        filters = [epochs.camera == camera, *([] if include_closed else [not_closed()])]
        return self._values(select(tables.pose_epoch).where(*filters).order_by(epochs.started_at), PoseEpoch)

    def _first_epoch(self, camera: str, at: datetime, reason: str) -> PoseEpoch:
        epochs = tables.pose_epoch.c
        with self._writing() as connection:
            statement = select(tables.pose_epoch).where(epochs.camera == camera, not_closed())
            statement = statement.order_by(epochs.started_at).limit(1)
            first = values_of(connection, statement, PoseEpoch)
            if not first:
                epoch = PoseEpoch(id=f"{camera}-1", camera=camera, started_at=at, reason=reason)
                connection.execute(insert(tables.pose_epoch).values(asdict(epoch)))
                return epoch
            earlier = min(at, first[0].started_at)
            connection.execute(update(tables.pose_epoch).where(epochs.id == first[0].id).values(started_at=earlier))
            return replace(first[0], started_at=earlier)

    def add_sun_points(self, points: Iterable[SunPoint]) -> int:
        """Store sightings and return how many were new; one that is there already is left as it is."""
        rows = [asdict(point) for point in points]
        if not rows:
            return 0
        self._prepare_months([row["time"] for row in rows])
        with self._writing() as connection:
            return insert_new(connection, sun_point, rows)

    def widen_clock_errors(self, camera: str, *, since: datetime, until: datetime, error_s: float) -> int:
        """Widen the bound of the clock's error of sightings with `since` <= time <= `until`; return how many."""
        c = sun_point.c
        doubted = [c.camera == camera, c.time >= since, c.time <= until, func.coalesce(c.clock_error_s, 0.0) < error_s]
        with self._writing() as connection:
            return connection.execute(update(sun_point).where(*doubted).values(clock_error_s=error_s)).rowcount

    def sun_points(
        self,
        camera: str,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        accepted: bool | None = None,
        pose_epoch: str | None = None,
        body: str | None = SUN,
        largest_clock_error_s: float | None = None,
        newest_first: bool = False,
        limit: int | None = None,
    ) -> tuple[SunPoint, ...]:
        """Return sightings with `since` <= time < `until`, in the order of their times; None does not filter.

        Of the sun unless another `body` is named.
        """
        c = sun_point.c
        filters = _filters(camera, since=since, until=until, accepted=accepted, pose_epoch=pose_epoch)
        filters += [*_clock_within(largest_clock_error_s), *given((c.body.__eq__, body))]
        fields = [column for column in c if column.name != "id"]
        order = (c.time.desc(), c.id.desc()) if newest_first else (c.time, c.id)
        return self._values(select(*fields).where(*filters).order_by(*order).limit(limit), SunPoint)

    def sun_point_columns(
        self,
        camera: str,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        pose_epoch: str | None = None,
        method: str | None = None,
        body: str | None = SUN,
        no_sun: bool = False,
        of_files: bool = False,
        largest_clock_error_s: float | None = None,
        after_id: int | None = None,
    ) -> SunPointColumns:
        """Return the accepted sightings with `since` <= time < `until` as columns, for a fit; None does not filter.

        With `no_sun` only those of other bodies, with `of_files` only those in image files, with `after_id` only those
        stored since the one of that key.
        """
        c = sun_point.c
        # no column, so that SQLite finds the few new rows by their keys, and does not read all of the camera by theirs
        of_camera = c.camera.__eq__ if after_id is None else c.camera.concat("").__eq__
        filters = _filters(None, since=since, until=until, accepted=True, pose_epoch=pose_epoch)
        filters += [of_camera(camera), *_clock_within(largest_clock_error_s)]
        filters += given((c.body.__eq__, body), (c.method.__eq__, method), (c.file.__ne__, "" if of_files else None))
        filters += given((c.id.__gt__, after_id), (c.body.__ne__, SUN if no_sun else None))
        with self._reading() as connection:
            return read_columns(connection, camera, filters, others=body != SUN)

    def sun_candidates(
        self, camera: str, *, since: datetime | None = None, until: datetime | None = None
    ) -> CandidateColumns:
        """Return what decides which of the accepted sightings of the sun a fit uses; see `sightings_of_ids`."""
        with self._reading() as connection:
            return read_candidates(connection, camera, _filters(camera, since=since, until=until, accepted=True))

    def sightings_of_ids(self, camera: str, ids: IntArray) -> SunPointColumns:
        """Return the sightings of a camera with these keys, in the order of time; without those that are gone."""
        with self._reading() as connection:
            return read_columns(connection, camera, [listed(connection, ids)])

    def newest_sighting_time(self, camera: str, *, largest_clock_error_s: float) -> datetime | None:
        """Return the time of the newest sighting whose clock error bound is within a limit; None without one."""
        c = sun_point.c
        newest = select(c.time).where(c.camera == camera, *_clock_within(largest_clock_error_s))
        with self._reading() as connection:
            return connection.scalar(newest.order_by(c.time.desc()).limit(1))

    def observation_times(
        self, camera: str, *, since: datetime, until: datetime, largest_clock_error_s: float | None = None
    ) -> FloatArray | None:
        """Return when sun exposures were taken, with a sighting or without, s since 1970-01-01 UTC (n,).

        None where sightings were imported: a file of sightings does not tell when there was an exposure without one.
        Exposures whose clock may be wrong by more than `largest_clock_error_s` are left out, and images that the camera
        had delivered before (`FROZEN`): they show another moment's sky.
        """
        c = sun_point.c
        filters = [*_filters(camera, since=since, until=until), *_clock_within(largest_clock_error_s)]
        filters += [c.body == SUN, c.verdict != FROZEN]
        with self._reading() as connection:
            imported = select(c.id).where(*filters, c.method == "import").limit(1)
            if connection.scalar(imported) is not None:
                return None
            return read_times(connection, filters)

    def sun_levels(
        self, camera: str, *, since: datetime, until: datetime, largest_clock_error_s: float | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the accepted discs' times (unix seconds) and levels over full scale in 1 µs, background subtracted.

        A saturated disc's level is what the fit made of its edges; above 100 times full scale it counts as that.
        """
        c = sun_point.c
        filters = _filters(camera, since=since, until=until, accepted=True) + _clock_within(largest_clock_error_s)
        filters += [c.method == "disc", c.body == SUN]
        with self._reading() as connection:
            return read_levels(connection, filters)

    def dates_with_points(self, camera: str, *, longitude: float, since: date | None = None) -> tuple[date, ...]:
        """Return the solar dates (from `since` on) on which the sun was looked at, accepted or not."""
        values = {
            "camera": camera,
            "since": 0 if since is None else round(1e6 * day_bounds_unix_s(since, longitude=longitude)[0]),
            "day": round(1e6 * DAY_S),
            "ahead": round(1e6 * longitude * SECONDS_PER_DEGREE),
        }
        with self._reading() as connection:
            times = connection.scalars(_FIRST_OF_EACH_DAY, values).all()
        return tuple(solar_date(time / 1e6, longitude=longitude) for time in times)


def _next_id(connection: Connection, camera: str) -> str:
    """Return an id for a new pose epoch; rows that cannot be read are counted, for their ids are taken."""
    count = select(func.count()).select_from(tables.pose_epoch).where(tables.pose_epoch.c.camera == camera)
    return f"{camera}-{(connection.scalar(count) or 0) + 1}"


def _first_answered(connection: Connection, pose_epoch: str) -> datetime | None:
    """Return from when on a calibration of a pose epoch answered; None where none did."""
    c = tables.calibration.c
    filters = (c.pose_epoch == pose_epoch, c.state.in_(SERVED))
    return connection.scalar(select(c.valid_from).where(*filters).order_by(c.valid_from).limit(1))


def _filters(
    camera: str | None,
    *,
    since: datetime | None = None,
    until: datetime | None = None,
    accepted: bool | None = None,
    pose_epoch: str | None = None,
) -> list[ColumnElement[bool]]:
    c = sun_point.c
    return given(
        (c.camera.__eq__, camera),
        (c.time.__ge__, since),
        (c.time.__lt__, until),
        (c.accepted.__eq__, accepted),
        (c.pose_epoch.__eq__, pose_epoch),
    )


def not_closed() -> ColumnElement[bool]:
    """Return the condition that a pose epoch has a duration: one that was closed as wrong ends where it began."""
    epochs = tables.pose_epoch.c
    return or_(epochs.ended_at.is_(None), epochs.ended_at > epochs.started_at)


def _clock_within(largest_s: float | None) -> list[ColumnElement[bool]]:
    """Return the condition that a sighting's clock error bound, where one is known, is within a limit."""
    return [] if largest_s is None else [func.coalesce(sun_point.c.clock_error_s, 0.0) <= largest_s]
