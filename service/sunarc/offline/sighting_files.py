"""Sightings in and out of the archive, and the care of its database."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any, TextIO

from sunarc.archive import (
    backup,
    backup_into,
    check,
    downgrade,
    lock_state,
    newest_sound_copy,
    open_archive,
    prepare_folder,
    require_file,
    restore,
    upgrade_present,
    write_sightings,
)
from sunarc.errors import InputError
from sunarc.runtime.clock import Clock
from sunarc.settings import Settings


def export_points(settings: Settings, target: TextIO, *, since: datetime | None, until: datetime | None) -> int:
    """Write the accepted sightings as CSV and return how many, with the air where it was measured (see `air_of`)."""
    with open_archive(settings.database) as archive:
        points = archive.sun_points(settings.name, since=since, until=until, accepted=True)
        air = archive.air_of(settings.name, points)
    rows = [(p.time, p.x_px, p.y_px, p.sigma_px, p.body) for p in points if p.x_px is not None and p.y_px is not None]
    return write_sightings(target, rows, air=air)


def upgrade_database(state: Path) -> str:
    """Create or migrate the database of a state folder and say what was done."""
    path = database_of(state)
    existed = path.exists()
    with _locked(state):
        copy = upgrade_present(path)
    if copy is not None:
        return f"{path} was upgraded; the former one is kept as {copy.name}"
    return f"{path} is up to date" if existed else f"{path} was made"


def check_database(state: Path) -> dict[str, Any]:
    """Return the result of a database check."""
    found = check(database_of(state))
    return {
        "sound": found.sound,
        "revision": found.revision,
        "head": found.head,
        "integrity": list(found.integrity),
        "damaged_calibrations": list(found.damaged),
        "rows": dict(found.rows),
    }


def downgrade_database(state: Path, revision: str) -> str:
    """Bring the database back to an older revision and say what was kept."""
    path = database_of(state)
    require_file(path, command=f"sunarc db upgrade --state {state}")
    with _locked(state):
        copy = downgrade(path, revision)
    return f"{path} is at revision {revision} now; the former one is kept as {copy.name}"


def backup_database(state: Path, target: Path) -> str:
    """Copy the database and say where to."""
    require_file(database_of(state), command=f"sunarc db upgrade --state {state}")
    return f"copied to {backup(database_of(state), target)}"


def backup_database_into(state: Path, folder: Path, *, keep: int, clock: Clock) -> str:
    """Copy the database into a folder of dated copies and say where to."""
    require_file(database_of(state), command=f"sunarc db upgrade --state {state}")
    return f"copied to {backup_into(database_of(state), folder, keep=keep, now=clock.now())}"


def restore_database(state: Path, source: Path | None, *, clock: Clock) -> str:
    """Put a copy in the database's place, the newest of the folder `backups` for None; say what was kept.

    Raises
    ------
    InputError : there is no such copy, it is damaged, or the database is in use.
    OutsideError : the service runs; its process id is named.
    """
    path = database_of(state)
    chosen = source or newest_sound_copy(state / "backups")
    if chosen is None:
        raise InputError(
            field="--latest", problem=f"no sound copy is in {state / 'backups'}", remedy="name a copy of the database"
        )
    with _locked(state):
        kept = restore(path, chosen, now=clock.now())
    former = "" if kept is None else f"; the former one is kept as {kept.name}"
    return f"{path} is what {chosen} was{former}"


@contextmanager
def _locked(state: Path) -> Iterator[None]:
    """Keep the service from running while its database is replaced or migrated."""
    prepare_folder(state)
    with lock_state(state):
        yield


def database_of(state: Path) -> Path:
    """Return the database file of a state folder."""
    return state / "sunarc.sqlite"
