"""Measured air: of solar days, of imported sightings, and as a calibration was made with it.

Revision ID: 0009
Revises: 0008
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None

_AIR = ("temperature_c", "pressure_hpa")


def upgrade() -> None:
    """Nothing was measured until now: the site's annual means were assumed."""
    op.create_table(
        "day_air",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("date", sa.Date(), nullable=False),
        *(sa.Column(name, sa.Float()) for name in _AIR),
        sa.Column("set_at", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("camera", "date", name="pk_day_air"),
        sa.ForeignKeyConstraint(["camera"], ["camera.name"], name="fk_day_air_camera"),
    )
    for name in _AIR:
        op.add_column("sun_point", sa.Column(name, sa.Float()))
    op.add_column("used_sightings", sa.Column("air", sa.LargeBinary()))


def downgrade() -> None:
    """Forget it: the site's annual means are assumed again."""
    op.drop_column("used_sightings", "air")
    for name in _AIR:
        op.drop_column("sun_point", name)
    op.drop_table("day_air")
