"""Answers of many rows, as JSON or .npy: which calibration answers which point, and how many are computed at once."""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from http import HTTPStatus
from typing import Any

import numpy as np
from fastapi import Request
from fastapi.responses import Response
from fastapi.routing import APIRoute
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool

from sunarc.calibration.answers.direction_table import Lookup
from sunarc.calibration.answers.error_model import Ensemble
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.errors import InputError, NotFoundError
from sunarc.imager.archive.values import CalibrationRecord
from sunarc.imager.web.arrays import NPY, Rows, bytes_ahead, read_rows, require_few, rows_response
from sunarc.imager.web.context import ApiContext, Sampling, model_key
from sunarc.imager.web.middleware.shared_quota import client_network
from sunarc.imager.web.problems import Fault, RefusedError, Responses, described_answer
from sunarc.sky.days import solar_days

_MOST_CALIBRATIONS = 8
"""Of one request with a time for each point: as many as are kept ready."""
_MOST_DAYS = 366
"""Solar days of such a request; each has a site of its own, with the air measured on it."""
_YEARS = (0.0, 7_258_118_400.0)
"""Times that are answered for, 1970 to 2199, s since 1970: those of the API's other times."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answering:
    """Calibration that answers a question.

    Attributes
    ----------
    context : of the camera that was asked for.
    record : its calibration.
    ready : made ready.
    time : that was asked for; now by the frames' time where none was.
    each : what answers for the times of points; None where all points have one time.
    """

    context: ApiContext
    record: CalibrationRecord
    ready: Lookup
    time: datetime
    each: Timeline | None = None

    @property
    def calibrations(self) -> tuple[str, ...]:
        """Return the ids of the calibrations, in the order of time."""
        return (self.record.id,) if self.each is None else self.each.calibrations


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Timeline:
    """Calibrations that answer for each of many times.

    Attributes
    ----------
    times : (m,) different times, rising, s since 1970.
    groups : (m,) which of `answers` does; a group has one calibration and one solar day.
    answers : in the order of time.
    asked : (n,) times of the points, as they were asked.
    """

    times: FloatArray
    groups: IntArray
    answers: tuple[Answering, ...]
    asked: FloatArray

    @property
    def calibrations(self) -> tuple[str, ...]:
        """Return the ids of the calibrations, in the order of time."""
        return tuple(dict.fromkeys(one.record.id for one in self.answers))

    def split(self, times: FloatArray) -> Iterator[tuple[Answering, IntArray]]:
        """Yield the answering calibration of points of these times, and which points (indices)."""
        groups = self.groups[np.searchsorted(self.times, times)]
        for group in np.unique(groups).tolist():
            yield self.answers[group], np.flatnonzero(groups == group)

    def point_calibrations(self) -> list[str]:
        """Return the id of the calibration that answers for each of the points."""
        names = [one.record.id for one in self.answers]
        return [names[group] for group in self.groups[np.searchsorted(self.times, self.asked)].tolist()]


def answering_at(context: ApiContext, request: Request, at: datetime | None) -> Answering:
    """Return the calibration that answers a request for one time, now without one."""
    selected, record = context.answering(request, at)
    return Answering(
        context=selected, record=record, ready=selected.ready.get(record), time=at or selected.frame_clock()
    )


def answering_each(context: ApiContext, request: Request, asked: FloatArray) -> Answering:
    """Return the calibrations of a request whose points have times; by itself it is that of the first time.

    Raises
    ------
    NotFoundError
        No calibration answers for one of the times.
    RefusedError
        (413) More than 8 calibrations answer, or the times lie on more than 366 solar days.
    InputError
        A time lies outside the years 1970 to 2199.
    """
    within = np.isfinite(asked) & (asked >= _YEARS[0]) & (asked < _YEARS[1])
    if not np.all(within):
        place = f"at[{int(np.argmin(within))}]"
        raise InputError(field=place, problem="lies outside the years 1970 to 2199", remedy="give s since 1970, UTC")
    selected, times = context.of(request), np.unique(asked)
    days = solar_days(times, longitude=selected.site.longitude)
    require_few(len(np.unique(days)), most=_MOST_DAYS, field="at", what="solar days")
    records = records_at(selected, times, asked)
    changes = [k for k in range(len(times)) if k == 0 or days[k] != days[k - 1] or records[k] is not records[k - 1]]
    answers = tuple(
        Answering(context=selected, record=records[k], ready=selected.ready.get(records[k]), time=moment(times[k]))
        for k in changes
    )
    groups = np.searchsorted(np.array(changes), np.arange(len(times)), side="right") - 1
    each = Timeline(times=times, groups=groups, answers=answers, asked=asked)
    first = answers[groups[np.searchsorted(times, asked[0])]]
    return Answering(context=selected, record=first.record, ready=first.ready, time=moment(asked[0]), each=each)


def records_at(context: ApiContext, unix_s: FloatArray, requested_unix_s: FloatArray) -> list[CalibrationRecord]:
    """Return the records that answer at each of rising times.

    A calibration answers for one interval of time (one that is made current again does so as a copy), and has each age
    in one: what answers at two times answers between them.
    """
    found: dict[int, CalibrationRecord] = {}
    distinct: dict[str, CalibrationRecord] = {}

    def look(k: int) -> CalibrationRecord:
        if k not in found:
            record = context.record_or_none(moment(unix_s[k]))
            if record is None:
                place = f"at[{int(np.flatnonzero(requested_unix_s == unix_s[k])[0])}]"
                problem = f"no calibration answers for {moment(unix_s[k]).isoformat()}"
                raise NotFoundError(field=place, problem=problem, remedy="see /v1/calibrations for what there is")
            found[k] = distinct.setdefault(model_key(record), record)
            require_few(len(distinct), most=2 * _MOST_CALIBRATIONS, field="at", what="ages of calibrations")
            ids = {one.id for one in distinct.values()}
            require_few(len(ids), most=_MOST_CALIBRATIONS, field="at", what="calibrations")
        return found[k]

    spans = [(0, len(unix_s) - 1)]
    while spans:
        low, high = spans.pop()
        if look(low) is look(high):
            found |= dict.fromkeys(range(low, high + 1), found[low])
        elif high - low > 1:
            middle = (low + high) // 2
            spans += [(low, middle), (middle, high)]
    return [found[k] for k in range(len(unix_s))]


def moment(unix_s: float) -> datetime:
    """Return seconds since 1970 as a time."""
    return datetime.fromtimestamp(float(unix_s), UTC)


class ComputeSlots:
    """Semaphore of large computations that serves waiting addresses in turn.

    A slot is taken when all that is computed on is there, and left when the numbers are: not while a request is being
    sent, nor while its answer is being read. Addresses that wait take turns.

    Parameters
    ----------
    most : how many run; an address of which more requests wait than that is refused (429).
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._free = most
        self._waiting: OrderedDict[str | None, deque[asyncio.Future[None]]] = OrderedDict()

    def require_room(self, client: str | None) -> None:
        """Raise RefusedError (429) where too much of an address waits already. On the event loop alone."""
        if len(self._waiting.get(client, ())) >= self._most:
            fault = Fault(field="request", problem="too many large requests at once", remedy="ask again in a second")
            raise RefusedError(HTTPStatus.TOO_MANY_REQUESTS, fault, headers={"retry-after": "1"})

    @asynccontextmanager
    async def slot(self, client: str | None) -> AsyncIterator[None]:
        """Wait for a slot, and hold it. On the event loop alone."""
        await self._wait_for_slot(client)
        try:
            yield
        finally:
            self._release_slot()

    async def _wait_for_slot(self, client: str | None) -> None:
        if self._free:
            self._free -= 1
            return
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(client, deque()).append(waiter)
        try:
            await waiter
        except asyncio.CancelledError:
            if waiter.done() and not waiter.cancelled():
                self._release_slot()  # it was handed a slot in the same moment
            raise

    def _release_slot(self) -> None:
        """Pass the slot on to the next waiting address."""
        while self._waiting:
            client, waiters = self._waiting.popitem(last=False)
            waiter = waiters.popleft()
            if waiters:
                self._waiting[client] = waiters
            if not waiter.done():
                waiter.set_result(None)
                return
        self._free += 1


