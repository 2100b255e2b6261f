"""From the package to a service that is ready, on a Debian that has never seen it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from .conftest import AS_SUNARC
from .machine import wait_for

if TYPE_CHECKING:
    from .conftest import Field, Fields

pytestmark = [pytest.mark.booted, pytest.mark.timeout(1200)]

OWN = ("/var/lib/sunarc", "/tmp", "/var/tmp", "/dev/", "/proc/")
SCRIPT = Path(__file__).parents[2] / "deploy" / "install"
START_PROCESSOR_S = 10.0
"""Of the first start and of one after a boot, until ready: of an idle computer with 1 core, less than half a minute."""
COPIES = "ls /var/lib/sunarc/before-0.*.sqlite | wc -l"
WRITABLE = """
import os, stat
for folder, folders, files in os.walk("/"):
    if folder.startswith(("/proc", "/sys")):
        folders[:] = []
        continue
    for path in (folder, *(os.path.join(folder, name) for name in files)):
        if os.access(path, os.W_OK) and not stat.S_IFMT(os.lstat(path).st_mode) in (stat.S_IFLNK, stat.S_IFSOCK):
            print(path)
"""


LINKS = """
import os
os.chdir("/var/lib/sunarc")
for second in range(3):
    name = f"before-0-2020010{second + 1}T000000Z.sqlite"
    os.symlink("/etc/victim", name)
open("before-\\n1 victim\\n-20200101T000000Z.sqlite", "w").close()
os.symlink("/etc/victim", "contact-sheet.png.part")
"""
LOCKING = """
import fcntl, pathlib, time
with open("/var/lib/dpkg/lock-frontend", "w") as lock:
    fcntl.lockf(lock, fcntl.LOCK_EX)
    pathlib.Path("/run/locked").touch()
    time.sleep(30.0)
