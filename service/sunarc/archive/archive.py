"""The archive as one object."""

from __future__ import annotations

import sqlite3
from datetime import datetime
from pathlib import Path
from typing import cast

from sqlalchemy import URL, Engine, QueuePool

from sunarc.archive.calibration_inputs import UsedSightings
from sunarc.archive.condition_times import ConditionTimes
from sunarc.archive.counts import Counts
from sunarc.archive.day_air import MeasuredAir
from sunarc.archive.days_and_events import Journal
from sunarc.archive.engine import create_archive_engine, reading, writing
from sunarc.archive.epoch_closing import EpochClosing
from sunarc.archive.feeds import Feeds
from sunarc.archive.file import DAMAGED, DELETED, EMPTIED, REPLACED, DatabaseFile
from sunarc.archive.file_sightings import FileSightings
from sunarc.archive.fleet import FleetRegistry
from sunarc.archive.housekeeping import HousekeepingRecord
from sunarc.archive.night_images import NightImages
from sunarc.archive.nightly import Nightly
from sunarc.archive.notices import Notices
from sunarc.archive.outbox import Outbox
from sunarc.archive.recovery import Recovery, rebuild
from sunarc.archive.schema import UPGRADE_SERVER, require_file, require_head
from sunarc.archive.server import create_server_engine, name_of, require_writable
from sunarc.archive.sighting_revisions import SightingRevisions
from sunarc.archive.sightings import Sightings
from sunarc.archive.space_reserve import Room
from sunarc.errors import OutsideError


class Archive(
    Sightings,
    FileSightings,
    SightingRevisions,
    EpochClosing,
    UsedSightings,
    Journal,
    MeasuredAir,
    Outbox,
    Feeds,
    FleetRegistry,
    Notices,
    NightImages,
    Nightly,
    Counts,
    HousekeepingRecord,
    ConditionTimes,
    Room,
):
    """The database: values in, values out; safe to use from any thread."""

    def __init__(self, engine: Engine, file: DatabaseFile | None) -> None:
        super().__init__(engine, file)
        self._witness = None if file is None else _reader(file)

    def close(self) -> None:
        """Close the connections that are not in use."""
        if self._witness is not None:
            self._witness.close()
        super().close()

    def recover(self, *, now: datetime) -> Recovery | None:
        """Put the database's file back when it is not in place; reads and writes wait meanwhile.

        Returns
        -------
        What was done; None when the file is in place, and on PostgreSQL.

        Raises
        ------
        OutsideError : it could not be done; sightings wait in memory, and it may be tried again.
        """
        file, witness = self._file, self._witness
        if file is None or witness is None:
            return None
        problem = file.problem()
        if problem is None:
            return None
        if problem not in {DELETED, REPLACED, EMPTIED, DAMAGED}:
            raise OutsideError(f"the database {file.path} {problem}")
        with self._lock:
            self._usable.clear()
            try:
                self._require_idle(file.path)
                done = rebuild(file.path, witness, problem=problem, now=now, close=self.close)
                file.remember()
                self._witness = _reader(file)
            finally:
                self._usable.set()
        for camera in self.saved_cameras():
            self.save_camera(camera)  # a new database, or an old copy, may not have it
        return done

    def _require_idle(self, path: Path) -> None:
        """Refuse while another thread reads: SQLite removes files by name when it closes the last connection."""
        if cast("QueuePool", self._engine.pool).checkedout():
            raise OutsideError(f"the database {path} is being read; it is put back at the next look")


def open_archive(store: Path | URL, *, upgrade_command: str | None = None) -> Archive:
    """Open a database of the head revision for reading and writing.

    Parameters
    ----------
    store : the SQLite file, or the address of a PostgreSQL database.
    upgrade_command : what a refusal tells the reader to run; by default the command for this file's folder.

    Raises
    ------
    SchemaError : there is no database, or it is of another revision.
    ConfigurationError : the file is no database.
    OutsideError : it cannot be written to.
    """
    if isinstance(store, URL):
        return _open_on_server(store, command=upgrade_command or UPGRADE_SERVER)
    path = store
    command = upgrade_command or f"sunarc db upgrade --state {path.parent}"
    require_file(path, command=command)
    file = DatabaseFile(path)
    engine = create_archive_engine(path, file=file)
    try:
        with reading(engine) as connection:
            require_head(connection, where=str(path), command=command)
        with writing(engine):
            pass  # a folder that cannot be written to is found now, not at the first sighting
        file.remember()
        return Archive(engine, file)
    except BaseException:
        engine.dispose()
        raise


def _open_on_server(url: URL, *, command: str) -> Archive:
    engine = create_server_engine(url)
    try:
        with reading(engine) as connection:
            require_writable(connection)
            require_head(connection, where=name_of(url), command=command)
        return Archive(engine, None)
    except BaseException:
        engine.dispose()
        raise


def _reader(file: DatabaseFile) -> sqlite3.Connection:
    """Return a connection that keeps the database and its write-ahead log open, so that they outlive their names."""
    try:
        connection = file.connect()
        connection.execute("SELECT count(*) FROM alembic_version").fetchone()  # opens the log
    except sqlite3.Error as error:
        raise OutsideError(f"cannot use the database {file.path}: {error}") from error
    return connection
