"""Input of a fit from the archive's columns."""

from __future__ import annotations

import numpy as np

from sunarc.archive import SunPointColumns
from sunarc.calibration import SunPoints


def points_of(columns: SunPointColumns, *, latest: str | None = None) -> SunPoints:
    """Return the sightings of an archive's columns.

    Parameters
    ----------
    columns : sightings in the order of time.
    latest : the pose epoch that is numbered last, so that a fit is of it; the last in time where None or not present.
    """
    epoch = columns.epoch
    if latest in columns.epoch_ids[:-1]:
        index = columns.epoch_ids.index(latest)
        epoch = np.where(epoch == index, len(columns.epoch_ids) - 1, epoch - (epoch > index))
    return SunPoints(
        unix_s=columns.unix_s,
        pixels=columns.pixels,
        sigma_px=columns.sigma_px,
        epoch=epoch,
        clock_error_s=columns.clock_error_s,
        temperature=columns.temperature,
        pressure=columns.pressure,
    )
