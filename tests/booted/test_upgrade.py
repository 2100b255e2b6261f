"""From one version to the next with a year of data, and back."""

from __future__ import annotations

import resource
import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from .conftest import AS_SUNARC
from .machine import wait_for

if TYPE_CHECKING:
    from .conftest import Field

pytestmark = [pytest.mark.booted, pytest.mark.timeout(1800)]

DAYS, A_DAY = 365, 1000
SUNARC = (*AS_SUNARC, "sunarc")
DPKG = ("dpkg", "--force-confold", "--force-unsafe-io")  # as deploy/install has it; settings were changed by hand
# The former version stands aside; new files lie beside the old ones; they take their places; the package is set up.
MOMENTS = (
    "test -d /usr/lib/sunarc/before",
    "test -e /usr/lib/sunarc/site/scipy/__init__.py.dpkg-new",
    "test -e /usr/share/doc/sunarc/usb3.conf.dpkg-new -a ! -e /usr/bin/sunarc.dpkg-new",
    "test ! -d /usr/lib/sunarc/before",
)


def lay(field: Field, package: Path) -> None:
    """Install a package over what is there, as deploy/install does."""
    shutil.copy(package, field.path("/srv/sunarc.deb"))
    dpkg = [part for name in ("confold", "unsafe-io") for part in ("-o", f"Dpkg::Options::=--force-{name}")]
    options = ("--yes", "--allow-downgrades", "--reinstall", *dpkg)
    field.do("apt-get", "install", *options, "/srv/sunarc.deb", timeout_s=600.0)


def install(field: Field, package: Path) -> float:
    """Install a package over what is there, wait until the service is ready; return the processor seconds of both."""
    begun, used = time.monotonic(), children_processor_s()
    lay(field, package)
    installed = time.monotonic()
    used = children_processor_s() - used
    field.wait_until_ready()
    started = field.processor_s()
    print(f"{installed - begun:.0f} s to install, {time.monotonic() - installed:.0f} s to be ready")  # noqa: T201 - a figure
    print(f"of processor: {used:.1f} s and {started:.1f} s")  # noqa: T201 - same
    return used + started


def take_back(field: Field, package: Path, revision: str) -> None:
    """Go back to a former package and its revision of the database, as docs/operating/alerts.md says."""
    field.do("systemctl", "stop", "sunarc")
    field.do(*SUNARC, "db", "downgrade", "--to", revision, "--state", "/var/lib/sunarc")
    install(field, package)


def children_processor_s() -> float:
    """Return the processor time of all processes that this one started and that have ended, seconds."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_a_year_of_data_is_upgraded_in_a_minute_of_processor_and_can_go_back(
    former_computer: Field, work: Path
) -> None:
    field = former_computer
    field.remember(days=DAYS, a_day=A_DAY)
    revision, n = field.sql("SELECT version_num FROM alembic_version"), field.sightings()
    assert n > DAYS * A_DAY * 0.9

    processor_s = install(field, work / "sunarc.deb")
    assert field.sql("SELECT version_num FROM alembic_version") > revision
    assert field.sightings() >= n
    assert field.path(f"/var/lib/sunarc/sunarc.sqlite.before-{revision}").exists()
    n = field.wait_for_sightings(2)

    take_back(field, work / "previous.deb", revision)
    assert field.sql("SELECT version_num FROM alembic_version") == revision
    assert field.sightings() >= n
    field.wait_for_sightings(1)
    assert processor_s < 60.0


@pytest.mark.smoke
def test_a_machine_is_upgraded_killed_taken_back_and_purged_and_loses_nothing(
    former_computer: Field, work: Path
) -> None:
    """Of each once, on one machine that has no network: what tests/run does where a machine is kept."""
    field = former_computer
    n, revision = field.wait_for_sightings(2), field.sql("SELECT version_num FROM alembic_version")

    install(field, work / "sunarc.deb")
    assert field.sql("SELECT version_num FROM alembic_version") >= revision
    upgraded = field.wait_for_sightings(1)
    assert upgraded > n

    restarts = field.restarts()
    field.do("systemctl", "kill", "-s", "KILL", "--kill-whom=main", "sunarc")
    wait_for(lambda: field.restarts() > restarts, within_s=60.0, what="the restart")
    field.wait_until_ready()
    assert field.sql("PRAGMA integrity_check") == "ok"
    restarted = field.wait_for_sightings(1)
    assert restarted > upgraded

    take_back(field, work / "previous.deb", revision)
    taken_back = field.wait_for_sightings(1)
    assert taken_back > restarted

    field.do("apt-get", "purge", "--yes", "sunarc")
    assert not field.path("/usr/lib/sunarc").exists()
    lay(field, work / "sunarc.deb")  # as on a new computer, beside the measurements of the one before
    field.configure(binning=None)
    field.wait_until_ready()
    assert field.wait_for_sightings(1) > taken_back


def test_an_older_version_on_a_newer_database_says_what_to_do_and_touches_nothing(field_computer: Field) -> None:
    field = field_computer
    n = field.wait_for_sightings(2)
    known = set_revision(field, "9999")
    field.call("systemctl", "start", "--no-block", "sunarc")
    wait_for(lambda: "revision 9999" in field.journal(), within_s=60.0, what="the reason", every_s=0.5)
    assert not field.active()
    assert field.sightings() >= n
    set_revision(field, known)
    field.do("systemctl", "reset-failed", "sunarc")
    field.do("systemctl", "start", "sunarc")
    field.wait_until_ready()
    field.wait_for_sightings(n)


def set_revision(field: Field, revision: str) -> str:
    """Give the database of the stopped service another revision; return what it had."""
    field.do("systemctl", "stop", "sunarc")
    known = field.sql("SELECT version_num FROM alembic_version").strip()
    update = f"UPDATE alembic_version SET version_num = '{revision}'"
    field.do(*AS_SUNARC, "sqlite3", "/var/lib/sunarc/sunarc.sqlite", update)
    return known


def test_the_power_cut_in_the_middle_of_an_upgrade_leaves_a_version_that_works(
    former_computer: Field, work: Path
) -> None:
    field = former_computer
    field.wait_for_sightings(1)
    shutil.copy(work / "sunarc.deb", field.path("/srv/sunarc.deb"))
    for reached in MOMENTS:
        n = field.sightings()
        field.do("systemd-run", "--unit=upgrade", *DPKG, "--install", "/srv/sunarc.deb")
        field.do("timeout", "600", "sh", "-c", f"until {reached}; do sleep 0.05; done", timeout_s=610.0)
        field.machine.cut()
        field.machine.boot()
        field.wait_until_ready()
        assert field.sightings() >= n
        assert field.sql("PRAGMA integrity_check") == "ok"
    field.do(*DPKG, "--configure", "-a")
    install(field, work / "sunarc.deb")
    assert not field.path("/usr/lib/sunarc/before").exists()
    assert field.do("dpkg-query", "-W", "-f", "${db:Status-Status}", "sunarc") == "installed"
    verified = field.call("dpkg", "--verify", "sunarc").stdout.splitlines()
    assert [line for line in verified if not line.endswith("/etc/sunarc/sunarc.toml")] == []
    field.wait_for_sightings(1)
