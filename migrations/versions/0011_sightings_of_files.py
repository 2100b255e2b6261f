"""Sightings name the image file that they come from, and the key has it: exposures of a stack share their time.

Revision ID: 0011
Revises: 0010
"""

from __future__ import annotations

from typing import Literal

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

_KEY = ("camera", "time", "body", "exposure_us", "method")


def upgrade() -> None:
    """Of sightings stored until now the file is not known: the empty name."""
    with op.batch_alter_table("sun_point", recreate=_recreate()) as table:
        table.add_column(sa.Column("file", sa.Text(), nullable=False, server_default=""))
        table.add_column(sa.Column("ingest_pass", sa.Integer()))
        table.drop_constraint("uq_sun_point", type_="unique")
        table.create_unique_constraint("uq_sun_point", [*_KEY, "file"])
    op.add_column("used_sightings", sa.Column("sigma", sa.LargeBinary()))


def _recreate() -> Literal["always", "never"]:
    """Return how the table is changed: SQLite changes no constraint in place."""
    return "always" if op.get_bind().dialect.name == "sqlite" else "never"


def downgrade() -> None:
    """Of sightings that differ in their file alone, the one that was stored first stays."""
    op.drop_column("used_sightings", "sigma")
    first = f"SELECT min(id) FROM sun_point GROUP BY {', '.join(_KEY)}"  # noqa: S608 - constants
    op.execute(f"DELETE FROM sun_point WHERE id NOT IN ({first})")  # noqa: S608 - constants
    with op.batch_alter_table("sun_point", recreate=_recreate()) as table:
        table.drop_constraint("uq_sun_point", type_="unique")
        table.drop_column("ingest_pass")
        table.drop_column("file")
        table.create_unique_constraint("uq_sun_point", _KEY)
