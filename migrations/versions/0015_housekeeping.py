"""Disk space and camera temperature by hour and by day, and since when conditions hold.

Revision ID: 0015
Revises: 0014
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Both tables are filled from the next start on."""
    op.create_table(
        "housekeeping",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("step", sa.Text(), nullable=False),
        sa.Column("time", sa.BigInteger(), nullable=False),
        sa.Column("disk_free_bytes", sa.BigInteger()),
        sa.Column("images_bytes", sa.BigInteger()),
        sa.Column("temperature_c", sa.Float()),
        sa.Column("temperature_min_c", sa.Float()),
        sa.Column("temperature_max_c", sa.Float()),
        sa.Column("n_temperatures", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("camera", "step", "time", name="pk_housekeeping"),
    )
    op.create_table(
        "condition",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("code", sa.Text(), nullable=False),
        sa.Column("since", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("camera", "code", name="pk_condition"),
    )


def downgrade() -> None:
    """Forget both; what waits for a hub of them goes too, for the version before cannot read it."""
    op.drop_table("condition")
    op.drop_table("housekeeping")
    op.execute("DELETE FROM outbox WHERE kind IN ('housekeeping', 'housekeeping.removed')")
