"""How long refits, the status page and a start take with five years of sightings in the archive.

    python docs/studies/five_years.py --state FOLDER

makes the database (2.5 million sightings, five pose epochs, a verdict and a refused refit every day) in FOLDER unless
it is there, and prints what each takes. With PYTHONDONTWRITEBYTECODE set, a start would compile the whole service anew.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import socket
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
import uuid
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from fastapi import FastAPI

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.imager.archive.archive import Archive, CameraArchive, open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.values import CameraRecord, Day, Event, Refit
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.web.app import create_app
from sunarc.imager.web.options import ApiOptions
from sunarc.imager.workers.calibrating.day_judge import DayJudge
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.options import RefitOptions
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import project_fast
from sunarc.sky.sun import sun_angles, sun_directions

START = datetime(2013, 5, 13, 6, 30, tzinfo=UTC)
DAYS = 1826
_CADENCE_S = 30.0
SIGHTINGS = 2_500_000
_SIGMA_PX = 0.02
END = START + timedelta(days=DAYS)
_CONFIG = """\
name = "roof"
state = "{state}"
source = "replay"
[site]
latitude = 36.604043
longitude = -97.484856
altitude = 318.0
[replay]
folder = "{folder}"
[api]
port = {port}
"""


def main() -> None:
    """Make the database where it is missing, and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--state", type=Path, required=True)
    path = parser.parse_args().state / "sunarc.sqlite"
    # A solve's process reads the file that its parent was started from: the service's launcher, which imports nothing.
    # This file imports all of the service.
    vars(sys.modules["__main__"]).pop("__file__", None)
    if not path.exists():
        measured("making the database", lambda: make(path))
    for _ in range(2):  # the first one may have to compile and to read a cold disk
        start(path)
    measure(path)


def make(path: Path, *, days: int = DAYS, cadence_s: float = _CADENCE_S, most: int = SIGHTINGS) -> None:
    """Write days into a new database: by default five years."""
    upgrade(path)
    archive = open_archive(path)
    camera = true_camera()
    archive.cameras.save(CameraRecord.at(SGP, name="roof", width=camera.width, height=camera.height))
    first = archive.epochs.at("roof", START, reason="installed")
    rng = np.random.default_rng(5)
    times = START.timestamp() + np.arange(0.0, days * 86_400.0, cadence_s)
    times = np.concatenate([part[sun_angles(part, SGP).apparent_zenith < 88.0] for part in np.array_split(times, 200)])
    times = times[np.sort(rng.permutation(times.size)[:most])]
    with closing(sqlite3.connect(path)) as connection, connection:
        for part in np.array_split(times, 50):
            pixels = project_fast(camera, sun_directions(part, SGP)) + rng.normal(0.0, _SIGMA_PX, (part.size, 2))
            connection.executemany(
                "INSERT INTO sun_point (camera, pose_epoch, time, body, exposure_us, method, accepted, verdict, reason,"
                " x_px, y_px, sigma_px, clock_error_s)"
                " VALUES ('roof', ?, ?, 'sun', 20, 'disc', 1, 'clear', '', ?, ?, ?, 0.01)",
                (
                    (first.id, round(1e6 * t), x, y, _SIGMA_PX)
                    for t, (x, y) in zip(part.tolist(), pixels.tolist(), strict=True)
                ),
            )
    for year in range(1, round(days / 365)):
        archive.epochs.open("roof", at=START + timedelta(days=365 * year), reason="moved")
    _remember_days(archive, days)
    archive.close()


def _remember_days(archive: Archive, days: int) -> None:
    for number in range(days):
        moment = START + timedelta(days=number + 1)
        day = (START + timedelta(days=number)).date()
        archive.days.save(
            Day(camera="roof", date=day, verdict="clear", findings=(), n=1300, n_possible=1400, decided_at=moment)
        )
        archive.events.add(Event(time=moment, kind="day", severity="info", text=f"{day} was clear", camera="roof"))
        refit = archive.refits.add(Refit(id=uuid.uuid4().hex, camera="roof", requested_at=moment, reason="a day"))
        archive.refits.finish(refit.id, state="refused", finished_at=moment, message="not better")


