"""What was measured in the images of a night, until its verdict is stored.

Revision ID: 0016
Revises: 0015
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """The first image of the next night makes the first row."""
    op.create_table(
        "night_image",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("time", sa.BigInteger(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("exposure_us", sa.Float(), nullable=False),
        sa.Column("gain_db", sa.Float(), nullable=False),
        sa.Column("pixel_format", sa.Text(), nullable=False),
        sa.Column("full_scale", sa.Integer(), nullable=False),
        sa.Column("width", sa.Integer(), nullable=False),
        sa.Column("height", sa.Integer(), nullable=False),
        sa.Column("binning", sa.Integer(), nullable=False),
        sa.Column("serial", sa.Text(), nullable=False),
        sa.Column("clock_error_s", sa.Float(), nullable=False),
        sa.Column("halo", sa.Float()),
        sa.Column("digest", sa.BigInteger(), nullable=False),
        sa.Column("n_repeated", sa.Integer(), nullable=False),
        sa.Column("n_tries", sa.Integer(), nullable=False),
        sa.Column("measured", sa.LargeBinary(), nullable=False),
        sa.Column("picture", sa.LargeBinary()),
        sa.PrimaryKeyConstraint("camera", "time", "kind", name="pk_night_image"),
    )


def downgrade() -> None:
    """Forget the images of a night that has no verdict yet, as a restart of the version before does."""
    op.drop_table("night_image")
