"""Route of the hub: rows that imagers send."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import re
import zlib
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from datetime import datetime
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Header, Path, Query, Request
from fastapi.security.utils import get_authorization_scheme_param
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool
from starlette.types import Message, Receive, Scope, Send

from sunarc.api.middleware.admission import FEED_PATH
from sunarc.api.middleware.http_only import HttpMiddleware
from sunarc.api.problems import Fault, RefusedError, answers
from sunarc.archive.archive import Archive
from sunarc.archive.database.schema import head_revision
from sunarc.archive.fleet.feed_rows import FeedBatch, Reason, Refusal, read_feed_lines
from sunarc.errors import InputError, OutsideError
from sunarc.json_fields import described

MOST_BYTES = 64_000_000
"""Of a body when it is decompressed; an imager sends a million at once, and one calibration has a few."""
LARGE_BYTES = 10_000
"""Of a compressed body, about 200 rows: what an imager sends that was away."""
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


@dataclass(eq=False)
class FeedReceiver:
    """Stores what imagers send, and writes into quarantine what is refused.

    Parameters
    ----------
    archive : the hub's.
    now : real time.
    """

    archive: Archive
    now: Callable[[], datetime]

    def take(self, *, camera: str, token: str, installation: str, revision: str, after: int, body: bytes) -> int:
        """Return the number up to which the hub has an imager's rows; RefusedError where it takes none of them."""
        self._require_token(camera, token)
        if not _INSTALLATION.fullmatch(installation):
            raise self._refused(camera, "", Refusal(reason="malformed", text="the installation's id is not a word"))
        if revision > head_revision():
            text = f"the imager is at revision {revision}, the hub at {head_revision()}"
            raise self._refused(camera, installation, Refusal(reason="newer_imager", text=text))
        try:
            rows = read_feed_lines(_decompressed(body), after=after)
        except InputError as error:
            raise self._refused(camera, installation, Refusal(reason="malformed", text=str(error))) from None
        except _TooLargeError as error:
            raise _error(Refusal(reason="body_too_large", text=str(error))) from None  # see FeedSizes
        batch = FeedBatch(camera=camera, installation=installation, after=after, rows=rows)
        committed = self.archive.feeds.take(batch, now=self.now())
        if isinstance(committed, Refusal):
            raise _error(committed)
        return committed

    def _require_token(self, camera: str, token: str) -> None:
        digests = self.archive.feeds.tokens(camera, now=self.now())
        if digests is None:
            refusal = Refusal(reason="unknown_camera", text=f"nobody registered a camera {camera}")
            raise self._refused(camera, "", refusal)
        own = token_digest(token)
        if not sum(hmac.compare_digest(own, digest) for digest in digests):
            # What the request says of itself is not believed: the id would be a stranger's.
            refusal = Refusal(reason="forged_token", text="the token is not one of the camera's, or has expired")
            raise self._refused(camera, "", refusal)

    def note_too_large(self, camera: str) -> None:
        """Write into quarantine that a body was too large."""
        if self.archive.feeds.tokens(camera, now=self.now()) is not None:
            refusal = Refusal(reason="body_too_large", text="a body was too large; the imager sends it in parts")
            self.archive.feeds.refuse(camera=camera, installation="", refusal=refusal, now=self.now())

    def _refused(self, camera: str, installation: str, refusal: Refusal) -> RefusedError:
        self.archive.feeds.refuse(camera=camera, installation=installation, refusal=refusal, now=self.now())
        return _error(refusal)


def token_digest(token: str) -> str:
    """Return the digest that the hub keeps of a token."""
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()


def feed_routes(receiver: FeedReceiver) -> APIRouter:
    """Return the route that takes what imagers send."""
    routes = APIRouter(tags=["fleet"])
    large = asyncio.Semaphore(LARGE_AT_ONCE)

    @routes.put("/v1/cameras/{camera}/feed", responses=answers(401, 404, 408, 409, 413, 422))
    async def feed(
        request: Request, camera: Name, after: After, installation: Installation, revision: Revision
    ) -> Committed:
        """Store rows of an imager's outbox: gzip-compressed lines of {"seq", "kind", "data"}.

        A repetition changes nothing. What is refused, as a whole or one row, is in /v1/quarantine with its reason.
        """
        scheme, token = get_authorization_scheme_param(request.headers.get("authorization"))
        body = await request.body()
        # After a failure of the hub all imagers catch up: without a limit they would have every thread of the pool.
        async with large if len(body) > LARGE_BYTES else nullcontext():
            committed = await run_in_threadpool(
                receiver.take,
                camera=camera,
                token=token if scheme.lower() == "bearer" else "",
                installation=installation,
                revision=revision,
                after=after,
                body=body,
            )
        return Committed(committed=committed)

    return routes


@dataclass(kw_only=True, eq=False)
class FeedSizes(HttpMiddleware):
    """Writes into quarantine that a feed's body was too large, whoever refused it: mostly it was not even read.

    Parameters
    ----------
    receiver : writes it down.
    """

    receiver: FeedReceiver

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and look at the answer's status."""
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
            await run_in_threadpool(self._note, found.group(1))

    def _note(self, camera: str) -> None:
        try:
            self.receiver.note_too_large(camera)
        except OutsideError:
            return  # the database does not answer, which the imager hears next time


class _TooLargeError(Exception):
    pass


def _decompressed(body: bytes) -> bytes:
    """Return a gzip body's content, no more of it than is allowed: a small one can hold gigabytes."""
    unpacking = zlib.decompressobj(wbits=31)
    try:
        content = unpacking.decompress(body, MOST_BYTES)
    except zlib.error as error:
        raise InputError(field="body", problem=f"is not gzip ({error})", remedy="compress it") from None
    if unpacking.unconsumed_tail:
        raise _TooLargeError(f"the body is larger than {MOST_BYTES} bytes when decompressed")
    if not unpacking.eof:
        raise InputError(field="body", problem="is not complete gzip", remedy="send it again")
    return content


def _error(refusal: Refusal) -> RefusedError:
    fault = Fault(field=refusal.reason, problem=refusal.text, remedy=_REMEDIES.get(refusal.reason, "correct it"))
    return RefusedError(_STATUS.get(refusal.reason, HTTPStatus.UNPROCESSABLE_ENTITY), fault)
