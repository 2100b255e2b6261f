"""What a campaign's service talks to by network: a picture's address, a receiver, and a hub on PostgreSQL."""

from __future__ import annotations

import contextlib
import sqlite3
import threading
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.client import HTTPException
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import psycopg
from tests.fixtures.hub_process import HubProcess
from tests.fixtures.links import Link
from tests.fixtures.postgresql import TEMPLATE, running_server

from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.imager.runtime.clock import SystemClock

from .campaign_processes import TOKEN, pause

CAMERA = "roof"
GRANTS = Path(__file__).parents[2] / "deploy" / "hub" / "grants.sql"
STRANGE: tuple[tuple[int, dict[str, str], bytes], ...] = (
    (401, {"WWW-Authenticate": "Digest foo"}, b""),
    (401, {"WWW-Authenticate": 'Digest realm="x", nonce="y", qop='}, b""),
    (401, {"WWW-Authenticate": 'Basic realm="a", Digest realm="b", nonce="c", algorithm=SHA-256, qop="auth"'}, b""),
    (302, {"Location": "http://["}, b""),
    (302, {"Location": "http://h\xe4\xff/\x80"}, b""),
    (302, {}, b""),
    (200, {"Content-Type": "image/jpeg", "Last-Modified": "Tue, 01 Jan 20130000000 00:00:00 GMT"}, b"none"),
    (200, {"Content-Type": "image/jpeg", "Date": "Tue, 01 Jan 0001 00:00:00 GMT"}, b"\xff\xd8\xff"),
    (200, {"Content-Type": "\x80", "Transfer-Encoding": "chunked"}, b"zz\r\n"),
    (204, {}, b""),
    (599, {"Retry-After": "9" * 400}, b""),
)
"""Answers of cameras that are none: status, headers, body."""
_ROWS = "SELECT time, body, exposure_us, method, file, x_px, y_px, CAST(accepted AS INTEGER) FROM sun_point"


@dataclass
class Other:
    """What answers on loopback beside the service: the camera's address, and a receiver of messages.

    Attributes
    ----------
    camera : where the picture of now is, as the simulated camera gives it.
    mode : what a request for the picture gets.
    drips, refuses : how the receiver takes messages.
    received : the ids of the messages that it has taken.
    """

    camera: str = ""
    mode: str = "picture"
    drips: bool = False
    refuses: bool = False
    received: list[str] = field(default_factory=list)
    _last: tuple[dict[str, str], bytes] | None = None
    _n: int = 0

    def picture(self) -> tuple[int, dict[str, str], bytes]:
        """Return status, headers and body of the answer to a request for the picture."""
        if self.mode == "unavailable":
            return 503, {}, b"busy"
        if self.mode == "page":
            return 200, {"Content-Type": "text/html"}, b"<html>please log in</html>"
        if self.mode == "redirect":
            return 302, {"Location": "http://192.0.2.1/current.jpg"}, b""
        if self.mode == "strange":
            self._n += 1
            return STRANGE[self._n % len(STRANGE)]
        if self.mode == "frozen" and self._last is not None:
            self._n += 1
            frozen = self._last[1]
            with urllib.request.urlopen(self.camera, timeout=5.0) as answer:
                kept = {name: answer.headers[name] for name in ("Content-Type", "Date", "Last-Modified")}
            return 200, kept, with_comment(frozen, f"picture {self._n}")
        if self.mode != "stale" or self._last is None:
            with urllib.request.urlopen(self.camera, timeout=5.0) as answer:
                kept = {name: answer.headers[name] for name in ("Content-Type", "Date", "Last-Modified")}
                self._last = kept, answer.read()
        return 200, *self._last

    def give(self, request: BaseHTTPRequestHandler) -> None:
        """Answer a request for the picture."""
        try:
            status, headers, body = self.picture()
        except (OSError, HTTPException):
            status, headers, body = 504, {}, b""
        request.send_response_only(status)
        length = len(body) if self.mode != "endless" else 1 << 40
        for name, value in {**headers, "Content-Length": str(length)}.items():
            request.send_header(name, value)
        request.end_headers()
        with contextlib.suppress(OSError):  # the service waits no longer
            for part in self._parts(body):
                request.wfile.write(part)

    def _parts(self, body: bytes) -> Iterator[bytes]:
        if self.mode == "drip":
            for at in range(0, len(body), 64):
                yield body[at : at + 64]
                pause(0.5)
        elif self.mode == "endless":
            yield from (bytes(1 << 16) for _ in range(4000))
        else:
            yield body

    def take(self, request: BaseHTTPRequestHandler) -> None:
        """Take a message, or not."""
        request.rfile.read(int(request.headers["content-length"]))
        with contextlib.suppress(OSError):  # the service waits no longer
            for _ in range(40 if self.drips else 0):
                request.wfile.write(b"H")
                pause(0.5)
            taken = not (self.drips or self.refuses)
            if taken:
                self.received.append(request.headers["webhook-id"])
            request.send_response(204 if taken else 500)
            request.end_headers()

    def handler(self) -> type[BaseHTTPRequestHandler]:
        """Return what answers a request."""
        other = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                other.give(self)

            def do_POST(self) -> None:
                other.take(self)

            def log_message(self, *_: object) -> None:
                pass

        return Handler


