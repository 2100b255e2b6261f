"""A camera that repeats its images, a second service, and a database that is deleted, emptied or damaged."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest

from .conditions import wait_for_reason, wait_until_gone
from .conftest import AS_SUNARC, SLOT_S
from .machine import wait_for

if TYPE_CHECKING:
    from .conftest import Field

pytestmark = [pytest.mark.booted, pytest.mark.timeout(1200)]

DATABASE = "/var/lib/sunarc/sunarc.sqlite"
FROZEN_SLOTS = 10
FLIP = """
import sqlite3, sys
with sqlite3.connect("/var/lib/sunarc/sunarc.sqlite", timeout=20.0) as connection:
    name, document = connection.execute("SELECT id, document FROM calibration WHERE state = 'current'").fetchone()
    flipped = bytearray(document, "utf-8")
    flipped[len(flipped) // 2] ^= 1
    connection.execute("UPDATE calibration SET document = ? WHERE id = ?", (flipped.decode(), name))
"""


def test_a_camera_that_repeats_its_images_is_reported_and_none_of_them_is_a_sighting(field_computer: Field) -> None:
    field = field_computer
    field.wait_for_sightings(3)
    pid = field.main_pid()
    field.order("REPEAT_FRAME", 1)
    wait_for_reason(field, "camera_frozen")
    before, first = field.accepted(), field.sightings()
    time.sleep(FROZEN_SLOTS * SLOT_S)
    assert field.accepted() == before
    assert field.sightings() > first
    assert "camera_frozen" in {reason["code"] for reason in field.ask("/readyz")["reasons"]}
    field.order("REPEAT_FRAME", 0)
    wait_until_gone(field, "camera_frozen")
    field.wait_for_sightings(2)
    assert field.main_pid() == pid


def test_a_second_service_on_the_same_state_is_refused_with_the_id_of_the_first(field_computer: Field) -> None:
    field = field_computer
    pid = field.main_pid()
    second = field.call(*AS_SUNARC, "sunarc", "serve", "--config", "/etc/sunarc/sunarc.toml")
    assert second.returncode == 3
    assert str(pid) in second.stderr
    field.wait_for_sightings(1)
    assert field.main_pid() == pid


def test_a_database_deleted_under_the_service_is_written_back(field_computer: Field) -> None:
    field = field_computer
    field.wait_for_sightings(3)
    pid, newest = field.main_pid(), int(field.sql("SELECT max(id) FROM sun_point"))
    field.do("sh", "-c", f"rm {DATABASE}*")
    wait_for_reason(field, "database_written_back")
    field.wait_for_sightings(2)
    assert int(field.sql(f"SELECT count(*) FROM sun_point WHERE id <= {newest}")) == newest
    assert field.sql("PRAGMA integrity_check") == "ok"
    assert field.sql("SELECT count(*) FROM event WHERE kind = 'database_written_back'") == "1"
    assert field.main_pid() == pid


@pytest.mark.parametrize("lost", [f"truncate --size=0 {DATABASE}", f"rm {DATABASE}"])
def test_a_lost_database_is_restored_from_its_copy_at_the_start(field_computer: Field, lost: str) -> None:
    field = field_computer
    field.wait_for_sightings(3)
    copied = field.sightings()
    field.do("systemctl", "start", "sunarc-backup.service")
    field.do("systemctl", "stop", "sunarc")
    field.do("sh", "-c", f"{lost} && rm -f {DATABASE}-wal {DATABASE}-shm")
    field.do("systemctl", "start", "sunarc")
    field.wait_until_ready()
    wait_for_reason(field, "database_restored")
    assert field.sightings() >= copied
    field.wait_for_sightings(2)
    assert field.do("stat", "-c", "%U %a", DATABASE).strip() == "sunarc 640"
    assert field.restarts() == 0


def test_a_calibration_with_a_flipped_bit_is_reported_not_served_and_replaced(field_computer: Field) -> None:
    field = field_computer
    field.remember(days=2, a_day=200)
    first = refitted(field)
    field.remember(days=12, a_day=600)
    second = refitted(field)
    assert second != first
    field.do(*AS_SUNARC, "python3", "-c", FLIP)
    field.do("systemctl", "kill", "-s", "KILL", "--kill-whom=main", "sunarc")
    wait_for(lambda: field.restarts() == 1, within_s=60.0, what="the restart")
    field.wait_until_ready()
    assert field.ask("/v1/calibration")["id"] != second
    wait_for(
        lambda: field.ask("/v1/calibration")["id"] not in {first, second}, within_s=300.0, what="the refit asked for"
    )
    assert "calibration_damaged" in field.sql("SELECT kind FROM event")
    field.wait_for_sightings(2)
    assert field.restarts() == 1
    wait_until_gone(field, "calibration_damaged")
    field.compare_with_truth()


def test_a_flipped_bit_in_the_kernels_is_found_by_the_package_s_sums(field_computer: Field) -> None:
    field = field_computer
    assert "_kernels" not in field.call("dpkg", "--verify", "sunarc").stdout
    (module,) = field.path("/usr/lib/sunarc/site/sunarc").glob("_kernels*.so")
    raw = bytearray(module.read_bytes())
    raw[len(raw) // 2] ^= 1
    module.unlink()  # the service that runs has the former file mapped
    module.write_bytes(raw)
    assert module.name in field.call("dpkg", "--verify", "sunarc").stdout
    field.wait_for_sightings(2)
    field.call("systemctl", "restart", "sunarc")
    wait_for(
        lambda: field.call("systemctl", "is-failed", "sunarc").stdout.strip() == "failed",
        within_s=120.0,
        what="the end",
    )
    assert f"{module.name} is damaged; dpkg --verify sunarc" in field.journal()
    by_unit = ("journalctl", "-u", "sunarc-failed", "-o", "cat", "--no-pager", "-p", "crit")
    wait_for(lambda: module.name in field.do(*by_unit), within_s=60.0, what="the list of damaged files")
    raw[len(raw) // 2] ^= 1
    module.write_bytes(raw)
    field.do("systemctl", "reset-failed", "sunarc")
    field.do("systemctl", "start", "sunarc")
    field.wait_until_ready()


def refitted(field: Field) -> str:
    """Ask for a refit, wait for its end, and return the id of the calibration that is served."""
    assert field.ask("/v1/refits", method="POST") is not None

    def ended() -> bool:
        return not {"requested", "running"} & set(field.sql("SELECT state FROM refit").split())

    wait_for(ended, within_s=300.0, what="the refit's end", every_s=0.5)
    return str(field.ask("/v1/calibration")["id"])
