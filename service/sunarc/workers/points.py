"""From the archive's columns to what a fit is given."""

from __future__ import annotations

from sunarc.archive import SunPointColumns
from sunarc.calibration import SunPoints


def points_of(columns: SunPointColumns) -> SunPoints:
    """Return the sightings of an archive's columns."""
    return SunPoints(
        unix_s=columns.unix_s,
        pixels=columns.pixels,
        sigma_px=columns.sigma_px,
        epoch=columns.epoch,
        clock_error_s=columns.clock_error_s,
    )
