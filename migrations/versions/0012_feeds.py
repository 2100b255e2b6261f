"""What an imager sends to a hub and has not sent yet; what a hub knows of its imagers.

Revision ID: 0012
Revises: 0011
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

_TABLES = ("outbox", "outbox_position", "feed_token", "feed", "quarantine", "fleet")


def upgrade() -> None:
    """Nothing is sent until a hub is set."""
    _create_tables_of_an_imager()
    _create_tables_of_a_hub()
    _create_quarantine()


def _create_tables_of_an_imager() -> None:
    op.create_table(
        "outbox",
        sa.Column("seq", sa.Integer(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("data", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("seq", name="pk_outbox"),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "outbox_position",
        sa.Column("installation", sa.Text(), nullable=False),
        sa.Column("committed", sa.BigInteger(), nullable=False),
        sa.Column("sent", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("installation", name="pk_outbox_position"),
    )


def _create_tables_of_a_hub() -> None:
    op.create_table(
        "feed_token",
        sa.Column("digest", sa.Text(), nullable=False),
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("created_at", sa.BigInteger(), nullable=False),
        sa.Column("expires_at", sa.BigInteger()),
        sa.PrimaryKeyConstraint("digest", name="pk_feed_token"),
    )
    op.create_table(
        "feed",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("installation", sa.Text(), nullable=False),
        sa.Column("committed", sa.BigInteger(), nullable=False),
        sa.Column("accepted", sa.Boolean(), nullable=False),
        sa.Column("first_at", sa.BigInteger(), nullable=False),
        sa.Column("last_at", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("camera", "installation", name="pk_feed"),
    )
    op.create_table(
        "fleet",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("received_at", sa.BigInteger(), nullable=False),
        sa.Column("last_sighting_at", sa.BigInteger()),
        sa.Column("calibration", sa.Text()),
        sa.Column("calibrated_at", sa.BigInteger()),
        sa.Column("sky_rms_deg", sa.Float()),
        sa.Column("status", sa.JSON(), nullable=False),
        sa.Column("status_at", sa.BigInteger()),
        sa.PrimaryKeyConstraint("camera", name="pk_fleet"),
    )


def _create_quarantine() -> None:
    op.create_table(
        "quarantine",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("installation", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("seq", sa.BigInteger(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("data", sa.Text(), nullable=False),
        sa.Column("n", sa.Integer(), nullable=False),
        sa.Column("first_at", sa.BigInteger(), nullable=False),
        sa.Column("last_at", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("camera", "installation", "reason", "seq", name="pk_quarantine"),
    )
    op.create_index("ix_quarantine_last_at", "quarantine", ["last_at"])


def downgrade() -> None:
    """Forget it; what was sent is at the hub, and what was received stays."""
    if op.get_bind().dialect.name == "sqlite":
        triggers = sa.text("SELECT name FROM sqlite_master WHERE type = 'trigger' AND name LIKE 'outbox_%'")
        for name in op.get_bind().execute(triggers).scalars().all():
            op.execute(f'DROP TRIGGER "{name}"')
    for name in _TABLES:
        op.drop_table(name)
