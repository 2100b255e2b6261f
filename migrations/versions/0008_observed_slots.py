"""Days tell in how many slots the sun was observed, so that missed slots are not taken for clouds.

Revision ID: 0008
Revises: 0007
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Of days judged until now it was not counted."""
    op.add_column("day", sa.Column("n_observed", sa.Integer()))


def downgrade() -> None:
    """Forget it; the verdicts stay."""
    op.drop_column("day", "n_observed")
