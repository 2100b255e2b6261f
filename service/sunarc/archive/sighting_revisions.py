"""Later changes of which sightings are accepted: exclusion and readmission."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from sqlalchemy import update

from sunarc.archive.store import Store, given
from sunarc.archive.tables import sun_point

ELSEWHERE = "elsewhere"
"""Verdict on a clean disc where the sun should not be, as far as the calibration knows."""
FROZEN: Literal["frozen"] = "frozen"
"""Verdict on a sighting in an image that the camera had delivered before."""
MOVED = "the camera had moved"
"""Reason of a sighting that was found elsewhere and accepted once the camera was known to have moved."""
LENS_CHANGED = "lens"
"""Reason of a pose epoch that also has another lens: nothing from before says anything of it."""


class SightingRevisions(Store):
    """The part of the archive that changes whether sightings are accepted; their pixels stay."""

    def exclude(self, camera: str, *, since: datetime, until: datetime | None = None, reason: str) -> int:
        """Leave accepted sightings with `since` <= time < `until` out of every fit, and return how many."""
        c = sun_point.c
        filters = given((c.camera.__eq__, camera), (c.time.__ge__, since), (c.time.__lt__, until))
        change = update(sun_point).where(*filters, c.accepted.is_(True))
        with self._writing() as connection:
            return connection.execute(change.values(accepted=False, verdict="set_aside", reason=reason)).rowcount

    def readmit(self, camera: str, *, since: datetime, until: datetime | None = None, reason: str = MOVED) -> int:
        """Accept the discs seen elsewhere with `since` <= time < `until`, and return how many: the camera has moved."""
        c = sun_point.c
        filters = given((c.camera.__eq__, camera), (c.time.__ge__, since), (c.time.__lt__, until))
        filters += [c.verdict == ELSEWHERE, c.x_px.is_not(None), c.y_px.is_not(None)]
        with self._writing() as connection:
            change = update(sun_point).where(*filters).values(accepted=True, verdict="clear", reason=reason)
            return connection.execute(change).rowcount
