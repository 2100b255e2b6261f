"""A database that is lost or emptied, at a start and while it is in use; what is kept beside it."""

from __future__ import annotations

import os
import sqlite3
import threading
from contextlib import closing, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from tests.fixtures.stores import ROOF

from sunarc.common.errors import ConfigurationError, InputError, OutsideError
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database import recovery
from sunarc.imager.archive.database.backup import backup_into, newest_sound_copy, restore
from sunarc.imager.archive.database.recovery import prepare_database, upgrade_present
from sunarc.imager.archive.database.schema import check, downgrade, upgrade
from sunarc.imager.archive.values import Event

NOW = datetime(2026, 5, 1, 2, 0, tzinfo=UTC)


def remember(archive: Archive, text: str) -> None:
    archive.events.add(Event(time=NOW, kind="note", severity="info", text=text, camera="roof"))


def texts(path: Path) -> set[str]:
    archive = open_archive(path)
    found = {event.text for event in archive.events.find("roof")}
    archive.close()
    return found


def prepare(path: Path) -> str | None:
    done = prepare_database(path, backups=path.parent / "backups", images=path.parent / "images", now=NOW)
    return None if done is None else done.kind


def test_a_new_folder_gets_a_database_without_a_word_and_keeps_it(path: Path) -> None:
    assert [prepare(path), prepare(path)] == [None, None]
    assert check(path).sound


@pytest.mark.parametrize("how", ["deleted", "emptied"])
def test_a_lost_database_is_restored_from_the_newest_sound_copy(archive: Archive, path: Path, how: str) -> None:
    backups = path.parent / "backups"
    remember(archive, "first night")
    backup_into(path, backups, keep=7, now=NOW)
    remember(archive, "second night")
    newest = backup_into(path, backups, keep=7, now=NOW + timedelta(days=1))
    damaged = backup_into(path, backups, keep=7, now=NOW + timedelta(days=2))
    damaged.write_bytes(b"SQLite format 3\0" + bytes(1000))
    remember(archive, "lost")
    archive.close()
    path.unlink() if how == "deleted" else path.write_bytes(b"")
    done = prepare_database(path, backups=backups, images=path.parent / "images", now=NOW)
    assert done is not None
    assert done.kind == "restored"
    assert str(newest) in done.text
    assert texts(path) == {"first night", "second night"}


@pytest.mark.parametrize("how", ["emptied", "deleted"])
def test_a_lost_database_without_a_copy_is_begun_anew_and_said(archive: Archive, path: Path, how: str) -> None:
    archive.close()
    image = path.parent / "images" / "2026" / "05" / "01" / "20260501T000000.000Z_hdr.png"
    image.parent.mkdir(parents=True)
    image.touch()
    path.unlink() if how == "deleted" else path.write_bytes(b"")
    assert prepare(path) == "new"
    assert check(path).sound
    assert prepare(path) is None


def test_a_damaged_database_is_refused_with_the_command_that_restores_it(path: Path) -> None:
    path.parent.mkdir()
    path.write_text("no database\n" * 100)
    with pytest.raises(ConfigurationError, match=f"--state {path.parent}"):
        prepare(path)


def test_a_deleted_database_takes_no_more_writes_and_is_written_back_whole(archive: Archive, path: Path) -> None:
    remember(archive, "before")
    for file in path.parent.glob("sunarc.sqlite*"):
        file.unlink()
    with pytest.raises(OutsideError, match="deleted"):
        remember(archive, "into the void")
    assert not path.exists()  # nothing made a new one
    assert [camera.name for camera in archive.cameras.all()] == ["roof"]  # what is open can still be read
    done = archive.recover(now=NOW)
    assert done is not None
    assert done.kind == "written_back"
    remember(archive, "after")
    assert archive.recover(now=NOW) is None
    archive.close()
    assert texts(path) == {"before", "after"}
    assert check(path).sound


def test_a_file_that_replaces_the_database_in_use_is_kept_aside(archive: Archive, path: Path, tmp_path: Path) -> None:
    remember(archive, "ours")
    other = tmp_path / "other.sqlite"
    upgrade(other)
    other.replace(path)
    with pytest.raises(OutsideError, match="replaced"):
        remember(archive, "into the other")
    done = archive.recover(now=NOW)
    assert done is not None
    assert "kept as sunarc.sqlite.found-20260501T020000Z" in done.text
    archive.close()
    assert texts(path) == {"ours"}
    assert check(path.with_name("sunarc.sqlite.found-20260501T020000Z")).sound


