"""Reader of JSON bodies: its memory is bounded, however many names, values or levels a body has."""

from __future__ import annotations

import json
import re
from functools import cache
from itertools import chain
from typing import Any, TypeVar

import msgspec
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError

from sunarc.imager.web.arrays import require_few

RequestModel = TypeVar("RequestModel", bound=BaseModel)

_UNKNOWN = re.compile(r"Object contains unknown field `(.{0,100}).*`", re.DOTALL)
_NOT_FINITE = (b"-Infinity", b"Infinity", b"NaN")
_WIDEST = 4
"""Numbers of a row, one more than a request has."""


def parsed_body(model: type[RequestModel], body: bytes, *, most: int, named: str | None = None) -> RequestModel:
    """Return the request that a JSON body holds; reading stops at the first unknown name, and at a list's first error.

    Parameters
    ----------
    model : of the request, an object of numbers, texts, and lists of them or of short rows.
    body : JSON.
    most : rows of a field, at most.
    named : name of a field with too many rows in the refusal; its own unless given.

    Raises
    ------
    RequestValidationError : as FastAPI's own; the body is no JSON, or is not of the model.
    RefusedError : (413) a field has more rows.
    """
    parts = _parts(model, body)
    for name, part in parts.items():
        require_few(_count(bytes(part)), most=most, field=named or name)
    separated = [(b",", json.dumps(name).encode(), b":", part) for name, part in parts.items()]
    bounded = b"".join([b"{", *[*chain.from_iterable(separated)][1:], b"}"])  # the one copy
    try:
        return model.model_validate_json(bounded)
    except ValidationError as error:
        faults = error.errors(include_url=False, include_context=False, include_input=False)
        raise RequestValidationError([{**fault, "loc": ("body", *fault["loc"])} for fault in faults]) from None


def _parts(model: type[BaseModel], body: bytes) -> dict[str, msgspec.Raw]:
    """Return the JSON text of each field that a body has."""
    try:
        return _split(model, body)
    except msgspec.ValidationError:
        raise _refusal("model_type") from None
    except (msgspec.DecodeError, RecursionError):
        # NaN is no JSON, and yet named by its place: as a number that is too large
        text = body
        for word in _NOT_FINITE:
            text = text.replace(word, b"1e999")
        if text == body:
            raise _refusal("json_invalid") from None
    return _parts(model, text)


def _split(model: type[BaseModel], body: bytes) -> dict[str, msgspec.Raw]:
    """Return the text of each field, and null for the first name that is no field; no value is made."""
    strict, lenient = _readers(model)
    unknown: dict[str, msgspec.Raw] = {}
    try:
        found = strict.decode(body)
    except msgspec.ValidationError as error:
        name = _UNKNOWN.fullmatch(str(error))
        if name is None:
            raise
        unknown, found = {name[1]: msgspec.Raw(b"null")}, lenient.decode(body)
    given = ((name, getattr(found, name)) for name in model.model_fields)
    return {name: part for name, part in given if part is not msgspec.UNSET} | unknown


@cache
def _readers(model: type[BaseModel]) -> tuple[msgspec.json.Decoder[Any], msgspec.json.Decoder[Any]]:
    """Return what splits a body into a model's fields: one that refuses other names, and one that skips them."""
    fields = [(name, msgspec.Raw | msgspec.UnsetType, msgspec.UNSET) for name in model.model_fields]
    kinds = (msgspec.defstruct(model.__name__, fields, forbid_unknown_fields=strict) for strict in (True, False))
    strict, lenient = (msgspec.json.Decoder(kind) for kind in kinds)
    return strict, lenient


def _count(part: bytes) -> int:
    """Return the number of a field's rows: its lists, or its values where they are more than rows have."""
    n_rows, n_values = part.count(b"[") - 1, part.count(b",") + 1
    return n_rows if n_rows > 0 and n_values <= _WIDEST * n_rows else n_values


def _refusal(kind: str) -> RequestValidationError:
    return RequestValidationError([{"type": kind, "loc": ("body",), "msg": ""}])
