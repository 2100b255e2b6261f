"""Requests with many rows: read, computed and written, at once when small, in a thread and by turns when large."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from http import HTTPStatus
from typing import Any, TypeVar

import numpy as np
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from pydantic import BaseModel, ValidationError
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool

from sunarc.api.answering import Answering, answering_at, answering_each
from sunarc.api.arrays import NPY, Rows, bytes_ahead, read_rows, require_few, rows_response
from sunarc.api.compute_slots import ComputeSlots
from sunarc.api.context import CALIBRATION, ApiContext, Sampling
from sunarc.api.middleware.client_address import client_network
from sunarc.api.problems import Fault, RefusedError
from sunarc.array_types import FloatArray
from sunarc.calibration.ensemble import Ensemble
from sunarc.errors import InputError

RequestModel = TypeVar("RequestModel", bound=BaseModel)

_JSON = "application/json"
_SMALL_BYTES = 4096
"""A question of this size is answered faster than a thread takes over."""
_BINARY = {"schema": {"type": "string", "format": "binary"}}


@dataclass(frozen=True, slots=True, kw_only=True)
class Computation:
    """One kind of request with many rows.

    Attributes
    ----------
    read : returns the rows of a JSON body; at most so many.
    columns : how many columns the rows may have.
    answer : returns the answer's rows for the request's rows.
    answer_columns : names of the answer's columns.
    as_json : returns the answer's rows as a JSON object.
    draw : returns the rows of one draw of an ensemble, (n, `draw_columns`), for the request's rows.
    draw_columns : names of its columns.
    draws_as_json : returns the rows of all draws, (draws, n, columns), as a JSON object.
    double : answer in double precision whatever the question has.
    times : returns the times of the rows, s since 1970; None where they have none. Then the times choose what answers.
    """

    read: Callable[[bytes, int], FloatArray]
    columns: tuple[int, ...]
    answer: Callable[[Answering, Rows], Rows]
    answer_columns: tuple[str, ...]
    as_json: Callable[[Answering, Rows], dict[str, Any]]
    draw: Callable[[Answering, Ensemble, int, Rows], Rows]
    draw_columns: tuple[str, ...]
    draws_as_json: Callable[[FloatArray], dict[str, Any]]
    double: bool = False
    times: Callable[[Rows], FloatArray | None] = lambda _: None


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What a request asks beside its rows: the time, and how many draws of which seed."""

    at: datetime | None
    draws: int
    seed: int


async def compute(
    computation: Computation, context: ApiContext, slots: ComputeSlots, request: Request, question: Question
) -> Response:
    """Answer a request in kind: JSON with JSON, .npy with .npy."""
    media_type = request.headers.get("content-type", _JSON).partition(";")[0].strip().lower()
    if media_type == NPY:
        return await _rows(computation, context, slots, request, question)
    if media_type != _JSON:
        fault = Fault(field="content-type", problem=f"{media_type!r} is not read here", remedy=f"send {_JSON} or {NPY}")
        raise RefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, fault)
    body = await request.body()
    if len(body) <= _SMALL_BYTES:
        # On the event loop only where nothing has to be read or made: that would hold up every other request.
        chosen = question.draws or CALIBRATION in request.query_params
        ours_now = question.at is None and not chosen and not request.path_params["camera"] and b'"at"' not in body
        if ours_now and context.ready.cached_value(context.record_or_none(None)) is not None:
            return _json(computation, context, request, body, question)
        return await run_in_threadpool(_json, computation, context, request, body, question)
    client = client_network(request.scope)
    slots.require_room(client)
    async with slots.slot(client):
        answer = await run_in_threadpool(_json, computation, context, request, body, question)
    request.state.holding.grow(len(answer.body))
    return answer


def parsed_body(model: type[RequestModel], body: bytes) -> RequestModel:
    """Return what a JSON body asks; RequestValidationError, as FastAPI's own, where it is not of the model."""
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        faults = error.errors(include_url=False, include_context=False, include_input=False)
        raise RequestValidationError([{**fault, "loc": ("body", *fault["loc"])} for fault in faults]) from None


