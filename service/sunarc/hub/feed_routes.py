"""Route of the hub: rows that imagers send."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import math
import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from functools import partial
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Header, Path, Query, Request, Response
from fastapi.security.utils import get_authorization_scheme_param
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool
from starlette.types import Message, Receive, Scope, Send

from sunarc.common.errors import InputError, OutsideError
from sunarc.hub.archive import HubArchive
from sunarc.hub.feeds import Tokens
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.day_digests import DayDigests, StoredDays
from sunarc.imager.archive.feed_rows import MOST_ROWS, FeedBatch, Reason, Refusal, read_feed_lines
from sunarc.imager.runtime.json_fields import described
from sunarc.imager.web.middleware.admission import FEED_PATH
from sunarc.imager.web.middleware.http_only import HttpMiddleware
from sunarc.imager.web.problems import Fault, RefusedError, answers

MOST_BYTES = 16_000_000
"""Of a body when it is decompressed; an imager sends a million at once, and one calibration has a few."""
LARGE_BYTES, LARGE_CONTENT_BYTES = 10_000, 200_000
"""Of a compressed body and of its content, about 200 rows: a batch of an imager that was away."""
MOST_LISTS, MOST_VALUES = 200_000, 1_000_000
"""Lists and objects of JSON in a body, and values: an empty list takes 27 times as much memory as of its text."""
_PATIENCE = 3
"""Batches in succession of which nothing could be stored, until the sender waits: 1 s, twice as long each time."""
_LONGEST_WAIT_S = 60
_TOKENS_EVERY = timedelta(seconds=10)
"""For so long a token that was ended is still taken; a new one is known at once."""
LARGE_AT_ONCE = 2
"""Large bodies that are stored at the same time; the others wait for one another, and small ones for none of them."""
_STATUS: dict[Reason, HTTPStatus] = {
    "unknown_camera": HTTPStatus.NOT_FOUND,
    "forged_token": HTTPStatus.UNAUTHORIZED,
    "second_installation": HTTPStatus.CONFLICT,
    "newer_imager": HTTPStatus.CONFLICT,
    "body_too_large": HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
}
"""How a refusal is answered; 422 where nothing is said here."""
_REMEDIES: dict[Reason, str] = {
    "unknown_camera": "register it on the hub: sunarc hub token CAMERA",
    "forged_token": "send Authorization: Bearer … with the token of `sunarc hub token CAMERA`",
    "second_installation": "if it replaces the former one: sunarc hub accept CAMERA INSTALLATION",
    "newer_imager": "install the imager's version on the hub",
    "body_too_large": "send fewer rows",
}
_INSTALLATION = re.compile(r"[0-9A-Za-z-]{1,64}")


class Committed(BaseModel):
    """Up to which number the hub has an imager's rows."""

    committed: Annotated[int, described("Number of the last row; -1: send all again.", 4711)]


