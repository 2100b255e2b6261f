"""What the whole service costs at its real cadence: processor time and memory, with a 2048×2048 Mono12 camera.

    unshare -n sh -c 'ip link set lo up; exec python docs/studies/running_cost.py --minutes 6'

Runs a simulated imager in a process of its own, and the service as `sunarc serve` runs it, at speed 1. After a minute
of settling it prints, every minute and at the end, the service's processor time per second of real time (in percent
of one core) and its resident memory; at the end, how the sun was seen, and what the images take. The calibration that
it begins with comes of four simulated days.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import FrameType

import numpy as np

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.sightings import Sightings
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.values import CameraRecord
from sunarc.imager.runtime.clock import SystemClock
from sunarc.lab.simulation.imager import ImagerOptions, run_imager
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions

_SIZE = 2048
_START = datetime(2013, 5, 13, 17, 0, tzinfo=UTC)
_CLOCK = SystemClock()
_TICKS = os.sysconf("SC_CLK_TCK")
_CONFIG = """\
state = "{state}"
[site]
latitude = 36.604043
longitude = -97.484856
altitude = 318.0
[camera]
address = "127.0.0.1"
pixel_format = "Mono12"
packet_size = 8000
packet_socket = {packet_socket}
timestamps = "camera"
[capture]
cadence_s = {cadence}
[api]
port = 8099
"""


def main() -> None:
    """Measure, or be the imager."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--cadence", type=float, default=30.0)
    parser.add_argument("--udp", action="store_true", help="as an unprivileged user receives frames")
    parser.add_argument("--imager", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.imager:
        _be_imager(arguments.imager)
        return
    with (
        tempfile.TemporaryDirectory() as folder,
        _running([sys.executable, __file__, "--imager", f"{folder}/truth.json"]),
    ):
        config, state = Path(folder) / "sunarc.toml", Path(folder) / "state"
        packet_socket = "false" if arguments.udp else "true"
        config.write_text(_CONFIG.format(state=state, cadence=arguments.cadence, packet_socket=packet_socket))
        _wait_for(Path(folder) / "truth.json")
        _calibrate(Path(folder))
        with _running([sys.executable, "-m", "sunarc", "serve", "--config", str(config)], **_unit()) as service:
            _wait(60.0)
            _measure(service.pid, minutes=arguments.minutes)
        images = list((state / "images").rglob("*"))
        files = [path for path in images if path.is_file()]
        kinds = Counter(path.name.split("_")[-1] for path in files)
        with sqlite3.connect(state / "sunarc.sqlite") as database:
            print("sightings:", dict(database.execute("SELECT verdict, COUNT(*) FROM sun_point GROUP BY verdict")))
        print("files:", dict(kinds), f"{sum(path.stat().st_size for path in files) / 1e6:.1f} MB")


def _calibrate(folder: Path) -> None:
    """Let the service begin with a calibration of simulated sightings: the ordinary day."""
    database = folder / "state" / "sunarc.sqlite"
    upgrade(database)
    archive = open_archive(database)
    archive.cameras.save(CameraRecord.at(SGP, name="imager", width=_SIZE, height=_SIZE))
    epoch = archive.epochs.at("imager", _START, reason="first frame")
    truth = from_document(json.loads((folder / "truth.json").read_text())).camera
    document = to_document(
        calibrate(_sightings(truth), site=SGP, image_size=(_SIZE, _SIZE)),
        id="simulated",
        camera="imager",
        state="candidate",
        created_at=_START,
        valid_from=_START,
        valid_until=None,
        pose_epoch=epoch.id,
        software_version=version("sunarc"),
    )
    archive.calibrations.add(document)
    archive.calibrations.activate("simulated")
    archive.close()


def _sightings(camera: Camera) -> Sightings:
    """Return the sun in four days' images, 0.02 px of noise, a sighting every 5 minutes."""
    times = _START.timestamp() - 86_400.0 * np.array([[1.0], [10.0], [20.0], [30.0]]) + np.arange(0.0, 86_400.0, 300.0)
    times = times[sun_angles(times, SGP).apparent_zenith < 85.0]
    pixels = project(camera, sun_directions(times, SGP))
    return Sightings.of(unix_s=times, pixels=pixels + np.random.default_rng(1).normal(0.0, 0.02, pixels.shape))


def _measure(pid: int, *, minutes: float) -> None:
    began, before = _CLOCK.monotonic(), _spent_s(pid)
    while _CLOCK.monotonic() - began < minutes * 60.0:
        _wait(min(60.0, began + minutes * 60.0 - _CLOCK.monotonic() + 0.01))
        elapsed_s = _CLOCK.monotonic() - began
        share = 100.0 * (_spent_s(pid) - before) / elapsed_s
        memory = f"{_mib(pid, 'VmRSS'):.0f} MiB, {_mib(pid, 'RssAnon'):.0f} of them not of files"
        print(f"{elapsed_s:6.0f} s  {share:5.2f} % of a core  {memory}", flush=True)


def _wait(seconds: float) -> None:
    _CLOCK.wait(threading.Event(), seconds)


def _wait_for(file: Path) -> None:
    while not file.exists():
        _wait(0.2)


def _spent_s(pid: int) -> float:
    """Return the processor time that a process and the children it waited for have used, seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(int(ticks) for ticks in fields[11:15]) / _TICKS


def _mib(pid: int, kind: str) -> float:
    """Return the resident memory of a process, of a kind that proc(5) names."""
    line = next(line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith(kind))
    return int(line.split()[1]) / 1024.0


def _unit() -> dict[str, str]:
    """Return the variables that the service's unit sets."""
    unit = (Path(__file__).parents[2] / "deploy" / "sunarc.service").read_text("utf-8")
    lines = [line.partition("=")[2] for line in unit.splitlines() if line.startswith("Environment=")]
    return dict(one.split("=", 1) for line in lines for one in line.split() if "%" not in one)


@contextmanager
def _running(command: list[str], **variables: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(command, env=os.environ | variables)  # noqa: S603 - our own programs
    try:
        yield process
    finally:
        process.terminate()
        process.wait(timeout=30.0)


def _be_imager(truth: Path) -> None:
    """Serve frames of the paper's lens on a larger sensor."""
    paper = true_camera()
    margin = (_SIZE - paper.width) / 2.0
    x, y = paper.principal_point_px
    scale = _SIZE / paper.width
    larger = replace(
        paper,
        width=_SIZE,
        height=_SIZE,
        principal_point_px=(x + margin, y + margin),
        focal_length_px=(paper.focal_length_px[0] * scale, paper.focal_length_px[1] * scale),
    )
    stop = threading.Event()

    def end(_number: int, _frame: FrameType | None) -> None:
        stop.set()

    signal.signal(signal.SIGTERM, end)
    run_imager(ImagerOptions(start=_START, speed=1.0, camera=larger, truth=truth), stop)


if __name__ == "__main__":
    main()