def with_comment(jpeg: bytes, text: str) -> bytes:
    """Return a JPEG file with a comment; its pixels are the same."""
    comment = text.encode()
    return jpeg[:2] + b"\xff\xfe" + (len(comment) + 2).to_bytes(2, "big") + comment + jpeg[2:]


class CampaignHub:
    """A hub on a PostgreSQL of its own, whose disk is small, at the end of a link that fails as it is told.

    Parameters
    ----------
    folder : empty; where PostgreSQL's user may come.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.installations: list[str] = []
        self.put_back: set[str] = set()
        """Rows that the service had until an operator put its database back; the hub keeps them."""
        self._ended = contextlib.ExitStack()
        self.server = self._ended.enter_context(running_server(folder=folder / "pg"))
        with open_hub_archive(self.server.url(TEMPLATE)) as archive:
            moment = SystemClock().now()
            archive.feeds.add_token(CAMERA, token_digest(TOKEN), now=moment, former_until=moment)
        self.server.sql("postgres", "CREATE ROLE sunarc_feed LOGIN", "CREATE ROLE sunarc_reader")
        self.server.script(TEMPLATE, GRANTS, user="test")
        self._starts = threading.Lock()
        self.process = HubProcess(folder, self.server.url(TEMPLATE, user="sunarc_feed"))
        self._ended.callback(self.process.kill)
        self.process.wait_until_it_answers()
        self.link = Link(self.process.address, seed=1)
        self._ended.callback(self.link.close)

    def settings(self, token_file: Path) -> str:
        """Return what the service's settings have of the hub."""
        return f'[hub]\nurl = "http://127.0.0.1:{self.link.port}"\ntoken_file = "{token_file}"\n'

    def close(self) -> None:
        """End hub and server."""
        self._ended.close()

    def tend(self) -> None:
        """Start a hub that ended, as its unit does."""
        with self._starts:
            self.process.start_again_if_ended()

    def kill(self) -> None:
        """End the hub at once."""
        with self._starts:
            self.process.kill()

    def start_server(self) -> None:
        """Start PostgreSQL again, as its unit does, where it ended or was ended."""
        with contextlib.suppress(AssertionError):  # it ended by itself: its disk was full
            self.server.stop("immediate")
        self.server.start()

    def sql(self, statement: str) -> None:
        """Carry out a statement in the hub's database, as its owner."""
        self.server.sql(TEMPLATE, statement)

    @contextlib.contextmanager
    def locked(self, table: str) -> Iterator[None]:
        """Keep others from a table."""
        with psycopg.connect(host=str(self.server.folder), user="test", dbname=TEMPLATE) as connection:
            connection.execute(f"LOCK TABLE {table} IN ACCESS EXCLUSIVE MODE")
            yield
            connection.rollback()

    def is_ready(self) -> bool:
        """Whether the hub says that it is."""
        try:
            answer: Any = self.process.ask("/readyz")
        except (OSError, ValueError, HTTPException):
            return False
        return bool(answer["status"] == "ready")

    def missing(self, rows: set[str], database: Path) -> list[str]:
        """Return what the hub has not of rows that the service still has, and what it has beside the service's.

        A service whose database was put back sends under another id, which an operator accepts.
        """
        self.tend()
        self.accept()
        try:
            hubs = self._rows()
        except AssertionError as error:  # of psql
            return [f"PostgreSQL: {error}"]
        own = self.rows_of(database)
        missing = [f"the hub has not {row}" for row in sorted((rows & own) - hubs)]
        return (missing + [f"the hub alone has {row}" for row in sorted(hubs - own - self.put_back)])[:20]

    def accept(self) -> None:
        """Accept, as an operator does, another installation that sends for the camera."""
        with contextlib.suppress(Exception), open_hub_archive(self.server.url(TEMPLATE)) as archive:
            for one in archive.feeds.quarantine(CAMERA):
                if one.reason == "second_installation" and one.installation not in self.installations:
                    self.installations.append(one.installation)
                    archive.feeds.accept_installation(CAMERA, one.installation, now=SystemClock().now())

    def _rows(self) -> set[str]:
        lines = self.server.sql(TEMPLATE, _ROWS).splitlines()
        return {_key(line.split("|")) for line in lines}

    def rows_of(self, database: Path) -> set[str]:
        """Return the sightings of a service's database, as they are compared."""
        with contextlib.closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=20.0)) as connection:
            return {_key(row) for row in connection.execute(_ROWS)}

    @property
    def n_rows(self) -> int:
        """How many sightings the hub has."""
        return int(self.server.sql(TEMPLATE, "SELECT count(*) FROM sun_point"))


def _key(row: Any) -> str:
    time, body, exposure, method, file, x, y, accepted = ("" if value is None else value for value in row)
    numbers = ("" if value == "" else f"{float(value):.9g}" for value in (exposure, x, y))
    return f"{time} {body} {method} {file} {accepted} {' '.join(numbers)}"
