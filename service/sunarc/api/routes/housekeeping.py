"""Routes of the housekeeping: disk space and the camera's temperature over hours and days."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from pydantic import BaseModel

from sunarc.api.context import ApiContext
from sunarc.api.problems import answers
from sunarc.api.schemas.parameters import Since, Until
from sunarc.archive.housekeeping_values import Housekeeping, HousekeepingStep
from sunarc.json_fields import described


class HousekeepingRows(BaseModel):
    """Disk space and temperature, the newest first; hours and days without a measurement are left out."""

    step: Annotated[HousekeepingStep, described("Length of each row: an hour, or a UTC day.", "hour")]
    rows: Annotated[list[Housekeeping], described("The newest first.")]


def housekeeping_routes(context: ApiContext) -> APIRouter:
    """Return the route of disk space and temperature."""
    routes = APIRouter(tags=["record"])

    @routes.get("/housekeeping", responses=answers(422))
    def housekeeping(
        *,
        request: Request,
        step: Annotated[
            HousekeepingStep, Query(description="Hours are kept for 92 days, UTC days for five years.")
        ] = "hour",
        since: Since = None,
        until: Until = None,
    ) -> HousekeepingRows:
        """Tell free disk space and the camera's temperature of hours or days that begin with since <= time < until."""
        selected = context.of(request)
        found = selected.archive.housekeeping(selected.camera, step=step, since=since, until=until)
        return HousekeepingRows(step=step, rows=list(found))

    return routes
