"""The database's revision: compare, migrate, check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import URL, Connection, Engine, func, inspect, select

import sunarc
from sunarc.common.errors import InputError, SchemaError, disk_errors
from sunarc.imager.archive.calibration_rows import damaged_calibrations
from sunarc.imager.archive.database import connections
from sunarc.imager.archive.database.backup import backup, remove_old_asides
from sunarc.imager.archive.database.tables import metadata

UPGRADE_SERVER = "sunarc db upgrade --store ADDRESS, as the database's owner"
"""The command that brings a PostgreSQL database to the head revision."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """Result of a database check.

    Attributes
    ----------
    revision, head : the database's own, and the one this version needs; None for a database without tables.
    integrity : SQLite's findings; empty when it is sound, and on PostgreSQL.
    damaged : ids of the calibrations whose documents do not match their checksums; none of them is served.
    current_damaged : whether one of them is current.
    rows : the number of rows by table; empty when the revisions differ.
    """

    revision: str | None
    head: str
    integrity: tuple[str, ...]
    rows: Mapping[str, int]
    damaged: tuple[str, ...] = ()
    current_damaged: bool = False

    @property
    def sound(self) -> bool:
        """Return whether this version can use the database."""
        return self.revision == self.head and not self.integrity and not self.current_damaged


def head_revision() -> str:
    """Return the revision that this version needs."""
    return known_revisions()[-1]


def upgrade(path: Path) -> Path | None:
    """Create the database, or bring it to the head revision.

    Returns
    -------
    The copy that was made before a migration; None when there was nothing to migrate.
    """
    existed = path.exists()
    with disk_errors(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    engine = connections.create_archive_engine(path, foreign_keys=False, create=True)
    try:
        with connections.reading(engine) as connection:
            revision = _read_revision(connection)
        if revision == head_revision():
            return None
        if revision is not None and revision not in known_revisions():
            raise _newer_schema_error(revision, str(path))
        copy = backup(path, _copy_path(path, revision), replace=True) if existed else None
        _migrate(engine, to="head")
    finally:
        engine.dispose()
    remove_old_asides(path)
    return copy


def upgrade_server(url: URL) -> bool:
    """Bring a PostgreSQL database to the head revision as its owner, and return whether anything was to do."""
    engine = connections.create_server_engine(url)
    try:
        with connections.reading(engine) as connection:
            connections.require_writable(connection)
            revision = _read_revision(connection)
        if revision is not None and revision not in known_revisions():
            raise _newer_schema_error(revision, connections.public_address(url))
        if revision != head_revision():
            _migrate(engine, to="head")
        return revision != head_revision()
    finally:
        engine.dispose()


def check(store: Path | URL) -> Check:
    """Return revision, integrity and size of a database, changing nothing."""
    if isinstance(store, URL):
        engine = connections.create_server_engine(store)
    else:
        require_file(store, command="sunarc db upgrade")
        engine = connections.create_archive_engine(store)
    try:
        with connections.reading(engine) as connection:
            revision, head = _read_revision(connection), head_revision()
            rows = {
                name: connection.scalar(select(func.count()).select_from(table)) or 0
                for name, table in (metadata.tables.items() if revision == head else ())
            }
            damaged = damaged_calibrations(connection) if revision == head else {}
            return Check(
                revision=revision,
                head=head,
                integrity=_find_integrity_faults(connection),
                rows=rows,
                damaged=tuple(damaged),
                current_damaged="current" in damaged.values(),
            )
    finally:
        engine.dispose()


def downgrade(path: Path, revision: str) -> Path:
    """Bring a database back to an older revision, for an older version of the service; return the copy made first.

    What only the newer revision can hold is lost; everything else stays.
    """
    require_file(path, command="sunarc db upgrade")
    revisions = known_revisions()
    engine = connections.create_archive_engine(path, foreign_keys=False, create=True)
    try:
        with connections.reading(engine) as connection:
            present = _read_revision(connection)
        if present not in revisions or revision not in revisions or revision > present:
            older = ", ".join(revisions[: revisions.index(present) + 1]) if present in revisions else "none"
            raise InputError(
                field="--to",
                problem=f"{path} is at revision {present}, which cannot be brought to {revision}",
                remedy=f"give one of: {older}",
            )
        copy = backup(path, path.with_name(f"{path.name}.at-{present}"), replace=True)
        _migrate(engine, to=revision)
    finally:
        engine.dispose()
    return copy


def require_file(path: Path, *, command: str) -> None:
    """Refuse a path without a database."""
    if not path.is_file():
        raise SchemaError(f"there is no database at {path}; run: {command}")


def require_head(connection: Connection, *, where: str, command: str) -> None:
    """Refuse a database of another revision."""
    revision, head = _read_revision(connection), head_revision()
    if revision is None or revision in known_revisions():
        if revision != head:
            raise SchemaError(f"{where} is at revision {revision}, this version needs {head}; run: {command}")
        return
    raise _newer_schema_error(revision, where)


def _newer_schema_error(revision: str, where: str) -> SchemaError:
    return SchemaError(
        f"{where} is at revision {revision}, which this version ({sunarc.__version__}, {head_revision()}) "
        "does not know; "
        "install the version that wrote it, or a newer one"
    )


def _copy_path(path: Path, revision: str | None) -> Path:
    return path.with_name(f"{path.name}.before-{revision or 'none'}")


def _read_revision(connection: Connection) -> str | None:
    if not inspect(connection).has_table("alembic_version"):
        return None
    found = connection.exec_driver_sql("SELECT version_num FROM alembic_version").scalar()
    return None if found is None else str(found)


def known_revisions() -> tuple[str, ...]:
    """Return the revisions that this version knows, oldest first: a migration's file begins with its own."""
    revisions = sorted(file.stem.split("_")[0] for file in (_find_migrations_folder() / "versions").glob("[0-9]*.py"))
    if not revisions:
        raise SchemaError("the migrations are missing; install sunarc again")
    return tuple(revisions)


def _migrate(engine: Engine, *, to: str) -> None:
    """Bring a database to a revision, up or down, in one transaction; "head" is the newest."""
    from alembic import command  # noqa: PLC0415 - slow to import, and a start without a migration does without it
    from alembic.config import Config  # noqa: PLC0415

    config = Config()
    config.set_main_option("script_location", str(_find_migrations_folder()).replace("%", "%%"))
    with connections.writing(engine) as connection:
        config.attributes["connection"] = connection
        if to == "head":
            command.upgrade(config, to)
        else:
            command.downgrade(config, to)


def _find_integrity_faults(connection: Connection) -> tuple[str, ...]:
    if connection.dialect.name != "sqlite":
        return ()  # PostgreSQL checks its pages itself (initdb --data-checksums, pg_amcheck)
    lines = [str(row[0]) for row in connection.exec_driver_sql("PRAGMA integrity_check")]
    orphans = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
    return (*(line for line in lines if line != "ok"), *(f"{row[0]} row {row[1]} refers to nothing" for row in orphans))


def _find_migrations_folder() -> Path:
    package = Path(sunarc.__file__).parent
    places = (package / "migrations", package.parents[1] / "migrations")  # an installed wheel, a checkout
    return next((folder for folder in places if folder.is_dir()), places[0])
