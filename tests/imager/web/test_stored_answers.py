"""Large answers: made once, compressed, sent whole to who reads slowly, and by range."""

from __future__ import annotations

import asyncio
import io
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.imager.web.test_slow_clients import SMALL, connect, serving

from sunarc.calibration.answers.direction_table import back_projection_map
from sunarc.imager.web.bulk import ComputeSlots
from sunarc.imager.web.problems import RefusedError
from sunarc.imager.web.routes import maps
from sunarc.imager.web.routes.stored_answers import AnswerFiles, ResponseBody, Tagged, byte_range

if TYPE_CHECKING:
    from pathlib import Path

    from fastapi import Request
    from tests.fixtures.served import Made, Make

    from sunarc.calibration.answers.direction_table import BackProjectionMap, Lookup

PATHS = ("/v1/remap?size=32", "/v1/masks/sun", "/v1/masks/horizon")
RATE_BYTES_PER_S = 50_000
TINY = replace(SMALL, width=120, height=116, focal_length_px=(41.0, 41.0), principal_point_px=(59.8, 58.1))


@pytest.mark.parametrize("path", PATHS)
def test_a_part_is_sent_that_continues_what_was_cut_off(made: Made, path: str) -> None:
    whole = made.client.get(path)
    size = len(whole.content)
    assert (whole.headers["accept-ranges"], int(whole.headers["content-length"])) == ("bytes", size)
    resumed = {"range": f"bytes={size // 2}-", "if-range": whole.headers["etag"]}
    part = made.client.get(path, headers=resumed)
    assert (part.status_code, part.content) == (206, whole.content[size // 2 :])
    first, last = size // 2, size - 1
    assert part.headers["content-range"] == f"bytes {first}-{last}/{size}"
    assert part.headers["sunarc-calibration"] == "second"
    another = made.client.get(path, headers=resumed | {"if-range": '"another"'})
    assert (another.status_code, another.content) == (200, whole.content)
    outside = made.client.get(path, headers={"range": f"bytes={size}-"})
    assert (outside.status_code, outside.headers["content-range"]) == (416, f"bytes */{size}")
    assert outside.json()["errors"][0]["field"] == "range"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, None),
        ("bytes=0-0", range(1)),
        ("bytes=90-", range(90, 100)),
        ("bytes=90-1000", range(90, 100)),
        ("bytes=-7", range(93, 100)),
        ("bytes=-1000", range(100)),
        ("bytes=0-99999999999999999999999", range(100)),
        ("Bytes=3-4", range(3, 5)),
        # what RFC 9110 has ignored: another unit, several ranges, an end before the beginning, no range
        ("lines=1-2", None),
        ("bytes=0-1,5-6", None),
        ("bytes=9-3", None),
        ("bytes=-", None),
        ("", None),
    ],
)
def test_a_range_within_the_bytes(text: str | None, expected: range | None) -> None:
    assert byte_range(text, 100) == expected


@pytest.mark.parametrize("text", ["bytes=100-", "bytes=-0", "bytes=99999999999999999999999-"])
def test_a_range_outside_the_bytes_is_refused(text: str) -> None:
    with pytest.raises(RefusedError) as refused:
        byte_range(text, 100)
    assert refused.value.status == 416


def test_a_map_is_compressed_without_loss_and_made_once(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[BackProjectionMap] = []

    def counted(ready: Lookup) -> BackProjectionMap:
        found.append(back_projection_map(ready))
        return found[-1]

    monkeypatch.setattr(maps, "back_projection_map", counted)
    answers = [made.client.get("/v1/back-projection-map") for _ in range(2)]
    assert 20e6 < len(answers[0].content) < 30e6  # of 73 MB
    assert (len(found), answers[0].content == answers[1].content) == (1, True)
    h5netcdf = pytest.importorskip("h5netcdf")
    with h5netcdf.File(io.BytesIO(answers[0].content), "r") as file:
        np.testing.assert_array_equal(file.variables["direction"][...], found[0].directions)


@pytest.mark.parametrize("path", ["/v1/back-projection-map", "/v1/remap?size=200"])
def test_a_reader_at_50_kb_per_s_gets_the_whole(make: Make, path: str) -> None:
    """Much longer than a reader may stand still, over buffers that hold little of it."""
    served = serving(make, camera=TINY, send_buffer=16_384, request_within_s=0.5)
    with served as port, connect(port, receive_buffer=8192) as one:
        one.sendall(f"GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n".encode())
        told, begun_s = b"", time.monotonic()  # noqa: TID251 - real sockets
        while more := one.recv(RATE_BYTES_PER_S // 10):
            told += more
            time.sleep(max(0.0, begun_s + len(told) / RATE_BYTES_PER_S - time.monotonic()))  # noqa: TID251 - real sockets
        took_s = time.monotonic() - begun_s  # noqa: TID251 - real sockets
    head, _, content = told.partition(b"\r\n\r\n")
    assert int(head.lower().split(b"content-length: ")[1].split(b"\r\n")[0]) == len(content)
    assert 2.0 < len(content) / RATE_BYTES_PER_S < took_s < 20.0


class _Asking:
    """What `AnswerFiles` reads of a request."""

    def __init__(self) -> None:
        self.scope = {"type": "http", "client": ("192.0.2.1", 1), "headers": []}
        self.headers: dict[str, str] = {}


async def _ask(files: AnswerFiles, tag: str, made: list[str], n_bytes: int) -> None:
    request: Request = _Asking()  # type: ignore[assignment]
    asked = Tagged(request=request, headers={"etag": tag}, if_none_match=None)

    def make() -> ResponseBody:
        made.append(tag)
        return ResponseBody(content=bytes(n_bytes), media_type="application/x-npz")

    await files.answer(asked, ComputeSlots(1), make)


async def _ask_all(files: AnswerFiles, tags: str, n_bytes: int) -> str:
    made: list[str] = []
    for tag in tags:
        await _ask(files, tag, made, n_bytes)
    return "".join(made)


@pytest.mark.parametrize(("most", "expected"), [(350, "abcda"), (400, "abcd"), (90, "abacbda")])
def test_the_files_that_are_kept_are_bounded_in_bytes(most: int, expected: str) -> None:
    assert asyncio.run(_ask_all(AnswerFiles(most_bytes=most), "abacbda", 100)) == expected


def test_files_lie_where_systemd_says_that_caches_are(
    made: Made, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "absent"))
    refused = made.client.get(PATHS[0])
    assert (refused.status_code, refused.json()["type"]) == (503, "urn:sunarc:problem:unavailable")
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path))
    assert made.client.get(PATHS[0]).status_code == 200
    assert list(tmp_path.glob("*.npz")) == []  # without a name: nothing is left behind
