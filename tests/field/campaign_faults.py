"""The faults of a campaign: each is done, and over when its method returns."""

from __future__ import annotations

import contextlib
import errno
import random
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from tests.fixtures.ports import free_port

from .campaign_processes import SHIM, SLOT_S, START_WITHIN_S, Processes, Setting, now, pause

FAULTS = (
    "kill",
    "stop",
    "stop_while_solving",
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
    "deleted_database",
    "disk_full",
    "second_service",
)
"""Not among them: a wrong camera clock (the service compares it with the host's, which at 200 times real time says
nothing; `test_camera_clock.py` does it in real time) and upgrades (the booted tests, on an installed package)."""
NEEDS_OWN_DISK = frozenset({"disk_full"})


class Faults(Processes):
    """Two processes and the faults done to them.

    Parameters
    ----------
    folder, port, setting : of `Processes`.
    seed : of the faults and their durations.
    """

    def __init__(self, folder: Path, *, port: int, seed: int, setting: Setting | None = None) -> None:
        super().__init__(folder, port=port, setting=setting)
        self.random = random.Random(seed)
        self.counts: dict[str, int] = {}
        self.left_out: list[str] = []
        if not self.has_own_disk:
            self.left_out = sorted(NEEDS_OWN_DISK)

    def drawn(self) -> Iterator[str]:
        """Yield faults without end, each kind once before any comes again."""
        possible = [fault for fault in FAULTS if fault not in self.left_out]
        while True:
            yield from self.random.sample(possible, len(possible))

    def disturb(self, fault: str) -> None:
        """Do a fault, and let the service recover."""
        self.counts[fault] = self.counts.get(fault, 0) + 1
        self._log(f"{fault} begins")
        self.clear_from = float("inf")
        try:
            getattr(self, f"_{fault}")()
        except (OSError, RuntimeError, sqlite3.Error, subprocess.TimeoutExpired) as error:
            self.exits.append(f"{fault} failed: {error}")  # found wrong, and the campaign goes on
            self._restore()
        self.clear_from = now() + 12.0 * SLOT_S
        self._log(f"{fault} ends")
        self.wait(self.random.uniform(1.0, 10.0) * SLOT_S)

    def end(self) -> list[str]:
        """Return the images that were handed on whole and have no sighting; a camera hands on no file."""
        return []

    def _log(self, text: str) -> None:
        with (self.folder / "faults.log").open("a") as log:
            log.write(f"{now():.1f} {self.frame_time()} {text}\n")
        with (self.folder / "service.log").open("a") as log:
            log.write(f"---- {text}\n")

    def _restore(self) -> None:
        """Bring both processes back, with the host's clock right, after a fault that did not end as it should."""
        self.clock_file.write_text("0 synchronised")
        (self.state / "ballast").unlink(missing_ok=True)
        if self.service is not None:
            self.service.send_signal(signal.SIGCONT)
        self.stop_service(signal.SIGKILL)
        self.kill_imager()
        self.start_imager()
        self.start_service()

    def _kill(self) -> None:
        self.stop_service(signal.SIGKILL)
        self.start_service()

    def _stop(self) -> None:
        self.stop_service(self.random.choice([signal.SIGTERM, signal.SIGINT]))
        self.start_service()

    def _stop_while_solving(self) -> None:
        """Ask for a refit, and stop the service while it is solved, if there is anything to solve."""
        asked = self.get("/v1/refits", method="POST")
        end = now() + 4.0
        while asked is not None and now() < end:
            refit = self.get(f"/v1/refits/{asked['id']}")
            if refit is not None and refit["state"] == "running":
                break
            pause(0.02)
        pause(self.random.uniform(0.0, 1.0))
        self.stop_service(self.random.choice([signal.SIGTERM, signal.SIGKILL]))
        self.start_service()

    def _pause(self) -> None:
        assert self.service is not None
        self.service.send_signal(signal.SIGSTOP)
        pause(self.random.uniform(1.0, 4.0))
        self.service.send_signal(signal.SIGCONT)

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
        begin = self.frame_time() or self._known[0]
        self._ordered("REPEAT_FRAME", 1)
        if self.judge is not None:
            self.judge.repeated(begin, self.latest_time())

    def _black_frames(self) -> None:
        self._ordered("BLACK", 1)

    def _host_clock(self) -> None:
        """Set the host's clock wrong, and right again."""
        ahead = self.random.choice([-3600.0, -60.0, 5.0, 7200.0, 400.0 * 86_400.0])
        state = self.random.choice(["synchronised", "unsynchronised"])
        self.clock_file.write_text(f"{ahead} {state}")
        self.wait(self.random.uniform(2.0, 6.0))
        if self.random.random() < 0.3:
            self._kill()
        self.clock_file.write_text("0 synchronised")

    def _locked(self) -> None:
        with contextlib.closing(sqlite3.connect(self.database, timeout=20.0, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            self.wait(self.random.uniform(0.5, 8.0))
            connection.execute("ROLLBACK")

    def _backup(self) -> None:
        command = [sys.executable, "-m", "sunarc", "db", "backup", str(self.folder / "backups"), "--keep", "2"]
        command += ["--state", str(self.state)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=START_WITHIN_S, check=False)
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

    def _deleted_database(self) -> None:
        """Remove the database under the service, which puts it back."""
        for path in self.state.glob("sunarc.sqlite*"):
            path.unlink()
        pause(self.random.uniform(0.0, 3.0))
        self.wait_for(self.database.exists, what="the database put back", within_s=30.0)

    def _disk_full(self) -> None:
        """Fill the disk that holds state and images, and free it again."""
        ballast = self.state / "ballast"
        with ballast.open("wb", buffering=0) as file:
            end = now() + self.random.uniform(1.0, 8.0) * SLOT_S
            while now() < end:
                try:
                    file.write(bytes(1 << 20))
                except OSError as error:
                    if error.errno != errno.ENOSPC:
                        raise
                    self.wait(0.1)
        ballast.unlink()

    def _second_service(self) -> None:
        """Start a service on the same state folder; it has to be refused, and the first one unharmed."""
        settings = self.write_settings("second.toml", port=free_port())
        command = [sys.executable, str(SHIM), str(self.clock_file), "serve", "--config", str(settings)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=START_WITHIN_S, check=False)
        except subprocess.TimeoutExpired:
            self.exits.append("a second service on the state folder was not refused")
            return
        if done.returncode != 3 or "stop that service first" not in done.stderr:
            self.exits.append(f"a second service ended with {done.returncode}: {done.stderr.strip()[-200:]}")
        if self.get("/healthz") is None:
            self.exits.append("the first service does not answer after a second one was started")

    def _ordered(self, register: str, value: int) -> None:
        self.order(register, value)
        self.wait(self.random.uniform(1.0, 8.0) * SLOT_S)
        self.order(register, 0)