def measure(path: Path) -> None:
    """Print what a refit, the pages and a start take."""
    measured("upgrade and open", lambda: upgrade_and_open(path))
    archive = open_archive(path)
    board = StatusRegistry(version="study", started_at=END, monotonic=SystemClock().monotonic)
    judge = DayJudge(
        camera=CameraArchive(archive, name="roof", site=SGP),
        cadence_s=lambda: _CADENCE_S,
        sun_zenith_deg=88.0,
        now=lambda: END,
        request_refit=lambda reason: Refit(id="x", camera="roof", requested_at=END, reason=reason),
    )
    measured("the first look for ended days", judge.judge_ended_days)
    measured("the next look", judge.judge_ended_days)
    worker = RefitWorker(
        camera=CameraArchive(archive, name="roof", site=SGP),
        options=RefitOptions(),
        calibration=CalibrationOptions(),
        cadence_s=_CADENCE_S,
        clock=SystemClock(),
        now=lambda: END,
        board=board,
    )
    for what in ("the first refit, with the search for pose epochs and fits of the earlier ones", "a nightly refit"):
        refit = archive.refits.add(Refit(id=uuid.uuid4().hex, camera="roof", requested_at=END, reason="study"))
        measured(what, partial(worker.carry_out, refit, threading.Event(), lambda: None))
        print(archive.refits.get(refit.id), flush=True)
    app = create_app(
        archive=archive,
        camera="roof",
        site=SGP,
        status=board.snapshot,
        request_refit=lambda reason: replace(refit, reason=reason),
        frame_clock=lambda: END,
        latest_image=lambda: None,
        options=ApiOptions(),
    )
    for page in ("/v1/status", "/metrics", "/v1/calibration", "/v1/days", "/v1/events", "/v1/sun-points"):
        for which in ("first", "again"):
            measured(f"GET {page}, {which}", partial(asyncio.run, fetch(app, page)))
    print(f"size of the database: {path.stat().st_size / 1e6:.0f} MB")


async def fetch(app: FastAPI, page: str) -> None:
    """Ask for a page, and fail unless it is answered."""
    transport = httpx.ASGITransport(app, client=("127.0.0.1", 1))
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        (await client.get(page)).raise_for_status()


def upgrade_and_open(path: Path) -> None:
    """Do what a start does with the database."""
    upgrade(path)
    open_archive(path).close()


def start(path: Path) -> None:
    """Print how long the service takes until it is ready, and to say for the first time how it is."""
    with tempfile.TemporaryDirectory() as place, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(f"{place}/notify")
        heard.settimeout(300.0)
        port = _free_port()
        config = Path(place) / "sunarc.toml"
        config.write_text(_CONFIG.format(state=path.parent.resolve(), folder=place, port=port))
        command = [sys.executable, "-m", "sunarc", "serve", "--config", str(config)]
        begin = time.perf_counter()
        environment = {**os.environ, "NOTIFY_SOCKET": f"{place}/notify"}
        process = subprocess.Popen(command, env=environment)  # noqa: S603 - our own command
        try:
            while b"READY=1" not in heard.recv(4096):
                pass
            print(f"ready to serve after {time.perf_counter() - begin:.2f} s", flush=True)
            for which in ("first", "again"):
                begin = time.perf_counter()
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/v1/status", timeout=60.0) as answer:
                    answer.read()
                print(f"GET /v1/status of that service, {which}: {time.perf_counter() - begin:.3f} s", flush=True)
        finally:
            process.terminate()
            process.wait(30.0)


def _free_port() -> int:
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])


def measured(what: str, work: Callable[[], Any]) -> float:
    """Do something, print what it takes, and return the seconds."""
    wall, cpu = time.perf_counter(), _cpu_s()
    work()
    wall = time.perf_counter() - wall
    print(f"{what}: {wall:.3f} s; processor {_cpu_s() - cpu:.3f} s, the child processes' with it", flush=True)
    return wall


def _cpu_s() -> float:
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


if __name__ == "__main__":
    main()
