"""Since when conditions of the service hold, so that a restart does not begin them anew."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from sqlalchemy import delete, insert, select

from sunarc.archive.store import Store
from sunarc.archive.tables import condition


class ConditionTimes(Store):
    """The part of the archive with the conditions that held when they were last stored."""

    def condition_times(self, camera: str) -> Mapping[str, datetime]:
        """Return since when the stored conditions of a camera's service hold, by code; "" is the hub's own."""
        with self._reading() as connection:
            rows = connection.execute(select(condition.c.code, condition.c.since).where(condition.c.camera == camera))
            return {str(code): since for code, since in rows if since is not None}

    def save_condition_times(self, camera: str, times: Mapping[str, datetime]) -> None:
        """Store since when conditions hold, in place of all that was stored of this service."""
        rows = [{"camera": camera, "code": code, "since": since} for code, since in times.items()]
        with self._writing() as connection:
            connection.execute(delete(condition).where(condition.c.camera == camera))
            if rows:
                connection.execute(insert(condition), rows)
