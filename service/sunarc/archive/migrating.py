"""Alembic's part: the migrations run. Imported only when there is something to migrate, for it is slow to import."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from sqlalchemy import Engine

from sunarc.archive.engine import writing


def migrate(engine: Engine, folder: Path, *, to: str) -> None:
    """Bring a database to a revision, up or down, in one transaction.

    Parameters
    ----------
    engine : of the database, foreign keys off.
    folder : of the migrations.
    to : the revision; "head" is the newest.
    """
    config = Config()
    config.set_main_option("script_location", str(folder).replace("%", "%%"))
    with writing(engine) as connection:
        config.attributes["connection"] = connection
        if to == "head":
            command.upgrade(config, to)
        else:
            command.downgrade(config, to)
