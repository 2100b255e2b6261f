"""Every failure as one shape: a problem document of RFC 9457, with the field, the problem and the remedy."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import re
import threading
import traceback
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from types import MappingProxyType
from typing import Any

from fastapi import FastAPI, Request
from fastapi.dependencies.models import Dependant
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.routing import compile_path
from starlette.types import Scope

from sunarc.common.errors import ConflictError, InputError, NotFoundError, OutsideError, SunarcError

_WINDOW_S = 300.0  # as long as the log's own filter holds repeats back
_MAX_KINDS = 256


@dataclass(slots=True)
class _Kind:
    """Time at which a fault was last logged, and the count of later ones."""

    logged_at_s: float
    unlogged: int = 0


class FaultLog:
    """Logs faults: the first of a kind with its stack, later ones at most once in five minutes, with their count.

    Faults are of one kind when the exception's type and the line that raised it are.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kinds: OrderedDict[str, _Kind] = OrderedDict()

    def record(self, error: BaseException, *, request: str, now_s: float) -> str:
        """Log a fault, or count it; return its name, which the answer and the log share.

        Parameters
        ----------
        error : the fault.
        request : method and path.
        now_s : seconds that never jump.
        """
        name, location = _name_fault(error)
        with self._lock:
            kind = self._kinds.get(name)
            if kind is not None and now_s - kind.logged_at_s < _WINDOW_S:
                kind.unlogged += 1
                return name
            self._kinds[name] = _Kind(now_s)
            self._kinds.move_to_end(name)
            if len(self._kinds) > _MAX_KINDS:
                self._kinds.popitem(last=False)
        # Outside the lock: formatting a stack takes milliseconds.
        if kind is None:
            _log.error("fault %s: %s failed at %s", name, request, location, exc_info=error)
        else:
            again = "fault %s again: %s failed at %s: %s (%d more since it was last logged)"
            _log.error(again, name, request, location, type(error).__name__, kind.unlogged)
        return name


