"""A hub's nightly work: summaries of days, how the nights went, and the function that drops old partitions.

Revision ID: 0014
Revises: 0013
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """The first night summarises every day that there is."""
    op.create_table(
        "day_summary",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("date", sa.Date(), nullable=False),
        sa.Column("verdict", sa.Text(), nullable=False),
        sa.Column("n_sightings", sa.Integer(), nullable=False),
        sa.Column("n_accepted", sa.Integer(), nullable=False),
        sa.Column("clock_error_s", sa.Float()),
        sa.Column("temperature_c", sa.Float()),
        sa.Column("n_warnings", sa.Integer(), nullable=False),
        sa.Column("calibration", sa.Text()),
        sa.Column("sky_rms_deg", sa.Float()),
        sa.Column("pose_offset_deg", sa.Float()),
        sa.Column("decided_at", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("camera", "date", name="pk_day_summary"),
        sa.ForeignKeyConstraint(["camera"], ["camera.name"], name="fk_day_summary_camera"),
    )
    op.create_table(
        "nightly_run",
        sa.Column("night", sa.Date(), nullable=False),
        sa.Column("started_at", sa.BigInteger(), nullable=False),
        sa.Column("finished_at", sa.BigInteger()),
        sa.Column("results", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("night", name="pk_nightly_run"),
    )
    if op.get_bind().dialect.name == "postgresql":
        _create_function()


def _create_function() -> None:
    """Make what drops partitions; whoever may store a sighting may call it, and it refuses what is young."""
    schema = op.get_bind().dialect.identifier_preparer.quote(op.get_bind().scalar(sa.select(sa.func.current_schema())))
    op.execute(
        f"""
        CREATE FUNCTION sunarc_drop_months(before bigint) RETURNS integer
        LANGUAGE plpgsql SECURITY DEFINER SET search_path = {schema}, pg_temp AS $$
        DECLARE
            first timestamp := date_trunc('month', to_timestamp(before / 1000000) AT TIME ZONE 'UTC');
            partition regclass;
            dropped integer := 0;
        BEGIN
            IF first > (now() AT TIME ZONE 'UTC') - interval '90 days' THEN
                RAISE EXCEPTION 'sightings younger than 90 days are kept' USING ERRCODE = '22008';
            END IF;
            FOR partition IN
                SELECT inhrelid::regclass FROM pg_inherits JOIN pg_class ON pg_class.oid = inhrelid
                WHERE inhparent = 'sun_point'::regclass AND relname ~ '^sun_point_[0-9]{{6}}$'
                    AND relname < 'sun_point_' || to_char(first, 'YYYYMM')
            LOOP
                EXECUTE format('DROP TABLE %s', partition);
                dropped := dropped + 1;
            END LOOP;
            RETURN dropped;
        END $$
        """  # noqa: S608 - the schema's name is quoted
    )
    op.execute("REVOKE ALL ON FUNCTION sunarc_drop_months(bigint) FROM PUBLIC")


def downgrade() -> None:
    """Summaries are made anew after the next upgrade."""
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP FUNCTION sunarc_drop_months(bigint)")
    op.drop_table("nightly_run")
    op.drop_table("day_summary")
