"""The checksum of every calibration document.

Revision ID: 0007
Revises: 0006
"""

from __future__ import annotations

import hashlib
import json

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Compute it for the documents that can be read; the others stay without one, and count as damaged."""
    op.add_column("calibration", sa.Column("document_sha256", sa.Text(), nullable=False, server_default=""))
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        return  # a PostgreSQL database begins at a later revision: it has no calibration yet
    names = [row[0] for row in connection.execute(sa.text("SELECT _rowid_ FROM calibration"))]
    for name in names:  # one document at a time: together they may be larger than the memory
        of_this = {"name": name}
        read = sa.text("SELECT CAST(document AS BLOB) FROM calibration WHERE _rowid_ = :name")
        stored = connection.execute(read, of_this).scalar_one()
        if _is_object(stored):
            keep = sa.text("UPDATE calibration SET document_sha256 = :checksum WHERE _rowid_ = :name")
            connection.execute(keep, {**of_this, "checksum": hashlib.sha256(stored).hexdigest()})


def downgrade() -> None:
    """Forget it."""
    op.drop_column("calibration", "document_sha256")


def _is_object(stored: bytes) -> bool:
    try:
        return isinstance(json.loads(stored), dict)
    except ValueError:
        return False
