"""A simulated imager in a process of its own."""

from __future__ import annotations

import signal
import threading

from sunarc.runtime.clock import SystemClock
from sunarc.simulation.fake_camera import FakeCamera
from sunarc.simulation.imager import ImagerOptions, halve_speed, run_imager
from sunarc.simulation.made_archive import PictureOptions, write_pictures
from sunarc.simulation.options import SceneOptions, SensorModel, SimulatedNight

__all__ = ["ImagerOptions", "PictureOptions", "SceneOptions", "SensorModel", "SimulatedNight", "simulate_imager",
           "simulate_pictures"]  # fmt: skip


def simulate_imager(options: ImagerOptions) -> None:
    """Run a simulated imager until SIGTERM or SIGINT; SIGUSR1 halves its speed."""
    run_imager(options, _stopping(), running=_slow_on_signal)


def simulate_pictures(options: PictureOptions) -> None:
    """Write the pictures of a simulated camera into a folder until SIGTERM or SIGINT."""
    write_pictures(options, SystemClock(), _stopping())


def _stopping() -> threading.Event:
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    return stop


def _slow_on_signal(camera: FakeCamera) -> None:
    signal.signal(signal.SIGUSR1, lambda *_: halve_speed(camera))