Name = Annotated[str, Path(description="Name of the camera.", min_length=1, max_length=100)]
After = Annotated[int, Query(ge=-1, lt=2**63, description="There is nothing between this number and the first row's.")]
Installation = Annotated[str, Header(alias="Sunarc-Installation", description="Id of the imager's outbox.")]
Revision = Annotated[str, Header(alias="Sunarc-Revision", description="Revision of the imager's database.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class SentBody:
    """Body of an imager's request: under which name, with which token, and the number that the rows follow."""

    camera: str
    token: str
    installation: str
    revision: str
    after: int
    body: bytes


@dataclass(eq=False)
class FeedReceiver:
    """Stores the rows that imagers send, and writes into quarantine those that are refused.

    Parameters
    ----------
    archive : the hub's.
    now : real time.
    """

    archive: HubArchive
    now: Callable[[], datetime]

    def __post_init__(self) -> None:
        """Begin with no sender that has to wait, and no tokens read."""
        self._failed: dict[str, tuple[int, datetime]] = {}
        self._tokens: Tokens = {}
        self._read_at: datetime | None = None

    def wait_s(self, camera: str) -> int:
        """Return for how many seconds a sender has to wait of whose last batches no row could be stored."""
        n, since = self._failed.get(camera, (0, self.now()))
        pause_s = min(2 ** min(max(n - _PATIENCE, 0), 16) // 2, _LONGEST_WAIT_S)
        waited_s = (self.now() - since).total_seconds()
        return math.ceil(pause_s - waited_s) if 0.0 <= waited_s < pause_s else 0

    def take(self, sent: SentBody, *, large: bool) -> int | None:
        """Return the number up to which the hub has an imager's rows; None of a body that is large and may not be.

        Raises
        ------
        RefusedError : the hub takes none of them.
        """
        try:
            return self._take_rows(sent, large=large)
        finally:
            n = self.archive.feeds.n_failing(sent.camera)
            if not n:
                self._failed.pop(sent.camera, None)
            elif n != self._failed.get(sent.camera, (0, None))[0]:
                self._failed[sent.camera] = (n, self.now())

    def _take_rows(self, sent: SentBody, *, large: bool) -> int | None:
        camera, installation, after = sent.camera, sent.installation, sent.after
        self.require_token(camera, sent.token)
        if not _INSTALLATION.fullmatch(installation):
            raise self._record_refusal(
                camera, "", Refusal(reason="malformed", text="the installation's id is not a word")
            )
        if sent.revision > head_revision():
            text = f"the imager is at revision {sent.revision}, the hub at {head_revision()}"
            raise self._record_refusal(camera, installation, Refusal(reason="newer_imager", text=text))
        try:
            content = _decompress_body(sent.body, MOST_BYTES if large else LARGE_CONTENT_BYTES)
            if content is None and not large:
                return None
            rows = read_feed_lines(_require_memory(content), after=after)
        except InputError as error:
            raise self._record_refusal(camera, installation, Refusal(reason="malformed", text=str(error))) from None
        except _TooLargeError as error:
            raise _make_error(Refusal(reason="body_too_large", text=str(error))) from None  # see FeedSizes
        batch = FeedBatch(camera=camera, installation=installation, after=after, rows=rows)
        committed = self.archive.feeds.take(batch, now=self.now())
        if isinstance(committed, Refusal):
            raise _make_error(committed)
        return committed

    def require_token(self, camera: str, token: str) -> None:
        """Raise `RefusedError` where a token is not one of the camera's, and write that into quarantine."""
        own, now = token_digest(token), self.now()
        if self._has_valid_token(camera, own, now):
            return
        self._read_at = None  # it may be new
        if self._has_valid_token(camera, own, now):
            return
        if camera not in self._tokens:
            refusal = Refusal(reason="unknown_camera", text=f"nobody registered a camera {camera}")
            raise self._record_refusal(camera, "", refusal)
        # What the request says of itself is not believed: the id would be a stranger's.
        refusal = Refusal(reason="forged_token", text="the token is not one of the camera's, or has expired")
        raise self._record_refusal(camera, "", refusal)

    def _has_valid_token(self, camera: str, own: str, now: datetime) -> bool:
        """Return whether a digest is that of a camera's token that has not ended; read every 10 s, for all at once."""
        if self._read_at is None or not timedelta(0) <= now - self._read_at < _TOKENS_EVERY:
            self._tokens, self._read_at = self.archive.feeds.all_tokens(), now
        valid = [one for one, until in self._tokens.get(camera, ()) if until is None or until > now]
        return sum(hmac.compare_digest(own, digest) for digest in valid) > 0

    def stored_days(self, camera: str, token: str, installation: str, *, since: date, until: date) -> DayDigests:
        """Return the digests of a camera's days.

        Raises
        ------
        RefusedError : the token is not the camera's, or another installation sends its rows.
        """
        self.require_token(camera, token)
        found = self.archive.feeds.digests(camera, installation, since=since, until=until)
        if found is None:
            raise _make_error(Refusal(reason="second_installation", text=f"{installation} does not send as {camera}"))
        return found

    def note_too_large(self, camera: str) -> None:
        """Write into quarantine that a body was too large."""
        if camera in self.archive.feeds.all_tokens():
            refusal = Refusal(reason="body_too_large", text="a body was too large; the imager sends it in parts")
            self.archive.feeds.refuse(camera=camera, installation="", refusal=refusal, now=self.now())

    def _record_refusal(self, camera: str, installation: str, refusal: Refusal) -> RefusedError:
        self.archive.feeds.refuse(camera=camera, installation=installation, refusal=refusal, now=self.now())
        return _make_error(refusal)


def token_digest(token: str) -> str:
    """Return the digest that the hub keeps of a token."""
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()


def feed_routes(receiver: FeedReceiver) -> APIRouter:
    """Return the routes that take the rows of imagers, and answer with the stored ones."""
    routes = APIRouter(tags=["fleet"])
    slots = asyncio.Semaphore(LARGE_AT_ONCE)

    @routes.put("/v1/cameras/{camera}/feed", responses=answers(401, 404, 408, 409, 413, 422))
    async def feed(  # noqa: PLR0917 - FastAPI's parameters
        request: Request,
        response: Response,
        camera: Name,
        after: After,
        installation: Installation,
        revision: Revision,
    ) -> Committed:
        """Store rows of an imager's outbox: gzip-compressed lines of {"seq", "kind", "data"}.

        A repetition changes nothing. What is refused, as a whole or one row, is in /v1/quarantine with its reason.
        A sender of whose rows none can be stored is asked to wait (Retry-After), and answered 429 until then.
        """
        token = _request_token(request)
        await run_in_threadpool(receiver.require_token, camera, token)  # a stranger's body is not read
        wait_s = receiver.wait_s(camera)
        if wait_s:
            fault = Fault(
                field="request", problem="no row of the last batches could be stored", remedy="wait, or correct it"
            )
            raise RefusedError(HTTPStatus.TOO_MANY_REQUESTS, fault, headers={"retry-after": str(wait_s)})
        sent = SentBody(
            camera=camera,
            token=token,
            installation=installation,
            revision=revision,
            after=after,
            body=await request.body(),
        )
        committed = None
        if int(request.headers.get("content-length") or LARGE_BYTES + 1) <= LARGE_BYTES:
            committed = await run_in_threadpool(receiver.take, sent, large=False)
        if committed is None:
            # After a failure of the hub all imagers catch up: without a limit they would have every thread of the pool.
            async with slots:
                committed = await run_in_threadpool(receiver.take, sent, large=True)
        wait_s = receiver.wait_s(camera)
        if wait_s:
            response.headers["retry-after"] = str(wait_s)
        return Committed(committed=committed or 0)

    _add_stored_days(routes, receiver)
    return routes


def _add_stored_days(routes: APIRouter, receiver: FeedReceiver) -> None:
    """Add the route of a camera's stored days."""
    comparing = asyncio.Semaphore(1)

    @routes.get("/v1/cameras/{camera}/feed", responses=answers(401, 404, 409, 422, 429))
    async def stored(  # noqa: PLR0917 - FastAPI's parameters
        request: Request, camera: Name, since: date, until: date, installation: Installation, revision: Revision
    ) -> StoredDays:
        """Return number and hash of a camera's rows by kind and UTC day, since <= day < until, with its own token.

        At most 32 days and 200,000 rows are read; `until` says how far. One sender at a time is answered, the others
        429.
        """
        token = _request_token(request)
        await run_in_threadpool(receiver.require_token, camera, token)  # a stranger gets no slot
        if comparing.locked():
            fault = Fault(field="request", problem="another comparison is under way", remedy="try again later")
            raise RefusedError(HTTPStatus.TOO_MANY_REQUESTS, fault, headers={"retry-after": "30"})
        last = until if revision == head_revision() else since  # of other columns hashes say nothing
        async with comparing:
            ask = partial(receiver.stored_days, camera, token, installation, since=since, until=last)
            found = await run_in_threadpool(ask)
        return StoredDays(revision=head_revision(), until=found.until, days=found.days)


def _request_token(request: Request) -> str:
    """Return the token that a request bears; empty without one."""
    scheme, token = get_authorization_scheme_param(request.headers.get("authorization"))
    return token if scheme.lower() == "bearer" else ""


@dataclass(kw_only=True, eq=False)
class FeedSizes(HttpMiddleware):
    """Writes into quarantine that a feed's body was too large, whoever refused it: mostly it was not even read.

    Parameters
    ----------
    receiver : writes it down.
    """

    receiver: FeedReceiver

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and read the answer's status."""
        found = FEED_PATH.fullmatch(scope["path"]) if scope["type"] == "http" else None
        if found is None:
            await self.app(scope, receive, send)
            return
        statuses: list[int] = []

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                statuses.append(message["status"])
            await send(message)

        await self.app(scope, receive, sending)
        if statuses == [HTTPStatus.REQUEST_ENTITY_TOO_LARGE]:
            await run_in_threadpool(self._note_too_large, found.group(1))

    def _note_too_large(self, camera: str) -> None:
        try:
            self.receiver.note_too_large(camera)
        except OutsideError:
            return  # the database does not answer, which the imager hears next time


class _TooLargeError(Exception):
    pass


def _decompress_body(body: bytes, most: int) -> bytes | None:
    """Return a gzip body's content; None where it has more bytes than `most`: a small one can hold gigabytes."""
    unpacking = zlib.decompressobj(wbits=31)
    try:
        content = unpacking.decompress(body, most)
    except zlib.error as error:
        raise InputError(field="body", problem=f"is not gzip ({error})", remedy="compress it") from None
    if unpacking.unconsumed_tail:
        return None
    if not unpacking.eof:
        raise InputError(field="body", problem="is not complete gzip", remedy="send it again")
    return content


def _require_memory(content: bytes | None) -> bytes:
    """Return a content that needs no more memory than is there for it."""
    if content is None:
        raise _TooLargeError(f"the body is larger than {MOST_BYTES} bytes when decompressed")
    if content.count(b"[") + content.count(b"{") > MOST_LISTS:
        raise _TooLargeError(f"the body has more than {MOST_LISTS} lists and objects")
    if content.count(b",") > MOST_VALUES:
        raise _TooLargeError(f"the body has more than {MOST_VALUES} values")
    if content.count(b"\n") > MOST_ROWS:
        raise _TooLargeError(f"the body has more than {MOST_ROWS} rows")
    return content


def _make_error(refusal: Refusal) -> RefusedError:
    fault = Fault(field=refusal.reason, problem=refusal.text, remedy=_REMEDIES.get(refusal.reason, "correct it"))
    return RefusedError(_STATUS.get(refusal.reason, HTTPStatus.UNPROCESSABLE_ENTITY), fault)
