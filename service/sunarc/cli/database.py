"""The commands of `sunarc points` and `sunarc db`: parse, call, print."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy import URL

from sunarc.cli.options import AsJson, Config, OptionalState, State, parse_image_size, print_rows, service_settings
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.messages import counted
from sunarc.common.utc import parse_time
from sunarc.imager.archive.database.backup import backup, backup_into, newest_sound_copy, restore
from sunarc.imager.archive.database.connections import server_url
from sunarc.imager.archive.database.recovery import upgrade_present
from sunarc.imager.archive.database.schema import check, downgrade, require_file, upgrade_server
from sunarc.imager.archive.database.state_folder import lock_holder, lock_state
from sunarc.imager.commands.archive_tables import database_path, export_everything, write_points
from sunarc.imager.commands.archive_tables import import_points as read_points
from sunarc.imager.runtime.clock import SystemClock

points_cli = typer.Typer(no_args_is_help=True, help="Import and export sightings as CSV.")
Store = Annotated[
    str | None, typer.Option("--store", help="A PostgreSQL database, as the setting `store`.", show_default=False)
]

db_cli = typer.Typer(no_args_is_help=True, help="The archive's database.")


@points_cli.command("import")
def import_points(
    file: Annotated[Path, typer.Argument(help="CSV of sightings.")],
    config: Config = None,
    image_size: Annotated[
        str | None, typer.Option(help="W,H in px, for a camera that the archive does not know yet.")
    ] = None,
) -> None:
    """Add sightings from a CSV file to the archive; those that it already has are skipped.

    A new state folder gets a database, and the camera is stored with the settings' site.

    Example: sunarc points import points.csv --config sunarc.toml --image-size 1748,1748
    """
    settings = service_settings(config)
    size = None if image_size is None else parse_image_size(image_size)
    added, total, outside = read_points(settings, file, image_size=size)
    left_out = f", {outside} outside the image were left out" if outside else ""
    print(f"{added} of {counted(total, 'sighting')} added, {total - added - outside} were there already{left_out}")
    note_running_service(settings.state)


@points_cli.command("export")
def export_points(
    config: Config = None,
    since: Annotated[str | None, typer.Option(help="First time, ISO 8601.")] = None,
    until: Annotated[str | None, typer.Option(help="End, ISO 8601, exclusive.")] = None,
) -> None:
    """Write the accepted sightings of the archive as CSV to standard output.

    Example: sunarc points export --config sunarc.toml > points.csv
    """
    write_points(
        service_settings(config),
        sys.stdout,
        since=_parse_optional_time(since, "--since"),
        until=_parse_optional_time(until, "--until"),
    )


@db_cli.command()
def upgrade(state: OptionalState = None, store: Store = None) -> None:
    """Create the database, or bring it to this version's revision; of an SQLite file a copy is kept.

    Example: sunarc db upgrade --state /var/lib/sunarc
    """
    place = _choose_store(state, store)
    if isinstance(place, URL):
        print("the database was upgraded" if upgrade_server(place) else "the database is up to date")
        return
    state = place
    path = database_path(state)
    existed = path.exists()
    with _lock_database(state):
        copy = upgrade_present(path)
    if copy is not None:
        print(f"{path} was upgraded; the former one is kept as {copy.name}")
    else:
        print(f"{path} is up to date" if existed else f"{path} was made")


@db_cli.command("check")
def check_database(state: OptionalState = None, store: Store = None, *, as_json: AsJson = False) -> None:
    """Check the database's revision and integrity; exit 1 when something is wrong.

    Example: sunarc db check --state /var/lib/sunarc
    """
    place = _choose_store(state, store)
    result = check(place if isinstance(place, URL) else database_path(place))
    found = {
        "sound": result.sound,
        "revision": result.revision,
        "head": result.head,
        "integrity": list(result.integrity),
        "damaged_calibrations": list(result.damaged),
        "rows": dict(result.rows),
    }
    print_rows(found, ("what", "value"), [[key, str(value)] for key, value in found.items()], as_json=as_json)
    if not found["sound"]:
        raise typer.Exit(1)


@db_cli.command("downgrade")
def downgrade_database(*, to: Annotated[str, typer.Option("--to", help="The older revision.")], state: State) -> None:
    """Bring the database back to an older revision, before an older version is installed; a copy is kept.

    Example: sunarc db downgrade --to 0001 --state /var/lib/sunarc
    """
    path = _require_database(state)
    with _lock_database(state):
        copy = downgrade(path, to)
    print(f"{path} is at revision {to} now; the former one is kept as {copy.name}")


@db_cli.command("backup")
def backup_database(
    target: Annotated[Path, typer.Argument(help="File to write; with --keep, folder of dated copies.")],
    *,
    state: State,
    keep: Annotated[int | None, typer.Option(help="How many copies the folder keeps, the newest.")] = None,
) -> None:
    """Copy the database, consistently, while the service runs.

    Example: sunarc db backup copy.sqlite --state /var/lib/sunarc
    """
    path = _require_database(state)
    copy = backup(path, target) if keep is None else backup_into(path, target, keep=keep, now=SystemClock().now())
    print(f"copied to {copy}")


@db_cli.command("restore")
def restore_database(
    source: Annotated[Path | None, typer.Argument(help="A copy of the database.", show_default=False)] = None,
    *,
    latest: Annotated[bool, typer.Option("--latest", help="The newest sound copy in STATE/backups.")] = False,
    state: State,
) -> None:
    """Put a copy in the database's place, the service being stopped; the former one is kept.

    Root acts as the owner of the state folder, here as in every command: that user needs to be able to read the copy.

    Example: sunarc db restore /var/lib/sunarc/backups/sunarc-20260501T020000Z.sqlite --state /var/lib/sunarc
    """
    if latest == (source is not None):
        raise InputError(field="SOURCE", problem="give either a copy or --latest", remedy="see --help")
    copy = source or newest_sound_copy(state / "backups")
    if copy is None:
        raise InputError(
            field="--latest", problem=f"no sound copy is in {state / 'backups'}", remedy="name a copy of the database"
        )
    path = database_path(state)
    with _lock_database(state):
        former = restore(path, copy, now=SystemClock().now())
    print(f"{path} is what {copy} was" + ("" if former is None else f"; the former one is kept as {former.name}"))


@db_cli.command("export")
def export_all(
    folder: Annotated[Path, typer.Argument(help="A new folder.")], *, state: State, as_json: AsJson = False
) -> None:
    """Write everything that the archive holds as CSV, JSON and NetCDF.

    Example: sunarc db export everything/ --state /var/lib/sunarc
    """
    written = export_everything(state, folder)
    print_rows(written, ("file", "rows"), [[name, str(n)] for name, n in written.items()], as_json=as_json)


def _choose_store(state: Path | None, store: str | None) -> Path | URL:
    """Return the state folder or the PostgreSQL database that one of two options names."""
    if state is not None and store is None:
        return state
    if store is not None and state is None:
        return server_url(store)
    raise InputError(field="--state, --store", problem="give one of them", remedy="see --help")


def _require_database(state: Path) -> Path:
    """Return the database of a state folder; an error where it is missing."""
    require_file(database_path(state), command=f"sunarc db upgrade --state {state}")
    return database_path(state)


@contextmanager
def _lock_database(state: Path) -> Iterator[None]:
    """Keep the service from running while its database is replaced or migrated."""
    with disk_errors(state):
        state.mkdir(parents=True, exist_ok=True)
    with lock_state(state):
        yield


def note_running_service(state: Path) -> None:
    """Say on standard error that a service uses the rows written into its state folder."""
    holder = lock_holder(state)
    if holder is not None:
        print(
            f"sunarc: the service with process id {holder} uses this state folder; "
            "its next refit takes the new sightings (POST /v1/refits starts one)",
            file=sys.stderr,
        )


def _parse_optional_time(text: str | None, option: str) -> datetime | None:
    return None if text is None else parse_time(text, where=option)