"""


def test_a_configured_package_is_ready_for_ten_seconds_of_processor_and_after_a_reboot(
    new_field: Fields, installed: Path
) -> None:
    field = new_field(installed)
    field.image()
    field.machine.boot()
    assert not field.active()
    assert "site.latitude" in field.journal()
    field.configure()  # nothing is restarted by hand: the path unit sees the settings written
    field.wait_until_ready()
    assert field.processor_s() < START_PROCESSOR_S
    seen = field.wait_for_sightings(3)
    field.machine.stop()
    field.machine.boot()
    field.wait_until_ready()
    assert field.processor_s() < START_PROCESSOR_S
    assert field.wait_for_sightings(1) > seen
    assert field.do("systemctl", "--failed", "--no-legend").strip() == ""


def run_script(field: Field, package: Path, *options: str) -> str:
    """Run deploy/install in the machine with a package; return what it prints."""
    shutil.copy(SCRIPT, field.path("/srv/install"))
    shutil.copy(package, field.path("/srv/sunarc.deb"))
    return field.do("/srv/install", *options, "/srv/sunarc.deb", timeout_s=900.0)


def test_the_script_installs_on_a_fresh_machine_and_once_more_over_itself(new_field: Fields, work: Path) -> None:
    field = new_field(work / "tree")
    field.configure()
    field.path("/etc/sunarc/sunarc.toml").rename(field.path("/srv/site.toml"))
    field.image()
    field.machine.boot()
    printed = run_script(field, work / "sunarc.deb", "--config", "/srv/site.toml")
    assert "install: ready: serving at" in printed
    stored = field.wait_for_sightings(2)
    pid = field.main_pid()
    field.do("sh", "-c", "cd / && echo kept >victim && echo kept >/etc/victim")
    field.do(*AS_SUNARC, "python3", "-c", LINKS)
    field.do("systemd-run", "--unit=upgrading", "python3", "-c", LOCKING)  # as unattended-upgrades does
    wait_for(lambda: field.call("test", "-e", "/run/locked").returncode == 0, within_s=60.0, what="the lock")
    printed = run_script(field, work / "sunarc.deb")
    assert "install: waiting for apt's lock" in printed
    assert "install: copying the database to /var/lib/sunarc/before-" in printed
    assert "install: ready: serving at" in printed
    assert field.main_pid() != pid
    assert field.do("sh", "-c", "cat /victim /etc/victim && stat -c %U:%a /victim /etc/victim").split() == [
        *("kept", "kept"),
        *("root:644", "root:644"),
    ]
    assert field.do("find", "/var/lib/sunarc", "-not", "-user", "sunarc") == ""
    assert field.wait_for_sightings(1) > stored


def test_the_script_upgrades_the_previous_version(former_computer: Field, work: Path) -> None:
    field = former_computer
    stored = field.wait_for_sightings(2)
    printed = run_script(field, work / "sunarc.deb")
    assert "install: ready: serving at" in printed
    assert field.do("sh", "-c", COPIES).strip() == "1"
    assert field.wait_for_sightings(1) > stored


def test_the_service_is_its_own_user_and_writes_nowhere_but_in_its_state(field_computer: Field) -> None:
    field, pid = field_computer, str(field_computer.main_pid())
    assert field.do("stat", "-c", "%U:%G", f"/proc/{pid}").strip() == "sunarc:sunarc"
    inside = ["nsenter", "-t", pid, "-m", "--", "setpriv", "--reuid=sunarc", "--regid=sunarc", "--clear-groups"]
    found = field.do(*inside, "python3", "-c", WRITABLE).split("\n")
    assert any(path.startswith("/var/lib/sunarc") for path in found)
    assert [path for path in found if path and not path.startswith(OWN)] == []
    status = field.do("cat", f"/proc/{pid}/status")
    assert "NoNewPrivs:\t1" in status
    assert "CapEff:\t0000000000000000" in status
    assert field.do("stat", "-c", "%a %U", "/etc/sunarc/token").strip() == "600 root"


def test_the_units_are_sound_and_the_services_exposure_is_small(field_computer: Field) -> None:
    field = field_computer
    names = field.do("sh", "-c", "dpkg -L sunarc | grep ^/lib/systemd/system/").split()
    assert "/lib/systemd/system/sunarc.service" in names
    verified = field.call("systemd-analyze", "verify", "--man=no", *names)
    assert (verified.returncode, verified.stdout + verified.stderr) == (0, "")
    for unit, threshold in (("sunarc.service", 14), ("sunarc-failed.service", 35), ("sunarc-backup.service", 29)):
        offline = ["systemd-analyze", "security", "--offline=true", f"--threshold={threshold}"]
        judged = field.call(*offline, f"/lib/systemd/system/{unit}")
        assert judged.returncode == 0, judged.stdout


def test_what_is_not_used_is_refused_and_what_is_used_works(field_computer: Field) -> None:
    field = field_computer
    field.wait_for_sightings(2)  # frames came by UDP
    kernel = field.do("cat", "/proc/sys/net/core/rmem_max").strip()
    assert f"net.core.rmem_max = {kernel}" in field.do("cat", "/usr/lib/sysctl.d/60-sunarc.conf")
    assert field.ask("/v1/status")["camera"]["connected"]
    assert " rwxp " not in field.do("cat", f"/proc/{field.main_pid()}/maps")


def test_a_removed_package_leaves_the_measurements_and_a_purged_one_too_unless_asked(field_computer: Field) -> None:
    field = field_computer
    field.wait_for_sightings(1)
    field.do("apt-get", "purge", "--yes", "sunarc")
    assert field.path("/var/lib/sunarc/sunarc.sqlite").stat().st_size > 0
    assert not field.path("/etc/sunarc/token").exists()
    assert not field.path("/usr/lib/sunarc").exists()
    assert field.call("systemctl", "is-active", "sunarc").stdout.strip() in {"inactive", "unknown"}


def test_the_same_commit_gives_the_same_package(work: Path) -> None:
    if not (work / "again.deb").exists():
        pytest.skip("deploy/test-booted --twice builds the package a second time")
    assert subprocess.run(["cmp", work / "sunarc.deb", work / "again.deb"], check=False).returncode == 0