def body_of(schema: str, rows: str) -> dict[str, Any]:
    """Return the description of a body that is JSON of a schema, or rows."""
    content = {_JSON: {"schema": {"$ref": f"#/components/schemas/{schema}"}}, NPY: _BINARY}
    return {"requestBody": {"required": True, "content": content, "description": f"JSON, or as .npy: {rows}"}}


def row_responses(columns: Sequence[str]) -> dict[int | str, dict[str, Any]]:
    """Return the description of an answer that may be rows."""
    text = f"What was asked; as .npy, (n, {len(columns)}) in the precision of the question: {', '.join(columns)}."
    text += " With draws, (draws, n, columns): see Sunarc-Columns."
    headers = {
        "Sunarc-Calibration": {"description": "Id of the calibration that answered.", "schema": {"type": "string"}},
        "Sunarc-Columns": {"description": "Names of the columns of a .npy.", "schema": {"type": "string"}},
    }
    return {200: {"description": text, "headers": headers, "content": {NPY: {}}}}


def _json(computation: Computation, context: ApiContext, request: Request, body: bytes, question: Question) -> Response:
    rows = computation.read(body, context.options.max_points)
    require_few(len(rows) * question.draws, most=context.options.max_points, field="draws")
    answering = _answering(computation, context, request, rows, question)
    answer = {"calibration": answering.record.id} | computation.as_json(answering, computation.answer(answering, rows))
    if question.draws:
        ensemble = _ensemble(answering, question)
        drawn = np.array([computation.draw(answering, ensemble, draw, rows) for draw in ensemble], dtype=np.float64)
        answer["draws"] = computation.draws_as_json(drawn)
    content = to_json(answer, inf_nan_mode="null")
    return Response(content, media_type=_JSON, headers=_calibrations(answering))


async def _rows(
    computation: Computation, context: ApiContext, slots: ComputeSlots, request: Request, question: Question
) -> Response:
    client = client_network(request.scope)
    slots.require_room(client)
    rows = read_rows(await request.body(), columns=computation.columns, most=context.options.max_rows)
    if rows.dtype == np.float32 and computation.times(rows) is not None:
        problem = "holds times in single precision, which are off by up to 64 s"
        raise InputError(field="body", problem=problem, remedy="send float64")
    rows = rows.astype(np.float64) if computation.double else rows
    require_few(len(rows) * question.draws, most=context.options.max_rows, field="draws")
    columns = computation.draw_columns if question.draws else computation.answer_columns
    width = len(columns)
    request.state.holding.grow(bytes_ahead(rows, width) + (rows.nbytes if rows.flags.owndata else 0))
    answering = await run_in_threadpool(_answering, computation, context, request, rows, question)
    answers: list[Callable[[Rows], Rows]] = [partial(computation.answer, answering)]
    if question.draws:
        ensemble = await run_in_threadpool(_ensemble, answering, question)
        answers = [partial(computation.draw, answering, ensemble, draw) for draw in ensemble]
    return rows_response(
        rows,
        answers,
        draws=question.draws,
        width=width,
        headers=_calibrations(answering) | {"sunarc-columns": ",".join(columns)},
        slot=partial(slots.slot, client),
    )


def _ensemble(answering: Answering, question: Question) -> Ensemble:
    """Return the draws that are asked for."""
    sampling = Sampling(calibration=answering.record.id, draws=question.draws, seed=question.seed)
    return answering.context.ensembles.get(sampling)


def _answering(
    computation: Computation, context: ApiContext, request: Request, rows: Rows, question: Question
) -> Answering:
    """Return what answers: for the time of each row where they have one, else for the one that is asked for."""
    times = computation.times(rows)
    if times is None or not len(times):
        return answering_at(context, request, question.at)
    for name, given in (("at", question.at), ("draws", question.draws)):
        if given:
            problem = "cannot be given together with a time for each point"
            raise InputError(field=name, problem=problem, remedy="leave one of them out, or ask for each time alone")
    return answering_each(context, request, times)


def _calibrations(answering: Answering) -> dict[str, str]:
    return {"sunarc-calibration": ", ".join(answering.calibrations)}
