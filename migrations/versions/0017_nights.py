"""Nights as rows, as days are; until now their events were all that said what a night was like.

Revision ID: 0017
Revises: 0016
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date, datetime
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None

_VERDICTS = {"clear", "partly", "cloudy", "moonlit", "unusable"}
_COUNTS = (
    *("n_images", "n_accepted", "n_stored", "n_moon_images", "n_moon_stored", "n_warm_pixels", "n_stars", "n_matched"),
)
_NUMBERS = (
    *("star_offset_px", "limiting_magnitude", "star_fwhm_px", "cloud_fraction", "transparency", "extinction"),
    *("extinction_sigma", "zero_point", "star_ellipticity", "halo", "width_growth", "halo_growth", "fading_mag"),
)


def upgrade() -> None:
    """Make a row of the last event of each night; the events stay."""
    night = op.create_table(
        "night",
        sa.Column("camera", sa.Text(), nullable=False),
        sa.Column("date", sa.Date(), nullable=False),
        sa.Column("verdict", sa.Text(), nullable=False),
        sa.Column("findings", sa.JSON(), nullable=False),
        sa.Column("decided_at", sa.BigInteger(), nullable=False),
        *(sa.Column(name, sa.Integer(), nullable=False) for name in _COUNTS),
        *(sa.Column(name, sa.Float()) for name in _NUMBERS),
        sa.Column("zenith_bands", sa.JSON(), nullable=False),
        sa.Column("images", sa.JSON(none_as_null=True)),
        sa.Column("picture_time", sa.BigInteger()),
        sa.ForeignKeyConstraint(["camera"], ["camera.name"], name="fk_night_camera"),
        sa.PrimaryKeyConstraint("camera", "date", name="pk_night"),
    )
    event = sa.table(
        "event",
        *(sa.column("id"), sa.column("camera"), sa.column("time", sa.BigInteger()), sa.column("kind")),
        sa.column("details", sa.JSON()),
    )
    told = sa.select(event).where(event.c.kind == "night", event.c.camera.is_not(None)).order_by(event.c.id)
    found = (_row(one.camera, one.time, one.details) for one in op.get_bind().execute(told).all())
    rows = {(row["camera"], row["date"]): row for row in found if row is not None}  # as it was judged last
    if rows:
        op.bulk_insert(night, [*rows.values()])


def downgrade() -> None:
    """Forget the rows: the events tell the same; what waits for a hub of them goes too."""
    op.drop_table("night")
    op.execute("DELETE FROM outbox WHERE kind IN ('night', 'night.removed')")


def _row(camera: str, time: object, details: object) -> dict[str, Any] | None:
    """Return the row of an event; None where it does not say which night was judged, and what it was."""
    if not isinstance(details, Mapping) or type(time) is not int or "verdict" not in details:
        return None
    try:
        evening = date.fromisoformat(str(details.get("date")))
    except ValueError:
        return None
    verdict, findings, images = details["verdict"], details.get("findings"), details.get("images")
    lacking = "verdict" if verdict not in _VERDICTS else "n_images" if type(details.get("n_images")) is not int else ""
    if lacking:
        verdict, findings = "unusable", [{"code": "night_damaged", "data": {"field": lacking}}]
    bands = details.get("zenith_bands")
    return {
        "camera": camera,
        "date": evening,
        "verdict": verdict,
        "findings": findings if isinstance(findings, list) else [],
        "decided_at": time,
        # a number that the version of then did not have: none were counted, and nothing is known
        **{name: count if type(count := details.get(name)) is int else 0 for name in _COUNTS},
        **{name: number if isinstance(number := details.get(name), int | float) else None for name in _NUMBERS},
        "zenith_bands": bands if isinstance(bands, list) else [],
        "images": images if isinstance(images, Mapping) else None,
        "picture_time": _microseconds(details.get("picture_time")),
    }


def _microseconds(time: object) -> int | None:
    """Return an RFC 3339 time in microseconds since 1970-01-01 UTC; None where there is none."""
    try:
        return None if time is None else round(datetime.fromisoformat(str(time)).timestamp() * 1e6)
    except ValueError:
        return None
