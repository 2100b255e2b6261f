"""The archive as one object, and as one camera sees it."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self, TypeVar

from sqlalchemy import URL, Engine

from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding
from sunarc.imager.archive.calibrations import CalibrationStore
from sunarc.imager.archive.cameras import CameraStore
from sunarc.imager.archive.database import connections
from sunarc.imager.archive.database.recovery import Recovery, rebuild
from sunarc.imager.archive.database.schema import UPGRADE_SERVER, require_file, require_head
from sunarc.imager.archive.database.store import Database
from sunarc.imager.archive.days import DayStore, NightStore
from sunarc.imager.archive.epochs import EpochStore
from sunarc.imager.archive.events import ConditionStore, EventStore, HousekeepingStore, RefitStore
from sunarc.imager.archive.notices import NoticeStore
from sunarc.imager.archive.outbox import Outbox
from sunarc.imager.archive.seen_files import SeenFileStore
from sunarc.imager.archive.sightings import SightingStore
from sunarc.imager.archive.values import Event, EventSeverity
from sunarc.sky.site import Site


class Archive:
    """The database as its parts: values in, values out; safe to use from any thread.

    Attributes
    ----------
    database : connections and transactions.
    cameras, epochs, sightings : the cameras, the intervals in which they did not move, and what was sighted.
    calibrations, refits : what was made of them.
    days, nights, events : the record.
    seen_files : the image files of a followed folder that were seen.
    conditions, housekeeping : how the service is, and its disk and camera.
    outbox, notices : rows for a hub, and notices for receivers of messages.

    Parameters
    ----------
    engine, file : see `Database`.
    """

    def __init__(self, engine: Engine, file: connections.DatabaseFile | None) -> None:
        database = self.database = Database(engine, file)
        self._witness = None if file is None else _hold_files_open(file)
        self.cameras = CameraStore(database)
        self.epochs = EpochStore(database)
        self.sightings = SightingStore(database)
        self.calibrations = CalibrationStore(database)
        self.refits = RefitStore(database)
        self.days = DayStore(database)
        self.nights = NightStore(database)
        self.events = EventStore(database)
        self.seen_files = SeenFileStore(database)
        self.conditions = ConditionStore(database)
        self.housekeeping = HousekeepingStore(database)
        self.outbox = Outbox(database)
        self.notices = NoticeStore(database)
        self.revision = database.revision
        self.require_storing = database.require_storing
        self.last_written = database.last_written

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections that are not in use."""
        if self._witness is not None:
            self._witness.close()
        self.database.close()

    def recover(self, *, now: datetime) -> Recovery | None:
        """Put the database's file back when it is not in place; reads and writes wait meanwhile.

        Returns
        -------
        What was done; None when the file is in place, and on PostgreSQL.

        Raises
        ------
        OutsideError : it could not be done; sightings wait in memory, and it may be tried again.
        """
        file, witness = self.database.file, self._witness
        if file is None or witness is None:
            return None
        problem = file.problem()
        if problem is None:
            return None
        if problem not in {connections.DELETED, connections.REPLACED, connections.EMPTIED, connections.DAMAGED}:
            raise OutsideError(f"the database {file.path} {problem}")
        with self.database.suspend_use():
            done = rebuild(file.path, witness, problem=problem, now=now, close=self.close)
            file.remember()
            self._witness = _hold_files_open(file)
        for camera in self.cameras.saved():
            self.cameras.save(camera)  # a new database, or an old copy, may not have it
        return done


Opened = TypeVar("Opened", bound=Archive)


def open_archive(store: Path | URL, *, upgrade_command: str | None = None) -> Archive:
    """Open a database as an imager's archive (`open_database`)."""
    return open_database(Archive, store, upgrade_command=upgrade_command)


def open_database(kind: type[Opened], store: Path | URL, *, upgrade_command: str | None = None) -> Opened:
    """Open a database of the head revision for reading and writing.

    Parameters
    ----------
    kind : what it is opened as: `Archive`, or the hub's.
    store : the SQLite file, or the address of a PostgreSQL database.
    upgrade_command : what a refusal tells the reader to run; by default the command for this file's folder.

    Raises
    ------
    SchemaError : there is no database, or it is of another revision.
    ConfigurationError : the file is no database.
    OutsideError : it cannot be written to.
    """
    if isinstance(store, URL):
        return _open_on_server(kind, store, command=upgrade_command or UPGRADE_SERVER)
    path = store
    command = upgrade_command or f"sunarc db upgrade --state {path.parent}"
    require_file(path, command=command)
    file = connections.DatabaseFile(path)
    engine = connections.create_archive_engine(path, file=file)
    try:
        with connections.reading(engine) as connection:
            require_head(connection, where=str(path), command=command)
        with connections.writing(engine):
            pass  # a folder that cannot be written to is found now, not at the first sighting
        file.remember()
        return kind(engine, file)
    except BaseException:
        engine.dispose()
        raise


def _open_on_server(kind: type[Opened], url: URL, *, command: str) -> Opened:
    engine = connections.create_server_engine(url)
    try:
        with connections.reading(engine) as connection:
            connections.require_writable(connection)
            require_head(connection, where=connections.public_address(url), command=command)
        return kind(engine, None)
    except BaseException:
        engine.dispose()
        raise


def _hold_files_open(file: connections.DatabaseFile) -> sqlite3.Connection:
    """Return a connection that keeps the database and its write-ahead log open, so that they outlive their names."""
    try:
        connection = file.connect()
        connection.execute("SELECT count(*) FROM alembic_version").fetchone()  # opens the log
    except sqlite3.Error as error:
        raise OutsideError(f"cannot use the database {file.path}: {error}") from error
    return connection


class CameraArchive:
    """A camera in an archive.

    Attributes
    ----------
    archive : open; its parts are asked by the camera's name.
    name : of the camera.
    site : where it stands.
    """

    def __init__(self, archive: Archive, *, name: str, site: Site) -> None:
        self.archive = archive
        self.name = name
        self.site = site

    def site_with_air_at(self, time: datetime) -> Site:
        """Return the site in the measured air of the solar day of a moment (`DayStore.site_with_air_at`)."""
        return self.archive.days.site_with_air_at(self.name, self.site, time)

    def add_event(
        self,
        finding: Finding,
        *,
        time: datetime,
        severity: EventSeverity,
        kind: str | None = None,
        details: Mapping[str, Any] = MappingProxyType({}),
    ) -> Event:
        """Store the event of a finding and return it; `details` are further data than the finding's."""
        event = Event.of(finding, time=time, severity=severity, camera=self.name, kind=kind, details=details)
        return self.archive.events.add(event)