def _name_fault(error: BaseException) -> tuple[str, str]:
    """Return a fault's name, and the line that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    location = f"{frames[-1].filename}:{frames[-1].lineno}" if frames else "an unknown line"
    identity = f"{type(error).__module__}.{type(error).__qualname__} {location}"
    return hashlib.sha256(identity.encode()).hexdigest()[:8], location


MEDIA_TYPE = "application/problem+json"
_MOST_FAULTS = 20
_RETRY_AFTER_S = 5
"""A database or a disk is mostly away for seconds, as in a restart."""
NO_CALIBRATION = "no_calibration"
_NEXT_CALIBRATION_S = 60
"""Between two questions for the first calibration, which a clear day makes."""
_log = logging.getLogger(__name__)

_PROBLEMS = {
    "json_invalid": "is not JSON",
    "model_attributes_type": "is not a JSON object",
    "model_type": "is not a JSON object",
    "timezone_aware": "has no zone",
}
_REMEDIES: dict[str, str] = {
    "missing": "add it",
    "extra_forbidden": "remove it or correct its spelling",
    "finite_number": "give a finite number",
    "float_type": "give a number",
    "list_type": "give a list",
    "tuple_type": "give a list",
    "json_invalid": "send a JSON document",
    "model_attributes_type": "send a JSON object, with its content type",
    "model_type": "send a JSON object",
}
_TIME_REMEDY = "write it with its zone, as 2013-05-13T18:30:00Z or 2013-05-13T20:30:00+02:00"
_REMEDIES |= dict.fromkeys(("timezone_aware", "datetime_parsing", "datetime_from_date_parsing"), _TIME_REMEDY)
_REMEDY = "see /openapi.json for what is expected"


class Fault(BaseModel):
    """One fault of a request: field, problem and remedy."""

    field: str = Field(description="Where: a parameter, or a place in the body.", examples=["pixels[3][0]"])
    problem: str = Field(description="What is wrong with it.", examples=["input should be a finite number"])
    remedy: str = Field(description="What to do about it.", examples=["give a finite number"])


class Problem(BaseModel):
    """A problem document (RFC 9457)."""

    type: str = Field(description="Stable name of the kind of problem.", examples=["urn:sunarc:problem:invalid"])
    title: str = Field(description="The kind of problem, in words.", examples=["Unprocessable Entity"])
    status: int = Field(description="The HTTP status.", examples=[422])
    detail: str = Field(
        description="This problem, in one sentence.",
        examples=["at: no calibration answers for 1999-01-01T00:00:00+00:00"],
    )
    instance: str = Field(description="The path that was asked for.", examples=["/v1/back-project"])
    errors: list[Fault] = Field(description="What is wrong, one by one; may be empty.")


class NoCalibrationError(NotFoundError):
    """No calibration answers now.

    A route whose description has 503 computes by one and will answer later; another was asked for the calibration.
    """


_NOT_JSON = Fault(field="content-type", problem="is not accepted", remedy="send application/json")


class RefusedError(SunarcError):
    """Error of a request that is refused by its form, whatever it asks for.

    Parameters
    ----------
    status : the HTTP status.
    fault : where, what and what to do.
    headers : to send along.
    """

    def __init__(self, status: HTTPStatus, fault: Fault, *, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(f"{fault.field}: {fault.problem}; {fault.remedy}")
        self.status = status
        self.fault = fault
        self.headers = headers


class UnreadError(HTTPException):
    """Error of a request whose body is not read to its end; its connection is closed after the answer.

    Parameters
    ----------
    status : the HTTP status.
    fault : where, what and what to do.
    """

    def __init__(self, status: HTTPStatus, fault: Fault) -> None:
        detail = f"{fault.field}: {fault.problem}; {fault.remedy}"
        super().__init__(status, detail, headers={"connection": "close"})
        self.fault = fault

    def response(self, path: str) -> JSONResponse:
        """Return the answer to the request for a path."""
        return problem_response(
            HTTPStatus(self.status_code), path=path, detail=self.detail, errors=[self.fault], headers=self.headers
        )


def problem_response(
    status: HTTPStatus,
    *,
    path: str,
    detail: str,
    errors: Sequence[Fault] = (),
    headers: Mapping[str, str] | None = None,
    kind: str | None = None,
    members: Mapping[str, str] = MappingProxyType({}),
) -> JSONResponse:
    """Return a problem document as an answer, of the kind of its status unless one is given, with further members."""
    problem = Problem(
        type=f"urn:sunarc:problem:{kind or _KINDS.get(status, 'http')}",
        title=status.phrase,
        status=status,
        detail=detail,
        instance=path,
        errors=list(errors),
    )
    return JSONResponse(
        problem.model_dump() | dict(members), status_code=status, media_type=MEDIA_TYPE, headers=headers
    )


Responses = dict[int | str, dict[str, Any]]
"""Description of a route's answers by their status."""


def described_answer(
    text: str,
    content: Mapping[str, Any] | Iterable[str],
    *,
    headers: Mapping[str, str] | None = None,
    numbers: Mapping[str, str] | None = None,
    same: str | None = None,
) -> Responses:
    """Return the description of a route's answer 200, and of 304 where the client has it.

    Parameters
    ----------
    text : the answer in words.
    content : its media types, with their schemas where they are described.
    headers, numbers : texts of its headers, and of those that hold a number.
    same : noun with verb for the text of 304: "The map is the one"; None without an `ETag`.
    """
    kinds = (("string", headers or {}), ("number", numbers or {}))
    described = {
        name: {"description": one, "schema": {"type": kind}} for kind, texts in kinds for name, one in texts.items()
    }
    media = dict(content) if isinstance(content, Mapping) else {name: {} for name in content}
    found: Responses = {200: {"description": text, **({"headers": described} if described else {}), "content": media}}
    return found if same is None else found | {304: {"description": f"{same} that If-None-Match names."}}


