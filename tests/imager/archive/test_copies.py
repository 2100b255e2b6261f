"""Copies of the database, and the way back to them."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from sunarc.common.errors import InputError, OutsideError
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.backup import backup, backup_into, restore
from sunarc.imager.archive.database.schema import check, downgrade, head_revision, upgrade
from sunarc.imager.archive.values import Event

NOW = datetime(2026, 5, 1, 2, 0, tzinfo=UTC)
HOLDER = """
import sqlite3, sys
connection = sqlite3.connect(sys.argv[1])
connection.execute("PRAGMA journal_mode=WAL"); connection.execute("SELECT * FROM event").fetchall()
print("open", flush=True); sys.stdin.read()
"""


def remember(archive: Archive, text: str) -> None:
    archive.events.add(Event(time=NOW, kind="note", severity="info", text=text, camera="roof"))


def texts(path: Path) -> set[str]:
    archive = open_archive(path)
    found = {event.text for event in archive.events.find("roof")}
    archive.close()
    return found


@contextmanager
def held_open(path: Path) -> Iterator[None]:
    """Another process has the database open, idle."""
    with subprocess.Popen([sys.executable, "-c", HOLDER, path], stdin=-1, stdout=-1, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "open\n"
        yield


def test_a_restored_copy_is_what_it_was_and_the_former_database_is_kept(archive: Archive, path: Path) -> None:
    remember(archive, "before")
    copy = backup(path, path.with_name("copy.sqlite"))
    remember(archive, "after")
    archive.close()
    kept = restore(path, copy, now=NOW)
    assert texts(path) == {"before"}
    assert kept is not None
    assert texts(kept) == {"before", "after"}
    assert check(path).sound


def test_a_database_in_use_is_not_replaced(archive: Archive, path: Path) -> None:
    copy = backup(path, path.with_name("copy.sqlite"))
    remember(archive, "after")
    archive.close()
    with held_open(path), pytest.raises(InputError, match="systemctl stop"):
        restore(path, copy, now=NOW)
    assert texts(path) == {"after"}


def test_a_database_that_was_never_made_is_restored_too(archive: Archive, path: Path, tmp_path: Path) -> None:
    remember(archive, "before")
    target = tmp_path / "other" / "sunarc.sqlite"
    target.parent.mkdir()
    assert restore(target, path, now=NOW) is None
    assert texts(target) == {"before"}


@pytest.mark.parametrize("content", [b"", b"SQLite format 3\0 and then nothing", b"time_utc,x_px,y_px\n"])
def test_what_is_no_archive_is_not_restored(archive: Archive, path: Path, content: bytes) -> None:
    remember(archive, "mine")
    archive.close()
    false = path.with_name("false.sqlite")
    false.write_bytes(content)
    with pytest.raises(InputError, check=lambda error: error.field == "source"):
        restore(path, false, now=NOW)
    assert texts(path) == {"mine"}


def test_a_folder_keeps_the_newest_copies_and_nothing_else_is_removed(
    archive: Archive, path: Path, tmp_path: Path
) -> None:
    remember(archive, "here")
    folder = tmp_path / "backups"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    for day in range(4):
        newest = backup_into(path, folder, keep=2, now=NOW + timedelta(days=day))
    assert sorted(file.name for file in folder.iterdir()) == [
        "notes.txt",
        "sunarc-20260503T020000Z.sqlite",
        "sunarc-20260504T020000Z.sqlite",
    ]
    assert texts(newest) == {"here"}
    with pytest.raises(InputError, match="--keep"):
        backup_into(path, folder, keep=0, now=NOW)


def test_the_remains_of_an_interrupted_copy_do_not_stand_in_the_way(archive: Archive, path: Path) -> None:
    remember(archive, "here")
    target = path.with_name("copy.sqlite")
    target.with_name("copy.sqlite.partial").write_bytes(b"half a file")
    assert texts(backup(path, target)) == {"here"}
    assert not target.with_name("copy.sqlite.partial").exists()


def test_a_copy_to_a_place_that_is_not_there_is_told_in_a_line(archive: Archive, path: Path) -> None:
    assert archive.cameras.all()
    with pytest.raises(OutsideError, match="cannot copy"):
        backup(path, path.parent / "missing" / "copy.sqlite")


def test_an_older_revision_keeps_every_sighting_and_can_be_upgraded_again(archive: Archive, path: Path) -> None:
    remember(archive, "kept")
    archive.close()
    copy = downgrade(path, "0001")
    assert copy.name == f"sunarc.sqlite.at-{head_revision()}"
    assert check(path).revision == "0001"
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT text FROM event").fetchall() == [("kept",)]
    upgrade(path)
    assert texts(path) == {"kept"}
    assert check(path).sound


@pytest.mark.parametrize("revision", ["9999", "", "base"])
def test_a_revision_that_is_not_older_is_refused_with_those_that_are(
    archive: Archive, path: Path, revision: str
) -> None:
    archive.close()
    with pytest.raises(InputError, match="0001"):
        downgrade(path, revision)
    assert check(path).sound


def test_an_upgrade_that_a_power_cut_ended_after_its_copy_is_made_again(archive: Archive, path: Path) -> None:
    remember(archive, "kept")
    archive.close()
    downgrade(path, "0001")
    path.with_name("sunarc.sqlite.before-0001").write_bytes(b"the copy of the first attempt")
    copy = upgrade(path)
    assert copy == path.with_name("sunarc.sqlite.before-0001")
    assert check(path).sound
    assert check(copy).revision == "0001"
