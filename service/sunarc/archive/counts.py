"""Counts of what is stored, for the numbers that are read every few seconds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from datetime import date, datetime, timedelta
from typing import Any

from sqlalchemy import BigInteger, Column, Select, func, select, type_coerce

from sunarc.archive.store import Store
from sunarc.archive.tables import day, refit, sun_point
from sunarc.archive.values import SightingCounts
from sunarc.sky.days import SECONDS_PER_DEGREE, day_bounds_unix_s
from sunarc.sky.night import SUN
from sunarc.utc import DAY_S


class Counts(Store):
    """The part of the archive that counts."""

    def count_sightings(self, camera: str, *, since: datetime, until: datetime) -> Mapping[str, int]:
        """Return how many sightings with `since` <= time < `until` have each verdict."""
        c = sun_point.c
        return self._counted(
            select(c.verdict, func.count()).where(c.camera == camera, c.time >= since, c.time < until), c.verdict
        )

    def count_days(self, camera: str) -> Mapping[str, int]:
        """Return how many days have each verdict."""
        return self._counted(select(day.c.verdict, func.count()).where(day.c.camera == camera), day.c.verdict)

    def count_refits(self, camera: str) -> Mapping[str, int]:
        """Return how many refits are in each state."""
        return self._counted(select(refit.c.state, func.count()).where(refit.c.camera == camera), refit.c.state)

    def sightings_by_day(
        self, camera: str, *, longitude: float, since: date, until: date
    ) -> tuple[SightingCounts, ...]:
        """Return the counts of the looks at the sun on solar dates with `since` <= date < `until`, the newest first."""
        c, ahead = sun_point.c, round(1e6 * longitude * SECONDS_PER_DEGREE)
        begin, end = (round(1e6 * day_bounds_unix_s(one, longitude=longitude)[0]) for one in (since, until))
        time = type_coerce(c.time, BigInteger)
        number = ((time + ahead) // round(1e6 * DAY_S)).label("day")
        counts = select(number, c.verdict, c.accepted, func.count(), func.max(c.clock_error_s))
        of_days = counts.where(c.camera == camera, c.body == SUN, time >= begin, time < end)
        with self._reading() as connection:
            rows = connection.execute(of_days.group_by(number, c.verdict, c.accepted)).all()
        by_day: dict[int, list[tuple[str, bool, int, float | None]]] = {}
        for day_number, *row in rows:
            by_day.setdefault(int(day_number), []).append((row[0], row[1], row[2], row[3]))
        return tuple(_of_day(one, by_day[one]) for one in sorted(by_day, reverse=True))

    def _counted(self, statement: Select[Any], by: Column[str]) -> Mapping[str, int]:
        with self._reading() as connection:
            rows = connection.execute(statement.group_by(by)).all()
        return {str(name): int(n) for name, n in rows if name is not None}


def _of_day(day: int, rows: list[tuple[str, bool, int, float | None]]) -> SightingCounts:
    verdicts: Counter[str] = Counter()
    for verdict, _, count, _ in rows:
        verdicts[verdict] += count
    return SightingCounts(
        date=date(1970, 1, 1) + timedelta(days=day),
        verdicts=dict(sorted(verdicts.items())),
        accepted=sum(count for _, accepted, count, _ in rows if accepted),
        clock_error_s=max((error for *_, error in rows if error is not None), default=None),
    )
