"""The faults of a campaign: each is done, and over when its method returns."""

from __future__ import annotations

import contextlib
import errno
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any, Literal, NamedTuple

from tests.fixtures.ports import free_port
from tests.fixtures.postgresql import programs

from .campaign_judge import CLEAR_ZENITH_DEG
from .campaign_network import CampaignHub, Other
from .campaign_processes import ADDRESS, SHIM, START_WITHIN_S, Processes, Setting, mount_disk, now, pause, unmount_disk

Source = Literal["gige", "night", "folder", "http"]
_SERVICE = ("kill", "stop", "stop_while_solving", "pause", "second_service", "host_clock", "imager_killed")
_FILES = ("locked", "backup", "damaged_calibration", "deleted_database", "disk_full", "flipped_bit", "link_at_restore")
_OTHERS = (
    *("receiver_drips", "receiver_refuses"),
    *("hub_killed", "hub_away", "hub_fails", "hub_drips", "hub_disk_full", "postgresql_killed"),
    *("hub_may_not_insert", "hub_table_locked", "restore_while_hub_away"),
)
_CAMERA = (
    *("power_cycle", "freeze", "loss", "wrong_exposure", "wrong_exposures", "stale_exposure", "changed"),
    *("repeated_frames", "black_frames"),
)
_EVERY = (*_SERVICE, *_FILES, *_OTHERS)
FAULTS: dict[Source, tuple[str, ...]] = {
    "gige": (*_EVERY, *_CAMERA),
    "night": (*_EVERY, *_CAMERA),
    "folder": (
        *_EVERY,
        *("late_uploads", "truncated", "flipped_picture", "copies", "one_picture", "folder_away", "junk"),
        *("frozen_under_text", "strange_files"),
    ),
    "http": (
        *_EVERY,
        *("unavailable", "page", "drip", "endless", "stale", "redirect", "refused"),
        *("strange_answers", "frozen_under_text"),
    ),
}
"""What is done to the chain of each source; a fault is a method of its name. Not among them: a wrong camera clock
(the service compares it with the host's, which at 150 times real time says nothing; `test_camera_clock.py` does it in
real time) and upgrades (the booted tests, on an installed package)."""
NEEDS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("kill", "stop", "stop_while_solving", "pause", "second_service"), ("service",)),
    **dict.fromkeys(("locked", "backup", "damaged_calibration"), ("file",)),
    "deleted_database": ("service", "file", "disk"),
    "flipped_bit": ("service", "file", "disk", "link"),
    "disk_full": ("disk",),
    **dict.fromkeys(("imager_killed", "refused"), ("imager",)),
    "hub_away": ("link",),
    "link_at_restore": ("service", "file", "disk"),
    "restore_while_hub_away": ("service", "file", "disk", "link"),
    **dict.fromkeys(("hub_disk_full", "postgresql_killed", "hub_may_not_insert", "hub_table_locked"), ("postgresql",)),
    **dict.fromkeys(("truncated", "flipped_picture", "one_picture", "frozen_under_text"), ("pictures", "address")),
    **dict.fromkeys(("folder_away", "junk", "copies", "strange_files"), ("followed",)),
    **dict.fromkeys(("unavailable", "page", "drip", "endless", "stale", "redirect", "strange_answers"), ("address",)),
}
"""What a fault alone may use: those of a window that need the same are done one after the other, all others at once."""
NEEDS_OWN_DISK = frozenset({"disk_full", "hub_disk_full"})
NEEDS_HUB = frozenset(name for name in _OTHERS if not name.startswith("receiver"))
_ROOT_WRITES = ("lock", "reserve", "sunarc.sqlite.partial", "sunarc.sqlite-wal", "sunarc.sqlite-shm")
"""Names in the state folder that a restore writes or removes."""
_DATABASE = ("sunarc.sqlite", "sunarc.sqlite-wal", "sunarc.sqlite-shm")
_CLEAN_ENDS = frozenset({0, 1, 2, 3})
_WRONG_SETTINGS = 2
_SECRET = "c2VjcmV0IG9mIHRoZSBjYW1wYWlnbiBvZiBmYXVsdHM="  # noqa: S105 - of a receiver on loopback
_HINDER_A_START = ("disk_full", "locked")
_HINDERS_FOR_S = 5.0
_IN_A_WINDOW = (6, 12)
_BEGIN_WITHIN_SLOTS = 6.0
_NOTICES = {f"database_{kind}" for kind in ("written_back", "restored", "new", "salvaged")}
_OF_SPEED = ("slots_missed", "cycle_too_long", "image_times_late")
"""Conditions of the chain's speed: a second of an upload is minutes of the imager's time."""
STANDING = frozenset({"no_calibration", "provisional_calibration", *_OF_SPEED, *_NOTICES})
"""Conditions of the chain itself or of the last 40 slots, and notices that a restart ends; others end after faults."""
LASTING_DAYS = {"calibration_damaged": 1.5}
"""Days of the imager's time for which a condition may last: the next refit ends it, and the camera before is served."""
_RECOVERS_WITHIN_S = 240.0
_HUB_NOTICES_S = 20.0
"""Real seconds after which a hub without its database must not be ready; it looks every 10 s."""


