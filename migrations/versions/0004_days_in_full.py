"""Days tell how much of the sky they showed, how the clock was, and how the camera stood.

Revision ID: 0004
Revises: 0003
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

_NEW = {
    "n_cycles": sa.Integer,
    "solid_angle_sr": sa.Float,
    "doubtful_clock": sa.Float,
    "pose_offset_deg": sa.JSON,
    "pose_offset_sigma_deg": sa.JSON,
}


def upgrade() -> None:
    """Of days judged until now it is not known."""
    for name, kind in _NEW.items():
        op.add_column("day", sa.Column(name, kind()))


def downgrade() -> None:
    """Forget it; the verdicts stay."""
    for name in _NEW:
        op.drop_column("day", name)
