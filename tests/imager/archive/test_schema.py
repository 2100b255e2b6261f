from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import create_engine

from sunarc.common.errors import ConfigurationError, InputError, OutsideError, SchemaError
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.backup import backup
from sunarc.imager.archive.database.schema import check, head_revision, upgrade
from sunarc.imager.archive.database.tables import metadata
from sunarc.imager.archive.values import CameraRecord


def set_revision(path: Path, revision: str) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("UPDATE alembic_version SET version_num = ?", (revision,))


def test_the_migrations_make_the_tables_of_the_models(path: Path) -> None:
    upgrade(path)
    engine = create_engine(f"sqlite:///{path}")
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, metadata) == []
    engine.dispose()


def test_migrations_are_named_after_their_revisions_which_follow_one_another(pytestconfig: pytest.Config) -> None:
    config = Config()
    config.set_main_option("script_location", str(pytestconfig.rootpath / "migrations"))
    scripts = list(ScriptDirectory.from_config(config).walk_revisions())
    assert [Path(script.path).name.split("_")[0] for script in scripts] == [script.revision for script in scripts]
    assert scripts[0].revision == head_revision()
    assert sorted(script.revision for script in scripts) == [script.revision for script in reversed(scripts)]


def test_an_upgrade_from_nothing_reaches_the_head_and_a_second_one_does_nothing(path: Path) -> None:
    assert upgrade(path) is None
    before = path.read_bytes()
    assert upgrade(path) is None
    assert path.read_bytes() == before
    looked = check(path)
    assert looked.sound
    assert looked.revision == head_revision() == "0020"
    assert set(looked.rows) == set(metadata.tables)


def test_an_existing_database_is_copied_before_it_is_migrated(path: Path) -> None:
    path.parent.mkdir()
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("CREATE TABLE mine (x)")
    copy = upgrade(path)
    assert copy is not None
    assert copy.name == "sunarc.sqlite.before-none"
    with closing(sqlite3.connect(copy)) as connection:
        assert connection.execute("SELECT name FROM sqlite_master").fetchall() == [("mine",)]


def test_a_failed_migration_leaves_the_database_as_it_was(path: Path) -> None:
    path.parent.mkdir()
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("CREATE TABLE event (x)")  # the last table that the migration makes
    with pytest.raises(OutsideError, match="event already"):
        upgrade(path)
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT name FROM sqlite_master").fetchall() == [("event",)]


def test_a_missing_database_is_refused_with_the_command_that_makes_one(path: Path) -> None:
    with pytest.raises(SchemaError, match=f"--state {path.parent}$"):
        open_archive(path)
    assert not path.exists()


def test_a_database_without_tables_is_refused_with_the_command(path: Path) -> None:
    path.parent.mkdir()
    path.touch()
    with pytest.raises(SchemaError, match=r"None.*0020.*do this"):
        open_archive(path, upgrade_command="do this")


def test_a_database_of_a_newer_version_is_refused_and_named(path: Path) -> None:
    upgrade(path)
    set_revision(path, "9999")
    with pytest.raises(SchemaError, match="9999"):
        open_archive(path)
    with pytest.raises(SchemaError, match="9999"):
        upgrade(path)  # what a start of the service does first
    assert [file.name for file in path.parent.iterdir() if "before" in file.name] == []
    assert not check(path).sound


def test_a_file_that_is_no_database_is_refused_and_left_alone(path: Path) -> None:
    path.parent.mkdir()
    path.write_text("time_utc,x_px,y_px\n" * 100)
    for attempt in (open_archive, check, upgrade):
        with pytest.raises(ConfigurationError, match=path.name):
            attempt(path)
    assert path.read_text().startswith("time_utc")


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutsideError, match=str(tmp_path / "file")):
        upgrade(tmp_path / "file" / "state" / "sunarc.sqlite")


def test_a_folder_that_cannot_be_written_to_is_refused() -> None:
    with pytest.raises(OutsideError, match=r"/proc/self/sunarc\.sqlite"):
        upgrade(Path("/proc/self/sunarc.sqlite"))


def test_a_database_that_is_locked_by_another_process_is_said_to_be_locked(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    upgrade(path)
    monkeypatch.setattr("sunarc.imager.archive.database.connections._BUSY_TIMEOUT_MS", 50)
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(OutsideError, match="locked"):
            open_archive(path)


def test_a_backup_is_a_whole_database_made_while_others_write(archive: Archive, path: Path, tmp_path: Path) -> None:
    target = backup(path, tmp_path / "copy.sqlite")
    archive.cameras.save(CameraRecord(name="late", latitude=0.0, longitude=0.0, altitude=0.0, width=1, height=1))
    copy = open_archive(target)
    assert [camera.name for camera in copy.cameras.all()] == ["roof"]
    copy.close()
    with pytest.raises(InputError, match="exists"):
        backup(path, target)


def test_a_backup_to_a_folder_that_is_not_there_fails_in_one_line(archive: Archive, path: Path) -> None:
    assert archive.cameras.all()
    with pytest.raises(OutsideError, match="cannot copy"):
        backup(path, path.parent / "missing" / "copy.sqlite")


@pytest.mark.usefixtures("path")  # SQLite's
def test_every_connection_is_durable_and_keeps_foreign_keys(archive: Archive) -> None:
    with archive.database.reading() as connection:
        pragmas = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        }
    assert pragmas == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1, "busy_timeout": 30_000}