class Known(NamedTuple):
    """The last frame and the last sighting that a service knows, seconds of the imager's time."""

    frame: float
    sighting: float


class Faults(Processes):
    """Two processes, a receiver of messages and a hub, and the faults done to them.

    Parameters
    ----------
    folder, port, setting : of `Processes`.
    seed : of the faults and their durations.
    source : how the images come.
    """

    only: Sequence[str] = ()
    """The kinds that are drawn; all of the source where it is empty."""
    patience = 1.0
    """Factor of the real seconds within which all has to go on after faults."""

    def __init__(
        self, folder: Path, *, port: int, seed: int, setting: Setting | None = None, source: Source = "gige"
    ) -> None:
        super().__init__(folder, port=port, setting=setting)
        self.faults_of: Source = source
        self.source = source if source in {"folder", "http"} else self.source
        self.seed = seed
        self.pool = ThreadPoolExecutor(_IN_A_WINDOW[1])  # an imager ends with the thread that started it
        self.drawn = threading.local()  # each fault has numbers of its own
        self.counts: dict[str, int] = {}
        self.failed = False
        self.n_starts_again = 0
        self.hinders_until: dict[str, float] = {}
        self.flipped: set[str] = set()
        self.other = Other()
        self.server = ThreadingHTTPServer((ADDRESS, 0), self.other.handler())
        self.server.daemon_threads = True
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        self.address = f"http://{ADDRESS}:{self.server.server_address[1]}"
        self.has_hub_disk = mount_disk(folder / "hub")
        (folder / "hub").chmod(0o755)
        self.hub = CampaignHub(folder / "hub") if programs() is not None else None
        missing = set() if self.hub is not None else NEEDS_HUB
        if not self.has_own_disk or not self.has_hub_disk:
            missing |= NEEDS_OWN_DISK
        self.left_out = sorted(missing)

    def __exit__(self, *error: object) -> None:
        super().__exit__(*error)
        self.pool.shutdown()
        self.server.shutdown()
        self.server.server_close()
        if self.hub is not None:
            self.hub.close()
        if self.has_hub_disk:
            unmount_disk(self.folder / "hub")

    def other_sections(self) -> str:
        """Return the settings of the receiver and of the hub."""
        secret = self.folder / "secret"
        secret.write_text(_SECRET + "\n")
        push = f'[push]\nwebhooks = ["{self.address}/hook"]\nwebhook_secret_file = "{secret}"\n'
        return push + ("" if self.hub is None else self.hub.settings(self.folder / "token"))

    @property
    def random(self) -> random.Random:
        """The numbers of the fault of this thread."""
        if not hasattr(self.drawn, "numbers"):
            self.drawn.numbers = random.Random(self.seed)
        numbers: random.Random = self.drawn.numbers
        return numbers

    def tend(self) -> None:
        """Start a hub that ended."""
        if self.hub is not None:
            self.hub.tend()

    def explains_an_end(self, code: int) -> bool:
        """Whether a fault of this moment may end the service at its start, with a reason."""
        explained = code in _CLEAN_ENDS - {_WRONG_SETTINGS} and now() < max(self.hinders_until.values(), default=0.0)
        if explained:
            self.n_starts_again += 1
            self.note(f"the service ended at its start with {code}, and is started again")
        return explained

    def windows(self) -> Iterator[list[str]]:
        """Yield the faults of one window after the other: some of different kinds, each kind once before any again."""
        drawn = random.Random(self.seed)
        every = [fault for fault in FAULTS[self.faults_of] if fault not in self.left_out]
        possible = [fault for fault in every if fault in (self.only or every)]
        while True:
            kinds = drawn.sample(possible, len(possible))
            while kinds:
                count = drawn.randint(*_IN_A_WINDOW)
                yield kinds[:count]
                del kinds[:count]

    def disturb(self, faults: Sequence[str]) -> None:
        """Do faults, all that do not hinder each other at once, while everything is looked at."""
        first = sum(self.counts.values())
        done = [self.pool.submit(self._one, fault, first + n) for n, fault in enumerate(faults)]
        while not all(one.done() for one in done):
            self.wait(0.5)
        for one in done:
            one.result()  # a defect of the campaign itself ends it
        if self.failed:
            self.restore()
            self.failed = False

    def _one(self, fault: str, number: int) -> None:
        """Do a fault after a while."""
        self.drawn.numbers = random.Random(f"{self.seed} {number}")
        self.wait(self.random.uniform(0.0, _BEGIN_WITHIN_SLOTS) * self.slot_s)
        with self.held(*NEEDS.get(fault, ())):
            self.counts[fault] = self.counts.get(fault, 0) + 1
            self._hinder(fault, float("inf"))
            self.note(f"{fault} begins")
            try:
                getattr(self, f"_{fault}")()
            except (AssertionError, OSError, RuntimeError, sqlite3.Error, subprocess.SubprocessError) as error:
                self.exits.append(f"{fault} failed: {error}")  # found wrong, and the campaign goes on
                self.failed = True
            self.note(f"{fault} ends")
            self._hinder(fault, now() + _HINDERS_FOR_S)

    def _hinder(self, fault: str, until: float) -> None:
        if fault in _HINDER_A_START:
            self.hinders_until[fault] = until

    def known(self) -> Known | None:
        """Return the last frame and the last sighting that the service knows; None while it does not answer."""
        status = self.get("/v1/status")
        if status is None:
            return None
        last = status["last_frame_at"]
        newest = max((time for time, _ in self.stored_sightings()), default=0) / 1e6
        return Known(float("-inf") if last is None else datetime.fromisoformat(last).timestamp(), newest)

    def awaited(self, since: Known) -> list[str]:
        """Return what is still missing after faults at whose end something was known, but for the hub."""
        found, ready = self.known(), self.get("/readyz")
        if found is None or ready is None:
            return ["no answer"]
        missing = [f"/readyz says {one['code']}" for one in ready["reasons"] if not self._stands(one)]
        if found.frame <= since.frame:
            missing.append("no frame")
        if found.sighting <= since.sighting and self.zenith_deg(max(found.frame, since.sighting)) < CLEAR_ZENITH_DEG:
            missing.append("no sighting")
        return missing + self.forgotten(since.frame)

    def _stands(self, reason: dict[str, Any]) -> bool:
        """Whether a condition does not have to end with the faults, or not yet."""
        moment = datetime.now(UTC)
        stood_s = (moment - datetime.fromisoformat(reason["since"])).total_seconds() * self.setting.speed
        return reason["code"] in STANDING or stood_s < 86_400.0 * LASTING_DAYS.get(reason["code"], 0.0)

    def forgotten(self, since: float) -> list[str]:  # noqa: ARG002 - of pictures
        """Return the images from before one of the imager's times that were handed on whole and have no sighting."""
        return []

    def end(self) -> list[str]:
        """End the imager; return what the service has forgotten and what the hub has not, if it does not in minutes."""
        self.kill_imager()
        end = now() + self.patience * _RECOVERS_WITHIN_S
        while missing := self._unfinished():
            if now() > end:
                break
            self.wait(1.0)
        return missing

    def _unfinished(self) -> list[str]:
        rows = [] if self.hub is None else self.hub.missing(self.hub.rows_of(self.database), self.database)
        return rows + self.forgotten(float("inf"))

    def recover(self) -> list[str]:
        """Wait until all goes on as before the faults, also the hub has every row; return what has not within minutes.

        Everything is looked at meanwhile, as in `wait`.
        """
        since, end, before = self.known(), now() + self.patience * _RECOVERS_WITHIN_S, list[str]()
        while since is None or (missing := self.awaited(since)):
            if now() > end:
                return ["no answer"] if since is None else missing
            if self.hub is not None and since is not None and "/readyz says hub_refuses" in missing:
                self.hub.accept()
            if since is not None and missing != before:
                self.note(f"still {missing}")
                before = missing
            self.wait(0.5)
            since = since or self.known()
        if self.hub is None:
            return []
        end, rows = now() + self.patience * _RECOVERS_WITHIN_S, self.hub.rows_of(self.database)
        while missing := self.hub.missing(rows, self.database):
            if now() > end:
                return missing
            self.wait(2.0)
        return []

    def note(self, text: str) -> None:
        """Write a line to the logs of the faults and of the service."""
        with (self.folder / "faults.log").open("a") as log:
            log.write(f"{now():.1f} {self._known[0]:.0f} {text}\n")
        with (self.folder / "service.log").open("a") as log:
            log.write(f"---- {text}\n")

    def restore(self) -> None:
        """Bring both processes back, with the host's clock right, after a fault that did not end as it should."""
        self.clock_file.write_text("0 synchronised")
        (self.state / "ballast").unlink(missing_ok=True)
        if self.hub is not None:
            (self.hub.folder / "ballast").unlink(missing_ok=True)
            self.hub.link.down = self.hub.link.drips = False
            self.hub.link.share = 0.0
            self.hub.start_server()
        if self.service is not None:
            self.service.send_signal(signal.SIGCONT)
        self.stop_service(signal.SIGKILL)
        if (self.folder / "kept").exists():
            self._put_back(self.folder / "kept")
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
        starts = self.n_starts
        self._ordered("REPEAT_FRAME", 1)
        self._note_copies(begin, starts)

    def _note_copies(self, begin: float, starts: int) -> None:
        """Note that images came again since a time; a service that is started meanwhile does not know the first."""
        assert self.judge is not None
        self.judge.repeated(begin, self.latest_time(), times=1 + self.n_starts - starts)

    def _black_frames(self) -> None:
        self._ordered("BLACK", 1)

    def _host_clock(self) -> None:
        """Set the host's clock wrong, and right again."""
        ahead = self.random.choice([-3600.0, -60.0, 5.0, 7200.0, 400.0 * 86_400.0])
        state = self.random.choice(["synchronised", "unsynchronised"])
        self.clock_file.write_text(f"{ahead} {state}")
        self.wait(self.random.uniform(2.0, 6.0))
        if self.random.random() < 0.3:
            with self.held("service"):
                self._kill()
        self.clock_file.write_text("0 synchronised")

    def _locked(self) -> None:
        with contextlib.closing(sqlite3.connect(self.database, timeout=20.0, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            self.wait(self.random.uniform(0.5, 8.0))
            connection.execute("ROLLBACK")

    def _backup(self) -> None:
        done = self._sunarc("db", "backup", self.folder / "backups", "--keep", "2")
        if done.returncode:
            self.exits.append(f"backup: {done.stderr.strip()}")

    def _sunarc(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        """Run a command of the state folder."""
        command = [sys.executable, "-m", "sunarc", *map(str, arguments), "--state", str(self.state)]
        return subprocess.run(command, capture_output=True, text=True, timeout=START_WITHIN_S, check=False)

    def _copy(self) -> Path:
        """Make a copy of the database, and return its path."""
        done = self._sunarc("db", "backup", self.folder / "copies", "--keep", "1")
        if done.returncode:
            raise RuntimeError(f"no copy: {done.stderr.strip()}")
        return max((self.folder / "copies").glob("*.sqlite*"), key=lambda path: path.stat().st_mtime)

    def _link_at_restore(self) -> None:
        """Restore as root while a link lies in the state folder: what it points to must stay as it is."""
        self.stop_service(signal.SIGTERM)
        copy, victim = self._copy(), self.folder / "victim"
        victim.write_text("not the service's\n")
        victim.chmod(0o600)
        before = victim.read_bytes(), victim.stat().st_mode, victim.stat().st_uid, victim.stat().st_nlink
        link = self.state / self.random.choice(_ROOT_WRITES)
        link.unlink(missing_ok=True)
        link.symlink_to(victim)
        done = self._sunarc("db", "restore", copy)
        if done.returncode not in _CLEAN_ENDS or "Traceback" in done.stderr:
            self.exits.append(f"restore beside a link {link.name}: {done.returncode} {done.stderr.strip()[-200:]}")
        if before != (victim.read_bytes(), victim.stat().st_mode, victim.stat().st_uid, victim.stat().st_nlink):
            self.exits.append(f"a restore followed the link {link.name}")
        if link.is_symlink():
            link.unlink()
        self.start_service()

    def _restore_while_hub_away(self) -> None:
        """Put an earlier copy back while the hub, which has more, does not answer; new rows follow."""
        copy = self._copy()
        self.wait(self.random.uniform(3.0, 10.0) * self.slot_s)
        self._of_hub.link.down = True
        self.stop_service(self.random.choice([signal.SIGTERM, signal.SIGKILL]))
        with self.held("looks"):
            self.looks = False
        rows = self._of_hub.rows_of(self.database)
        done = self._sunarc("db", "restore", copy)
        if done.returncode:
            self.exits.append(f"restore: {done.returncode} {done.stderr.strip()[-200:]}")
        self._of_hub.put_back |= rows - self._of_hub.rows_of(self.database)
        with self.held("looks"):
            if self.judge is not None:
                self.judge.put_back()
            self.looks = True
        self.start_service()
        self.wait(self.random.uniform(3.0, 15.0) * self.slot_s)
        self._of_hub.link.down = False

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
        self._fill(self.state / "ballast")

    def _fill(self, ballast: Path) -> None:
        with ballast.open("wb", buffering=0) as file:
            end = now() + self.random.uniform(1.0, 8.0) * self.slot_s
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
        self.wait(self.random.uniform(1.0, 8.0) * self.slot_s)
        self.order(register, 0)

    def _receiver_drips(self) -> None:
        self.other.drips = True
        self.get("/v1/refits", method="POST")
        self.wait(self.random.uniform(2.0, 10.0) * self.slot_s)
        self.other.drips = False

    def _receiver_refuses(self) -> None:
        self.other.refuses = True
        self.get("/v1/refits", method="POST")
        self.wait(self.random.uniform(2.0, 10.0) * self.slot_s)
        self.other.refuses = False

    def _flipped_bit(self) -> None:
        """Flip a bit of a file that the service writes; it has to start, or to end with a reason. Then put it back."""
        self.stop_service(self.random.choice([signal.SIGTERM, signal.SIGKILL]))
        kept = self.folder / "kept"
        with self.held("looks"):
            self.looks = False
        if self.hub is not None:  # which is not told what such a state holds
            self.hub.link.down = True
        shutil.copytree(self.state, kept, ignore=shutil.ignore_patterns("reserve", "lock", "ballast"))
        files = sorted(one for one in kept.rglob("*") if one.is_file() and one.stat().st_size)
        kind = self.random.choice(sorted({_kind(one.relative_to(kept)) for one in files}))
        chosen = self.random.choice([path for one in files if _kind(path := one.relative_to(kept)) == kind])
        self.flipped.add(kind)
        content = (self.state / chosen).read_bytes()
        (self.state / chosen).write_bytes(flipped(content, self.random.randrange(8 * len(content))))
        self.note(f"a bit of {chosen}")
        self._starts_or_says_why(chosen)
        self._put_back(kept)
        self.start_service()

    def _put_back(self, kept: Path) -> None:
        """Put a state back of which a bit was flipped."""
        for name in _DATABASE:
            (self.state / name).unlink(missing_ok=True)
        shutil.copytree(kept, self.state, dirs_exist_ok=True)
        shutil.rmtree(kept)
        self.looks = True
        if self.hub is not None:
            self.hub.link.down = False

    def _starts_or_says_why(self, chosen: Path) -> None:
        try:
            self.start_service()
            pause(3.0 * self.slot_s)
        except RuntimeError as error:
            code = None if self.service is None else self.service.poll()
            if code not in _CLEAN_ENDS:
                self.exits.append(f"a bit of {chosen}: {error}, code {code}")
        if self.service is not None and self.service.poll() is None:
            self.stop_service(signal.SIGTERM)
        self.service = None

    # Faults of the hub, which this chain sends to; it starts again as its unit has it.

    def _hub_killed(self) -> None:
        self._of_hub.kill()
        self.wait(self.random.uniform(1.0, 8.0) * self.slot_s)

    def _hub_away(self) -> None:
        self._of_hub.link.down = True
        self.wait(self.random.uniform(2.0, 20.0) * self.slot_s)
        self._of_hub.link.down = False

    def _hub_fails(self) -> None:
        """Lose requests and answers, deliver some late or twice."""
        self._of_hub.link.share = 0.7
        self.wait(self.random.uniform(5.0, 20.0) * self.slot_s)
        self._of_hub.link.share = 0.0

    def _hub_drips(self) -> None:
        self._of_hub.link.drips = True
        self.wait(self.random.uniform(5.0, 20.0) * self.slot_s)
        self._of_hub.link.drips = False

    def _hub_disk_full(self) -> None:
        """Fill the disk of PostgreSQL, and free it again."""
        self._fill(self._of_hub.folder / "ballast")
        self._of_hub.start_server()

    def _postgresql_killed(self) -> None:
        """End PostgreSQL as a crash does; the hub must not call itself ready meanwhile."""
        self._of_hub.server.stop("immediate")
        end = now() + _HUB_NOTICES_S
        while self._of_hub.is_ready() and now() < end:
            self.wait(1.0)
        if self._of_hub.is_ready():
            self.exits.append("the hub is ready without its database")
        self._of_hub.server.start()

    def _hub_may_not_insert(self) -> None:
        """Take the hub's role its privilege of storing sightings, as a forgotten `grants.sql` does."""
        self._of_hub.sql("REVOKE INSERT ON sun_point FROM sunarc_feed")
        self.wait(self.random.uniform(3.0, 15.0) * self.slot_s)
        self._of_hub.sql("GRANT INSERT ON sun_point TO sunarc_feed")

    def _hub_table_locked(self) -> None:
        """Lock a table that the hub stores in, as a job of its administrator does."""
        with self._of_hub.locked("sun_point"):
            self.wait(self.random.uniform(2.0, 20.0) * self.slot_s)

    @property
    def _of_hub(self) -> CampaignHub:
        assert self.hub is not None
        return self.hub


def flipped(content: bytes, bit: int) -> bytes:
    """Return bytes of which one bit is another."""
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def _kind(path: Path) -> str:
    """Return a kind of file that the service writes: its folder and its ending."""
    return path.name if len(path.parts) == 1 else f"{path.parts[0]}/*{path.suffix}"
