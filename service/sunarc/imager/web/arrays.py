"""Bodies with many rows, as JSON or as numpy writes them (.npy), and answers that are sent as they are computed.

The memory of a JSON body's reader is bounded, however many names, values or levels the body has.
"""

from __future__ import annotations

import asyncio
import io
import json
import math
import re
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from functools import cache, partial
from http import HTTPStatus
from itertools import chain
from typing import Any, TypeVar

import msgspec
import numpy as np
from fastapi.exceptions import RequestValidationError
from numpy.lib import format as npy
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.imager.web.problems import Fault, RefusedError

NPY = "application/x-npy"
Rows = FloatArray | NDArray[np.float32]

_CHUNK = 65_536
_AHEAD = 2
MOST_BYTES_AHEAD = (_AHEAD + 1) * _CHUNK * 20 * 8
"""Of one answer, made and not sent: 32 MB with the 20 columns in double precision of a geolocation."""
_FLOATS = tuple(np.dtype(order + kind) for order in "<>" for kind in ("f4", "f8"))
_REMEDY = "send what numpy.save writes: two dimensions, float64 or float32, C order"


def read_rows(body: bytes, *, columns: tuple[int, ...], most: int) -> Rows:
    """Return the rows of a .npy file; InputError for an invalid one, RefusedError (413) for too many rows.

    Parameters
    ----------
    body : the file.
    columns : how many columns it may have.
    most : so many rows at most.
    """
    try:
        header = read_npy_header(body)
    except NpyHeaderError as error:
        raise InputError(field="body", problem=f"is not a .npy file: {error}", remedy=_REMEDY) from None
    dtype = header.dtype
    if dtype is None or dtype not in _FLOATS or header.fortran_order or len(header.shape) != 2:
        order = "Fortran" if header.fortran_order else "C"
        kind = header.descr if dtype is None else dtype
        raise InputError(field="body", problem=f"holds {kind} of shape {header.shape} in {order} order", remedy=_REMEDY)
    count, width = header.shape
    if width not in columns:
        widths = " or ".join(str(number) for number in columns)
        raise InputError(field="body", problem=f"has {width} columns", remedy=f"give {widths} columns")
    require_few(count, most=most, field="body")
    content = memoryview(body)[header.offset :]
    if len(content) != count * width * dtype.itemsize:
        raise InputError(field="body", problem=f"is cut short, or longer than its {count} rows", remedy=_REMEDY)
    return np.frombuffer(content, dtype=dtype).reshape(count, width).astype(dtype.newbyteorder("="), copy=False)


def require_few(count: int, *, most: int, field: str, what: str = "") -> None:
    """Raise RefusedError (413) where there are more than `most`."""
    if count > most:
        raise RefusedError(
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
            Fault(field=field, problem=f"{f'{count} {what}'.strip()} at once, more than {most}", remedy="ask in parts"),
        )


class PartsResponse(Response):
    """Sends parts one after the other, the next ones being made in threads meanwhile.

    Parameters
    ----------
    parts : each makes one.
    length : of all together, bytes.
    media_type, headers : to send along.
    slot : gives each part a place to be made at.
    """

    def __init__(
        self,
        parts: Sequence[Callable[[], bytes | memoryview]],
        *,
        length: int,
        media_type: str,
        headers: dict[str, str],
        slot: Callable[[], AbstractAsyncContextManager[None]],
    ) -> None:
        self._parts, self._slot = parts, slot
        self.status_code, self.background, self.media_type = 200, None, media_type
        self.init_headers(headers | {"content-length": str(length)})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:  # noqa: ARG002 - the protocol's
        """Send the answer."""
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        async for part in self._make_parts():
            await send({"type": "http.response.body", "body": part, "more_body": True})
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _make_parts(self) -> AsyncIterator[bytes | memoryview]:
        coming: list[asyncio.Task[bytes | memoryview]] = []
        try:
            for part in self._parts:
                coming.append(asyncio.create_task(self._make_part(part)))
                if len(coming) > _AHEAD:
                    yield await coming.pop(0)
            while coming:
                yield await coming.pop(0)
        finally:
            for task in coming:
                task.cancel()

    async def _make_part(self, part: Callable[[], bytes | memoryview]) -> bytes | memoryview:
        async with self._slot():
            return await run_in_threadpool(part)


