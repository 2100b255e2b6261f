"""One state folder: a second service, and its database deleted, emptied and damaged."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import subprocess
import urllib.error
import urllib.request
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path

import pytest
from tests.fixtures.calibrations import SITE
from tests.fixtures.ports import free_port
from tests.fixtures.served import calibration

from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.backup import backup_into
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.values import CameraRecord

from .test_restart import CONFIG, answers, run_serve, sunarc, wait_for

pytestmark = [pytest.mark.system, pytest.mark.timeout(170)]
MAY = datetime(2013, 5, 13, tzinfo=UTC)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "sunarc.toml"
    path.write_text(CONFIG.format(state=tmp_path / "state", address="127.0.0.77", port=free_port()))
    return path


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """Return a database with two calibrations, the second of which is current."""
    path = tmp_path / "state" / "sunarc.sqlite"
    upgrade(path)
    archive = open_archive(path)
    archive.cameras.save(
        CameraRecord(name="roof", latitude=SITE.latitude, longitude=SITE.longitude, altitude=318.0, width=1748,
                     height=1748)
    )  # fmt: skip
    epoch = archive.epochs.at("roof", MAY, reason="installed").id
    for name in ("first", "second"):
        document = to_document(calibration(), id=name, camera="roof", state="candidate", created_at=MAY,
                               valid_from=MAY, valid_until=None, pose_epoch=epoch, software_version="1")  # fmt: skip
        archive.calibrations.add(document)
        archive.calibrations.activate(name)
    archive.close()
    return path


def port_of(config: Path) -> int:
    return int(config.read_text().rsplit("port = ", 1)[1])


def reasons(config: Path) -> dict[str, str]:
    url = f"http://127.0.0.1:{port_of(config)}/v1/status"
    with suppress(urllib.error.HTTPError), urllib.request.urlopen(url, timeout=5.0) as response:
        return {reason["code"]: reason["text"] for reason in json.load(response)["reasons"]}
    return {}  # while the database is being put back


def served(config: Path) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port_of(config)}/v1/calibration", timeout=5.0) as response:
        return str(json.load(response)["id"])


def stop(service: subprocess.Popen[bytes]) -> None:
    os.kill(service.pid, signal.SIGTERM)
    assert service.wait(timeout=10.0) == 0


def test_a_second_service_is_refused_and_a_deleted_database_is_put_back(
    config: Path, database: Path, tmp_path: Path
) -> None:
    log = tmp_path / "log"
    with sunarc("serve", "--config", str(config), log=log) as service:
        wait_for(lambda: answers(port_of(config)), within_s=60.0, log=log)
        second = tmp_path / "second.toml"
        second.write_text(config.read_text().replace(f"port = {port_of(config)}", f"port = {free_port()}"))
        for other in (second, config):
            refused = run_serve(other)
            assert (refused.returncode, refused.stderr.count("\n")) == (3, 1)
            assert f"in use by process {service.pid};" in refused.stderr
        for file in database.parent.glob("sunarc.sqlite*"):
            file.unlink()
        wait_for(lambda: "database_written_back" in reasons(config), within_s=30.0, log=log)
        assert served(config) == "second"
        stop(service)
    assert "Traceback" not in log.read_text()
    with closing(sqlite3.connect(database)) as connection:
        assert connection.execute("SELECT count(*) FROM event WHERE kind = 'database_written_back'").fetchone() == (1,)


def test_an_emptied_database_is_restored_and_a_damaged_calibration_not_served(
    config: Path, database: Path, tmp_path: Path
) -> None:
    log = tmp_path / "log"
    with closing(sqlite3.connect(database, isolation_level=None)) as connection:
        connection.execute(
            "UPDATE calibration SET document = replace(document, 'equisolid', 'equisolie') WHERE id = 'second'"
        )
    backup_into(database, database.parent / "backups", keep=7, now=MAY)
    database.write_bytes(b"")
    with sunarc("serve", "--config", str(config), log=log) as service:
        wait_for(lambda: answers(port_of(config)), within_s=60.0, log=log)
        wait_for(lambda: {"database_restored", "calibration_damaged"} <= set(reasons(config)), within_s=30.0, log=log)
        assert served(config) == "first"
        stop(service)
    assert "Traceback" not in log.read_text()


def test_a_secret_that_cannot_be_read_is_a_condition_and_the_service_serves(config: Path, tmp_path: Path) -> None:
    log, secret = tmp_path / "log", tmp_path / "secret"
    push = f'[push]\nwebhooks = ["http://127.0.0.1:9/hook"]\nwebhook_secret_file = "{secret}"\n[api]'
    config.write_text(config.read_text().replace("[api]", push))
    with sunarc("serve", "--config", str(config), log=log) as service:
        wait_for(lambda: answers(port_of(config)), within_s=60.0, log=log)
        wait_for(lambda: any(code.startswith("push_unusable_") for code in reasons(config)), within_s=30.0, log=log)
        stop(service)
    assert "Traceback" not in log.read_text()


def test_a_store_carried_to_another_site_is_one_line_and_exit_2(config: Path, database: Path) -> None:
    config.write_text(config.read_text().replace("latitude = 36.604043", "latitude = 48.1"))
    done = run_serve(config)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "set `name` to a new one" in done.stderr
    assert database.exists()
