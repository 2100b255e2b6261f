"""A camera's pixel format is remembered, so that another one is noticed.

Revision ID: 0006
Revises: 0005
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Until now nobody asked: empty is "not known"."""
    op.add_column("camera", sa.Column("pixel_format", sa.Text(), nullable=False, server_default=""))


def downgrade() -> None:
    """Forget it."""
    op.drop_column("camera", "pixel_format")
