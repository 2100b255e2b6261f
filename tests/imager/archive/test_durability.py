from __future__ import annotations

import subprocess
import sys
import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.schema import check
from sunarc.imager.archive.values import SunPoint

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
POINT = SunPoint(
    camera="roof", pose_epoch="roof-1", time=NOON, method="disc", accepted=True, verdict="clear", x_px=1.0, y_px=2.0
)

WRITER = """
import sys
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.values import SunPoint

archive = open_archive(Path(sys.argv[1]))
noon = datetime.fromisoformat(sys.argv[2])
point = SunPoint(camera="roof", pose_epoch="roof-1", time=noon, method="disc", accepted=False, verdict="hidden")
for i in range(1_000_000):
    archive.sightings.add(replace(point, time=noon + timedelta(seconds=2 * i + j)) for j in range(2))
    print(2 * i + 2, flush=True)
"""


@pytest.mark.system
def test_a_killed_writer_loses_nothing_that_was_committed(archive: Archive, path: Path) -> None:
    command = [sys.executable, "-c", WRITER, str(path), NOON.isoformat()]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        told = 0
        for line in writer.stdout:
            told = int(line)
            if told >= 60:
                break
        writer.kill()
        told = max([told, *(int(line) for line in writer.stdout.read().split("\n")[:-1])])
    stored = len(archive.sightings.find("roof"))
    assert stored >= told
    assert stored % 2 == 0  # a batch is there as a whole or not at all
    assert check(path).integrity == ()


def test_many_threads_write_and_read_one_archive(archive: Archive) -> None:
    failures: list[BaseException] = []

    def work(number: int) -> None:
        try:
            for i in range(20):
                point = replace(POINT, time=NOON + timedelta(seconds=100 * i + number))
                assert archive.sightings.add([point]) == 1
                assert point in archive.sightings.find("roof")
        except BaseException as error:  # noqa: BLE001 - carried to the test's own thread
            failures.append(error)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert len(archive.sightings.find("roof")) == 160


def test_a_reader_sees_the_state_before_a_writer_commits(archive: Archive, path: Path) -> None:
    other = open_archive(path)
    with archive.database.writing():
        assert other.sightings.find("roof") == ()  # WAL: a reader never waits for a writer
    other.close()


def test_an_archive_written_by_two_objects_has_both_their_rows(archive: Archive, path: Path) -> None:
    other = open_archive(path)
    other.sightings.add([POINT])
    archive.sightings.add([replace(POINT, method="paper")])
    assert len(other.sightings.find("roof")) == 2
    other.close()


def test_a_hand_edited_reference_shows_in_the_check(archive: Archive, path: Path) -> None:
    archive.sightings.add([POINT])
    with archive.database.reading() as connection:
        connection.exec_driver_sql("COMMIT")
        connection.exec_driver_sql("PRAGMA foreign_keys=OFF")
        connection.exec_driver_sql("DELETE FROM pose_epoch")
        connection.exec_driver_sql("BEGIN")
    looked = check(path)
    assert looked.integrity == ("sun_point row 1 refers to nothing",)
    assert not looked.sound
