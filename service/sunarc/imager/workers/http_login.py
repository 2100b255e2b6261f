"""Answers to the challenges of an HTTP or RTSP server: Digest (RFC 7616) or Basic (RFC 7617)."""

from __future__ import annotations

import base64
import hashlib
import re
import secrets
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple
from urllib.request import parse_http_list

_WORD = r"[!#$%&'*+\-.^`|~\w]+"
_PARAMETER = re.compile(rf'({_WORD})\s*=\s*(?:"(.*)"|({_WORD})?)', re.ASCII)
_SCHEME = re.compile(rf"({_WORD})(?:\s+(.*))?", re.ASCII)
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f]")


class Challenge(NamedTuple):
    """A way to log in that a server offers: its scheme and the names of its parameters in lower case."""

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
    """Return the Authorization that answers challenges, or None where none of them can be answered.

    The first Digest challenge of a known algorithm is answered. The password is sent by Basic only where no Digest is
    offered. A server that refuses without naming a scheme gets Basic.

    Parameters
    ----------
    login : user and password.
    challenges : of the server's answer.
    method, uri : of the request.
    """
    digests = [one for one in challenges if one.scheme == "digest"]
    answers = (_digest(login, one.parameters, method=method, uri=uri) for one in digests)
    answered = next((one for one in answers if one is not None), None)
    if answered is not None or digests:
        return answered
    if challenges and not any(one.scheme == "basic" for one in challenges):
        return None
    return f"Basic {base64.b64encode(':'.join(login).encode()).decode()}"


def _md5(content: bytes) -> str:
    return hashlib.md5(content, usedforsecurity=False).hexdigest()


_HASHES: Mapping[str, Callable[[bytes], str]] = {
    "md5": _md5,
    "sha": lambda content: hashlib.sha1(content, usedforsecurity=False).hexdigest(),
    "sha-256": lambda content: hashlib.sha256(content).hexdigest(),
    "sha-512-256": lambda content: hashlib.new("sha512_256", content).hexdigest(),
}
_SESSION = "-sess"


def _digest(login: tuple[str, str], parameters: Mapping[str, str], *, method: str, uri: str) -> str | None:
    """Return the answer to a Digest challenge; None where it is incomplete, or its algorithm is not known."""
    realm, nonce = parameters.get("realm"), parameters.get("nonce")
    algorithm = parameters.get("algorithm") or "MD5"
    hash_of = _HASHES.get(algorithm.lower().removesuffix(_SESSION))
    if hash_of is None or realm is None or not nonce:
        return None
    offered = {one.strip().lower() for one in parameters.get("qop", "").split(",")} - {""}
    qop = next((one for one in ("auth", "auth-int") if one in offered), None)
    if offered and qop is None:
        return None

    def hashed(*parts: str) -> str:
        return hash_of(":".join(parts).encode("latin-1"))

    user, password, uri = (part.encode().decode("latin-1") for part in (*login, uri))  # UTF-8 on the wire
    once, count = secrets.token_hex(8), "00000001"
    secret = hashed(user, realm, password)
    if algorithm.lower().endswith(_SESSION):
        secret = hashed(secret, nonce, once)
    request = hashed(method, uri, hash_of(b"")) if qop == "auth-int" else hashed(method, uri)
    numbered = [] if qop is None else [count, once, qop]
    response = hashed(secret, nonce, *numbered, request)
    given = {"username": user, "realm": realm, "nonce": nonce, "uri": uri, "response": response}
    if "opaque" in parameters:
        given["opaque"] = parameters["opaque"]
    if qop is not None or algorithm.lower().endswith(_SESSION):
        given["cnonce"] = once
    fields = [f'{name}="{_escaped(value)}"' for name, value in given.items()]
    fields += [f"algorithm={algorithm}"] if "algorithm" in parameters else []
    fields += [] if qop is None else [f"qop={qop}", f"nc={count}"]
    return f"Digest {', '.join(fields)}"


def _escaped(value: str) -> str:
    return re.sub(r'(["\\])', r"\\\1", value)
