"""Which image files of a followed folder were seen.

Revision ID: 0019
Revises: 0018
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """A service that follows a folder fills it at its first start."""
    op.create_table(
        "seen_file",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("file", sa.Text(), nullable=False),
        sa.Column("stamp", sa.Text(), nullable=False),
        sa.Column("content", sa.Text()),
        sa.Column("time", sa.BigInteger()),
        sa.Column("code", sa.Text()),
        sa.PrimaryKeyConstraint("camera", "file", name="pk_seen_file"),
    )
    op.create_index("ix_seen_file_time", "seen_file", ["camera", "time"])


def downgrade() -> None:
    """Forget it: the version before follows no folder."""
    op.drop_table("seen_file")