def rows_response(
    rows: Rows,
    answers: Sequence[Callable[[Rows], Rows]],
    *,
    draws: int,
    width: int,
    headers: dict[str, str],
    slot: Callable[[], AbstractAsyncContextManager[None]],
) -> PartsResponse:
    """Answer rows with rows, as a .npy file that is computed while it is being sent.

    Its shape is (n, `width`), the one answer's; with `draws` it is (draws, n, `width`), one answer after the other.
    """
    shape = (draws, rows.shape[0], width) if draws else (rows.shape[0], width)
    start = _make_npy_header(rows.dtype, shape)
    chunks = [rows[begin : begin + _CHUNK] for begin in range(0, len(rows), _CHUNK)]

    def made(answer: Callable[[Rows], Rows], chunk: Rows) -> memoryview:
        return np.ascontiguousarray(answer(chunk)).data.cast("B")

    return PartsResponse(
        [lambda: start, *(partial(made, answer, chunk) for answer in answers for chunk in chunks)],
        length=len(start) + math.prod(shape) * rows.dtype.itemsize,
        media_type=NPY,
        headers=headers,
        slot=slot,
    )


def bytes_ahead(rows: Rows, width: int) -> int:
    """Return how many bytes of an answer (n, `width`) are made before they are sent."""
    return min(len(rows), (_AHEAD + 1) * _CHUNK) * width * rows.dtype.itemsize


def _make_npy_header(dtype: np.dtype[np.floating], shape: tuple[int, ...]) -> bytes:
    stream = io.BytesIO()
    npy.write_array_header_1_0(stream, {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape})
    return stream.getvalue()


# The header of a .npy file, read by the grammar that numpy writes; no part of it is evaluated as Python.
#
# The format is numpy.lib.format's: a magic string, two version bytes, the header's length (little-endian, two bytes in
# version 1, four in versions 2 and 3), and one line that looks like a Python dictionary with exactly the keys
# ``descr``,
# ``fortran_order`` and ``shape``.

_MAGIC = b"\x93NUMPY"
_LENGTH_BYTES = {1: 2, 2: 4, 3: 4}
_MAX_HEADER_BYTES = 10_000  # numpy.load's own limit; the header of a plain array has about a hundred
_MAX_DIMENSIONS = 64  # numpy's own limit

_KEY = re.compile(r" *'(descr|fortran_order|shape)' *: *")
_VALUES = {
    "descr": re.compile(r"'([<>|=]?[A-Za-z][0-9]{0,10}(?:\[[0-9A-Za-z]{1,16}\])?)'"),
    "fortran_order": re.compile(r"(True|False)"),
    "shape": re.compile(r"\(((?: *[0-9]{1,19} *,)*+(?: *[0-9]{1,19})?+ *)\)"),
}
_COMMA = re.compile(r" *, *")
_END = re.compile(r" *} *\n?")
_NUMERIC = re.compile(r"[<>|=]?(?:[iufc][0-9]{1,2}|b1)")


class NpyHeaderError(ValueError):
    """The bytes do not begin with the header of a plain array."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NpyHeader:
    """Header of a .npy file: type, order and shape of its array.

    Attributes
    ----------
    descr : the type as it is written, "<f8".
    fortran_order : whether the first index varies fastest.
    shape : lengths of the dimensions.
    offset : index of the first byte after the header.
    """

    descr: str
    fortran_order: bool
    shape: tuple[int, ...]
    offset: int

    @property
    def dtype(self) -> np.dtype[np.generic] | None:
        """The type as numpy's; None for all but booleans, integers and floating-point numbers."""
        if not _NUMERIC.fullmatch(self.descr):
            return None
        try:
            return np.dtype(self.descr)
        except TypeError:  # a size that no number has
            return None


