"""The steps of docs/fleet.md, as they stand there: from a PostgreSQL without a database to a camera that is ready.

Roles log in without passwords here; systemd and the proxy are left out (tests/booted has the unit).
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from typing import Any, cast

import psycopg
import pytest
from tests.fixtures.feed_cases import STATUS_ROW, good_rows
from tests.fixtures.hub_process import HubProcess
from tests.fixtures.postgresql import Server, programs, running_server
from tests.imager.archive.test_calibrations import document

import sunarc
from sunarc.common.utc import to_microseconds
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.runtime.clock import SystemClock

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(300)]
ROOT = Path(__file__).parents[2]
HUB = ROOT / "deploy" / "hub"


def steps() -> list[str]:
    """Return the commands of the page's section on roles, and those that register a camera."""
    page = (ROOT / "docs" / "fleet.md").read_text()
    section = page.partition("## Roles")[2].partition("\n## ")[0]
    found = re.findall(r"^    (\S.*)$", section, re.MULTILINE)
    found += re.findall(r"^    ((?:export|sunarc hub token) .*)$", page, re.MULTILINE)
    assert [line.split()[0] for line in found] == ["sudo", "sunarc", "psql", "sunarc", "export", "sunarc"]
    return found


def script(server: Server) -> str:
    """Return the steps as a script for a server whose socket is elsewhere."""
    text = "\n".join(["set -eu", *steps()])
    text = text.replace("sudo -u postgres psql", "psql -d postgres -U test").replace(
        "/run/postgresql", str(server.folder)
    )
    return re.sub(r"^sunarc ", f"{sys.executable} -m sunarc ", text, flags=re.MULTILINE).replace(
        "deploy/hub/", f"{HUB}/"
    )


def ready_rows(folder: Path, camera: str) -> list[dict[str, Any]]:
    """Return the rows of a camera that is well now."""
    now = SystemClock().now()
    rows = [row for row in good_rows(folder, camera) if row[0] in {"camera", "pose_epoch", "sun_point", "calibration"}]
    made = document(f"{camera}-a", camera=camera, pose_epoch=f"{camera}-1", uncertainty={"sky_rms_deg": 0.02})
    digest = hashlib.sha256(json.dumps(made).encode()).hexdigest()
    changes: dict[str, dict[str, Any]] = {
        "sun_point": {"time": to_microseconds(now - timedelta(seconds=30))},
        "calibration": {"document": made, "document_sha256": digest, "state": "current"},
    }
    every = [(kind, data | changes.get(kind, {})) for kind, data in rows] + [
        ("status", STATUS_ROW | {"conditions": []})
    ]
    return [{"kind": kind, "data": data} for kind, data in every]


def test_the_steps_of_the_page_lead_to_a_camera_that_is_ready_on_two_hubs(tmp_path: Path) -> None:
    with running_server() as server, ExitStack() as stack:
        binaries = programs()
        path = f"{binaries}:{os.environ['PATH']}"
        environment = os.environ | {"PATH": path, "PGHOST": str(server.folder)}
        subprocess.run(["sh", "-c", script(server)], cwd=tmp_path, env=environment, check=True)
        token = tmp_path / "token"
        assert len(token.read_text().strip()) > 30
        hubs = []
        for name in ("first", "second"):
            (tmp_path / name).mkdir()
            hubs.append(HubProcess(tmp_path / name, server.url("sunarc", user="sunarc_feed")))
            stack.callback(hubs[-1].kill)
        (tmp_path / "imager").mkdir()
        rows = [json.dumps(row) + "\n" for row in ready_rows(tmp_path / "imager", "roof")]
        for n, hub in enumerate(hubs, 1):  # the second has the rows that follow those of the first
            hub.wait_until_it_answers()
            (tmp_path / "rows").write_text("".join(rows[: len(rows) * n // 2]))
            command = [sys.executable, str(HUB / "sender.py"), hub.url, "roof", str(token), str(tmp_path / "rows")]
            subprocess.run(command, check=True)
        for hub in hubs:
            (listed,) = cast("dict[str, Any]", hub.ask("/v1/fleet"))["cameras"]
            assert (listed["state"], listed["why"]) == ("ready", [])
            ready = cast("dict[str, Any]", hub.ask("/readyz"))
            assert ready["status"] == "ready"
            ports = {int(one["address"].rpartition(":")[2]) for one in ready["hubs"]}
            assert ports == {one.address[1] for one in hubs}
            assert {one["version"] for one in ready["hubs"]} == {sunarc.__version__}
        assert [hub.stop() for hub in hubs] == [0, 0]
        cut_off(server)


def cut_off(server: Server) -> None:
    """Kill a restore in its middle, and the server under another: nothing is left, and the next one is whole."""
    folder = server.folder / "copies"
    options = ("-h", str(server.folder), "-U", "sunarc_owner")
    name = server.carry_out(HUB / "backup", str(folder), "3", *options).strip()
    server.sql("postgres", "CREATE DATABASE again OWNER sunarc_owner TEMPLATE template0")
    server.sql("again", WAITING)
    tables = "SELECT count(*) FROM pg_tables WHERE schemaname = 'public'"
    for kill_server in (False, True):
        with psycopg.connect(host=str(server.folder), user="test", dbname="again", autocommit=True) as holding:
            holding.execute("SELECT pg_advisory_lock(1)")
            with server.begin(HUB / "restore", name, "again", *options) as restoring:
                while not server.sql("again", "SELECT 1 FROM pg_locks WHERE locktype = 'advisory' AND NOT granted"):
                    assert restoring.poll() is None
                if kill_server:
                    server.stop()
                    server.start()
                else:
                    os.killpg(restoring.pid, signal.SIGKILL)
        server.sql("again", "SELECT pg_advisory_lock(1)")  # until the restore's own session has ended
        assert server.sql("again", tables).strip() == "0"
    server.carry_out(HUB / "restore", name, "again", *options)
    with open_archive(server.url("again", user="sunarc_owner")) as again:
        assert len(again.sightings.find("roof")) == 1


WAITING = """
CREATE SCHEMA waiting;
CREATE FUNCTION waiting.here() RETURNS event_trigger LANGUAGE plpgsql
    AS 'BEGIN PERFORM pg_advisory_xact_lock(1); END';
CREATE EVENT TRIGGER waiting ON ddl_command_start WHEN TAG IN ('CREATE INDEX') EXECUTE FUNCTION waiting.here();
"""
"""Makes a restore wait where all rows are in, and no index is made yet."""
