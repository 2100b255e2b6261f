"""A simulated imager in a process of its own."""

from __future__ import annotations

import signal
import threading
from datetime import datetime
from pathlib import Path

from sunarc.simulation import FakeCamera, ImagerOptions, SceneOptions, SensorModel, halve_speed, run_imager
from sunarc.sky import Site


def simulate(
    *,
    address: str,
    start: datetime,
    speed: float,
    site: Site,
    lens_seed: int,
    clouds: str,
    nd_transmission: float,
    ghost: float,
    sun_cover: float,
    blooming: float,
    moon: tuple[float, float] | None,
    truth: Path | None,
) -> None:
    """Run a simulated imager until SIGTERM or SIGINT; SIGUSR1 halves its speed."""
    options = ImagerOptions(
        address=address,
        start=start,
        speed=speed,
        site=site,
        lens_seed=lens_seed,
        clouds=clouds,
        scene=SceneOptions(nd_transmission=nd_transmission, ghost_strength=ghost, sun_cover=sun_cover, moon_at=moon),
        sensor=SensorModel(blooming=blooming),
        truth=truth,
    )
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    run_imager(options, stop, running=_slow_on_signal)


def _slow_on_signal(camera: FakeCamera) -> None:
    signal.signal(signal.SIGUSR1, lambda *_: halve_speed(camera))
