"""Wrong requests and their answers: status, kind of problem and named fields, as `wrong_requests.txt` lists them.

A line is `STATUS KIND FIELDS <- [APPLICATION] METHOD PATH [| HEADER: VALUE]... [| BODY]`. A change of the web server
keeps every line; `SUNARC_WRITE_WRONG=1` writes the answers anew where one is to change.
"""

from __future__ import annotations

import io
import os
import re
from dataclasses import dataclass
from pathlib import Path

import httpx
import numpy as np
from tests.fixtures.served import TOKEN, Made, Make, write_image

LIST = Path(__file__).with_name("wrong_requests.txt")
LIMITS = {"max_points": 1000, "max_rows": 4000, "max_body_bytes": 100_000, "max_array_bytes": 1_000_000}
_HEADER = re.compile(r"([a-z-]+): ?([^{]*)")


@dataclass(frozen=True)
class Wrong:
    """A wrong request of the list, without its answer."""

    application: str
    method: str
    path: str
    headers: dict[str, str]
    body: bytes


def read(line: str) -> Wrong:
    head, *parts = line.split(" | ")
    *application, method, path = head.split(" ")
    headers, body = {}, b""
    for part in parts:
        found = _HEADER.fullmatch(part)
        if found:
            headers[found[1]] = f"Bearer {TOKEN}" if found[2] == "right" else found[2]
        else:
            body = content(part)
    return Wrong(application[0] if application else "filled", method, path, headers, body)


def content(part: str) -> bytes:
    kind, _, text = part.partition(" ")
    if kind == "npy":
        dtype, shape, *how = text.split(" ")
        rows = np.ones([int(size) for size in shape.split(",")], dtype=dtype, order="F" if "fortran" in how else "C")
        file = io.BytesIO()
        np.save(file, rows)
        return file.getvalue()[: -1 if "cut" in how else None]
    if kind == "rows":
        return b'{"pixels": [' + b", ".join([b"[1, 2]"] * int(text)) + b"]}"
    if kind == "directions":
        return b'{"direction_enu": [' + b", ".join([b"[0, 0, 1]"] * int(text)) + b"]}"
    return b"x" * int(text) if kind == "bytes" else part.encode()


def answer_of(applications: dict[str, Made], wrong: Wrong) -> str:
    client = applications[wrong.application].client
    headers = {"content-type": "application/json"} if wrong.body else {}
    answer = client.request(wrong.method, wrong.path, headers=headers | wrong.headers, content=wrong.body)
    return f"{answer.status_code} {named(answer)}"


def named(answer: httpx.Response) -> str:
    if not answer.headers.get("content-type", "").startswith("application/problem+json"):
        return "no problem"
    problem = answer.json()
    assert problem["status"] == answer.status_code
    assert problem["title"]
    assert problem["detail"]
    assert all(fault["problem"] and fault["remedy"] for fault in problem["errors"])
    kind = problem["type"].removeprefix("urn:sunarc:problem:")
    return f"{kind} {','.join(fault['field'] for fault in problem['errors'])}".rstrip()


def test_every_wrong_request_is_answered_as_listed(make: Make, tmp_path: Path) -> None:
    (tmp_path / "read").write_text(TOKEN)
    image = write_image(tmp_path)
    applications = {
        "filled": make(history="small", image=image, **LIMITS),
        "reading": make(history="small", read_token_file=tmp_path / "read", **LIMITS),
        "changeless": make(history="small", token=False),
        "empty": make(),
    }
    requests = [line.partition(" <- ")[2] for line in LIST.read_text().splitlines()]
    found = [f"{answer_of(applications, read(line))} <- {line}" for line in requests]
    if os.environ.get("SUNARC_WRITE_WRONG") == "1":
        LIST.write_text("".join(f"{line}\n" for line in found))
    assert len(set(requests)) >= 200
    assert not [line for line in found if "no problem" in line]
    assert found == LIST.read_text().splitlines()
    assert {line.partition(" ")[0] for line in found} >= {"401", "403", "404", "405", "413", "415", "416", "421", "422"}
