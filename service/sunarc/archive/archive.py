"""The archive as one object, and as one camera sees it."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from datetime import datetime
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

from sqlalchemy import URL, Engine, QueuePool

from sunarc.archive.calibrations import EpochClosing
from sunarc.archive.columns import UsedSightings
from sunarc.archive.database.connections import (
    DAMAGED,
    DELETED,
    EMPTIED,
    REPLACED,
    DatabaseFile,
    create_archive_engine,
    create_server_engine,
    name_of,
    reading,
    require_writable,
    writing,
)
from sunarc.archive.database.recovery import Recovery, rebuild
from sunarc.archive.database.schema import UPGRADE_SERVER, require_file, require_head
from sunarc.archive.database.store import Room
from sunarc.archive.days import Counts, MeasuredAir, StoredNights
from sunarc.archive.events import ConditionTimes, HousekeepingRecord, Journal
from sunarc.archive.fleet.feeds import Feeds, FleetRegistry
from sunarc.archive.fleet.nightly import Nightly
from sunarc.archive.fleet.notices import Notices
from sunarc.archive.fleet.outbox import Outbox
from sunarc.archive.sightings import FileSightings, SightingRevisions, SightingStore
from sunarc.archive.values import Event, EventSeverity
from sunarc.errors import OutsideError
from sunarc.findings import Finding, Messages
from sunarc.sky.site import Site


class Archive(
    SightingStore,
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
    StoredNights,
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


class CameraArchive:
    """The methods of an archive that concern one camera, without its name; see `Archive` for each.

    Parameters
    ----------
    archive : open.
    name : of the camera.
    site : where it stands.
    """

    def __init__(self, archive: Archive, *, name: str, site: Site) -> None:
        self.archive = archive
        self.name = name
        self.site = site
        self.add_housekeeping = partial(archive.add_housekeeping, name)
        self.current_calibration = partial(archive.current_calibration, name)
        self.current_epoch = partial(archive.current_epoch, name)
        self.current_model = partial(archive.current_model, name)
        self.damaged_calibration = partial(archive.damaged_calibration, name)
        self.dates_with_points = partial(archive.dates_with_points, name)
        self.days = partial(archive.days, name)
        self.epochs = partial(archive.epochs, name)
        self.events = partial(archive.events, name)
        self.exclude = partial(archive.exclude, name)
        self.expire_housekeeping = partial(archive.expire_housekeeping, name)
        self.last_served = partial(archive.last_served, name)
        self.add_night_image = partial(archive.add_night_image, name)
        self.begin_night_verdict = partial(archive.begin_night_verdict, name)
        self.drop_night_images = partial(archive.drop_night_images, name)
        self.newest_sighting_time = partial(archive.newest_sighting_time, name)
        self.night_images = partial(archive.night_images, name)
        self.nights = partial(archive.nights, name)
        self.observation_times = partial(archive.observation_times, name)
        self.open_epoch = partial(archive.open_epoch, name)
        self.readmit = partial(archive.readmit, name)
        self.record = partial(archive.camera, name)
        self.refits = partial(archive.refits, name)
        self.sightings_of_ids = partial(archive.sightings_of_ids, name)
        self.site_at = partial(archive.site_at, name, site)
        self.split_epoch = partial(archive.split_epoch, name)
        self.sun_candidates = partial(archive.sun_candidates, name)
        self.sun_levels = partial(archive.sun_levels, name)
        self.sun_point_columns = partial(archive.sun_point_columns, name)
        self.sun_points = partial(archive.sun_points, name)
        self.widen_clock_errors = partial(archive.widen_clock_errors, name)

    def add_event(
        self,
        finding: Finding,
        messages: Messages,
        *,
        time: datetime,
        severity: EventSeverity,
        kind: str | None = None,
        details: Mapping[str, Any] = MappingProxyType({}),
    ) -> Event:
        """Store the event of a finding and return it; `details` are what the finding's data do not say."""
        event = Event.of(finding, messages, time=time, severity=severity, camera=self.name, kind=kind, details=details)
        return self.archive.add_event(event)
