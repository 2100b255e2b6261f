"""Which sightings a calibration rests on.

Revision ID: 0003
Revises: 0002
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Of calibrations made until now it is not known."""
    op.create_table(
        "used_sightings",
        sa.Column("calibration", sa.Text(), nullable=False),
        sa.Column("ids", sa.LargeBinary(), nullable=False),
        sa.Column("epochs", sa.JSON(), nullable=False),
        sa.Column("digest", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("calibration", name="pk_used_sightings"),
        sa.ForeignKeyConstraint(["calibration"], ["calibration.id"], name="fk_used_sightings_calibration"),
    )


def downgrade() -> None:
    """Forget it; the calibrations stay."""
    op.drop_table("used_sightings")
