"""A machine with the package on it, an imager at the end of its cable, and what is asked of them.

`deploy/test-booted` makes what these tests need and runs them; anywhere else they are skipped, with this reason.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sunarc.lab.simulation.truth import SGP
from sunarc.sky.days import day_bounds_unix_s, solar_date
from sunarc.sky.site import Site

from .machine import IMAGER_ADDRESS, Machine, cabled, run, wait_for
from .truth import worse_than_stated, wrong_sightings

_ASK = """
import sys, urllib.request as u
asked = u.Request(sys.argv[1], method=sys.argv[2], headers={"Authorization": "Bearer " + sys.argv[3]})
print(u.urlopen(asked, timeout=5).read().decode())
"""
SPEED = 10  # of the camera's clock: a cycle of 30 s takes 3 s, which a busy host can keep
SLOT_S = 30.0 / SPEED
START = datetime(2013, 5, 13, 14, tzinfo=UTC)
AS_SUNARC = ("setpriv", "--reuid=sunarc", "--regid=sunarc", "--clear-groups")
_UP_WITHIN_S = 180.0  # by a busy host
_SYSCTL = Path(__file__).parents[2] / "deploy" / "debian" / "sunarc.sysctl"
_IMAGER = Path(__file__).parents[1] / "lab" / "simulation" / "imager_process.py"
_MOST_JUDGED = 3000  # of the newest sightings


@pytest.fixture(scope="session")
def work() -> Path:
    """Return the folder with `tree`, `sunarc.deb` and `previous.deb`."""
    folder = os.environ.get("SUNARC_BOOTED")
    if folder is None:
        pytest.skip("needs a machine to boot: run deploy/test-booted")
    return Path(folder)


@pytest.fixture(scope="session")
def networks() -> Iterator[tuple[str, str]]:
    with cabled(f"sunarc-{os.getpid()}") as names, kernel_settings():
        yield names


@contextmanager
def kernel_settings() -> Iterator[None]:
    """Set on the host what the package sets at a boot: a machine in a network namespace may only read it."""
    lines = [line.split(" = ") for line in _SYSCTL.read_text().splitlines() if not line.startswith("#")]
    wanted = {Path("/proc/sys", *name.split(".")): value for name, value in lines}
    before = {file: file.read_text() for file in wanted}
    for file, value in wanted.items():
        file.write_text(value)
    try:
        yield
    finally:
        for file, value in before.items():
            file.write_text(value)


@dataclass(slots=True)
class Field:
    """A field computer and its imager, which stands at `site`; its time begins at `start` and passes at `speed`."""

    machine: Machine
    imager_network: str
    log: Path
    site: Site = SGP
    start: datetime = START
    speed: int = SPEED
    _imager: subprocess.Popen[str] | None = field(default=None, init=False)
    _began_s: float | None = field(default=None, init=False)
    _binning: int = field(default=1, init=False)

    def call(self, *command: str, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
        return self.machine.call(*command, timeout_s=timeout_s)

    def do(self, *command: str, timeout_s: float = 120.0) -> str:
        return self.machine(*command, timeout_s=timeout_s)

    def path(self, name: str) -> Path:
        return self.machine.tree / name.lstrip("/")

    def write(self, name: str, text: str, *, mode: int = 0o644) -> None:
        self.path(name).parent.mkdir(parents=True, exist_ok=True)
        self.path(name).write_text(text)
        self.path(name).chmod(mode)

    def configure(
        self, *, more: str = "", binning: int | None = 2, timestamps: str = "camera", **capture: object
    ) -> None:
        """Write settings for the simulated imager; small frames keep a busy host from losing them."""
        given = {"speed": self.speed, **capture}
        lines = "\n".join(f"{name} = {value}" for name, value in given.items())
        self._binning = binning or 1
        binned = "" if binning is None else f"binning = {binning}\n"
        self.write(
            "/etc/sunarc/sunarc.toml",
            f'name = "roof"\n[site]\nlatitude = {self.site.latitude}\nlongitude = {self.site.longitude}\n'
            f"altitude = {self.site.altitude}\n"
            f'[camera]\naddress = "{IMAGER_ADDRESS}"\npacket_size = 8000\n{binned}timestamps = "{timestamps}"\n'
            f"[capture]\n{lines}\n{more}",
        )

    def image(self) -> None:
        """Switch the imager on; its time goes on where it would be, had it never been off."""
        self._began_s = self._began_s or time.monotonic()
        start = self.start + timedelta(seconds=self.speed * (time.monotonic() - self._began_s))
        site = {"latitude": self.site.latitude, "longitude": self.site.longitude, "altitude": self.site.altitude}
        options = json.dumps({"address": IMAGER_ADDRESS, "speed": self.speed, "site": site})
        command = [
            sys.executable,
            str(_IMAGER),
            options,
            start.isoformat(),
            str(self.log.with_suffix(".truth")),
            "orders",
        ]
        with self.log.open("ab") as log:
            self._imager = subprocess.Popen(
                ["ip", "netns", "exec", self.imager_network, *command],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                text=True,
            )

    def begin(self) -> None:
        """Switch imager and machine on, and wait until the service is ready."""
        self.image()
        self.machine.boot()
        self.wait_until_ready()

    def order(self, register: str, value: int) -> None:
        """Write a register of the imager, by its name in `sunarc.lab.simulation.fake_camera`."""
        assert self._imager is not None
        assert self._imager.stdin is not None
        self._imager.stdin.write(f"{register} {value}\n")
        self._imager.stdin.flush()

    def darken(self) -> None:
        """Switch the imager off."""
        if self._imager is not None:
            self._imager.send_signal(signal.SIGKILL)
            self._imager.wait()
            assert self._imager.stdin is not None
            self._imager.stdin.close()
            self._imager = None

    def ask(self, route: str, *, method: str = "GET") -> Any:
        """Ask the service from inside; None while it does not answer."""
        token = self.path("/etc/sunarc/token").read_text()
        answer = self.call("python3", "-c", _ASK, f"http://127.0.0.1:8080{route}", method, token)
        return json.loads(answer.stdout) if answer.returncode == 0 and answer.stdout.startswith(("{", "[")) else None

    def active(self) -> bool:
        return self.call("systemctl", "is-active", "sunarc").stdout.strip() == "active"

    def wait_until_ready(self, *, within_s: float = _UP_WITHIN_S) -> float:
        """Wait until systemd calls the service active, which it does when the service says that it is ready."""
        return wait_for(self.active, within_s=within_s, what="the service to be ready")

    def wait_for_sightings(self, n: int = 1, *, slots: int = 80) -> int:
        """Wait for `n` further accepted sightings and compare all with the truth; return how many sightings there are.

        Parameters
        ----------
        n : accepted ones.
        slots : of the imager's time within which they have to come. With a clear sun and an idle host, each slot gives
            one; a busy host misses some.
        """
        begun, within_s = self.accepted(), slots * SLOT_S
        try:
            what = f"{n} accepted sightings"
            wait_for(lambda: self.accepted() >= begun + n, within_s=within_s, what=what, every_s=0.5)
        except AssertionError:
            print(self.ask("/v1/status"), self.journal("-n", "30"), sep="\n")  # noqa: T201 - why there was none
            raise
        self.compare_with_truth()
        return self.sightings()

    def sightings(self) -> int:
        return int(self.sql("SELECT count(*) FROM sun_point") or 0)

    def accepted(self) -> int:
        return int(self.sql("SELECT count(*) FROM sun_point WHERE accepted") or 0)

    def compare_with_truth(self) -> None:
        """Fail where an accepted sighting, or the calibration that is served, is farther from the truth than stated."""
        columns = "time, x_px, y_px, sigma_px, ifnull(clock_error_s, 0.0)"
        select = f"SELECT {columns} FROM sun_point WHERE accepted ORDER BY id DESC LIMIT {_MOST_JUDGED}"
        rows = [[float(value) for value in line.split("|")] for line in self.sql(select).split()]
        assert wrong_sightings(np.reshape(rows, (-1, 5)), site=self.site, binning=self._binning) == []
        served = self.ask("/v1/calibration")
        assert served is None or worse_than_stated(served, binning=self._binning) == ""

    def sql(self, statement: str) -> str:
        database = "file:/var/lib/sunarc/sunarc.sqlite?mode=ro"
        answer = self.call("sqlite3", "-cmd", ".timeout 20000", database, statement)
        return answer.stdout.strip()

    def remember(self, *, days: int, a_day: int = 600) -> None:
        """Give the archive the sightings of former days, as the imager saw them."""
        wait_for(lambda: self.sql("SELECT count(*) FROM camera") == "1", within_s=_UP_WITHIN_S, what="the camera")
        self.do("systemctl", "stop", "sunarc")
        self.write("/srv/past.py", Path(__file__).with_name("past.py").read_text())
        longitude = self.site.longitude
        midnight, _ = day_bounds_unix_s(solar_date(self.start.timestamp(), longitude=longitude), longitude=longitude)
        command = ("python3", "-I", "/srv/past.py", str(midnight), str(days), str(a_day))
        self.do(*AS_SUNARC, *command, timeout_s=900.0)
        self.do("systemctl", "start", "sunarc")
        self.wait_until_ready()

    def main_pid(self) -> int:
        return int(self.do("systemctl", "show", "-P", "MainPID", "sunarc"))

    def journal(self, *options: str) -> str:
        return self.do("journalctl", "-u", "sunarc", "-o", "cat", "--no-pager", *options)

    def processor_s(self) -> float:
        """Return the processor time that the service has used since it was started, seconds."""
        return int(self.do("systemctl", "show", "-P", "CPUUsageNSec", "sunarc")) / 1e9

    def restarts(self) -> int:
        return int(self.do("systemctl", "show", "-P", "NRestarts", "sunarc"))


@contextmanager
def overlaid(lower: Path, folder: Path) -> Iterator[Path]:
    """Mount a tree that begins as `lower` and keeps what is written to itself."""
    upper, scratch, merged = folder / "upper", folder / "scratch", folder / "tree"
    for part in (upper, scratch, merged):
        part.mkdir(parents=True)
    run("mount", "-t", "overlay", "overlay", "-o", f"lowerdir={lower},upperdir={upper},workdir={scratch}", merged)
    try:
        yield merged
    finally:
        run("umount", merged)
        shutil.rmtree(folder)


Fields = Callable[[Path], Field]


@pytest.fixture
def new_field(work: Path, networks: tuple[str, str], tmp_path: Path) -> Iterator[Fields]:
    """Return what makes a field computer of a tree; what it wrote is thrown away afterwards."""
    with ExitStack() as stack:

        def make(lower: Path) -> Field:
            tree = stack.enter_context(overlaid(lower, work / f"overlay-{os.getpid()}"))
            made = Field(Machine(f"sunarc-{os.getpid()}", tree, networks[0]), networks[1], tmp_path / "imager.log")
            stack.callback(made.machine.stop)
            stack.callback(made.darken)
            return made

        yield make


@pytest.fixture(scope="session")
def installed(work: Path, networks: tuple[str, str]) -> Path:
    """Return a tree on which the package was installed once, not yet configured."""
    return with_package(work, networks, package="sunarc.deb", tree="installed")


@pytest.fixture(scope="session")
def installed_before(work: Path, networks: tuple[str, str]) -> Path:
    """Return a tree with the previous version."""
    return with_package(work, networks, package="previous.deb", tree="installed-before")


def with_package(work: Path, networks: tuple[str, str], *, package: str, tree: str) -> Path:
    """Install a package on a fresh tree, once per package."""
    target, stamp = work / tree, work / f"{tree}.stamp"
    wanted = run("sha256sum", work / package).split()[0]
    if stamp.exists() and stamp.read_text() == wanted:
        return target
    shutil.rmtree(target, ignore_errors=True)
    run("cp", "-a", work / "tree", target, timeout_s=300.0)
    shutil.copy(work / package, target / "srv" / "sunarc.deb")
    machine = Machine(f"sunarc-{os.getpid()}-i", target, networks[0])
    machine.boot()
    try:
        machine("apt-get", "install", "--quiet", "--yes", "/srv/sunarc.deb", timeout_s=600.0)
        machine("systemctl", "disable", "--now", "sunarc-backup.timer")
    finally:
        machine.stop()
    (target / "srv" / "sunarc.deb").unlink()
    stamp.write_text(wanted)
    return target


@pytest.fixture
def field_computer(new_field: Fields, installed: Path) -> Field:
    """Return a booted field computer whose service is ready and whose imager is on."""
    made = new_field(installed)
    made.configure()
    made.begin()
    return made


@pytest.fixture
def former_computer(new_field: Fields, installed_before: Path) -> Field:
    """Return a booted field computer with the previous version, ready, whose imager is on."""
    made = new_field(installed_before)
    made.configure(binning=None)  # which the version before did not know
    made.begin()
    return made
