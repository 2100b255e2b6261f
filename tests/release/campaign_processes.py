"""The two processes of a campaign: a simulated GigE Vision imager and the service, faster than real time."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from http.client import HTTPException
from pathlib import Path
from typing import Any, Self

from sunarc.lab.simulation.imager import next_dawn
from sunarc.lab.simulation.truth import SGP
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

from .campaign_judge import Judge

HERE = Path(__file__).resolve().parent
ADDRESS = "127.0.0.1"
START = datetime(2013, 5, 13, 14, 0, tzinfo=UTC)
SPEED = 150.0
CADENCE_S = 300.0
"""With `SPEED` a slot takes 2 s: in 0.6 s a loaded host has no time for exposures of the sun beside the others. Slots
of more than 312 s would leave moves within a day unsought."""
IMAGER = HERE.parent / "lab" / "simulation" / "imager_process.py"
SHIM = HERE / "clock_shim.py"
START_WITHIN_S = 300.0
"""Real seconds for a process to start; 5 to 51 s beside a load of 12 on 2 cores."""
NIGHT_ZENITH_DEG = 92.0
_NIGHT_SLOTS = 5.0
LONGEST_CAMPAIGN_S = 120.0 * 86_400.0
"""Simulated: a time later than this is not the imager's, but the host's."""
DISK_MB = 500
TOKEN = "a-token-of-the-campaign-0123456789"  # noqa: S105 - of a service on loopback that ends with the campaign
_CLONE_NEWNS, _MS_REC, _MS_PRIVATE, _MNT_DETACH = 0x20000, 0x4000, 1 << 18, 2
SETTINGS = """\
name = "roof"
source = "{source}"
state = "{state}"
[site]
latitude = {latitude}
longitude = {longitude}
altitude = {altitude}
{section}{others}[capture]
cadence_s = {cadence}
night_cadence_s = {night_cadence}
speed = {speed}
[night]
enabled = {nights}
[sensor]
black_level_fraction = 0.0078
[refit]
check_every_s = 1.0
[disk]
keep_days = 1.0
keep_free_mb = 100.0
[api]
port = {port}
token_file = "{token}"
"""
CAMERA = """\
[camera]
address = "127.0.0.1"
pixel_format = "Mono12"
packet_size = 60000
packet_socket = false
timestamps = "camera"
"""


def now() -> float:
    """Return real monotonic seconds."""
    return time.monotonic()


def pause(seconds: float) -> None:
    """Wait for real."""
    time.sleep(max(seconds, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """Where the imager stands, and how its time passes.

    Attributes
    ----------
    site : of the imager.
    start : its first time, aware.
    speed : seconds of its time in a real second.
    cadence_s : seconds of its time from slot to slot.
    nights : whether the imager shows the nights, and the service looks at their stars; else the imager skips them.
    """

    site: Site = SGP
    start: datetime = START
    speed: float = SPEED
    cadence_s: float = CADENCE_S
    nights: bool = False


class Processes:
    """An imager and a service, started, stopped and asked; both end with this process.

    Parameters
    ----------
    folder : empty; keeps settings, state and logs. Where mounting is allowed, the state is on a disk of its own.
    port : of the service.
    setting : of the imager.
    """

    source: str = "aravis"

    def __init__(self, folder: Path, *, port: int, setting: Setting | None = None) -> None:
        self.setting = setting or Setting()
        self.folder = folder
        self.port = port
        self.state = folder / "state"
        self.database = self.state / "sunarc.sqlite"
        self.clock_file = folder / "clock"
        self.exits: list[str] = []
        self.judge: Judge | None = None
        self.looks = True
        self.environment: dict[str, str] = {}
        """Of the service, beside this process's own."""
        self.n_starts = 0
        self.has_own_disk = mount_disk(self.state)
        self.imager: subprocess.Popen[str] | None = None
        self.service: subprocess.Popen[bytes] | None = None
        self._known = (self.setting.start.timestamp(), now())
        self.locks: defaultdict[str, threading.RLock] = defaultdict(threading.RLock)

    def __enter__(self) -> Self:
        self.write_settings("sunarc.toml", port=self.port)
        try:
            self.start_imager()
            self.start_service()
        except BaseException:
            self.__exit__()
            raise
        truth = json.loads((self.folder / "truth.json").read_text())
        self.judge = Judge(
            self.database, self.port, truth=truth, site=self.setting.site, cadence_s=self.setting.cadence_s
        )
        return self

    def __exit__(self, *_: object) -> None:
        self.stop_service(signal.SIGTERM)
        self.kill_imager()
        if self.has_own_disk:
            if self.database.exists():
                shutil.copy(self.database, self.folder / "sunarc.sqlite")
            unmount_disk(self.state)

    def write_settings(self, name: str, *, port: int) -> Path:
        """Write a settings file of the service with a port of its own, and return its path."""
        token = self.folder / "token"
        token.write_text(TOKEN)
        token.chmod(0o600)
        site = self.setting.site
        text = SETTINGS.format(
            source=self.source,
            section=self.source_section(),
            others=self.other_sections(),
            state=self.state,
            latitude=site.latitude,
            longitude=site.longitude,
            altitude=site.altitude,
            cadence=self.setting.cadence_s,
            night_cadence=self.setting.cadence_s * (_NIGHT_SLOTS if self.setting.nights else 1.0),
            nights=str(self.setting.nights).lower(),
            speed=self.setting.speed,
            port=port,
            token=token,
        )
        (self.folder / name).write_text(text)
        return self.folder / name

    def source_section(self) -> str:
        """Return the settings of the source."""
        return CAMERA

    def other_sections(self) -> str:
        """Return the settings of what else the service talks to."""
        return ""

    @property
    def slot_s(self) -> float:
        """Real seconds from slot to slot."""
        return self.setting.cadence_s / self.setting.speed

    def tend(self) -> None:
        """Do what is to be done again and again while time passes."""

    def frame_time(self) -> float | None:
        """Return the imager's time as the service has it, unix seconds; None while it has none."""
        status = self.get("/v1/status")
        if status is None or not (status.get("camera") or {}).get("connected") or status["last_frame_at"] is None:
            return None
        frame_time = datetime.fromisoformat(status["frame_time"]).timestamp()
        first = self.setting.start.timestamp()
        if not first <= frame_time < first + LONGEST_CAMPAIGN_S:
            return None  # the host's, before the first frame
        self._known = (max(frame_time, self._known[0]), now())
        return frame_time

    def zenith_deg(self, moment: float) -> float:
        """Return the sun's apparent zenith angle at one of the imager's times."""
        return float(sun_angles(moment, self.setting.site).apparent_zenith)

    def stored_sightings(self) -> set[tuple[int, float]]:
        """Return time and exposure of each stored sighting; none while the database cannot be read."""
        return set() if self.judge is None else self.judge.stored() or set()

    def latest_time(self) -> float:
        """Return the imager's time; while the service does not tell it, the latest that it can have, unix seconds."""
        known, at = self._known
        return self.frame_time() or known + (now() - at) * self.setting.speed

    def start_imager(self) -> None:
        """Start the imager a slot after the latest time that it can have shown, by day."""
        truth = self.folder / "truth.json"
        truth.unlink(missing_ok=True)
        began = self._next_start()
        self._known = (began, now())
        site = {name: getattr(self.setting.site, name) for name in ("latitude", "longitude", "altitude")}
        settings = {"address": ADDRESS, "clouds": "clear", "speed": self.setting.speed, "site": site}
        if self.setting.nights:
            settings |= {"skip_nights": False, "night": {}}
        start = datetime.fromtimestamp(began, UTC).isoformat()
        command = [sys.executable, str(IMAGER), json.dumps(settings), start, str(truth), "orders"]
        with (self.folder / "imager.log").open("ab") as log:
            self.imager = subprocess.Popen(command, stdin=subprocess.PIPE, text=True, stdout=log, stderr=log)
        self.wait_for(truth.exists, what="the imager")

    def _next_start(self) -> float:
        known, at = self._known
        if known == self.setting.start.timestamp():
            return known
        began = known + self.setting.cadence_s + (now() - at) * self.setting.speed
        if not self.setting.nights and self.zenith_deg(began) > NIGHT_ZENITH_DEG:
            began = next_dawn(began, self.setting.site)
        return began

    def kill_imager(self) -> None:
        """End the imager at once."""
        self.frame_time()
        with self.held("registers"):
            imager, self.imager = self.imager, None
        if imager is not None:
            imager.kill()
            imager.wait(timeout=10.0)
            if imager.stdin is not None:
                with contextlib.suppress(BrokenPipeError):
                    imager.stdin.close()

    def order(self, register: str, value: int) -> None:
        """Write a register of the imager."""
        with self.held("registers"):
            if self.imager is not None and self.imager.stdin is not None:
                self.imager.stdin.write(f"{register} {value}\n")
                self.imager.stdin.flush()

    @contextlib.contextmanager
    def held(self, *names: str) -> Iterator[None]:
        """Keep other threads from what two faults cannot be done to at once."""
        with contextlib.ExitStack() as stack:
            for name in sorted(names):
                stack.enter_context(self.locks[name])
            yield

    def explains_an_end(self, code: int) -> bool:  # noqa: ARG002 - of a chain with faults
        """Whether a service that ends at its start has a reason to, and its unit starts it again."""
        return False

    def start_service(self) -> None:
        """Start the service, again where that is explained as its unit does, and wait until it answers."""
        end = now() + START_WITHIN_S
        while True:
            self._start_once(end - now())
            if not self._ended():
                return
            code = None if self.service is None else self.service.returncode
            if code is None or not self.explains_an_end(code) or now() > end:
                raise RuntimeError(f"the service ended at its start with {code}; see {self.folder}")
            pause(0.5)

    def _start_once(self, within_s: float) -> None:
        command = [sys.executable, str(SHIM), str(self.clock_file), "serve", "--config"]
        self.n_starts += 1
        with (self.folder / "service.log").open("ab") as log:
            self.service = subprocess.Popen(
                [*command, str(self.folder / "sunarc.toml")],
                stdout=log,
                stderr=log,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", **self.environment},
            )
        answers = lambda: self.get("/healthz") is not None or self._ended()  # noqa: E731
        self.wait_for(answers, what="the service", within_s=within_s)

    def _ended(self) -> bool:
        return self.service is None or self.service.poll() is not None

    def stop_service(self, number: signal.Signals) -> None:
        """Send a signal and wait for the end."""
        if self.service is not None:
            self.service.send_signal(number)
            try:
                self.service.wait(timeout=20.0)
            except subprocess.TimeoutExpired:
                self.exits.append(f"did not end within 20 s of {number.name}")
                self.service.kill()
                self.service.wait()
            self.service = None

    def wait(self, seconds: float) -> None:
        """Let time pass; the main thread looks at everything every half second meanwhile."""
        if threading.current_thread() is not threading.main_thread():
            pause(seconds)
            return
        end = now() + seconds
        while now() < end:
            pause(min(0.5, end - now()))
            self.tend()
            self._start_if_ended()
            with self.held("looks"):
                if self.judge is not None and self.looks:
                    self.judge.look(self.frame_time())

    def _start_if_ended(self) -> None:
        """Start a service that ended by itself, which is found wrong; not while a fault has ended it."""
        if not self.locks["service"].acquire(blocking=False):
            return
        try:
            if self.service is not None and self.service.poll() is not None:
                self.exits.append(f"code {self.service.returncode} at {self._known[0]:.0f}")
                self.start_service()
        except RuntimeError as error:
            self.exits.append(str(error))
        finally:
            self.locks["service"].release()

    def wait_for(self, reached: Callable[[], bool], *, what: str, within_s: float = START_WITHIN_S) -> None:
        """Wait until something is reached; raise where it is not in time."""
        end = now() + within_s
        while not reached():
            if now() > end:
                raise RuntimeError(f"{what} did not start within {within_s:g} s; see {self.folder}")
            pause(0.05)

    def get(self, route: str, *, method: str = "GET") -> dict[str, Any] | None:
        """Return what the service answers; None where it does not, or refuses."""
        headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"}
        data = b"{}" if method == "POST" else None
        request = urllib.request.Request(
            f"http://{ADDRESS}:{self.port}{route}", method=method, headers=headers, data=data
        )
        try:
            with urllib.request.urlopen(request, timeout=5.0) as response:
                answer: dict[str, Any] = json.load(response)
                return answer
        except (OSError, ValueError, HTTPException):  # it may end in the middle of an answer
            return None


def mount_disk(folder: Path) -> bool:
    """Put a folder on a small disk in memory that only this process and its children see; return whether it is."""
    folder.mkdir(mode=0o750)
    if os.geteuid() != 0:
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_CLONE_NEWNS) or libc.mount(None, b"/", None, ctypes.c_ulong(_MS_REC | _MS_PRIVATE), None):
        return False
    options = f"size={DISK_MB}m,mode=0750".encode()
    return not libc.mount(b"tmpfs", str(folder).encode(), b"tmpfs", ctypes.c_ulong(0), options)


def unmount_disk(folder: Path) -> None:
    """Take a disk away again, with what is on it; a folder that a disk is on cannot be removed."""
    ctypes.CDLL(None).umount2(str(folder).encode(), _MNT_DETACH)