def read_npy_header(body: bytes) -> NpyHeader:
    """Return the header of a .npy file of version 1, 2 or 3.

    Parameters
    ----------
    body : the file, or its first bytes.

    Raises
    ------
    NpyHeaderError : it is cut short, longer than 10 000 bytes, or is not of the grammar; arrays of structured types,
        which numpy describes by a list, are among these.
    """
    if body[: len(_MAGIC)] != _MAGIC:
        raise NpyHeaderError("does not begin as a .npy file")
    size = _LENGTH_BYTES.get(body[6] if len(body) > 6 else 0)
    if size is None or body[7:8] != b"\0":
        raise NpyHeaderError("is of no known version")
    start = 8 + size
    length = int.from_bytes(body[8:start], "little")
    if length > _MAX_HEADER_BYTES or len(body) < start + length:
        raise NpyHeaderError("has a header that is cut short, or too long")
    try:
        text = body[start : start + length].decode("ascii")
    except UnicodeDecodeError:
        raise NpyHeaderError("has a header that is not of a plain array") from None
    found = _parse_dictionary(text)
    return NpyHeader(
        descr=found["descr"],
        fortran_order=found["fortran_order"] == "True",
        shape=_parse_shape(found["shape"]),
        offset=start + length,
    )


def _parse_dictionary(text: str) -> dict[str, str]:
    """Return the three entries as they are written; in any order, as the format's definition allows."""
    found: dict[str, str] = {}
    if not text.startswith("{"):
        raise NpyHeaderError("has a header that is not a dictionary")
    position = 1
    while key := _KEY.match(text, position):
        name = key[1]
        value = _VALUES[name].match(text, key.end())
        if value is None or name in found:
            raise NpyHeaderError(f"has a header whose {name} is not understood")
        found[name] = value[1]
        comma = _COMMA.match(text, value.end())
        position = value.end() if comma is None else comma.end()
        if comma is None:
            break
    if len(found) != len(_VALUES) or not _END.fullmatch(text, position):
        raise NpyHeaderError("has a header that is not of a plain array")
    return found


def _parse_shape(text: str) -> tuple[int, ...]:
    """Return the lengths; "3" alone, without its comma, is a number and no shape."""
    lengths = tuple(int(part) for part in text.split(",") if part.strip())
    if (len(lengths) == 1 and "," not in text) or len(lengths) > _MAX_DIMENSIONS or text.strip() == ",":
        raise NpyHeaderError("has a header whose shape is not understood")
    if any(length > np.iinfo(np.int64).max for length in lengths):
        raise NpyHeaderError("has a header whose shape is not understood")
    return lengths


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
        require_few(_count_rows(bytes(part)), most=most, field=named or name)
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
        return _split_fields(model, body)
    except msgspec.ValidationError:
        raise _make_refusal("model_type") from None
    except (msgspec.DecodeError, RecursionError):
        # NaN is no JSON, and yet named by its place: as a number that is too large
        text = body
        for word in _NOT_FINITE:
            text = text.replace(word, b"1e999")
        if text == body:
            raise _make_refusal("json_invalid") from None
    return _parts(model, text)


def _split_fields(model: type[BaseModel], body: bytes) -> dict[str, msgspec.Raw]:
    """Return the text of each field, and null for the first name that is no field; no value is made."""
    strict, lenient = _make_readers(model)
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
def _make_readers(model: type[BaseModel]) -> tuple[msgspec.json.Decoder[Any], msgspec.json.Decoder[Any]]:
    """Return the readers that split a body into a model's fields: one refuses other names, one skips them."""
    fields = [(name, msgspec.Raw | msgspec.UnsetType, msgspec.UNSET) for name in model.model_fields]
    kinds = (msgspec.defstruct(model.__name__, fields, forbid_unknown_fields=strict) for strict in (True, False))
    strict, lenient = (msgspec.json.Decoder(kind) for kind in kinds)
    return strict, lenient


def _count_rows(part: bytes) -> int:
    """Return the number of a field's rows: its lists, or its values where they are more than rows have."""
    n_rows, n_values = part.count(b"[") - 1, part.count(b",") + 1
    return n_rows if n_rows > 0 and n_values <= _WIDEST * n_rows else n_values


def _make_refusal(kind: str) -> RequestValidationError:
    return RequestValidationError([{"type": kind, "loc": ("body",), "msg": ""}])
