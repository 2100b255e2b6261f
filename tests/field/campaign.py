"""A random campaign of faults on the whole chain, judged against the simulator's truth; a short form is a test.

    tests/campaign --seed 1 --faults 300 [--json FILE]

A simulated GigE Vision imager and the service run as processes, faster than real time. Faults are drawn with a seed:
kills, stops, camera faults, wrong clocks, frozen and black frames, a locked database, a damaged row, backups. In the
end nothing may be lost or doubled, no accepted sighting farther from the truth than it states, no calibration served
worse than stated; the service must not have ended by itself, nor reported "ready" while no sighting could be stored.
Needs port 3956 of 127.0.0.1 (a network namespace of its own is best).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from sunarc.calibration import from_document
from sunarc.simulation import SGP
from sunarc.simulation.timeline import Timeline

from .campaign_judge import Findings, Judge

HERE = Path(__file__).resolve().parent

ADDRESS = "127.0.0.1"
START = datetime(2013, 5, 13, 14, 0, tzinfo=UTC)
SPEED = 200.0
CADENCE_S = 120.0
SLOT_S = CADENCE_S / SPEED
IMAGER = HERE.parent / "simulation" / "imager_process.py"
SHIM = HERE / "clock_shim.py"
START_WITHIN_S = 90.0
SETTINGS = """\
name = "roof"
state = "{state}"
[site]
latitude = {latitude}
longitude = {longitude}
altitude = {altitude}
[camera]
address = "127.0.0.1"
pixel_format = "Mono12"
packet_size = 60000
packet_socket = false
timestamps = "camera"
[capture]
cadence_s = {cadence}
night_cadence_s = {cadence}
speed = {speed}
[sensor]
black_level_fraction = 0.0078
[refit]
check_every_s = 1.0
[api]
port = {port}
"""


class Campaign:
    """Two processes and the faults done to them."""

    def __init__(self, folder: Path, *, seed: int, port: int) -> None:
        self.folder = folder
        self.port = port
        self.random = random.Random(seed)
        self.state = folder / "state"
        self.database = self.state / "sunarc.sqlite"
        self.counts: dict[str, int] = {}
        self.exits: list[str] = []
        self._clock_file = folder / "clock"
        self._timeline = Timeline(SGP, start_unix_s=START.timestamp(), speed=SPEED, skip_nights=True)
        self._began = now()
        self._imager: subprocess.Popen[str] | None = None
        self._service: subprocess.Popen[bytes] | None = None
        self._clear_from = 0.0
        self.judge: Judge | None = None

    def __enter__(self) -> Self:
        settings = SETTINGS.format(
            state=self.state,
            latitude=SGP.latitude,
            longitude=SGP.longitude,
            altitude=SGP.altitude,
            cadence=CADENCE_S,
            speed=SPEED,
            port=self.port,
        )
        (self.folder / "sunarc.toml").write_text(settings)
        self.start_imager()
        self.start_service()
        truth = from_document(json.loads((self.folder / "truth.json").read_text())).camera
        self.judge = Judge(self.database, self.port, truth=truth, site=SGP, cadence_s=CADENCE_S)
        return self

    def __exit__(self, *_: object) -> None:
        self.stop_service(signal.SIGTERM)
        self.kill_imager()

    def simulated(self) -> float:
        """Return the imager's time, unix seconds."""
        return self._timeline.at(now() - self._began)

    def start_imager(self) -> None:
        """Start the imager where its time would be."""
        truth = self.folder / "truth.json"
        truth.unlink(missing_ok=True)
        settings = {"address": ADDRESS, "clouds": "clear", "speed": SPEED, "skip_nights": True}
        start = datetime.fromtimestamp(self.simulated(), UTC).isoformat()
        command = [sys.executable, str(IMAGER), json.dumps(settings), start, str(truth), "orders"]
        log = (self.folder / "imager.log").open("ab")
        self._imager = subprocess.Popen(command, stdin=subprocess.PIPE, text=True, stdout=log, stderr=log)
        log.close()
        self._wait_for(truth.exists, what="the imager")

    def kill_imager(self) -> None:
        """End the imager at once."""
        if self._imager is not None:
            self._imager.kill()
            self._imager.wait(timeout=10.0)
            if self._imager.stdin is not None:
                with contextlib.suppress(BrokenPipeError):
                    self._imager.stdin.close()
            self._imager = None

    def order(self, register: str, value: int) -> None:
        """Write a register of the imager."""
        if self._imager is not None and self._imager.stdin is not None:
            self._imager.stdin.write(f"{register} {value}\n")
            self._imager.stdin.flush()

    def start_service(self) -> None:
        """Start the service and wait until it answers."""
        command = [
            sys.executable,
            str(SHIM),
            str(self._clock_file),
            "serve",
            "--config",
            str(self.folder / "sunarc.toml"),
        ]
        with (self.folder / "service.log").open("ab") as log:
            self._service = subprocess.Popen(
                command, stdout=log, stderr=log, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}
            )
        self._wait_for(self._answers, what="the service")

    def stop_service(self, number: signal.Signals) -> None:
        """Send a signal and wait for the end."""
        if self._service is not None:
            self._service.send_signal(number)
            try:
                self._service.wait(timeout=20.0)
            except subprocess.TimeoutExpired:
                self.exits.append(f"did not end within 20 s of {number.name}")
                self._service.kill()
                self._service.wait()
            self._service = None

    def wait(self, seconds: float) -> None:
        """Let time pass, looking at everything every half second."""
        end = now() + seconds
        while now() < end:
            time.sleep(min(0.5, max(end - now(), 0.0)))  # noqa: TID251 - real processes are waited for
            if self._service is not None and self._service.poll() is not None:
                self.exits.append(f"code {self._service.returncode} at {self.simulated():.0f}")
                self.start_service()
            if self.judge is not None:
                self.judge.look(self.simulated(), clear=now() > self._clear_from)

    def disturb(self, fault: str) -> None:
        """Do a fault, end it, and let the service recover."""
        self.counts[fault] = self.counts.get(fault, 0) + 1
        self._clear_from = float("inf")
        getattr(self, f"_{fault}")()
        self._clear_from = now() + 12.0 * SLOT_S
        self.wait(self.random.uniform(2.0, 12.0) * SLOT_S)

    def _kill(self) -> None:
        self.stop_service(signal.SIGKILL)
        self.start_service()

    def _stop(self) -> None:
        self.stop_service(self.random.choice([signal.SIGTERM, signal.SIGINT]))
        self.start_service()

    def _pause(self) -> None:
        assert self._service is not None
        self._service.send_signal(signal.SIGSTOP)
        self.wait(self.random.uniform(1.0, 4.0))
        self._service.send_signal(signal.SIGCONT)

    def _imager_killed(self) -> None:
        self.kill_imager()
        self.wait(self.random.uniform(0.0, 3.0))
        self.start_imager()

    def _power_cycle(self) -> None:
        self.order("POWER_CYCLE", 1)

    def _freeze(self) -> None:
        self.order("FREEZE", self.random.choice([700, 3000]))

    def _loss(self) -> None:
        self._ordered("LOSS", self.random.choice([100, 500, 1000]))

    def _wrong_exposure(self) -> None:
        self._ordered("WRONG_EXPOSURE", self.random.choice([25, 400, 1600]))

    def _wrong_exposures(self) -> None:
        self._ordered("ALL_EXPOSURES", self.random.choice([25, 400, 1600]))

    def _stale_exposure(self) -> None:
        self._ordered("STALE_EXPOSURE", 1)

    def _changed(self) -> None:
        self.order(self.random.choice(["GAIN_AUTO", "EXPOSURE_AUTO", "GAMMA", "GAIN"]), 1)

    def _repeated_frames(self) -> None:
        self._ordered("REPEAT_FRAME", 1)

    def _black_frames(self) -> None:
        self._ordered("BLACK", 1)

    def _host_clock(self) -> None:
        """Set the host's clock wrong, and right again."""
        ahead = self.random.choice([-3600.0, -60.0, 5.0, 7200.0, 400.0 * 86_400.0])
        state = self.random.choice(["synchronised", "unsynchronised"])
        self._clock_file.write_text(f"{ahead} {state}")
        self.wait(self.random.uniform(2.0, 6.0))
        if self.random.random() < 0.3:
            self._kill()
        self._clock_file.write_text("0 synchronised")

    def _locked(self) -> None:
        with contextlib.closing(sqlite3.connect(self.database, timeout=20.0, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            self.wait(self.random.uniform(0.5, 8.0))
            connection.execute("ROLLBACK")

    def _backup(self) -> None:
        target = self.folder / "backups"
        command = [
            sys.executable,
            "-m",
            "sunarc",
            "db",
            "backup",
            str(target),
            "--keep",
            "2",
            "--state",
            str(self.state),
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
        if done.returncode:
            self.exits.append(f"backup: {done.stderr.strip()}")

    def _damaged_calibration(self) -> None:
        """Change a byte of the current calibration's document."""
        with contextlib.closing(sqlite3.connect(self.database, timeout=20.0)) as connection, connection:
            row = connection.execute("SELECT id, document FROM calibration WHERE state = 'current'").fetchone()
            if row is not None:
                at = self.random.randrange(len(row[1]))
                damaged = row[1][:at] + chr(ord(row[1][at]) ^ 1) + row[1][at + 1 :]
                connection.execute("UPDATE calibration SET document = ? WHERE id = ?", (damaged, row[0]))

    def _ordered(self, register: str, value: int) -> None:
        self.order(register, value)
        self.wait(self.random.uniform(1.0, 8.0) * SLOT_S)
        self.order(register, 0)

    def _answers(self) -> bool:
        try:
            with socket.create_connection((ADDRESS, self.port), timeout=1.0):
                return True
        except OSError:
            return False

    def _wait_for(self, reached: Callable[[], bool], *, what: str) -> None:
        end = now() + START_WITHIN_S
        while not reached():
            if now() > end:
                raise RuntimeError(f"{what} did not start within {START_WITHIN_S:g} s; see {self.folder}")
            time.sleep(0.05)  # noqa: TID251 - same


FAULTS = (
    "kill",
    "stop",
    "pause",
    "imager_killed",
    "power_cycle",
    "freeze",
    "loss",
    "wrong_exposure",
    "wrong_exposures",
    "stale_exposure",
    "changed",
    "repeated_frames",
    "black_frames",
    "host_clock",
    "locked",
    "backup",
    "damaged_calibration",
)


def now() -> float:
    """Return real monotonic seconds."""
    return time.monotonic()  # noqa: TID251 - real processes are waited for


def drawn(chooser: random.Random) -> Iterator[str]:
    """Yield faults without end, each kind once before any comes again."""
    while True:
        yield from chooser.sample(FAULTS, len(FAULTS))


def campaign(*, seed: int, faults: int, folder: Path, most_s: float = float("inf")) -> tuple[Findings, dict[str, int]]:
    """Run a campaign; return what was found wrong and how often each fault was done.

    Parameters
    ----------
    seed : of the faults and their durations.
    faults : how many.
    folder : empty; keeps state and logs.
    most_s : real seconds after which no further fault is begun.
    """
    with socket.socket() as trial:
        trial.bind((ADDRESS, 0))
        port = int(trial.getsockname()[1])
    began = now()
    with Campaign(folder, seed=seed, port=port) as run:
        run.wait(15.0 * SLOT_S)
        kinds = drawn(run.random)
        while sum(run.counts.values()) < faults and now() - began < most_s:
            run.disturb(next(kinds))
        run.wait(15.0 * SLOT_S)
    assert run.judge is not None
    found = run.judge.end()
    found.own_exits = run.exits
    return found, run.counts


def main() -> int:
    """Run; exit 0 where nothing was found wrong, else 1."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--faults", type=int, default=300)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--keep", type=Path, help="an empty folder for state and logs (default: a temporary one)")
    options = parser.parse_args()
    with contextlib.ExitStack() as stack:
        folder = options.keep or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sunarc-campaign-")))
        folder.mkdir(parents=True, exist_ok=True)
        found, counts = campaign(seed=options.seed, faults=options.faults, folder=folder)
    report = {"seed": options.seed, "faults": counts, **asdict(found), "good": found.good}
    print(json.dumps(report, indent=1))  # noqa: T201 - a script that prints what it found
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n")
    return 0 if found.good else 1


if __name__ == "__main__":
    sys.exit(main())
