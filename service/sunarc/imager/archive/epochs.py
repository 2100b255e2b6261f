"""Pose epochs: the intervals in which a camera did not move."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

from sqlalchemy import ColumnElement, Connection, func, insert, or_, select, update

from sunarc.common.errors import InputError
from sunarc.imager.archive.calibration_rows import SERVED
from sunarc.imager.archive.database import tables
from sunarc.imager.archive.database.store import Part, read_records
from sunarc.imager.archive.database.tables import sun_point
from sunarc.imager.archive.values import PoseEpoch, SunPoint, field_values

LENS_CHANGED = "lens"
"""Reason of a pose epoch that also has another lens: nothing from before says anything of it."""


class EpochStore(Part):
    """The pose epochs of cameras."""

    def open(self, camera: str, *, at: datetime, reason: str) -> PoseEpoch:
        """Begin a new pose epoch: the one before ends, and sightings from `at` on move to the new one."""
        epochs = tables.pose_epoch.c
        # Read under the write lock, so that no other thread opens an epoch between the check and the row.
        with self._database.writing() as connection:
            statement = select(tables.pose_epoch).where(epochs.camera == camera)
            before = read_records(connection, statement, PoseEpoch)
            # a closed epoch has no duration, but its beginning stays unique
            if any(e.started_at >= at for e in before if e.ended_at != e.started_at or e.started_at == at):
                raise InputError(
                    field="at", problem="a pose epoch began at that time or later", remedy="give a later time"
                )
            epoch = PoseEpoch(id=_make_epoch_id(connection, camera), camera=camera, started_at=at, reason=reason)
            closing = update(tables.pose_epoch).where(epochs.camera == camera, epochs.ended_at.is_(None))
            connection.execute(closing.values(ended_at=at))
            connection.execute(insert(tables.pose_epoch).values(field_values(epoch)))
            moving = update(sun_point).where(sun_point.c.camera == camera, sun_point.c.time >= at)
            connection.execute(moving.values(pose_epoch=epoch.id))
        return epoch

    def split(self, camera: str, *, at: datetime, reason: str) -> tuple[PoseEpoch, PoseEpoch]:
        """Divide the pose epoch that `at` lies in, and return both parts; sightings go with their part.

        The part that calibrations answered for keeps the id: the later one where they all answer from `at` on, else
        the earlier one.

        Raises
        ------
        InputError : no epoch has `at` within it, or one that began at `at` was closed as wrong.
        """
        epochs = tables.pose_epoch.c
        with self._database.writing() as connection:
            statement = select(tables.pose_epoch).where(epochs.camera == camera).order_by(epochs.started_at)
            every = read_records(connection, statement, PoseEpoch)
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
            divided, new = begun[-1], _make_epoch_id(connection, camera)
            first = _read_first_answer_time(connection, divided.id)
            keeps_later = first is not None and first >= at
            earlier = replace(divided, id=new if keeps_later else divided.id, ended_at=at)
            later = replace(divided, id=divided.id if keeps_later else new, started_at=at, reason=reason)
            remaining, added = (later, earlier) if keeps_later else (earlier, later)
            connection.execute(update(tables.pose_epoch).where(epochs.id == divided.id).values(field_values(remaining)))
            connection.execute(insert(tables.pose_epoch).values(field_values(added)))
            side = sun_point.c.time < at if keeps_later else sun_point.c.time >= at
            moving = update(sun_point).where(sun_point.c.camera == camera, sun_point.c.pose_epoch == divided.id, side)
            connection.execute(moving.values(pose_epoch=new))
        return earlier, later

    def at(self, camera: str, at: datetime, *, reason: str) -> PoseEpoch:
        """Return the pose epoch of a moment; the first one reaches back to the earliest moment asked for."""
        with self._database.writing() as connection:
            return _epoch_at(connection, camera, at, reason)

    def current(self, camera: str, *, at: datetime | None = None) -> PoseEpoch | None:
        """Return the pose epoch that goes on, or the one of the moment `at`; None before the first."""
        epochs = tables.pose_epoch.c
        newest = select(tables.pose_epoch).where(epochs.camera == camera, not_closed())
        newest = newest.order_by(epochs.started_at.desc()).limit(1)
        found = self._database.records(newest if at is None else newest.where(epochs.started_at <= at), PoseEpoch)
        return found[0] if found else None

    def find(self, camera: str, *, include_closed: bool = False) -> tuple[PoseEpoch, ...]:
        """Return a camera's pose epochs, the first one first; those closed by an operator only if asked."""
        epochs = tables.pose_epoch.c
        filters = [epochs.camera == camera, *([] if include_closed else [not_closed()])]
        return self._database.records(select(tables.pose_epoch).where(*filters).order_by(epochs.started_at), PoseEpoch)


