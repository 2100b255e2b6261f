"""The archive as one object, and how it is opened."""

from __future__ import annotations

from pathlib import Path

from sunarc.archive.doubts import Doubts
from sunarc.archive.engine import create_archive_engine, reading, writing
from sunarc.archive.epoch_closing import EpochClosing
from sunarc.archive.journal import Journal
from sunarc.archive.schema import require_file, require_head
from sunarc.archive.sightings import Sightings
from sunarc.archive.used import UsedSightings


class Archive(Sightings, Doubts, EpochClosing, UsedSightings, Journal):
    """What we remember: values in, values out; one object serves all threads."""


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
    engine = create_archive_engine(path)
    try:
        with reading(engine) as connection:
            require_head(connection, path=path, command=command)
        with writing(engine):
            pass  # a folder that cannot be written to is found now, not at the first sighting
    except BaseException:
        engine.dispose()
        raise
    return Archive(engine)
