"""Route: what the nights were like."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request

from sunarc.api.context import ApiContext
from sunarc.api.problems import answers
from sunarc.api.schemas.nights import Night, Nights
from sunarc.api.schemas.paging import Cursor, page_at
from sunarc.api.schemas.parameters import Since, Until, row_limit
from sunarc.archive import Event

_KIND = "night"


def night_routes(context: ApiContext) -> APIRouter:
    """Return the route that tells the verdicts of the nights."""
    routes = APIRouter(tags=["record"])

    @routes.get("/nights", responses=answers(422), response_model_by_alias=False)
    def nights(
        *,
        request: Request,
        since: Since = None,
        until: Until = None,
        images: Annotated[bool, Query(description="Add the numbers of each image.", examples=[True])] = False,
        limit: Annotated[int, row_limit()] = 366,
        cursor: Cursor = None,
    ) -> Nights:
        """Tell the verdicts of the nights that were judged at since <= time < until, the newest first."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = selected.archive.events(
            selected.camera, since=since, until=page.until(until), kind=_KIND, limit=page.rows
        )
        rows, next_ = page.cut(found, request, time=lambda event: event.time)
        return Nights(nights=[_night(event, images=images) for event in rows], next=next_)

    return routes


def _night(event: Event, *, images: bool) -> Night:
    """Return the verdict that the event of a night carries."""
    left_out = {} if images else {"images": None}
    return Night.model_validate({**event.details, **left_out, "decided_at": event.time})
