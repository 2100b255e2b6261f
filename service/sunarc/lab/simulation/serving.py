"""A simulated imager in a process of its own."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.workers.options import read_login
from sunarc.lab.simulation.fake_camera import FakeCamera
from sunarc.lab.simulation.imager import ImagerOptions, halve_speed, run_imager
from sunarc.lab.simulation.options import Bump, SceneOptions, SensorModel, SimulatedNight
from sunarc.lab.simulation.pictures import PictureOptions, PictureServer, PresentPicture, serve_pictures, write_pictures

__all__ = ["Bump", "ImagerOptions", "PictureOptions", "SceneOptions", "SensorModel", "SimulatedNight", "simulate_http",
           "simulate_imager", "simulate_pictures"]  # fmt: skip


def simulate_imager(options: ImagerOptions) -> None:
    """Run a simulated imager until SIGTERM or SIGINT; SIGUSR1 halves its speed."""
    run_imager(options, _install_stop_handlers(), running=_install_speed_handler)


def simulate_pictures(options: PictureOptions, folder: Path) -> None:
    """Write the pictures of a simulated camera into a folder until SIGTERM or SIGINT."""
    write_pictures(options, folder, SystemClock(), _install_stop_handlers())


def simulate_http(options: PictureOptions, address: tuple[str, int], *, login: Path | None) -> None:
    """Give the present picture of a simulated camera by HTTP until SIGTERM or SIGINT, to whom has the file's login."""
    server = PictureServer(PresentPicture(options, SystemClock()), login=read_login(login, setting="--token-file"))
    serve_pictures(server, address, _install_stop_handlers())


def _install_stop_handlers() -> threading.Event:
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    return stop


def _install_speed_handler(camera: FakeCamera) -> None:
    signal.signal(signal.SIGUSR1, lambda *_: halve_speed(camera))
