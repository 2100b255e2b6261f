"""From one version to the next with a year of data, and back."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from .conftest import Field, Fields

pytestmark = [pytest.mark.booted, pytest.mark.timeout(1800)]

DAYS, A_DAY = 365, 1000
YEAR = f"""
import sys
sys.path.insert(0, "/usr/lib/sunarc/site")
from datetime import UTC, datetime, timedelta
from pathlib import Path
from sunarc.archive import SunPoint, open_archive
archive = open_archive(Path("/var/lib/sunarc/sunarc.sqlite"))
begin = datetime(2012, 1, 1, 12, tzinfo=UTC)
epoch = archive.epoch_at("roof", begin, reason="installed").id
for day in range({DAYS}):
    archive.add_sun_points(
        SunPoint(camera="roof", pose_epoch=epoch, time=begin + timedelta(days=day, seconds=30 * i), method="disc",
                 accepted=True, verdict="clear", reason="", x_px=500.0 + i, y_px=900.0, sigma_px=0.02)
        for i in range({A_DAY})
    )
"""
SUNARC = ("setpriv", "--reuid=sunarc", "--regid=sunarc", "--clear-groups", "sunarc")


def install(field: Field, package: Path) -> float:
    """Install a package over what is there and wait until the service is ready; return the seconds of both."""
    shutil.copy(package, field.path("/srv/sunarc.deb"))
    begun = time.monotonic()
    options = ("--yes", "--allow-downgrades", "--reinstall", "-o", "Dpkg::Options::=--force-confold")
    field.do("apt-get", "install", *options, "/srv/sunarc.deb", timeout_s=600.0)
    installed = time.monotonic()
    field.wait_until_ready(within_s=120.0)
    print(f"{installed - begun:.0f} s to install, {time.monotonic() - installed:.0f} s to be ready")  # noqa: T201 - a figure
    return time.monotonic() - begun


def test_a_year_of_data_is_upgraded_within_a_minute_and_can_go_back(
    new_field: Fields, installed_before: Path, work: Path
) -> None:
    field = new_field(installed_before)
    field.configure()
    field.image()
    field.machine.boot()
    field.wait_until_ready()
    field.wait_for_sightings(2)
    field.do("systemctl", "stop", "sunarc")
    field.do(*SUNARC[:-1], "python3", "-I", "-c", YEAR, timeout_s=600.0)
    field.do("systemctl", "start", "sunarc")
    field.wait_until_ready()
    revision, n = field.sql("SELECT version_num FROM alembic_version"), field.sightings()
    assert n > DAYS * A_DAY

    assert install(field, work / "sunarc.deb") < 60.0
    assert field.sql("SELECT version_num FROM alembic_version") > revision
    assert field.sightings() >= n
    assert field.path(f"/var/lib/sunarc/sunarc.sqlite.before-{revision}").exists()
    n = field.wait_for_sightings(2)

    field.do("systemctl", "stop", "sunarc")
    field.do(*SUNARC, "db", "downgrade", "--to", revision, "--state", "/var/lib/sunarc")
    install(field, work / "previous.deb")
    assert field.sql("SELECT version_num FROM alembic_version") == revision
    assert field.sightings() >= n
    field.wait_for_sightings(1)


def test_an_older_version_on_a_newer_database_says_what_to_do_and_touches_nothing(
    new_field: Fields, installed: Path, work: Path
) -> None:
    field = new_field(installed)
    field.configure()
    field.image()
    field.machine.boot()
    field.wait_until_ready()
    n = field.wait_for_sightings(2)
    with pytest.raises(AssertionError, match="the service to be ready"):
        install(field, work / "previous.deb")
    assert "which this version" in field.journal()
    assert "install the version that wrote it, or a newer one" in field.journal()
    assert field.sightings() >= n
    install(field, work / "sunarc.deb")
