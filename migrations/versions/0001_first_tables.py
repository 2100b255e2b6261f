"""The first tables.

Revision ID: 0001
Revises:
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Create them; times are whole microseconds since 1970-01-01 UTC."""
    _create_cameras()
    _create_sightings()
    if _is_postgresql():
        _partition_sightings()
    _create_calibrations()
    _create_events()


def _create_cameras() -> None:
    op.create_table(
        "camera",
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("latitude", sa.Float(), nullable=False),
        sa.Column("longitude", sa.Float(), nullable=False),
        sa.Column("altitude", sa.Float(), nullable=False),
        sa.Column("width", sa.Integer(), nullable=False),
        sa.Column("height", sa.Integer(), nullable=False),
        sa.Column("model", sa.Text(), nullable=False),
        sa.Column("serial", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("name", name="pk_camera"),
    )
    op.create_table(
        "pose_epoch",
        sa.Column("id", sa.Text(), nullable=False),
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("started_at", sa.BigInteger(), nullable=False),
        sa.Column("ended_at", sa.BigInteger()),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_pose_epoch"),
        sa.ForeignKeyConstraint(["camera"], ["camera.name"], name="fk_pose_epoch_camera"),
        sa.UniqueConstraint("camera", "started_at", name="uq_pose_epoch"),
    )


def _is_postgresql() -> bool:
    return op.get_bind().dialect.name == "postgresql"


def _create_sightings() -> None:
    partitioned = _is_postgresql()  # there every unique key has the partitions' column, the time
    op.create_table(
        "sun_point",
        *(
            (sa.Column("id", sa.BigInteger(), sa.Identity(), nullable=False),)
            if partitioned
            else (sa.Column("id", sa.Integer(), nullable=False),)
        ),
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("pose_epoch", sa.Text(), nullable=False),
        sa.Column("time", sa.BigInteger(), nullable=False),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("exposure_us", sa.Float(), nullable=False),
        sa.Column("method", sa.Text(), nullable=False),
        sa.Column("accepted", sa.Boolean(), nullable=False),
        sa.Column("verdict", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("x_px", sa.Float()),
        sa.Column("y_px", sa.Float()),
        sa.Column("sigma_px", sa.Float()),
        sa.Column("peak_fraction", sa.Float()),
        sa.Column("background_fraction", sa.Float()),
        sa.Column("radius_px", sa.Float()),
        sa.Column("ellipticity", sa.Float()),
        sa.Column("residual_chi2", sa.Float()),
        sa.Column("snr", sa.Float()),
        sa.Column("saturated_px", sa.Integer()),
        sa.Column("clock_error_s", sa.Float()),
        sa.PrimaryKeyConstraint(*(("id", "time") if partitioned else ("id",)), name="pk_sun_point"),
        sa.ForeignKeyConstraint(["camera"], ["camera.name"], name="fk_sun_point_camera"),
        sa.ForeignKeyConstraint(["pose_epoch"], ["pose_epoch.id"], name="fk_sun_point_pose_epoch"),
        sa.UniqueConstraint("camera", "time", "body", "exposure_us", "method", name="uq_sun_point"),
        postgresql_partition_by="RANGE (time)",
    )
    op.create_table(
        "day",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("date", sa.Date(), nullable=False),
        sa.Column("verdict", sa.Text(), nullable=False),
        sa.Column("reasons", sa.JSON(), nullable=False),
        sa.Column("n", sa.Integer(), nullable=False),
        sa.Column("n_possible", sa.Integer(), nullable=False),
        sa.Column("decided_at", sa.BigInteger(), nullable=False),
        sa.Column("arc_deg", sa.Float()),
        sa.Column("sd_px", sa.Float()),
        sa.Column("rmsd_px", sa.Float()),
        sa.PrimaryKeyConstraint("camera", "date", name="pk_day"),
        sa.ForeignKeyConstraint(["camera"], ["camera.name"], name="fk_day_camera"),
    )


def _partition_sightings() -> None:
    """Make what makes the partition of a month; whoever may store a sighting may call it, and make no other table."""
    op.create_index("ix_sun_point_time", "sun_point", ["time"], postgresql_using="brin")
    schema = op.get_bind().dialect.identifier_preparer.quote(op.get_bind().scalar(sa.select(sa.func.current_schema())))
    op.execute(
        f"""
        CREATE FUNCTION sunarc_require_month(moment bigint) RETURNS void
        LANGUAGE plpgsql SECURITY DEFINER SET search_path = {schema}, pg_temp AS $$
        DECLARE
            first timestamp := date_trunc('month', to_timestamp(moment / 1000000) AT TIME ZONE 'UTC');
            partition text := 'sun_point_' || to_char(first, 'YYYYMM');
        BEGIN
            IF first NOT BETWEEN '1970-01-01' AND '2199-12-01' THEN
                RAISE EXCEPTION 'no sightings of the year %', extract(year FROM first) USING ERRCODE = '22008';
            END IF;
            IF to_regclass(partition) IS NULL THEN
                EXECUTE format(
                    'CREATE TABLE %I PARTITION OF sun_point FOR VALUES FROM (%s) TO (%s)',
                    partition,
                    extract(epoch FROM first)::bigint * 1000000,
                    extract(epoch FROM first + interval '1 month')::bigint * 1000000
                );
            END IF;
        END $$
        """
    )
    op.execute("REVOKE ALL ON FUNCTION sunarc_require_month(bigint) FROM PUBLIC")


def _create_calibrations() -> None:
    op.create_table(
        "calibration",
        sa.Column("id", sa.Text(), nullable=False),
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("method", sa.Text(), nullable=False),
        sa.Column("created_at", sa.BigInteger(), nullable=False),
        sa.Column("valid_from", sa.BigInteger(), nullable=False),
        sa.Column("valid_until", sa.BigInteger()),
        sa.Column("pose_epoch", sa.Text()),
        sa.Column("parent", sa.Text()),
        sa.Column("accepted", sa.Boolean(), nullable=False),
        sa.Column("reasons", sa.JSON(), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_calibration"),
        sa.ForeignKeyConstraint(["camera"], ["camera.name"], name="fk_calibration_camera"),
        sa.ForeignKeyConstraint(["pose_epoch"], ["pose_epoch.id"], name="fk_calibration_pose_epoch"),
        sa.ForeignKeyConstraint(["parent"], ["calibration.id"], name="fk_calibration_parent"),
    )
    op.create_index("ix_calibration_camera_valid_from", "calibration", ["camera", "valid_from"])
    op.create_index(
        "uq_calibration_one_current",
        "calibration",
        ["camera"],
        unique=True,
        sqlite_where=sa.text("state = 'current'"),
        postgresql_where=sa.text("state = 'current'"),
    )


def _create_events() -> None:
    op.create_table(
        "refit",
        sa.Column("id", sa.Text(), nullable=False),
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("requested_at", sa.BigInteger(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("started_at", sa.BigInteger()),
        sa.Column("finished_at", sa.BigInteger()),
        sa.Column("calibration", sa.Text()),
        sa.Column("message", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_refit"),
        sa.ForeignKeyConstraint(["camera"], ["camera.name"], name="fk_refit_camera"),
        sa.ForeignKeyConstraint(["calibration"], ["calibration.id"], name="fk_refit_calibration"),
    )
    op.create_index("ix_refit_camera_requested_at", "refit", ["camera", "requested_at"])
    op.create_table(
        "event",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("camera", sa.Text()),
        sa.Column("time", sa.BigInteger(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("severity", sa.Text(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("details", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_event"),
        sa.ForeignKeyConstraint(["camera"], ["camera.name"], name="fk_event_camera"),
    )
    op.create_index("ix_event_time", "event", ["time"])