def _epoch_at(connection: Connection, camera: str, at: datetime, reason: str) -> PoseEpoch:
    """Return the pose epoch of a moment; the first one is opened, or reaches back to the moment."""
    epochs = tables.pose_epoch.c
    known = _read_epochs(connection, camera)
    if not known:
        first = PoseEpoch(id=f"{camera}-1", camera=camera, started_at=at, reason=reason)
        connection.execute(insert(tables.pose_epoch).values(field_values(first)))
        return first
    if at < known[0].started_at:
        connection.execute(update(tables.pose_epoch).where(epochs.id == known[0].id).values(started_at=at))
        return replace(known[0], started_at=at)
    return _find_last_begun(known, at)


def _read_epochs(connection: Connection, camera: str) -> tuple[PoseEpoch, ...]:
    statement = select(tables.pose_epoch).where(tables.pose_epoch.c.camera == camera, not_closed())
    return read_records(connection, statement.order_by(tables.pose_epoch.c.started_at), PoseEpoch)


def _find_last_begun(epochs: Sequence[PoseEpoch], at: datetime) -> PoseEpoch:
    return epochs[bisect_right(epochs, at, key=lambda epoch: epoch.started_at) - 1]


def assign_epochs(connection: Connection, points: Sequence[SunPoint], reason: str) -> Sequence[SunPoint]:
    """Return the sightings, those without a pose epoch in that of their time.

    In the transaction that stores them: an epoch that is opened before it is found here, and one that is opened after
    it moves them.
    """
    without = [point for point in points if not point.pose_epoch]
    epochs: dict[str, tuple[PoseEpoch, ...]] = {}
    for camera in {point.camera for point in without}:
        _epoch_at(connection, camera, min(point.time for point in without if point.camera == camera), reason)
        epochs[camera] = _read_epochs(connection, camera)
    return [
        point if point.pose_epoch else replace(point, pose_epoch=_find_last_begun(epochs[point.camera], point.time).id)
        for point in points
    ]


def _make_epoch_id(connection: Connection, camera: str) -> str:
    """Return an id for a new pose epoch; rows that cannot be read are counted, for their ids are taken."""
    count = select(func.count()).select_from(tables.pose_epoch).where(tables.pose_epoch.c.camera == camera)
    return f"{camera}-{(connection.scalar(count) or 0) + 1}"


def _read_first_answer_time(connection: Connection, pose_epoch: str) -> datetime | None:
    """Return from when on a calibration of a pose epoch answered; None where none did."""
    c = tables.calibration.c
    filters = (c.pose_epoch == pose_epoch, c.state.in_(SERVED))
    return connection.scalar(select(c.valid_from).where(*filters).order_by(c.valid_from).limit(1))


def not_closed() -> ColumnElement[bool]:
    """Return the condition that a pose epoch has a duration: one that was closed as wrong ends where it began."""
    epochs = tables.pose_epoch.c
    return or_(epochs.ended_at.is_(None), epochs.ended_at > epochs.started_at)
