"""Counts of what is stored, for the numbers that are read every few seconds."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import Column, Select, func, select

from sunarc.archive.store import Store
from sunarc.archive.tables import day, refit, sun_point


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

    def _counted(self, statement: Select[Any], by: Column[str]) -> Mapping[str, int]:
        with self._reading() as connection:
            rows = connection.execute(statement.group_by(by)).all()
        return {str(name): int(n) for name, n in rows if name is not None}
