from __future__ import annotations

import ctypes
import importlib.util
import json
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from sunarc.imager.runtime.clock import SystemClock
from sunarc.lab.simulation.imager import ImagerOptions, make_scene
from sunarc.lab.simulation.options import SceneOptions, SimulatedNight
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera

ADDRESS = "127.0.0.1"  # of 127/8 the only one that stands on an interface, which the fake camera wants
START = datetime(2013, 5, 13, 17, 0, tzinfo=UTC)
OPTIONS: dict[str, Any] = {"address": ADDRESS, "speed": 60.0, "clouds": "veil"}


@pytest.fixture(scope="session")
def scene() -> Scene:
    return Scene(true_camera(), SGP)


class Imager:
    """A simulated imager in a process of its own."""

    def __init__(
        self,
        folder: Path,
        *,
        start: datetime = START,
        night: dict[str, Any] | None = None,
        **options: Any,  # noqa: ANN401 - of an imager
    ) -> None:
        self._options, self._start = OPTIONS | options, start
        scene = SceneOptions() if night is None else SceneOptions(night=SimulatedNight(**night))
        self.scene = make_scene(ImagerOptions(**self._options, start=start, scene=scene))
        self._options |= {} if night is None else {"night": night}
        self.truth = folder / "truth.json"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        wait_until(port_is_free, what=f"UDP port 3956 at {ADDRESS} to be free", at_most_s=120.0)
        self.truth.unlink(missing_ok=True)
        script = str(Path(__file__).with_name("imager_process.py"))
        arguments = [json.dumps(self._options), self._start.isoformat(), str(self.truth)]
        self._process = subprocess.Popen([sys.executable, script, *arguments])
        wait_until(self.truth.exists, what="the simulated imager", at_most_s=90.0)

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait(timeout=10)
            self._process = None


@pytest.fixture(scope="module")
def imager(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Imager]:
    require_aravis()
    running = Imager(tmp_path_factory.mktemp("imager"))
    try:
        running.start()
        yield running
    finally:
        running.kill()


def require_aravis() -> None:
    if importlib.util.find_spec("gi") is None:
        pytest.skip("no GigE Vision: this environment has no gi (apt-get install python3-gi, then tests/run)")
    try:
        ctypes.CDLL("libaravis-0.8.so.0")
    except OSError:
        pytest.skip("no GigE Vision: Aravis is missing (apt-get install gir1.2-aravis-0.8)")


def port_is_free() -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((ADDRESS, 3956))
        except OSError:
            return False
    return True


def wait_until(condition: Callable[[], bool], *, what: str, at_most_s: float) -> None:
    clock = SystemClock()
    until = clock.monotonic() + at_most_s
    while not condition():
        if clock.monotonic() > until:
            pytest.fail(f"waited {at_most_s:g} s for {what}")
        clock.wait(threading.Event(), 0.05)
