"""What goes wrong around the service: it says so in a line, goes on where it can, and recovers when it is mended."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING

import pytest

from .conditions import wait_for_reason, wait_until_gone
from .machine import wait_for

if TYPE_CHECKING:
    from .conftest import Field

pytestmark = [pytest.mark.booted, pytest.mark.timeout(900)]

LOCK = """
import sqlite3, time
held = sqlite3.connect("/var/lib/sunarc/sunarc.sqlite", isolation_level=None, timeout=60)
held.execute("BEGIN EXCLUSIVE"); open("/run/locked", "w").close(); time.sleep({seconds}); held.execute("ROLLBACK")
"""


def on_small_disk(field: Field, *, size: str) -> None:
    """Give the state a file system of its own."""
    field.do("systemctl", "stop", "sunarc")
    field.do("mount", "-t", "tmpfs", "-o", f"size={size},mode=0750,uid=sunarc,gid=sunarc", "tmpfs", "/var/lib/sunarc")
    field.do("systemctl", "start", "sunarc")
    field.wait_until_ready()
    field.wait_for_sightings(2)


def test_settings_broken_by_hand_are_told_and_the_service_comes_back_when_they_are_mended(
    field_computer: Field,
) -> None:
    field = field_computer
    field.configure(more="[api]\nprot = 8080\n")
    field.call("systemctl", "restart", "sunarc")
    wait_for(lambda: not field.active(), within_s=30.0, what="the refusal")
    assert "api.prot" in field.journal()
    assert field.do("systemctl", "show", "-P", "ExecMainStatus", "sunarc").strip() == "2"
    field.configure()  # and nothing else: the path unit starts it
    field.wait_until_ready()


def test_an_absent_camera_degrades_the_service_and_a_returned_one_is_used(field_computer: Field) -> None:
    field = field_computer
    field.wait_for_sightings(1)
    field.darken()
    wait_for_reason(field, "camera_lost")
    assert field.active()
    field.image()
    wait_until_gone(field, "camera_lost")
    field.wait_for_sightings(1)


def test_a_full_disk_is_told_and_nothing_stored_is_lost(field_computer: Field) -> None:
    field = field_computer
    on_small_disk(field, size="64M")
    before = int(field.sql("SELECT max(id) FROM sun_point"))
    field.call("sh", "-c", "dd if=/dev/zero of=/var/lib/sunarc/filler bs=64k 2>/dev/null")
    wait_for_reason(field, "disk_full", "disk_low", "images_not_written", "sightings_not_stored")
    assert field.active()
    field.do("rm", "/var/lib/sunarc/filler")
    field.wait_for_sightings(2)
    assert int(field.sql(f"SELECT count(*) FROM sun_point WHERE id <= {before}")) == before
    assert field.sql("PRAGMA integrity_check") == "ok"


def test_a_disk_that_cannot_be_written_is_told_at_the_start_and_left_when_it_can(field_computer: Field) -> None:
    field = field_computer
    on_small_disk(field, size="64M")
    field.do("systemctl", "stop", "sunarc")
    field.do("mount", "-o", "remount,ro", "/var/lib/sunarc")
    field.call("systemctl", "start", "--no-block", "sunarc")
    wait_for(lambda: os.strerror(errno.EROFS) in field.journal(), within_s=60.0, what="the reason", every_s=0.5)
    assert not field.active()
    field.do("mount", "-o", "remount,rw", "/var/lib/sunarc")
    field.wait_until_ready()  # by itself: systemd tries again, and after ten times in five minutes
    field.wait_for_sightings(1)


def test_a_database_locked_by_another_is_waited_for(field_computer: Field) -> None:
    field = field_computer
    field.wait_for_sightings(1)
    before, restarts = int(field.sql("SELECT max(id) FROM sun_point")), field.restarts()
    field.do("systemd-run", "--unit=locker", "python3", "-c", LOCK.format(seconds=20))
    wait_for(lambda: field.call("test", "-e", "/run/locked").returncode == 0, within_s=20.0, what="the lock")
    assert field.ask("/healthz") is not None
    field.do("sh", "-c", "while systemctl is-active --quiet locker; do sleep 0.2; done")
    field.wait_for_sightings(2)
    assert field.active()
    assert field.restarts() == restarts
    assert int(field.sql(f"SELECT count(*) FROM sun_point WHERE id <= {before}")) == before


def test_a_service_started_on_a_locked_database_is_ready_when_the_lock_is_gone(field_computer: Field) -> None:
    field = field_computer
    field.do("systemctl", "stop", "sunarc")
    field.do("systemd-run", "--unit=locker", "python3", "-c", LOCK.format(seconds=15))
    wait_for(lambda: field.call("test", "-e", "/run/locked").returncode == 0, within_s=20.0, what="the lock")
    field.do("systemctl", "start", "--no-block", "sunarc")
    field.wait_until_ready()
    field.wait_for_sightings(1)
