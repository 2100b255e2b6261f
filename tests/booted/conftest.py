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
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from .machine import IMAGER_ADDRESS, Machine, cabled, run, wait_for

_ASK = """
import sys, urllib.request as u
asked = u.Request(sys.argv[1], method=sys.argv[2], headers={"Authorization": "Bearer " + sys.argv[3]})
print(u.urlopen(asked, timeout=5).read().decode())
"""
SPEED = 10  # of the camera's clock: a cycle of 30 s takes 3 s, which a busy host can keep
AS_SUNARC = ("setpriv", "--reuid=sunarc", "--regid=sunarc", "--clear-groups")
_UP_WITHIN_S = 180.0  # by a busy host


@pytest.fixture(scope="session")
def work() -> Path:
    """Return the folder with `tree`, `sunarc.deb` and `previous.deb`."""
    folder = os.environ.get("SUNARC_BOOTED")
    if folder is None:
        pytest.skip("needs a machine to boot: run deploy/test-booted")
    return Path(folder)


@pytest.fixture(scope="session")
def networks() -> Iterator[tuple[str, str]]:
    with cabled(f"sunarc-{os.getpid()}") as names:
        yield names


@dataclass(slots=True)
class Field:
    """A field computer and its imager."""

    machine: Machine
    imager_network: str
    log: Path
    _imager: subprocess.Popen[bytes] | None = field(default=None, init=False)

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

    def configure(self, *, more: str = "", binning: int | None = 2, **capture: object) -> None:
        """Write settings for the simulated imager; small frames keep a busy host from losing them."""
        given = {"speed": SPEED, **capture}
        lines = "\n".join(f"{name} = {value}" for name, value in given.items())
        binned = "" if binning is None else f"binning = {binning}\n"
        self.write(
            "/etc/sunarc/sunarc.toml",
            f'name = "roof"\n[site]\nlatitude = 36.604043\nlongitude = -97.484856\naltitude = 318.0\n'
            f'[camera]\naddress = "{IMAGER_ADDRESS}"\npacket_size = 8000\n{binned}timestamps = "camera"\n'
            f"[capture]\n{lines}\n{more}",
        )

    def image(self) -> None:
        """Switch the imager on."""
        command = [
            "ip",
            "netns",
            "exec",
            self.imager_network,
            str(Path(sys.executable).with_name("sunarc")),
            "simulate",
        ]
        with self.log.open("ab") as log:
            self._imager = subprocess.Popen(
                [*command, "--address", IMAGER_ADDRESS, "--speed", str(SPEED), "--start", "2013-05-13T14:00:00Z"],
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def darken(self) -> None:
        """Switch the imager off."""
        if self._imager is not None:
            self._imager.send_signal(signal.SIGKILL)
            self._imager.wait()
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

    def wait_for_sightings(self, n: int = 1, *, within_s: float = 240.0) -> int:
        """Wait for `n` further sightings; return how many there are."""
        begun = self.sightings()
        try:
            wait_for(lambda: self.sightings() >= begun + n, within_s=within_s, what=f"{n} sightings", every_s=0.5)
        except AssertionError:
            print(self.ask("/v1/status"), self.journal("-n", "30"), sep="\n")  # noqa: T201 - why there was none
            raise
        return self.sightings()

    def sightings(self) -> int:
        return int(self.sql("SELECT count(*) FROM sun_point") or 0)

    def sql(self, statement: str) -> str:
        database = "file:/var/lib/sunarc/sunarc.sqlite?mode=ro"
        answer = self.call("sqlite3", "-cmd", ".timeout 20000", database, statement)
        return answer.stdout.strip()

    def remember(self, *, days: int, a_day: int = 600) -> None:
        """Give the archive the sightings of former days, as the imager saw them."""
        wait_for(lambda: self.sql("SELECT count(*) FROM camera") == "1", within_s=_UP_WITHIN_S, what="the camera")
        self.do("systemctl", "stop", "sunarc")
        self.write("/srv/past.py", Path(__file__).with_name("past.py").read_text())
        self.do(*AS_SUNARC, "python3", "-I", "/srv/past.py", str(days), str(a_day), timeout_s=900.0)
        self.do("systemctl", "start", "sunarc")
        self.wait_until_ready()

    def main_pid(self) -> int:
        return int(self.do("systemctl", "show", "-P", "MainPID", "sunarc"))

    def journal(self, *options: str) -> str:
        return self.do("journalctl", "-u", "sunarc", "-o", "cat", "--no-pager", *options)

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
    made.image()
    made.machine.boot()
    made.wait_until_ready()
    return made
