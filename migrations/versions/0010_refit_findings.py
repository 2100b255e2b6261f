"""Refits say how they ended as findings, beside the sentence.

Revision ID: 0010
Revises: 0009
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Of refits that ended until now the sentence is the finding."""
    op.add_column("refit", sa.Column("findings", sa.JSON()))
    if op.get_bind().dialect.name != "sqlite":
        return  # a PostgreSQL database begins at a later revision: it has no refit yet
    # cast: one damaged bit can make a BLOB of a text, which json_object refuses, and with it the whole upgrade
    text = "json_object('text', CAST(message AS TEXT))"
    uncoded = f"json_array(json_object('code', 'uncoded', 'data', {text}))"
    op.execute(f"UPDATE refit SET findings = {uncoded} WHERE message <> ''")  # noqa: S608 - constants


def downgrade() -> None:
    """Forget the codes; the sentence stays."""
    op.drop_column("refit", "findings")
