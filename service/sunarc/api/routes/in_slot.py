"""Answers with a tag that take a slot to be made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus

from fastapi import Request
from fastapi.responses import Response
from starlette.concurrency import run_in_threadpool

from sunarc.api.compute_slots import ComputeSlots
from sunarc.api.middleware.client_address import client_network
from sunarc.api.routes.calibrations import matches


@dataclass(frozen=True, slots=True, kw_only=True)
class Tagged:
    """A request for what has a tag.

    Attributes
    ----------
    request : of the client.
    headers : with `etag`; sent with 304, too.
    if_none_match : the tags that the client has.
    """

    request: Request
    headers: Mapping[str, str]
    if_none_match: str | None


async def made_in_slot(slots: ComputeSlots, asked: Tagged, make: Callable[[], Response]) -> Response:
    """Return what `make` returns, called in a thread and in a slot; 304 where the client has it."""
    if matches(asked.if_none_match, asked.headers["etag"]):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=dict(asked.headers))
    client = client_network(asked.request.scope)
    slots.require_room(client)
    async with slots.slot(client):
        return await run_in_threadpool(make)
