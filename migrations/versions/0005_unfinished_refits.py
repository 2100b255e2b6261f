"""The refits that have not ended are found at once; the worker asks twice a second.

Revision ID: 0005
Revises: 0004
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Index them alone."""
    op.create_index(
        "ix_refit_unfinished",
        "refit",
        ["camera", "requested_at"],
        sqlite_where=sa.text("finished_at IS NULL"),
        postgresql_where=sa.text("finished_at IS NULL"),
    )


def downgrade() -> None:
    """Look through all again."""
    op.drop_index("ix_refit_unfinished")
