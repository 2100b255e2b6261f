"""Disk space and the camera's temperature: by hour for three months, by day for five years."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from typing import get_args

from sqlalchemy import Connection, and_, delete, or_, select

from sunarc.archive.housekeeping_values import Housekeeping, HousekeepingStep, merged
from sunarc.archive.rows import upsert
from sunarc.archive.store import Store, given, values_of
from sunarc.archive.tables import housekeeping

_KEPT: dict[HousekeepingStep, timedelta] = {"hour": timedelta(days=92), "day": timedelta(days=5 * 366)}
_COLUMNS = [column for column in housekeeping.c if column.name not in {"camera", "step"}]


class HousekeepingRecord(Store):
    """The part of the archive with disk space and temperatures."""

    def add_housekeeping(self, camera: str, measured: Iterable[Housekeeping]) -> None:
        """Add measurements to what is stored of their hour and their UTC day, in one transaction.

        Parameters
        ----------
        camera : its name; it need not have answered yet.
        measured : each within one hour.
        """
        with self._writing(camera=camera) as connection:
            for one in measured:
                for step in get_args(HousekeepingStep):
                    _add(connection, camera, step, one)

    def housekeeping(
        self, camera: str, *, step: HousekeepingStep, since: datetime | None = None, until: datetime | None = None
    ) -> tuple[Housekeeping, ...]:
        """Return the hours or days that begin with `since` <= time < `until`, the newest first."""
        c = housekeeping.c
        filters = given((c.time.__ge__, since), (c.time.__lt__, until))
        statement = select(*_COLUMNS).where(c.camera == camera, c.step == step, *filters).order_by(c.time.desc())
        return self._values(statement, Housekeeping)

    def expire_housekeeping(self, camera: str, *, now: datetime) -> int:
        """Remove a camera's hours older than 92 days and days older than 1830, and return how many."""
        c = housekeeping.c
        old = or_(*(and_(c.step == step, c.time < now - kept) for step, kept in _KEPT.items()))
        with self._writing(camera=camera) as connection:
            return connection.execute(delete(housekeeping).where(c.camera == camera, old)).rowcount


def _add(connection: Connection, camera: str, step: HousekeepingStep, measured: Housekeeping) -> None:
    c, time = housekeeping.c, _begin(measured.time, step)
    this = (c.camera == camera, c.step == step, c.time == time)
    stored = values_of(connection, select(*_COLUMNS).where(*this), Housekeeping)
    total = merged(measured, stored[0] if stored else Housekeeping(time=time), time=time)
    upsert(connection, housekeeping, {"camera": camera, "step": step, **asdict(total)}, key=["camera", "step", "time"])


def _begin(time: datetime, step: HousekeepingStep) -> datetime:
    """Return the beginning of the hour or the UTC day of a time."""
    hour = time.astimezone(UTC).replace(minute=0, second=0, microsecond=0)
    return hour if step == "hour" else hour.replace(hour=0)
