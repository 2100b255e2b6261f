"""Input of a fit from the archive's columns."""

from __future__ import annotations

import numpy as np

from sunarc.archive.values import SunPointColumns
from sunarc.calibration.model.kinds import kinds_of
from sunarc.calibration.model.sightings import SunPoints
from sunarc.sky.night import SUN, body_directions
from sunarc.sky.site import Site


def points_of(columns: SunPointColumns, *, site: Site | None = None, latest: str | None = None) -> SunPoints:
    """Return the sightings of an archive's columns.

    Parameters
    ----------
    columns : sightings in the order of time.
    site : where the camera stands, for the directions of stars and planets; None where all are of the sun.
    latest : the pose epoch that is numbered last, so that a fit is of it; the last in time where None or not present.
    """
    epoch = columns.epoch
    if latest in columns.epoch_ids[:-1]:
        index = columns.epoch_ids.index(latest)
        epoch = np.where(epoch == index, len(columns.epoch_ids) - 1, epoch - (epoch > index))
    if site is None and np.any(columns.body != SUN):
        raise ValueError("sightings of stars without a site")
    air = {"temperature": columns.temperature, "pressure": columns.pressure}
    directions = None if site is None else body_directions(columns.body, columns.unix_s, site, **air)
    return SunPoints(
        unix_s=columns.unix_s,
        pixels=columns.pixels,
        sigma_px=columns.sigma_px,
        epoch=epoch,
        clock_error_s=columns.clock_error_s,
        kind=kinds_of(columns.body),
        **air,
        **({} if directions is None else {"directions": directions}),
    )
