"""The service killed in mid-day, stopped in an orderly way, and started where it cannot run."""

from __future__ import annotations

import os
import signal
import socket
import sqlite3
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from tests.fixtures.ports import free_port

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

CONFIG = """\
name = "roof"
state = "{state}"
[site]
latitude = 36.604043
longitude = -97.484856
altitude = 318.0
[camera]
address = "{address}"
packet_size = 60000
packet_socket = false
timestamps = "camera"
[capture]
cadence_s = 60.0
speed = 100.0
[api]
port = {port}
"""


def wait_for_camera_port(log: Path) -> None:
    """Wait until no other test's imager is left on loopback."""

    def free() -> bool:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
            try:
                trial.bind(("127.0.0.1", 3956))
            except OSError:
                return False
            return True

    wait_for(free, within_s=60.0, log=log)


@contextmanager
def sunarc(*arguments: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    with log.open("ab") as output:
        process = subprocess.Popen([sys.executable, "-m", "sunarc", *arguments], stdout=output, stderr=output)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def wait_for(
    reached: Callable[[], bool], *, within_s: float, log: Path, progress: Callable[[], int] = lambda: 0
) -> None:
    """Wait as long as there is progress, and without any for so many seconds: a loaded host is slow, not wrong."""
    end, seen = time.monotonic() + within_s, progress()  # noqa: TID251 - real processes are waited for
    while not reached():
        if (newest := progress()) != seen:
            end, seen = time.monotonic() + within_s, newest  # noqa: TID251
        assert time.monotonic() < end, log.read_text()[-3000:]  # noqa: TID251
        time.sleep(0.2)  # noqa: TID251


def sightings(database: Path) -> list[tuple[int, float]]:
    if not database.exists():
        return []
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection:
        if not connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'sun_point'").fetchall():
            return []  # the file is there before its tables are
        return connection.execute("SELECT time, exposure_us FROM sun_point ORDER BY time, exposure_us").fetchall()


def answers(port: int) -> bool:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=1.0) as response:
            return bool(response.status == 200)
    except OSError:
        return False


@pytest.mark.gige
@pytest.mark.slow
def test_kill_9_in_mid_day_loses_and_doubles_nothing_and_sigterm_ends_within_5_s(tmp_path: Path) -> None:
    port, address, log = free_port(), "127.0.0.1", tmp_path / "log"
    log.touch()
    wait_for_camera_port(log)
    database = tmp_path / "state" / "sunarc.sqlite"
    config = tmp_path / "sunarc.toml"
    config.write_text(CONFIG.format(state=tmp_path / "state", address=address, port=port))
    truth = tmp_path / "truth.json"

    def stored() -> int:
        return len(sightings(database))

    imager = ("--address", address, "--start", "2013-05-13T16:00:00Z", "--speed", "100", "--truth", str(truth))
    with sunarc("simulate", *imager, log=log):
        wait_for(truth.exists, within_s=60.0, log=log)
        with sunarc("serve", "--config", str(config), log=log) as service:
            wait_for(lambda: stored() >= 10, within_s=90.0, log=log, progress=stored)
            service.kill()
        before = sightings(database)
        with sunarc("serve", "--config", str(config), log=log) as service:
            wait_for(lambda: stored() >= len(before) + 10, within_s=90.0, log=log, progress=stored)
            service.terminate()
            assert service.wait(timeout=5.0) == 0
    after = sightings(database)
    assert after[: len(before)] == before
    assert len(set(after)) == len(after)
    with closing(sqlite3.connect(database)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert connection.execute("SELECT count(*) FROM pose_epoch").fetchone() == (1,)


def run_serve(config: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "sunarc", "serve", "--config", str(config)]
    given = {**os.environ, **environment}
    return subprocess.run(command, env=given, capture_output=True, text=True, timeout=60.0, check=False)


def test_a_port_that_is_taken_is_one_line_and_exit_3(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        config = tmp_path / "sunarc.toml"
        config.write_text(CONFIG.format(state=tmp_path / "state", address="127.0.0.99", port=taken.getsockname()[1]))
        done = run_serve(config)
    assert done.returncode == 3
    assert "end what uses it, or set api.port to another" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "state").exists()


def test_a_state_folder_that_cannot_be_used_is_one_line_and_exit_3(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file in the way")
    config = tmp_path / "sunarc.toml"
    config.write_text(CONFIG.format(state=tmp_path / "state", address="127.0.0.99", port=free_port()))
    done = run_serve(config)
    assert done.returncode == 3
    assert "make it writable" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.gige
def test_without_its_camera_the_service_serves_says_so_and_stops_when_told(tmp_path: Path) -> None:
    port, log = free_port(), tmp_path / "log"
    config = tmp_path / "sunarc.toml"
    config.write_text(CONFIG.format(state=tmp_path / "state", address="127.0.0.99", port=port))
    with sunarc("serve", "--config", str(config), log=log) as service:
        wait_for(lambda: answers(port), within_s=60.0, log=log)
        wait_for(lambda: "camera_lost" in readiness(port), within_s=30.0, log=log)
        os.kill(service.pid, signal.SIGHUP)  # ignored: the settings are read at the start
        wait_for(lambda: answers(port), within_s=10.0, log=log)
        assert service.poll() is None
        os.kill(service.pid, signal.SIGTERM)
        assert service.wait(timeout=5.0) == 0


def readiness(port: int) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/readyz", timeout=5.0) as response:
        return str(response.read().decode())