def answers(*statuses: int) -> Responses:
    """Return the problem answers of a route, for its description."""
    described = {"content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}}
    return {status: {"description": HTTPStatus(status).phrase, **described} for status in statuses}


def add_problem_handlers(app: FastAPI, faults: FaultLog) -> None:
    """Answer every failure of an application with a problem document; `Boundary` does so for the rest."""

    async def ours(request: Request, error: Exception) -> JSONResponse:
        if _is_fault(error):
            name = record_fault(faults, error, request.scope)
            return internal_problem(request.url.path, name)
        return _answer_own_error(request, error)

    app.add_exception_handler(RequestValidationError, _answer_invalid)
    app.add_exception_handler(HTTPException, _answer_http_error)
    app.add_exception_handler(SunarcError, ours)


def record_fault(faults: FaultLog, error: Exception, scope: Scope) -> str:
    """Log the fault that a request led to, and return its name."""
    request = f"{scope.get('method', '')} {scope.get('path', '')}".strip()
    return faults.record(error, request=request, now_s=asyncio.get_running_loop().time())


def refusal_response(path: str, error: RefusedError) -> JSONResponse:
    """Return the answer to a request for a path that is refused by its form."""
    return problem_response(error.status, path=path, detail=str(error), errors=[error.fault], headers=error.headers)


def internal_problem(path: str, name: str) -> JSONResponse:
    """Return the answer to a request that met a fault of the service."""
    detail = f"internal error; see the service log for fault {name}"
    return problem_response(HTTPStatus.INTERNAL_SERVER_ERROR, path=path, detail=detail)


_STATUSES = {NotFoundError: HTTPStatus.NOT_FOUND, ConflictError: HTTPStatus.CONFLICT}
_KINDS = {
    HTTPStatus.BAD_REQUEST: "malformed",
    HTTPStatus.UNAUTHORIZED: "token",
    HTTPStatus.FORBIDDEN: "forbidden",
    HTTPStatus.NOT_FOUND: "not-found",
    HTTPStatus.METHOD_NOT_ALLOWED: "method",
    HTTPStatus.NOT_ACCEPTABLE: "not-acceptable",
    HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE: "range",
    HTTPStatus.REQUEST_TIMEOUT: "too-slow",
    HTTPStatus.CONFLICT: "conflict",
    HTTPStatus.REQUEST_ENTITY_TOO_LARGE: "too-large",
    HTTPStatus.UNSUPPORTED_MEDIA_TYPE: "media-type",
    HTTPStatus.MISDIRECTED_REQUEST: "misdirected",
    HTTPStatus.UNPROCESSABLE_ENTITY: "invalid",
    HTTPStatus.TOO_MANY_REQUESTS: "too-many",
    HTTPStatus.INTERNAL_SERVER_ERROR: "internal",
    HTTPStatus.SERVICE_UNAVAILABLE: "unavailable",
}


def _answer_invalid(request: Request, error: Exception) -> JSONResponse:
    found = error.errors() if isinstance(error, RequestValidationError) else ()
    if any(tuple(one["loc"]) == ("body",) for one in found) and not _sends_json(request):
        return _answer_own_error(request, RefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, _NOT_JSON))
    faults = [_make_fault(one) for one in list(found)[:_MOST_FAULTS]]
    return problem_response(
        HTTPStatus.UNPROCESSABLE_ENTITY, path=request.url.path, detail=_make_sentence(faults), errors=faults
    )


def _sends_json(request: Request) -> bool:
    media_type = request.headers.get("content-type", "application/json").partition(";")[0].strip().lower()
    return media_type == "application/json" or media_type.endswith("+json")


def _answer_http_error(request: Request, error: Exception) -> JSONResponse:
    if isinstance(error, UnreadError):
        return error.response(request.url.path)
    http_error = error if isinstance(error, HTTPException) else HTTPException(500)
    status, headers = HTTPStatus(http_error.status_code), http_error.headers
    if status == HTTPStatus.METHOD_NOT_ALLOWED and (methods := _list_methods(request)):
        headers = {"allow": ", ".join(sorted(methods))}
        described = " or ".join(sorted(methods - {"HEAD"}))
        fault = Fault(field="method", problem=f"{request.method} is not answered here", remedy=f"send {described}")
        return problem_response(
            status, path=request.url.path, detail=_make_sentence([fault]), errors=[fault], headers=headers
        )
    return problem_response(status, path=request.url.path, detail=str(http_error.detail), headers=headers)


