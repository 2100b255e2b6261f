"""A process that follows a folder and is killed at any moment forgets no file, and stores none twice."""

from __future__ import annotations

import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from tests.imager.live.test_folder import allsky, shot

MORNING = datetime(2025, 5, 13, 15, 0, tzinfo=UTC)
N = 14
FOLLOW = """
import sys
from datetime import datetime
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from tests.imager.live.followed import Followed
followed = Followed(Path(sys.argv[2]), datetime.fromisoformat(sys.argv[3]))
while True:
    followed.turn()
"""

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


def rows(base: Path, what: str) -> list[tuple[object, ...]]:
    with suppress(sqlite3.OperationalError), closing(sqlite3.connect(base / "state" / "sunarc.sqlite")) as connection:
        return connection.execute(what).fetchall()
    return [(0,)]


def test_a_process_that_is_killed_forgets_no_file_and_stores_none_twice(
    tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    times = [MORNING - timedelta(minutes=n) for n in range(N)]
    for moment in times:
        path = tmp_path / "images" / allsky(moment)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(shot(moment))
    command = [sys.executable, "-c", FOLLOW, str(pytestconfig.rootpath), str(tmp_path), MORNING.isoformat()]
    seen = []
    for least in (2, 6, N):
        with subprocess.Popen(command) as process:
            for _ in range(4000):
                ((n,),) = rows(tmp_path, "SELECT count(*) FROM seen_file")
                if isinstance(n, int) and n >= least:
                    break
                time.sleep(0.02)  # noqa: TID251 - a real process
            process.send_signal(signal.SIGKILL)
        seen.append(rows(tmp_path, "SELECT count(*) FROM seen_file")[0][0])
    assert 2 <= int(str(seen[0])) < N, "the first one was killed too late to tell anything"
    assert seen[-1] == N
    stored = rows(tmp_path, "SELECT time FROM sun_point ORDER BY time")
    assert [row[0] for row in stored] == sorted(round(1e6 * one.timestamp()) for one in times)
