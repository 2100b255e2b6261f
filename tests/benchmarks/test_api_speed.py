"""The routes beside a bare one, over the network: `pytest tests/benchmarks/test_api_speed.py --benchmark-enable`."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterator
from http.client import HTTPConnection
from typing import Any

import numpy as np
import pytest
import uvicorn
from fastapi import FastAPI
from numpy.typing import NDArray
from tests.fixtures.calibrations import SITE
from tests.fixtures.served import NOON, fill, new_archive

from sunarc.imager.archive.archive import open_archive
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.host import listen
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.web.app import create_app
from sunarc.imager.web.options import ApiOptions

_PIXEL = b'{"pixels": [[871.96, 700.0]]}'
_AT_ONCE = 200


def _served(app: FastAPI) -> Iterator[HTTPConnection]:
    listening = listen("127.0.0.1", 0)  # the service's own: its answers are not delayed
    listening.listen()
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", access_log=False))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
    thread.start()
    connection = HTTPConnection("127.0.0.1", listening.getsockname()[1])
    yield connection
    connection.close()
    server.should_exit = True
    thread.join()


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Iterator[HTTPConnection]:
    path = tmp_path_factory.mktemp("served") / "archive.sqlite"
    new_archive(path).close()
    archive = open_archive(path)
    fill(archive)
    clock = VirtualClock(NOON)
    board = StatusRegistry(version="0.1.0", started_at=NOON, monotonic=clock.monotonic)
    yield from _served(
        create_app(
            archive=archive,
            camera="roof",
            site=SITE,
            status=board.snapshot,
            request_refit=archive.refits.get,
            frame_clock=lambda: NOON,
            latest_image=lambda: None,
            options=ApiOptions(),
        )
    )
    archive.close()


@pytest.fixture(scope="module")
def bare() -> Iterator[HTTPConnection]:
    app = FastAPI()

    @app.get("/")
    def nothing() -> dict[str, bool]:
        return {"ok": True}

    @app.get("/async")
    async def nothing_async() -> dict[str, bool]:
        return {"ok": True}

    yield from _served(app)


def _ask(connection: HTTPConnection, method: str, path: str, body: bytes | None, media_type: str) -> bytes:
    connection.request(method, path, body, {"content-type": media_type} if body else {})
    answer = connection.getresponse()
    content = answer.read()
    assert answer.status == 200, content
    return content


@pytest.mark.benchmark(group="200 requests, one after the other")
@pytest.mark.parametrize("path", ["/", "/async"])
def test_a_bare_route(bare: HTTPConnection, path: str, benchmark: Any) -> None:  # noqa: ANN401 - the plug-in's own type
    benchmark(lambda: [_ask(bare, "GET", path, None, "") for _ in range(_AT_ONCE)])


@pytest.mark.benchmark(group="200 requests, one after the other")
def test_one_pixel(ours: HTTPConnection, benchmark: Any) -> None:  # noqa: ANN401 - the plug-in's own type
    benchmark(lambda: [_ask(ours, "POST", "/v1/back-project", _PIXEL, "application/json") for _ in range(_AT_ONCE)])


@pytest.mark.benchmark(group="1e6 pixels")
@pytest.mark.parametrize("kind", ["float64", "float32"])
def test_a_million_pixels(ours: HTTPConnection, kind: str, benchmark: Any) -> None:  # noqa: ANN401 - the plug-in's own type
    pixels = np.random.default_rng(0).uniform(300.0, 1400.0, (1_000_000, 2)).astype(kind)

    def asked() -> NDArray[np.floating]:
        stream = io.BytesIO()
        np.save(stream, pixels)
        answer: NDArray[np.floating] = np.load(
            io.BytesIO(_ask(ours, "POST", "/v1/back-project", stream.getvalue(), "application/x-npy"))
        )
        return answer

    assert np.all(np.isfinite(benchmark(asked)))
