"""One HTTP request with a limit on the whole of it, and answers to a server's challenge: Digest (RFC 7616) or Basic."""

from __future__ import annotations

import base64
import hashlib
import logging
import re
import secrets
import socket
import ssl
import urllib.parse
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import NamedTuple
from urllib.request import parse_http_list

import h11

_log = logging.getLogger(__name__)
_MOST_ADDRESSES = 4
"""Of a host that has many."""
_PART_BYTES = 65_536
"""Bytes that are read or written at once, and of the head of an answer."""
_TURN_S = 1.0
"""Between two heartbeats of an exchange that is under way."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HttpRequest:
    """A request.

    Attributes
    ----------
    method, url, headers, body : the request; `url` was checked.
    proxy : through which it goes; None: none.
    """

    method: str
    url: urllib.parse.SplitResult
    headers: Mapping[str, str]
    body: bytes
    proxy: urllib.parse.SplitResult | None = None


@dataclass(frozen=True, slots=True)
class HttpAnswer:
    """The status, headers (names in lower case, those of one name in lines) and beginning of the body of an answer."""

    status: int
    headers: Mapping[str, str]
    body: bytes


def request_target(url: urllib.parse.SplitResult) -> str:
    """Return the path and query of an address, as a request line has them."""
    return (url.path or "/") + (f"?{url.query}" if url.query else "")


class Trust:
    """Certificates that a TLS client trusts, the system's and a file's; read again where either has changed.

    Parameters
    ----------
    ca_file : with certificates in addition to those of the system.

    Raises
    ------
    OSError : the file cannot be read, or is invalid.
    """

    def __init__(self, ca_file: Path | None = None) -> None:
        system = ssl.get_default_verify_paths()
        self._ca_file = ca_file
        self._files = [Path(name) for name in (system.cafile, system.capath, ca_file) if name is not None]
        self._stamps = self._present_stamps()
        self._context = self._new_context()

    def context(self) -> ssl.SSLContext:
        """Return the present TLS context; where a changed file cannot be read, the former one."""
        stamps = self._present_stamps()
        if stamps != self._stamps:
            self._stamps = stamps
            try:
                self._context = self._new_context()
            except OSError as error:  # half written: it changes again
                _log.warning("certificates of %s cannot be read, the former ones are used: %s", self._ca_file, error)
        return self._context

    def _new_context(self) -> ssl.SSLContext:
        context = ssl.create_default_context()
        if self._ca_file is not None:
            context.load_verify_locations(self._ca_file)
        return context

    def _present_stamps(self) -> list[tuple[int, int, int] | None]:
        return [_read_stamp(file) for file in self._files]


def _read_stamp(file: Path) -> tuple[int, int, int] | None:
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


class UnfinishedError(Exception):
    """Error of an exchange that began and did not end: cut off, too slow, or no HTTP."""


@contextmanager
def exchange_errors() -> Iterator[None]:
    """Raise each error of an exchange as `OSError` (nothing was exchanged) or as `UnfinishedError`.

    Sockets, TLS, h11 and the encodings of host names and headers raise errors of their own kinds.
    """
    try:
        yield
    except (OSError, UnfinishedError):  # a refused certificate is a ValueError too
        raise
    except h11.RemoteProtocolError as error:
        raise UnfinishedError(f"its answer is no HTTP ({error})") from error
    except (h11.LocalProtocolError, ValueError) as error:
        raise OSError(f"the request cannot be written ({error})") from error


@dataclass(eq=False)
class Limit:
    """Time limit of an exchange, and the heartbeat meanwhile.

    Parameters
    ----------
    within_s : seconds from now on.
    monotonic : seconds that never jump.
    heartbeat : called about every second while something is waited for.
    """

    within_s: float
    _: KW_ONLY
    monotonic: Callable[[], float]
    heartbeat: Callable[[], None]

    def __post_init__(self) -> None:
        """Start the time limit."""
        self._until_s = self.monotonic() + self.within_s

    def left_s(self) -> float:
        """Call the heartbeat, and return the seconds left; TimeoutError at the end."""
        self.heartbeat()
        left_s = self._until_s - self.monotonic()
        if left_s <= 0.0:
            raise TimeoutError(f"not finished within {self.within_s:g} s")
        return left_s

    def read(self, channel: socket.socket) -> bytes:
        """Return the next bytes from a channel; empty where it was closed."""
        while True:
            channel.settimeout(min(self.left_s(), _TURN_S))
            with suppress(TimeoutError):
                return channel.recv(_PART_BYTES)

    def write(self, channel: socket.socket, content: bytes) -> None:
        """Write all of some bytes to a channel."""
        rest = memoryview(content)
        while rest:
            channel.settimeout(min(self.left_s(), _TURN_S))
            with suppress(TimeoutError):
                rest = rest[channel.send(rest[:_PART_BYTES]) :]


def fetch(request: HttpRequest, *, context: ssl.SSLContext | None, limit: Limit, most_bytes: int = 0) -> HttpAnswer:
    """Send a request, and return its answer.

    The limit holds for the whole of it, however slowly bytes come; a name that is not resolved takes as long as the
    host's resolver. `urllib` and `http.client` limit the time between two bytes alone.

    Parameters
    ----------
    request : what is sent.
    context : of TLS, for https.
    limit : on the time.
    most_bytes : no more of the body is read; with 0 the exchange ends at the status.

    Raises
    ------
    UnfinishedError : the connection was made, and was cut off or took too long; or the answer is no HTTP.
    OSError : no connection or no TLS in time.
    """
    with exchange_errors(), connected(request, context, limit) as channel:
        whole = request.proxy is not None and context is None
        target = request_target(request.url)
        lines = {
            "host": request.url.netloc.encode("idna").decode(),
            "content-length": str(len(request.body)),
            "connection": "close",
            **request.headers,
        }
        head = h11.Request(
            method=request.method,
            target=f"{request.url.scheme}://{request.url.netloc}{target}" if whole else target,
            headers=[(name.encode("ascii"), value.encode("latin-1")) for name, value in lines.items()],
        )
        try:
            return _exchange_events(channel, [head, h11.Data(data=request.body), h11.EndOfMessage()], limit, most_bytes)
        except OSError as error:
            raise UnfinishedError(str(error)) from error


def _exchange_events(channel: socket.socket, events: list[h11.Event], limit: Limit, most_bytes: int) -> HttpAnswer:
    connection = h11.Connection(h11.CLIENT, max_incomplete_event_size=_PART_BYTES)
    with suppress(BrokenPipeError, ConnectionResetError):  # who refuses early may close before all is read
        limit.write(channel, b"".join(connection.send(event) or b"" for event in events))
    status, body, headers = 0, bytearray(), dict[str, str]()
    while True:
        event = connection.next_event()
        if event is h11.NEED_DATA:
            connection.receive_data(limit.read(channel))
        elif isinstance(event, h11.Response):
            status = event.status_code
            for name, value in event.headers:
                key = name.decode("latin-1").lower()
                headers[key] = "\n".join([*([headers[key]] if key in headers else []), value.decode("latin-1")])
        elif isinstance(event, h11.Data):
            body += event.data
        if status and (isinstance(event, h11.EndOfMessage) or len(body) >= most_bytes):
            return HttpAnswer(status, headers, bytes(body[:most_bytes]))


def connected(request: HttpRequest, context: ssl.SSLContext | None, limit: Limit) -> socket.socket:
    """Return a connection to the first address of a host (or of its proxy) that answers, with TLS where asked for.

    The parameters and errors are those of `fetch`.
    """
    host, port = request.url.hostname or "", request.url.port or (443 if context else 80)
    proxy = request.proxy
    channel = (
        _connect_host(host, port, limit)
        if proxy is None
        else _connect_host(proxy.hostname or "", proxy.port or 80, limit)
    )
    try:
        if context is None:
            return channel
        if proxy is not None:
            _open_tunnel(channel, f"{host}:{port}", limit)
        channel.settimeout(limit.left_s())  # of the whole handshake
        return context.wrap_socket(channel, server_hostname=host)
    except BaseException:
        channel.close()
        raise


def _connect_host(host: str, port: int, limit: Limit) -> socket.socket:
    error: OSError = OSError("the name has no address")
    for _, _, _, _, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[:_MOST_ADDRESSES]:
        try:
            return socket.create_connection((str(address[0]), port), timeout=limit.left_s())
        except TimeoutError:
            raise
        except OSError as refused:
            error = refused
    raise error


def _open_tunnel(channel: socket.socket, target: str, limit: Limit) -> None:
    """Ask a proxy to pass the connection on to a host and port."""
    events: list[h11.Event] = [h11.Request(method="CONNECT", target=target, headers=[("host", target)])]
    status = _exchange_events(channel, [*events, h11.EndOfMessage()], limit, 0).status
    if status != 200:
        raise OSError(f"the proxy answers {status}")


_WORD = r"[!#$%&'*+\-.^`|~\w]+"
_PARAMETER = re.compile(rf'({_WORD})\s*=\s*(?:"(.*)"|({_WORD})?)', re.ASCII)
_SCHEME = re.compile(rf"({_WORD})(?:\s+(.*))?", re.ASCII)
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f]")


class Challenge(NamedTuple):
    """Authentication scheme that a server offers, and its parameters by names in lower case."""

    scheme: str
    parameters: Mapping[str, str]


def challenges_in(lines: Sequence[str]) -> list[Challenge]:
    """Return the challenges of the WWW-Authenticate lines of an answer, in their order; a line may hold several."""
    found: list[Challenge] = []
    for line in lines:
        parameters: dict[str, str] = {}  # those before a scheme belong to nothing
        for element in parse_http_list(_CONTROL.sub(" ", line)):
            named = _PARAMETER.fullmatch(element)
            if named is None:
                begun = _SCHEME.fullmatch(element)
                if begun is None:
                    continue
                parameters = {}
                found.append(Challenge(begun.group(1).lower(), parameters))
                named = _PARAMETER.fullmatch(begun.group(2) or "")
            if named is not None:
                parameters.setdefault(named.group(1).lower(), named.group(2) or named.group(3) or "")
    return found


def offers(challenges: Sequence[Challenge]) -> str:
    """Return the schemes and algorithms of challenges, for a message."""
    named = (f"{one.scheme.title()} {one.parameters.get('algorithm', '')}".strip() for one in challenges)
    return ", ".join(dict.fromkeys(named)) or "nothing"


def authorization(login: tuple[str, str], challenges: Sequence[Challenge], *, method: str, uri: str) -> str | None:
    """Return the Authorization header that answers challenges, or None where none can be answered.

    The first Digest challenge of a known algorithm is answered. The password is sent by Basic only where no Digest is
    offered. A server that refuses without naming a scheme gets Basic.

    Parameters
    ----------
    login : user and password.
    challenges : of the server's answer.
    method, uri : of the request.
    """
    digests = [one for one in challenges if one.scheme == "digest"]
    answers = (_answer_digest(login, one.parameters, method=method, uri=uri) for one in digests)
    answered = next((one for one in answers if one is not None), None)
    if answered is not None or digests:
        return answered
    if challenges and not any(one.scheme == "basic" for one in challenges):
        return None
    return f"Basic {base64.b64encode(':'.join(login).encode()).decode()}"


def _hash_md5(content: bytes) -> str:
    return hashlib.md5(content, usedforsecurity=False).hexdigest()


_HASHES: Mapping[str, Callable[[bytes], str]] = {
    "md5": _hash_md5,
    "sha": lambda content: hashlib.sha1(content, usedforsecurity=False).hexdigest(),
    "sha-256": lambda content: hashlib.sha256(content).hexdigest(),
    "sha-512-256": lambda content: hashlib.new("sha512_256", content).hexdigest(),
}
_SESSION = "-sess"


def _answer_digest(login: tuple[str, str], parameters: Mapping[str, str], *, method: str, uri: str) -> str | None:
    """Return the answer to a Digest challenge; None where it is incomplete, or its algorithm is not known."""
    realm, nonce = parameters.get("realm"), parameters.get("nonce")
    algorithm = parameters.get("algorithm") or "MD5"
    hash_content = _HASHES.get(algorithm.lower().removesuffix(_SESSION))
    if hash_content is None or realm is None or not nonce:
        return None
    offered = {one.strip().lower() for one in parameters.get("qop", "").split(",")} - {""}
    qop = next((one for one in ("auth", "auth-int") if one in offered), None)
    if offered and qop is None:
        return None

    def hash_parts(*parts: str) -> str:
        return hash_content(":".join(parts).encode("latin-1"))

    user, password, uri = (part.encode().decode("latin-1") for part in (*login, uri))  # UTF-8 on the wire
    once, count = secrets.token_hex(8), "00000001"
    secret = hash_parts(user, realm, password)
    if algorithm.lower().endswith(_SESSION):
        secret = hash_parts(secret, nonce, once)
    request = hash_parts(method, uri, hash_content(b"")) if qop == "auth-int" else hash_parts(method, uri)
    numbered = [] if qop is None else [count, once, qop]
    response = hash_parts(secret, nonce, *numbered, request)
    given = {"username": user, "realm": realm, "nonce": nonce, "uri": uri, "response": response}
    if "opaque" in parameters:
        given["opaque"] = parameters["opaque"]
    if qop is not None or algorithm.lower().endswith(_SESSION):
        given["cnonce"] = once
    fields = [f'{name}="{_escape_value(value)}"' for name, value in given.items()]
    fields += [f"algorithm={algorithm}"] if "algorithm" in parameters else []
    fields += [] if qop is None else [f"qop={qop}", f"nc={count}"]
    return f"Digest {', '.join(fields)}"


def _escape_value(value: str) -> str:
    return re.sub(r'(["\\])', r"\\\1", value)
