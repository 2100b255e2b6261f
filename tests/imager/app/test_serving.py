"""The service's process: its web server's heartbeat, the signals it gets, and how it ends."""

from __future__ import annotations

import asyncio
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Callable

import pytest
import uvicorn

from sunarc.imager.app.serving import Server, stop_on_signals
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.supervisor import Heartbeat

PATIENCE_S = 20.0  # only a failing test waits as long

# A thread is inside OpenCV, which has given the interpreter's lock back, whenever the process ends.
IN_OPENCV = """
import sys, threading
import cv2, numpy as np
from sunarc.imager.app.serving import end_process

image, begun = np.ones((1500, 1500), np.uint16), threading.Event()

def blur():
    while True:
        cv2.medianBlur(image, 5)
        begun.set()

for _ in range(3):
    threading.Thread(target=blur, daemon=True).start()
begun.wait()
print("written", end="")
end_process(0)
"""


def wait_for(reached: Callable[[], bool]) -> bool:
    clock, pause = SystemClock(), threading.Event()
    end_s = clock.monotonic() + PATIENCE_S
    while not reached() and clock.monotonic() < end_s:
        pause.wait(0.02)
    return reached()


def test_a_coroutine_that_blocks_the_loop_leaves_the_heartbeat_to_age_until_it_lets_go() -> None:
    blocked, release = threading.Event(), threading.Event()

    async def app(scope: object, _receive: object, send: Callable[[dict[str, object]], object]) -> None:
        del scope
        blocked.set()
        release.wait(PATIENCE_S)  # as a coroutine does that forgets to await
        await asyncio.sleep(0)
        await send({"type": "http.response.start", "status": 200, "headers": []})  # type: ignore[misc]
        await send({"type": "http.response.body", "body": b"done"})  # type: ignore[misc]

    clock, started = SystemClock(), threading.Event()
    heartbeat = Heartbeat(clock.monotonic)
    config = uvicorn.Config(app, lifespan="off", log_level="warning", timeout_graceful_shutdown=1)
    server = Server(config, on_started=started.set, heartbeat=heartbeat)
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        port = listening.getsockname()[1]
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
        thread.start()
        assert started.wait(PATIENCE_S)
        threading.Event().wait(0.6)
        assert heartbeat.age_s() < 0.5
        asking = threading.Thread(
            target=lambda: urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=PATIENCE_S).close()
        )
        asking.start()
        assert blocked.wait(PATIENCE_S)
        assert wait_for(lambda: heartbeat.age_s() > 1.0)
        release.set()
        asking.join(PATIENCE_S)
        assert wait_for(lambda: heartbeat.age_s() < 0.5)
        server.should_exit = True
        thread.join(PATIENCE_S)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stop_that_comes_while_the_workers_start_is_not_lost(number: signal.Signals) -> None:
    before = {one: signal.getsignal(one) for one in (signal.SIGTERM, signal.SIGINT)}
    config = uvicorn.Config(lambda *_: None, lifespan="off", log_level="warning")
    server = Server(config, on_started=lambda: None, heartbeat=Heartbeat(SystemClock().monotonic))
    late = threading.Timer(PATIENCE_S, lambda: setattr(server, "force_exit", True))
    try:
        stop_on_signals(server)
        signal.raise_signal(number)
        assert server.should_exit
        late.start()
        with socket.create_server(("127.0.0.1", 0)) as listening:
            server.run(sockets=[listening])
        assert not server.force_exit
    finally:
        late.cancel()
        for one, handler in before.items():
            signal.signal(one, handler)


def ended() -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", IN_OPENCV]
    return subprocess.run(command, capture_output=True, text=True, timeout=120.0, check=False)


def test_a_process_whose_threads_are_in_opencv_ends_with_its_code_and_its_output() -> None:
    for _ in range(2):  # of four that ended by sys.exit all were aborted
        done = ended()
        assert (done.returncode, done.stdout, done.stderr) == (0, "written", "")


def test_the_command_line_loads_no_library_that_only_a_fit_or_an_export_needs() -> None:
    later = "scipy.optimize scipy.interpolate h5py h5netcdf xarray pandas matplotlib"
    code = f"import sys, sunarc.cli.main; print(*[name for name in '{later}'.split() if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120.0, check=True)
    assert done.stdout.strip() == ""


def test_an_imager_loads_no_study_simulator_archive_analysis_or_optional_format() -> None:
    never = ["lab", "archives", "hub", "cli"]
    optional = [
        "dask",
        "distributed",
        "xarray",
        "h5py",
        "h5netcdf",
        "pandas",
        "matplotlib",
        "astropy",
        "fsspec",
        "numba",
        "llvmlite",
        "pvlib",
    ]
    code = (
        "import sys, sunarc.imager.app.serving, sunarc.imager.app.service, sunarc.imager.web.app; print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120.0, check=True)
    loaded = set(done.stdout.split())
    assert "sunarc.imager.app.service" in loaded
    assert not {*(f"sunarc.{name}" for name in never), *optional} & loaded
