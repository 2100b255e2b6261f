"""Many rows at once, as numpy writes them (.npy): read whole, answered as they are computed."""

from __future__ import annotations

import asyncio
import io
import math
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager
from functools import partial
from http import HTTPStatus

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from sunarc.api.npy_header import NpyHeaderError, read_npy_header
from sunarc.api.problems import Fault, RefusedError
from sunarc.array_types import FloatArray
from sunarc.errors import InputError

NPY = "application/x-npy"
Rows = FloatArray | NDArray[np.float32]

_CHUNK = 65_536
_AHEAD = 2
MOST_BYTES_AHEAD = (_AHEAD + 1) * _CHUNK * 20 * 8
"""Of one answer, made and not sent: 32 MB with the 20 columns in double precision of a geolocation."""
_FLOATS = tuple(np.dtype(order + kind) for order in "<>" for kind in ("f4", "f8"))
_REMEDY = "send what numpy.save writes: two dimensions, float64 or float32, C order"


def read_rows(body: bytes, *, columns: tuple[int, ...], most: int) -> Rows:
    """Return the rows of a .npy file; InputError where it is none, RefusedError (413) where it holds too many.

    Parameters
    ----------
    body : the file.
    columns : how many columns it may have.
    most : so many rows at most.
    """
    try:
        header = read_npy_header(body)
    except NpyHeaderError as error:
        raise InputError(field="body", problem=f"is no .npy file: {error}", remedy=_REMEDY) from None
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
        async for part in self._made():
            await send({"type": "http.response.body", "body": part, "more_body": True})
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _made(self) -> AsyncIterator[bytes | memoryview]:
        coming: list[asyncio.Task[bytes | memoryview]] = []
        try:
            for part in self._parts:
                coming.append(asyncio.create_task(self._make(part)))
                if len(coming) > _AHEAD:
                    yield await coming.pop(0)
            while coming:
                yield await coming.pop(0)
        finally:
            for task in coming:
                task.cancel()

    async def _make(self, part: Callable[[], bytes | memoryview]) -> bytes | memoryview:
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
    start = _header(rows.dtype, shape)
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


def _header(dtype: np.dtype[np.floating], shape: tuple[int, ...]) -> bytes:
    stream = io.BytesIO()
    npy.write_array_header_1_0(stream, {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape})
    return stream.getvalue()
