"""Answers that are large, or take long to make: made once, kept in files, sent whole or by range."""

from __future__ import annotations

import asyncio
import mmap
import os
import re
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from http import HTTPStatus

from fastapi import Request
from fastapi.responses import Response
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send

from sunarc.common.errors import OutsideError
from sunarc.imager.web.bulk import ComputeSlots
from sunarc.imager.web.middleware.shared_quota import QuotaUse, SharedQuota, client_network
from sunarc.imager.web.problems import Fault, RefusedError, Responses
from sunarc.imager.web.routes.calibrations import matches

_MOST_BYTES = 256_000_000
"""Of the files that are kept: eight maps of 1748 x 1748 pixels as NetCDF (29 MB each)."""
_MOST_READERS = 32
"""Large answers that are being sent: a quarter of the requests that `api.max_at_once` allows by default, so that slow
readers leave room for others. So many files at most are there besides those that are kept."""
_LARGE_BYTES = 1_000_000
"""A smaller answer is not counted: it lies in the connection's buffers and occupies nothing else."""
_SENT_AT_ONCE = 524_288
_RANGE = re.compile(r"bytes=[ \t]*(\d{0,1000})-(\d{0,1000})", re.IGNORECASE)
RANGED: Responses = {206: {"description": "The part that Range asks for."}}
"""Description of a route whose answers are sent by range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tagged:
    """Request for content that has an ETag.

    Attributes
    ----------
    request : of the client.
    headers : with `etag`; sent with 304, too.
    if_none_match : the tags that the client has.
    """

    request: Request
    headers: Mapping[str, str]
    if_none_match: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ResponseBody:
    """Body of a response: bytes of a media type, and headers that came with their making."""

    content: bytes
    media_type: str
    headers: Mapping[str, str] = field(default_factory=dict)


class AnswerFiles:
    """Files of recent answers, and their readers. Used on the event loop alone.

    A file has no name: it ends with the service, or when its last reader has it.

    Parameters
    ----------
    most_bytes : of the files that are kept; the one not requested for the longest time goes first.
    most_readers : large answers that are being sent; of more, an address that has more of them than another loses its
        oldest, and the one that has the most is refused (429).
    """

    def __init__(self, *, most_bytes: int = _MOST_BYTES, most_readers: int = _MOST_READERS) -> None:
        self._most_bytes = most_bytes
        self._readers = SharedQuota(most_readers)
        self._files: OrderedDict[str, _File] = OrderedDict()

    async def answer(self, asked: Tagged, slots: ComputeSlots, make: Callable[[], ResponseBody]) -> Response:
        """Return the content that `make` returns, from a file; 304 where the client has it.

        Parameters
        ----------
        asked : its tag says what it is: the same tag is made once.
        slots : where it is made, in a thread.
        make : makes it.
        """
        tag = asked.headers["etag"]
        if matches(asked.if_none_match, tag):
            return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=dict(asked.headers))
        client = client_network(asked.request.scope)
        file = self._find_kept(tag)
        if file is None:
            slots.require_room(client)
            async with slots.slot(client):
                # another request may have made it while this one waited
                file = self._find_kept(tag) or self._keep_file(tag, await run_in_threadpool(_write_to_file, make))
        part = _requested_part(asked.request, tag, len(file.bytes))
        counted = 1 if len(file.bytes) >= _LARGE_BYTES else 0
        headers = {**file.headers, **asked.headers}
        return FileAnswer(file, part, headers=headers, use=self._readers.open(client), counted=counted)

    def _find_kept(self, tag: str) -> _File | None:
        if tag in self._files:
            self._files.move_to_end(tag)
        return self._files.get(tag)

    def _keep_file(self, tag: str, file: _File) -> _File:
        self._files[tag] = file
        while len(self._files) > 1 and sum(len(one.bytes) for one in self._files.values()) > self._most_bytes:
            self._files.popitem(last=False)
        return file


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _File:
    bytes: mmap.mmap
    media_type: str
    headers: Mapping[str, str]


def _write_to_file(make: Callable[[], ResponseBody]) -> _File:
    """Return the made content, in a file: where systemd says that caches are, else where temporary files are."""
    made = make()
    folder = os.environ.get("CACHE_DIRECTORY", "").partition(":")[0] or tempfile.gettempdir()
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(made.content)
            file.flush()
            mapped = mmap.mmap(file.fileno(), len(made.content), access=mmap.ACCESS_READ)
    except OSError as error:
        problem = f"an answer of {len(made.content)} bytes cannot be stored in {folder}: {error.strerror}"
        raise OutsideError(problem) from error
    return _File(bytes=mapped, media_type=made.media_type, headers=made.headers)


class FileAnswer(Response):
    """Sends a file that is mapped, or a part of it, in pieces that a socket takes at once.

    However long it takes: a connection ends by itself where its client reads nothing.

    Parameters
    ----------
    file : what is sent.
    part : which bytes of it; None: all.
    headers : to send along.
    use : ends it where others need the room.
    counted : what it counts as, of what is being sent, until all is sent.
    """

    def __init__(
        self, file: _File, part: range | None, *, headers: dict[str, str], use: QuotaUse, counted: int
    ) -> None:
        self._file, self._use, self._counted = file, use, counted
        size = len(file.bytes)
        self._part = range(size) if part is None else part
        self.background, self.media_type = None, file.media_type
        self.status_code = HTTPStatus.OK if part is None else HTTPStatus.PARTIAL_CONTENT
        if part is not None:
            headers["content-range"] = f"bytes {part.start}-{part.stop - 1}/{size}"
        self.init_headers(headers | {"content-length": str(len(self._part)), "accept-ranges": "bytes"})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:  # noqa: ARG002 - the protocol's
        """Send the answer; one that is ended is cut off, and its connection with it."""
        with suppress(TimeoutError), self._use:
            self._use.grow(self._counted)
            async with asyncio.timeout(None) as until:
                self._use.ends(until)
                await self._send_pieces(send)

    async def _send_pieces(self, send: Send) -> None:
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        view = memoryview(self._file.bytes)[self._part.start : self._part.stop]
        for begin in range(0, len(view), _SENT_AT_ONCE):
            piece = view[begin : begin + _SENT_AT_ONCE]
            await send({"type": "http.response.body", "body": piece, "more_body": True})
        await send({"type": "http.response.body", "body": b"", "more_body": False})


def _requested_part(request: Request, tag: str, size: int) -> range | None:
    """Return the bytes that a request asks for; None for all, as where its part is of another content (If-Range)."""
    if request.headers.get("if-range", tag) != tag:
        return None
    return byte_range(request.headers.get("range"), size)


def byte_range(text: str | None, size: int) -> range | None:
    """Return the one range that a header Range asks for, of so many bytes; None where the whole is answered.

    A range beyond the end is cut there; what is no range of bytes, or several ones, is ignored (RFC 9110, 14.2).

    Raises
    ------
    RefusedError
        (416) It is not within these bytes.
    """
    found = None if text is None else _RANGE.fullmatch(text.strip())
    first, last = found.groups() if found else ("", "")
    if not (first or last) or (first and last and int(first) > int(last)):
        return None
    if first:
        part = range(int(first), min(int(last), size - 1) + 1 if last else size)
    else:
        part = range(max(size - int(last), 0), size)
    if part:
        return part
    fault = Fault(field="range", problem=f"{text!r} is not within {size} bytes", remedy="ask for bytes=FIRST-LAST")
    headers = {"content-range": f"bytes */{size}"}
    raise RefusedError(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, fault, headers=headers)
