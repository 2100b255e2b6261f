"""Runs a simulated imager until SIGTERM. Arguments: options in JSON, the start in ISO 8601, the truth's file.

With a fourth, "orders", it reads lines from standard input: a register's name in `genicam`, and its new value.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
from datetime import datetime
from pathlib import Path

from sunarc.lab.simulation import fake_camera as genicam
from sunarc.lab.simulation.fake_camera import FakeCamera
from sunarc.lab.simulation.imager import ImagerOptions, run_imager
from sunarc.lab.simulation.options import SceneOptions, SimulatedNight
from sunarc.sky.site import Site


def obey(camera: FakeCamera) -> None:
    for line in sys.stdin:
        name, value = line.split()
        camera.write(getattr(genicam, name), int(value))


def running(camera: FakeCamera) -> None:
    if orders:
        threading.Thread(target=obey, args=(camera,), daemon=True).start()


stop = threading.Event()
signal.signal(signal.SIGTERM, lambda *_: stop.set())
keywords, start, truth, *orders = sys.argv[1:]
chosen = json.loads(keywords)
if "site" in chosen:
    chosen["site"] = Site(**chosen["site"])
if "night" in chosen:
    chosen["scene"] = SceneOptions(night=SimulatedNight(**chosen.pop("night")))
options = ImagerOptions(**chosen, start=datetime.fromisoformat(start), truth=Path(truth))
run_imager(options, stop, running=running)
