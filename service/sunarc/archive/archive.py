"""The archive as one object."""

from __future__ import annotations

import sqlite3
from datetime import datetime
from pathlib import Path
from typing import cast

from sqlalchemy import Engine, QueuePool

from sunarc.archive.calibration_inputs import UsedSightings
from sunarc.archive.day_air import MeasuredAir
from sunarc.archive.days_and_events import Journal
from sunarc.archive.engine import create_archive_engine, reading, writing
from sunarc.archive.epoch_closing import EpochClosing
from sunarc.archive.file import DELETED, EMPTIED, REPLACED, DatabaseFile
from sunarc.archive.file_sightings import FileSightings
from sunarc.archive.recovery import Recovery, rebuild
from sunarc.archive.schema import require_file, require_head
from sunarc.archive.sighting_revisions import SightingRevisions
from sunarc.archive.sightings import Sightings
from sunarc.errors import OutsideError


class Archive(Sightings, FileSightings, SightingRevisions, EpochClosing, UsedSightings, Journal, MeasuredAir):
    """The database: values in, values out; safe to use from any thread."""

    def __init__(self, engine: Engine, file: DatabaseFile) -> None:
        super().__init__(engine, file)
        self._witness = _reader(file)

    def close(self) -> None:
        """Close the connections that are not in use."""
        self._witness.close()
        super().close()

    def recover(self, *, now: datetime) -> Recovery | None:
        """Put the database's file back when it is not in place; reads and writes wait meanwhile.

        Returns
        -------
        What was done; None when the file is in place.

        Raises
        ------
        OutsideError : it could not be done; sightings wait in memory, and it may be tried again.
        """
        problem = self._file.problem()
        if problem is None:
            return None
        if problem not in {DELETED, REPLACED, EMPTIED}:
            raise OutsideError(f"the database {self._file.path} {problem}")
        with self._lock:
            self._usable.clear()
            try:
                self._require_idle()
                done = rebuild(self._file.path, self._witness, problem=problem, now=now, close=self.close)
                self._file.remember()
                self._witness = _reader(self._file)
            finally:
                self._usable.set()
        for camera in self.saved_cameras():
            self.save_camera(camera)  # a new database, or an old copy, may not have it
        return done

    def _require_idle(self) -> None:
        """Refuse while another thread reads: SQLite removes files by name when it closes the last connection."""
        if cast("QueuePool", self._engine.pool).checkedout():
            raise OutsideError(f"the database {self._file.path} is being read; it is put back at the next look")


def open_archive(path: Path, *, upgrade_command: str | None = None) -> Archive:
    """Open a database of the head revision for reading and writing.

    Parameters
    ----------
    path : the database file.
    upgrade_command : what a refusal tells the reader to run; by default the command for this file's folder.

    Raises
    ------
    SchemaError : there is no database, or it is of another revision.
    ConfigurationError : the file is no database.
    OutsideError : it cannot be written to.
    """
    command = upgrade_command or f"sunarc db upgrade --state {path.parent}"
    require_file(path, command=command)
    file = DatabaseFile(path)
    engine = create_archive_engine(path, file=file)
    try:
        with reading(engine) as connection:
            require_head(connection, path=path, command=command)
        with writing(engine):
            pass  # a folder that cannot be written to is found now, not at the first sighting
        file.remember()
        return Archive(engine, file)
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