@pytest.mark.parametrize("with_copy", [True, False])
def test_a_recovery_whose_migration_fails_is_done_at_the_next_look(
    archive: Archive, path: Path, monkeypatch: pytest.MonkeyPatch, *, with_copy: bool
) -> None:
    def full(_: Path) -> None:
        raise OutsideError("cannot use the database: disk is full")

    remember(archive, "night")
    if with_copy:
        backup_into(path, path.parent / "backups", keep=7, now=NOW)
    with archive.database.reading() as connection:
        connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
    os.truncate(path, 0)
    with monkeypatch.context() as patched:
        patched.setattr(recovery, "upgrade", full)
        with pytest.raises(OutsideError, match="full"):
            archive.recover(now=NOW)
    done = archive.recover(now=NOW)
    assert done is not None
    assert done.kind in ({"restored", "written_back"} if with_copy else {"new", "written_back"})
    remember(archive, "after")
    archive.close()
    assert check(path).sound
    assert not path.with_name(f"{path.name}.partial").exists()


@pytest.mark.parametrize("with_copy", [True, False])
def test_an_emptied_database_in_use_is_restored_or_begun_anew(archive: Archive, path: Path, *, with_copy: bool) -> None:
    remember(archive, "night")
    if with_copy:
        backup_into(path, path.parent / "backups", keep=7, now=NOW)
    with archive.database.reading() as connection:
        connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
    os.truncate(path, 0)
    with pytest.raises(OutsideError, match="emptied"):
        remember(archive, "into the void")
    done = archive.recover(now=NOW)
    assert done is not None
    remember(archive, "after")  # the camera that it refers to is there
    archive.close()
    assert done.kind in ({"restored", "written_back"} if with_copy else {"new", "written_back"})
    assert texts(path) >= {"after"}
    assert check(path).sound


class Writers:
    """Threads that write and read all the time, and keep what was acknowledged."""

    def __init__(self, archive: Archive) -> None:
        self.stored: list[str] = []
        self.stop = threading.Event()
        self._archive = archive
        self._threads = [threading.Thread(target=self._write, args=(number,)) for number in range(3)]
        for thread in self._threads:
            thread.start()

    def _write(self, number: int) -> None:
        turn = 0
        while not self.stop.is_set():
            turn += 1
            with suppress(OutsideError):
                remember(self._archive, f"{number}-{turn}")
                self.stored.append(f"{number}-{turn}")
                self._archive.events.find("roof", limit=5)
                self._archive.revision()
            self.stop.wait(0.01)

    def join(self) -> None:
        self.stop.set()
        for thread in self._threads:
            thread.join()


def test_many_threads_lose_nothing_that_was_acknowledged_when_the_database_is_deleted(
    archive: Archive, path: Path
) -> None:
    writers = Writers(archive)
    recovered = 0
    for _ in range(3):
        writers.stop.wait(0.1)
        path.unlink()
        for _ in range(200):
            with suppress(OutsideError):  # another thread reads: at the next look
                recovered += archive.recover(now=NOW) is not None
                break
            writers.stop.wait(0.01)
    writers.stop.wait(0.1)
    writers.join()
    archive.close()
    assert recovered == 3
    assert len(writers.stored) > 10
    assert set(writers.stored) <= texts(path)
    assert check(path).sound


@pytest.mark.parametrize("content", [b"", b"SQLite format 3\0" + bytes(5000), b"something else"])
def test_a_damaged_database_is_moved_aside_by_a_restore(archive: Archive, path: Path, content: bytes) -> None:
    remember(archive, "here")
    copy = backup_into(path, path.parent / "backups", keep=1, now=NOW)
    archive.close()
    path.write_bytes(content)
    kept = restore(path, copy, now=NOW)
    assert kept is not None
    assert kept.read_bytes() == content
    assert texts(path) == {"here"}


def test_only_the_last_copies_made_before_migrations_and_restores_are_kept(archive: Archive, path: Path) -> None:
    archive.close()
    for number in range(6, 0, -1):
        downgrade(path, f"{number:04}")
        upgrade(path)
    beside = sorted(file.name for file in path.parent.glob("sunarc.sqlite.*"))
    assert len(beside) == 3
    assert "sunarc.sqlite.before-0001" in beside
    assert {oct((path.parent / name).stat().st_mode & 0o777) for name in beside} == {"0o640"}


def test_no_copy_is_newest_where_there_is_none(tmp_path: Path) -> None:
    assert newest_sound_copy(tmp_path / "missing") is None
    (tmp_path / "sunarc-20260501T020000Z.sqlite").write_bytes(b"")
    assert newest_sound_copy(tmp_path) is None


def test_the_camera_of_a_new_database_is_the_one_that_was_saved(archive: Archive, path: Path) -> None:
    with archive.database.reading() as connection:
        connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
    os.truncate(path, 0)
    archive.recover(now=NOW)
    assert archive.cameras.all() == (ROOF,)
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_no_command_begins_anew_beside_the_copies_of_a_lost_database(archive: Archive, path: Path) -> None:
    backup_into(path, path.parent / "backups", keep=7, now=NOW)
    archive.close()
    path.write_bytes(b"")
    for state in ("empty", "missing"):
        with pytest.raises(InputError, match=rf"{state}.*--latest"):
            upgrade_present(path)
        path.unlink(missing_ok=True)
    assert not path.exists()
