"""Sightings name the folder of their image file, and the key has it: two folders may have files of one name.

Revision ID: 0020
Revises: 0019
"""

from __future__ import annotations

from typing import Literal

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None

_KEY = ("camera", "time", "body", "exposure_us", "method", "file")


def upgrade() -> None:
    """Of sightings stored until now the folder is not known: the empty name."""
    with op.batch_alter_table("sun_point", recreate=_recreate()) as table:
        table.add_column(sa.Column("folder", sa.Text(), nullable=False, server_default=""))
        table.drop_constraint("uq_sun_point", type_="unique")
        table.create_unique_constraint("uq_sun_point", [*_KEY, "folder"])


def _recreate() -> Literal["always", "never"]:
    """Return how the table is changed: SQLite changes no constraint in place."""
    return "always" if op.get_bind().dialect.name == "sqlite" else "never"


def downgrade() -> None:
    """Of sightings that differ in their folder alone, an accepted one stays, else the one that was stored first."""
    _drop_triggers()
    best = f"row_number() OVER (PARTITION BY {', '.join(_KEY)} ORDER BY accepted DESC, id)"
    others = f"SELECT id FROM (SELECT id, {best} AS place FROM sun_point) AS ranked WHERE place > 1"  # noqa: S608 - constants
    op.execute(f"DELETE FROM sun_point WHERE id IN ({others})")  # noqa: S608 - constants
    with op.batch_alter_table("sun_point", recreate=_recreate()) as table:
        table.drop_constraint("uq_sun_point", type_="unique")
        table.drop_column("folder")
        table.create_unique_constraint("uq_sun_point", _KEY)


def _drop_triggers() -> None:
    """Queue nothing for a hub: the former version queues all rows again once the triggers are gone."""
    if op.get_bind().dialect.name == "sqlite":
        named = "SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = 'sun_point'"
        for name in op.get_bind().execute(sa.text(named)).scalars().all():
            op.execute(f'DROP TRIGGER "{name}"')