_JSON = "application/json"
_SMALL_BYTES = 4096
"""A question of this size is answered faster than a thread takes over."""
_BINARY = {"schema": {"type": "string", "format": "binary"}}


@dataclass(frozen=True, slots=True, kw_only=True)
class RowTable:
    """Rows of an answer.

    Attributes
    ----------
    columns : names of the columns.
    compute : returns the rows for those of the request: `compute(answering, rows)`; of one draw of an ensemble
        `compute(answering, ensemble, draw, rows)`.
    as_json : returns the rows as a JSON object: `as_json(answering, rows)`, those of all draws (draws, n, columns).
    """

    columns: tuple[str, ...]
    compute: Callable[..., Rows]
    as_json: Callable[[Answering, Rows], dict[str, Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Computation:
    """One kind of request with many rows.

    Attributes
    ----------
    read : returns the rows of a JSON body; at most so many.
    columns : how many columns the rows may have.
    answer, drawn : the answer's rows, and those of each draw.
    time_column : column of the times of the rows, s since 1970, where the rows have so many columns: they choose what
        answers. Then all is in double precision.
    """

    read: Callable[[bytes, int], FloatArray]
    columns: tuple[int, ...]
    answer: RowTable
    drawn: RowTable
    time_column: int | None = None

    def times(self, rows: Rows) -> FloatArray | None:
        """Return the times of rows that have one each; None of others."""
        if self.time_column is None or rows.shape[1] <= self.time_column:
            return None
        return np.ascontiguousarray(rows[:, self.time_column], dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """Question of a request apart from its rows: to whom, the time, and how many draws of which seed."""

    context: ApiContext
    request: Request
    at: datetime | None
    draws: int
    seed: int


async def compute(computation: Computation, slots: ComputeSlots, question: Question) -> Response:
    """Answer a request in kind: JSON with JSON, .npy with .npy."""
    context, request = question.context, question.request
    media_type = request.headers.get("content-type", _JSON).partition(";")[0].strip().lower()
    if media_type == NPY:
        return await _answer_rows(computation, slots, question)
    if media_type != _JSON:
        fault = Fault(field="content-type", problem=f"{media_type!r} is not read here", remedy=f"send {_JSON} or {NPY}")
        raise RefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, fault)
    body: bytes = request.state.body
    if len(body) <= _SMALL_BYTES:
        # On the event loop only where nothing has to be read or made: that would hold up every other request.
        if not request.scope["query_string"] and not request.path_params["camera"] and b'"at"' not in body:
            record = context.record_or_none(None)
            ready = None if record is None else context.ready.cached_value(record)
            if record is not None and ready is not None:
                now = Answering(context=context, record=record, ready=ready, time=context.frame_clock())
                return _answer_json(computation, question, body, now)
        return await run_in_threadpool(_answer_json, computation, question, body)
    client = client_network(request.scope)
    slots.require_room(client)
    async with slots.slot(client):
        answer = await run_in_threadpool(_answer_json, computation, question, body)
    request.state.use.grow(len(answer.body))
    return answer


class RowsRoute(APIRoute):
    """Route whose parameters have their defaults where a request has no query: it is answered at once then."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler, which solves the parameters only where there are some."""
        solving, answer = super().get_route_handler(), self.endpoint

        async def handle(request: Request) -> Response:
            response: Response = await (solving(request) if request.scope["query_string"] else answer(request))
            return response

        return handle


def describe_body(schema: str, rows: str) -> dict[str, Any]:
    """Return the description of a body that is JSON of a schema, or rows."""
    content = {_JSON: {"schema": {"$ref": f"#/components/schemas/{schema}"}}, NPY: _BINARY}
    return {"requestBody": {"required": True, "content": content, "description": f"JSON, or as .npy: {rows}"}}


def row_responses(columns: Sequence[str]) -> Responses:
    """Return the description of an answer that may be rows."""
    text = f"What was asked; as .npy, (n, {len(columns)}) in the precision of the question: {', '.join(columns)}."
    text += " With draws, (draws, n, columns): see Sunarc-Columns."
    headers = {
        "Sunarc-Calibration": "Id of the calibration that answered.",
        "Sunarc-Columns": "Names of the columns of a .npy.",
    }
    return described_answer(text, [NPY], headers=headers)


def _answer_json(computation: Computation, question: Question, body: bytes, now: Answering | None = None) -> Response:
    most = question.context.options.max_points
    rows = computation.read(body, most)
    require_few(len(rows) * question.draws, most=most, field="draws")
    answering = now or _find_answering(computation, question, rows)
    table, drawn = computation.answer, computation.drawn
    answer = {"calibration": answering.record.id} | table.as_json(answering, table.compute(answering, rows))
    if question.draws:
        ensemble = _make_ensemble(answering, question)
        draws = np.array([drawn.compute(answering, ensemble, draw, rows) for draw in ensemble], dtype=np.float64)
        answer["draws"] = drawn.as_json(answering, draws)
    content = to_json(answer, inf_nan_mode="null")
    return Response(content, media_type=_JSON, headers=_make_calibration_header(answering))


async def _answer_rows(computation: Computation, slots: ComputeSlots, question: Question) -> Response:
    request, most = question.request, question.context.options.max_rows
    client = client_network(request.scope)
    slots.require_room(client)
    rows = read_rows(request.state.body, columns=computation.columns, most=most)
    if rows.dtype == np.float32 and computation.times(rows) is not None:
        problem = "holds times in single precision, which are off by up to 64 s"
        raise InputError(field="body", problem=problem, remedy="send float64")
    rows = rows if computation.time_column is None else rows.astype(np.float64)
    require_few(len(rows) * question.draws, most=most, field="draws")
    table = computation.drawn if question.draws else computation.answer
    width = len(table.columns)
    request.state.use.grow(bytes_ahead(rows, width) + (rows.nbytes if rows.flags.owndata else 0))
    answering = await run_in_threadpool(_find_answering, computation, question, rows)
    answers: list[Callable[[Rows], Rows]] = [partial(table.compute, answering)]
    if question.draws:
        ensemble = await run_in_threadpool(_make_ensemble, answering, question)
        answers = [partial(table.compute, answering, ensemble, draw) for draw in ensemble]
    return rows_response(
        rows,
        answers,
        draws=question.draws,
        width=width,
        headers=_make_calibration_header(answering) | {"sunarc-columns": ",".join(table.columns)},
        slot=partial(slots.slot, client),
    )


def _make_ensemble(answering: Answering, question: Question) -> Ensemble:
    """Return the draws that are asked for."""
    sampling = Sampling(calibration=answering.record, draws=question.draws, seed=question.seed)
    return answering.context.ensembles.get(sampling)


def _find_answering(computation: Computation, question: Question, rows: Rows) -> Answering:
    """Return the answering calibrations: for the time of each row where it has one, else for the request's."""
    times = computation.times(rows)
    if times is None or not len(times):
        return answering_at(question.context, question.request, question.at)
    for name, given in (("at", question.at), ("draws", question.draws)):
        if given:
            problem = "cannot be given together with a time for each point"
            raise InputError(field=name, problem=problem, remedy="leave one of them out, or ask for each time alone")
    return answering_each(question.context, question.request, times)


def _make_calibration_header(answering: Answering) -> dict[str, str]:
    return {"sunarc-calibration": ", ".join(answering.calibrations)}
