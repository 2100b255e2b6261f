"""Refuses query parameters that a route does not have: one that is misspelled would be left out without a word."""

from __future__ import annotations

from collections.abc import Iterator
from http import HTTPStatus

from fastapi import Request
from fastapi.dependencies.models import Dependant

from sunarc.api.problems import Fault, RefusedError


def require_known_names(request: Request) -> None:
    """Refuse (422) a request whose query has a name that its route does not know.

    Raises
    ------
    RefusedError
        Names the parameter, and those that exist.
    """
    given = request.query_params.keys()
    if not given:
        return
    known = set(_names(request.scope["route"].dependant))
    for name in given:
        if name not in known:
            remedy = f"use {', '.join(sorted(known))}" if known else "leave it out; this route has no parameters"
            fault = Fault(field=name, problem="is not a parameter of this route", remedy=remedy)
            raise RefusedError(HTTPStatus.UNPROCESSABLE_ENTITY, fault)


def _names(dependant: Dependant) -> Iterator[str]:
    """Yield the names of the query parameters of a route and of what it depends on."""
    for parameter in dependant.query_params:
        yield parameter.alias
    for further in dependant.dependencies:
        yield from _names(further)
