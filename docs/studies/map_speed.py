"""How long a map takes: the first, the kept one, and the answer to who has it; beside what a bare socket needs.

    PYTHONPATH=. .venv/bin/python docs/studies/map_speed.py

serves a made camera of 1748 x 1748 pixels from a process of its own, as the service does, and asks over loopback. Told
are the time to the first byte and to the last one, the medians of the kept ones, the same for as many bytes that a
bare socket sends, and how far the map is from /v1/back-project at 20 000 pixels.
"""

from __future__ import annotations

import argparse
import io
import json
import multiprocessing
import socket
import tempfile
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import uvicorn
import xarray as xr
from tests.fixtures.calibrations import SITE
from tests.fixtures.served import NOON, fill, new_archive

from sunarc.imager.archive.values import Refit
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.host import listen
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.web.app import create_app
from sunarc.imager.web.middleware.connection_limit import bound_connections
from sunarc.imager.web.options import ApiOptions

MAP = "/v1/back-projection-map"
MAP_BYTES = 73_400_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What came, and when."""

    status: int
    tag: str
    body: bytearray
    first_ms: float
    whole_ms: float


def main() -> None:
    """Serve, ask and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=15, help="a kept map is asked for")
    options = parser.parse_args()
    ours, theirs = multiprocessing.Pipe()
    with tempfile.TemporaryDirectory() as folder:
        server = multiprocessing.get_context("spawn").Process(target=serve, args=(Path(folder), theirs), daemon=True)
        server.start()
        port, bare = ours.recv()
        ask(port, "/v1/back-project", body=b'{"pixels": [[872, 700]]}')  # the calibration is ready, as in a service
        report(port, bare, options.times)
        server.terminate()
        server.join()


def report(port: int, bare: int, times: int) -> None:
    """Print what was measured."""
    first = ask(port, MAP)
    print(f"first: {told([first])}, {len(first.body) / 1e6:.1f} MB")
    print(f"kept: {told([ask(port, MAP) for _ in range(times)])}")
    print(f"as many bytes from a bare socket: {told([ask(bare, MAP) for _ in range(times)])}")
    print(f"not modified: {told([ask(port, MAP, tag=first.tag) for _ in range(times)])}")
    masked = f"{MAP}?at=2013-05-13T18:30:00Z&sun_radius_deg=10"
    print(f"with a sun mask, first: {told([ask(port, masked)])}")
    print(f"with a sun mask, again: {told([ask(port, masked) for _ in range(times)])}")
    print(f"at most {furthest_deg(port, first.body):.1e} degrees from /v1/back-project")


def told(answers: list[Answer]) -> str:
    """Return the medians."""
    first, whole = (np.median([getattr(one, name) for one in answers]) for name in ("first_ms", "whole_ms"))
    return f"{answers[0].status}, first byte after {first:.1f} ms, last after {whole:.1f} ms (of {len(answers)})"


def furthest_deg(port: int, content: bytearray) -> float:
    """Return how far the map's zenith and azimuth are from back-projection's, on the sphere, at most."""
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 1748, (20_000, 2))
    body = json.dumps({"pixels": pixels.tolist()}).encode()
    asked = json.loads(ask(port, "/v1/back-project", body=body).body)
    with xr.open_dataset(io.BytesIO(bytes(content)), engine="h5netcdf") as sky:
        zenith, azimuth = (sky[name].values[pixels[:, 1], pixels[:, 0]].astype(float) for name in ("zenith", "azimuth"))
    theirs = np.array([asked[name] for name in ("zenith_deg", "azimuth_deg")], dtype=float)
    away = (azimuth - theirs[1] + 180.0) % 360.0 - 180.0
    return float(np.nanmax(np.hypot(zenith - theirs[0], away * np.sin(np.radians(zenith)))))


def ask(port: int, path: str, *, body: bytes = b"", tag: str = "") -> Answer:
    """Ask on a connection of its own."""
    head = f"{'POST' if body else 'GET'} {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n"
    head += f"content-length: {len(body)}\r\n" + (f"if-none-match: {tag}\r\n" if tag else "") + "\r\n"
    with socket.create_connection(("127.0.0.1", port)) as connection:
        start = time.perf_counter()
        connection.sendall(head.encode() + body)
        came = bytearray()
        while b"\r\n\r\n" not in came:
            came += connection.recv(65_536)
        first = time.perf_counter()
        begin = came.index(b"\r\n\r\n") + 4
        lines = dict(line.split(": ", 1) for line in came[: begin - 4].decode().split("\r\n")[1:])
        length = int(lines.get("content-length", 0))
        content = bytearray(length)
        content[: len(came) - begin] = came[begin:]
        have = len(came) - begin
        while have < length:
            have += connection.recv_into(memoryview(content)[have:])
    whole = time.perf_counter()
    return Answer(
        status=int(came[9:12]),
        tag=lines.get("etag", ""),
        body=content,
        first_ms=1e3 * (first - start),
        whole_ms=1e3 * (whole - start),
    )


def serve_bytes(listening: socket.socket, count: int) -> None:
    """Answer whatever is asked with so many bytes."""
    answer = b"HTTP/1.1 200 OK\r\ncontent-length: %d\r\n\r\n" % count
    content = bytes(count)
    while True:
        connection, _ = listening.accept()
        with connection:
            connection.recv(65_536)
            connection.sendall(answer)
            connection.sendall(content)


def serve(folder: Path, told_to: Connection) -> None:
    """Serve a made camera until the process is ended."""
    archive = new_archive(folder / "archive.sqlite")
    fill(archive)
    options = ApiOptions()
    app = create_app(
        archive=archive,
        camera="roof",
        site=SITE,
        status=StatusRegistry(version="0", started_at=NOON, monotonic=VirtualClock(NOON).monotonic).snapshot,
        request_refit=lambda reason: archive.refits.add(Refit(id="r", camera="roof", requested_at=NOON, reason=reason)),
        frame_clock=lambda: NOON,
        latest_image=lambda: None,
        options=options,
    )
    listening = listen("127.0.0.1", 0)
    listening.listen()
    bare = socket.create_server(("127.0.0.1", 0))
    threading.Thread(target=serve_bytes, args=(bare, MAP_BYTES), daemon=True).start()
    told_to.send((listening.getsockname()[1], bare.getsockname()[1]))
    config = uvicorn.Config(app, log_level="error", access_log=False)
    uvicorn.Server(bound_connections(config, options)).run(sockets=[listening])


if __name__ == "__main__":
    main()