def _list_methods(request: Request) -> set[str]:
    """Return the methods that the described path of a request knows; it may be several routes' together."""
    requested_path = re.sub("^/v1/cameras/[^/]+/", "/v1/", request.url.path)
    described = request.app.openapi()["paths"].items()
    found = [operations for path, operations in described if compile_path(path)[0].match(requested_path)]
    methods = {method.upper() for operations in found for method in operations}
    return methods | {"HEAD"} if "GET" in methods else methods


def _is_fault(error: Exception) -> bool:
    """Return whether an error is one of the service, and not of the request or of its surroundings."""
    return not isinstance(error, RefusedError | InputError | OutsideError)


def _answer_own_error(request: Request, error: Exception) -> JSONResponse:
    path = request.url.path
    if isinstance(error, RefusedError):
        return refusal_response(path, error)
    if isinstance(error, InputError):
        status = _STATUSES.get(type(error), HTTPStatus.UNPROCESSABLE_ENTITY)
        kind = headers = None
        if isinstance(error, NoCalibrationError):
            later = HTTPStatus.SERVICE_UNAVAILABLE in getattr(request.scope.get("route"), "responses", {})
            status = HTTPStatus.SERVICE_UNAVAILABLE if later else HTTPStatus.NOT_FOUND
            kind, headers = NO_CALIBRATION, {"retry-after": str(_NEXT_CALIBRATION_S)}
        fault = Fault(field=error.field, problem=error.problem, remedy=error.remedy)
        return problem_response(status, path=path, detail=str(error), errors=[fault], headers=headers, kind=kind)
    _log.error("%s %s: %s", request.method, path, error)
    again = {"retry-after": str(_RETRY_AFTER_S)}
    return problem_response(HTTPStatus.SERVICE_UNAVAILABLE, path=path, detail=str(error), headers=again)


def _make_fault(error: Mapping[str, Any]) -> Fault:
    """Return the fault of an error of pydantic; our own validators write "problem; remedy"."""
    kind, message = error["type"], str(error["msg"]).removeprefix("Value error, ")
    problem, _, remedy = message.partition("; ") if kind == "value_error" else (message, "", "")
    return Fault(
        field="body" if kind == "json_invalid" else _format_location(error["loc"]),
        problem=_PROBLEMS.get(kind, problem[:1].lower() + problem[1:]),
        remedy=remedy or _REMEDIES.get(kind, _REMEDY),
    )


def _format_location(location: Iterable[str | int]) -> str:
    """Name a place as its sender would: ("body", "pixels", 3, 0) is pixels[3][0]."""
    first, *rest = location
    parts = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in rest]
    return "".join(parts).lstrip(".") or str(first)


def _make_sentence(faults: Sequence[Fault]) -> str:
    first = faults[0]
    others = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return f"{first.field}: {first.problem}; {first.remedy}{others}"


async def require_known_names(request: Request) -> None:
    """Refuse (422) a request whose query has a name that its route does not know.

    Raises
    ------
    RefusedError
        Names the parameter, and those that exist.
    """
    given = request.query_params.keys()
    if not given:
        return
    known = set(_list_parameter_names(request.scope["route"].dependant))
    for name in given:
        if name not in known:
            remedy = f"use {', '.join(sorted(known))}" if known else "leave it out; this route has no parameters"
            fault = Fault(field=name, problem="is not a parameter of this route", remedy=remedy)
            raise RefusedError(HTTPStatus.UNPROCESSABLE_ENTITY, fault)


def _list_parameter_names(dependant: Dependant) -> Iterator[str]:
    """Yield the names of the query parameters of a route and of its dependencies."""
    for parameter in dependant.query_params:
        yield parameter.alias
    for further in dependant.dependencies:
        yield from _list_parameter_names(further)
