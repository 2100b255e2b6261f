"""A simulated imager in a process of its own."""

from __future__ import annotations

import signal
import threading

from sunarc.simulation.fake_camera import FakeCamera
from sunarc.simulation.imager import ImagerOptions, halve_speed, run_imager
from sunarc.simulation.options import SceneOptions, SensorModel, SimulatedNight

__all__ = ["ImagerOptions", "SceneOptions", "SensorModel", "SimulatedNight", "simulate_imager"]


def simulate_imager(options: ImagerOptions) -> None:
    """Run a simulated imager until SIGTERM or SIGINT; SIGUSR1 halves its speed."""
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    run_imager(options, stop, running=_slow_on_signal)


def _slow_on_signal(camera: FakeCamera) -> None:
    signal.signal(signal.SIGUSR1, lambda *_: halve_speed(camera))
