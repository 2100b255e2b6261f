"""A machine with nights, a broker and a hub enabled: it works with them, and measures without them."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.fixtures.archive import make_empty

from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.imager.runtime.status import worker_code

from .conditions import findings, wait_for_reason
from .machine import IMAGER_ADDRESS, wait_for

if TYPE_CHECKING:
    from .conftest import Field

pytestmark = [pytest.mark.booted, pytest.mark.timeout(900)]

HUB_PORT = 8090
BROKER_LOST = worker_code("push_failing", "mqtt")
SETTINGS = f"""
[night]
enabled = true
[push]
mqtt = "mqtt://{IMAGER_ADDRESS}"
[hub]
url = "http://{IMAGER_ADDRESS}:{HUB_PORT}"
token_file = "/etc/sunarc/hub-token"
"""


@contextmanager
def at_the_other_end(field: Field, log: Path, *command: str) -> Iterator[None]:
    """Run a program of this host at the other end of the machine's cable, and kill it."""
    with log.open("ab") as output:
        begun = ["ip", "netns", "exec", field.imager_network, *command]
        environment = {name: value for name, value in os.environ.items() if not name.startswith("SUNARC_")}
        process = subprocess.Popen(begun, stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=environment)
        try:
            yield
        finally:
            process.kill()
            process.wait()


def hub_command(state: Path, *, token: str) -> list[str]:
    """Make a hub that knows a token of the camera, and return the command that runs it."""
    make_empty(state / "sunarc.sqlite")
    now = datetime.now(UTC)
    with open_hub_archive(state / "sunarc.sqlite") as archive:
        archive.feeds.add_token("roof", token_digest(token), now=now, former_until=now)
    config = state / "hub.toml"
    config.write_text(f'state = "{state}"\n[api]\nhost = "{IMAGER_ADDRESS}"\nport = {HUB_PORT}\n')
    return [sys.executable, "-m", "sunarc", "serve", "--role", "hub", "--config", str(config)]


def broker_command(folder: Path) -> list[str]:
    config = folder / "mosquitto.conf"
    config.write_text(f"listener 1883 {IMAGER_ADDRESS}\nuser root\npersistence false\nallow_anonymous true\n")
    return [shutil.which("mosquitto") or "/usr/sbin/mosquitto", "-v", "-c", str(config)]


def fed_rows(state: Path) -> int:
    with closing(sqlite3.connect(f"file:{state / 'sunarc.sqlite'}?mode=ro", uri=True, timeout=20.0)) as hub:
        return int(hub.execute("SELECT count(*) FROM sun_point WHERE camera = 'roof'").fetchone()[0])


def test_nights_a_broker_and_a_hub_are_served_and_their_end_costs_no_sighting(
    field_computer: Field, tmp_path: Path
) -> None:
    field, broker_log, first, second = field_computer, tmp_path / "broker.log", tmp_path / "first", tmp_path / "second"
    token, another = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
    with ExitStack() as beside:
        beside.enter_context(at_the_other_end(field, broker_log, *broker_command(tmp_path)))
        beside.enter_context(at_the_other_end(field, tmp_path / "hub.log", *hub_command(first, token=token)))
        field.write("/etc/sunarc/hub-token", token)
        field.configure(more=SETTINGS)
        field.do("systemctl", "restart", "sunarc")
        field.wait_until_ready()
        field.wait_for_sightings(2)
        wait_for(lambda: "Received PUBLISH" in broker_log.read_text(), within_s=60.0, what="a message at the broker")
        wait_for(lambda: fed_rows(first) > 0, within_s=60.0, what="a sighting at the hub", every_s=1.0)
        checked = json.loads(field.do("sunarc", "check", "--config", "/etc/sunarc/sunarc.toml", "--json"))
        outcomes = {check["what"]: check["outcome"] for check in checked}
        assert "fail" not in outcomes.values(), checked
        assert [outcomes[part] for part in ("night", "hub", "mqtt", "database")] == ["ok"] * 4, checked
        assert (
            findings(field)
            .keys()
            .isdisjoint({"push_failing_mqtt", "push_unusable_mqtt", "hub_unreachable", "hub_refuses"})
        )
    restarts = field.restarts()
    wait_for_reason(field, BROKER_LOST)
    field.wait_for_sightings(2)
    # a hub is missed for a quarter of an hour before that is a condition; one that has lost its cameras says so at once
    with at_the_other_end(field, tmp_path / "hub.log", *hub_command(second, token=another)):
        wait_for_reason(field, "hub_refuses")
        field.wait_for_sightings(2)
    assert field.restarts() == restarts
    assert fed_rows(second) == 0
