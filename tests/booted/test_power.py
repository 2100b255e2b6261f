"""The power taken away, all processes at once, in the middle of each thing that writes."""

from __future__ import annotations

import random
import time
from typing import TYPE_CHECKING

import pytest

from .conftest import AS_SUNARC
from .machine import wait_for

if TYPE_CHECKING:
    from .conftest import Field

pytestmark = [pytest.mark.booted, pytest.mark.timeout(1800)]

SUNARC = (*AS_SUNARC, "sunarc")
STATE = ("--state", "/var/lib/sunarc")


def survive(field: Field, *, stored: int) -> None:
    """Cut the power, boot, and find the service ready with all that was stored."""
    field.machine.cut()
    field.machine.boot()
    field.wait_until_ready()
    assert int(field.sql(f"SELECT count(*) FROM sun_point WHERE id <= {stored}")) == stored
    assert field.sql("PRAGMA integrity_check") == "ok"


def stored(field: Field) -> int:
    return int(field.sql("SELECT max(id) FROM sun_point"))


def test_ten_cuts_during_capture(field_computer: Field) -> None:
    field, moments = field_computer, random.Random(1)
    for _ in range(10):
        field.wait_for_sightings(1)
        time.sleep(moments.uniform(0.0, 3.0))
        survive(field, stored=stored(field))
    field.wait_for_sightings(1)


def test_four_cuts_during_a_refit(field_computer: Field) -> None:
    field, moments = field_computer, random.Random(2)
    field.remember(days=3)

    def states() -> list[str]:
        return field.sql("SELECT state FROM refit").split()

    for _ in range(4):
        assert field.ask("/v1/refits", method="POST") is not None
        wait_for(lambda: "running" in states(), within_s=60.0, what="the refit to run", every_s=0.05)
        time.sleep(moments.uniform(0.0, 3.0))
        survive(field, stored=stored(field))
        wait_for(lambda: not {"requested", "running"} & set(states()), within_s=300.0, what="the refit's end")
    field.ask("/v1/refits", method="POST")
    wait_for(lambda: not {"requested", "running"} & set(states()), within_s=300.0, what="the refit's end")
    assert field.sql("SELECT state FROM refit ORDER BY requested_at DESC LIMIT 1") in {
        "accepted",
        "marginal",
        "refused",
    }


def test_three_cuts_during_a_migration(field_computer: Field) -> None:
    field, moments = field_computer, random.Random(3)
    field.remember(days=30)
    head = field.sql("SELECT version_num FROM alembic_version")
    for _ in range(3):
        kept = stored(field)
        field.do("systemctl", "stop", "sunarc")
        field.do(*SUNARC, "db", "downgrade", "--to", "0001", *STATE)
        field.call("sh", "-c", "rm -f /var/lib/sunarc/*.before-0001*")
        field.do("systemctl", "start", "--no-block", "sunarc")
        field.call("timeout", "30", "sh", "-c", "until ls /var/lib/sunarc/*.before-0001* >/dev/null 2>&1; do :; done")
        time.sleep(moments.uniform(0.0, 0.05))
        survive(field, stored=kept)
        assert field.sql("SELECT version_num FROM alembic_version") == head
    field.wait_for_sightings(1)


def test_three_cuts_during_a_backup(field_computer: Field) -> None:
    field, moments = field_computer, random.Random(4)
    field.remember(days=30)
    for _ in range(3):
        field.do("systemctl", "start", "--no-block", "sunarc-backup.service")
        time.sleep(moments.uniform(0.5, 6.0))
        survive(field, stored=stored(field))
    field.do("systemctl", "start", "sunarc-backup.service")
    copies = [path for path in field.path("/var/lib/sunarc/backups").iterdir() if path.suffix == ".sqlite"]
    assert copies
    for copy in copies:
        name = f"/var/lib/sunarc/backups/{copy.name}"
        assert field.do("sqlite3", name, "PRAGMA integrity_check").strip() == "ok"
    field.do("systemctl", "stop", "sunarc")
    newest = max(copies, key=lambda path: path.name)
    field.do(*SUNARC, "db", "restore", f"/var/lib/sunarc/backups/{newest.name}", *STATE)
    field.do("systemctl", "start", "sunarc")
    field.wait_until_ready()
    field.wait_for_sightings(1)
