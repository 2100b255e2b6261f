"""Horizon profile: the elevation below which the sky is hidden, by azimuth, from an obstruction mask."""

from __future__ import annotations

import calendar
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.utc import DAY_S
from sunarc.imaging.obstructions import (
    SOILED,
    CellGrid,
    Cells,
    ObstructionMask,
    ObstructionSums,
    obstruction_mask,
    sampled_cells,
)
from sunarc.optics.camera import Camera, camera_sees
from sunarc.optics.forward import project_fast
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HorizonProfile:
    """Horizon seen by the camera, by azimuth in whole degrees."""

    elevation_deg: FloatArray
    """(360,) highest elevation that is hidden; 0 where nothing is. NaN where the camera does not see."""
    sigma_deg: FloatArray
    """(360,) 1-sigma."""
    openings: tuple[tuple[tuple[float, float], ...], ...]
    """Of each azimuth, the spans of elevation below it through which the sky is seen, degrees."""

    def hides(self, directions: FloatArray) -> BoolArray:
        """Return (...): which directions (..., 3), east-north-up, lie below it and in no opening."""
        east, north, up = np.moveaxis(directions, -1, 0)
        column = np.rint(np.degrees(np.arctan2(east, north))).astype(int) % 360
        elevation = np.degrees(np.arctan2(up, np.hypot(east, north)))
        hidden = elevation < np.nan_to_num(self.elevation_deg)[column]
        for number, spans in enumerate(self.openings):
            for lowest, highest in spans:
                hidden &= ~((column == number) & (elevation >= lowest) & (elevation < highest))
        return np.asarray(hidden)


_STEP_DEG = 0.1
_OPENING_DEG = 1.0
_ELEVATION = np.arange(0.0, 90.0, _STEP_DEG)
_AT_ONCE = 20
"""Azimuths at a time, for the sake of memory."""
_OFFSETS_DEG = (-0.4, -0.2, 0.0, 0.2, 0.4)


def find_obstructions(
    sums: ObstructionSums, grid: CellGrid, *, sigma_deg: float = 0.0
) -> tuple[ObstructionMask, HorizonProfile]:
    """Return the mask and the horizon of the evidence; `sigma_deg`: see `horizon_profile`, NaN counts as 0."""
    mask = obstruction_mask(sums, grid)
    return mask, horizon_profile(mask, sigma_deg=0.0 if math.isnan(sigma_deg) else sigma_deg)


def horizon_profile(mask: ObstructionMask, *, sigma_deg: float = 0.0) -> HorizonProfile:
    """Return the horizon of a mask.

    Parameters
    ----------
    mask : of the camera; dirt on its dome does not count.
    sigma_deg : 1-sigma of the calibration's directions near the horizon.
    """
    clean = np.where(mask.state == SOILED, 0.0, mask.probability).astype(np.float32)
    parts = [_measure_azimuths(clean, mask.grid.camera, azimuth) for azimuth in np.arange(360.0).reshape(-1, _AT_ONCE)]
    tops, widths, seen, middle = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    top = np.median(tops, axis=1)
    resolution = mask.grid.resolution_deg / math.sqrt(12.0)
    spread = 1.48 * np.median(np.abs(tops - top[:, None]), axis=1)
    soft = np.median(np.abs(widths - tops), axis=1) / 2.0
    sigma = np.sqrt(resolution**2 + spread**2 + soft**2 + sigma_deg**2)
    top[~seen] = np.nan
    openings = tuple(_find_openings(row, highest) for row, highest in zip(middle, top.tolist(), strict=True))
    return HorizonProfile(elevation_deg=top, sigma_deg=sigma, openings=openings)


def _measure_azimuths(
    probability: Cells, camera: Camera, azimuth_deg: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray, Cells]:
    """Return by azimuth (n): highest elevations at half and at a tenth, whether it is seen, and probabilities."""
    azimuth = (azimuth_deg[:, None] + np.array(_OFFSETS_DEG))[..., None]
    directions = direction_from_angles(zenith_deg=90.0 - _ELEVATION, azimuth_deg=azimuth)
    at = project_fast(camera, directions.reshape(-1, 3))
    shape = directions.shape[:-1]
    seen = (camera_sees(camera, at) & np.isfinite(at).all(axis=-1)).reshape(shape)
    hidden = sampled_cells(probability, at.reshape(shape[0], -1, 2), camera).reshape(shape)
    middle = np.where(seen, hidden, np.float32(1.0))[:, len(_OFFSETS_DEG) // 2]
    tops, widths = (_highest_hidden_elevation((hidden > limit) & seen) for limit in (0.5, 0.1))
    return tops, widths, np.asarray(seen.any(axis=(1, 2))), middle


def _highest_hidden_elevation(above: BoolArray) -> FloatArray:
    """Return (...) the highest elevation at which something holds (..., elevations), 0 where it holds nowhere."""
    last = above.shape[-1] - 1 - np.argmax(above[..., ::-1], axis=-1)
    return np.where(above.any(axis=-1), _ELEVATION[last] + 0.5 * _STEP_DEG * (last > 0), 0.0)


def _find_openings(hidden: Cells, highest: float) -> tuple[tuple[float, float], ...]:
    free = np.concatenate([[False], (hidden < 0.5) & (highest > _ELEVATION), [False]])
    edges = np.flatnonzero(np.diff(free.astype(int))).reshape(-1, 2)
    spans = [(round(first * _STEP_DEG, 1), round(last * _STEP_DEG, 1)) for first, last in edges.tolist()]
    return tuple(span for span in spans if span[1] - span[0] >= _OPENING_DEG)


class SunHours(NamedTuple):
    """Hours of each month (12,) with the sun up, and those of them in which it is behind the horizon of a profile."""

    up: FloatArray
    lost: FloatArray


_SAMPLED_DAYS, _EVERY_S = (5, 15, 25), 300.0


def sun_hours(profile: HorizonProfile, site: Site, *, year: int) -> SunHours:
    """Return the hours of sun that a horizon hides, by month, of three days each."""
    up, lost = np.zeros(12), np.zeros(12)
    for month in range(12):
        begins = [datetime(year, month + 1, day, tzinfo=UTC).timestamp() for day in _SAMPLED_DAYS]
        unix_s = np.add.outer(begins, np.arange(0.0, DAY_S, _EVERY_S)).ravel()
        directions = sun_directions(unix_s, site)
        days = calendar.monthrange(year, month + 1)[1] / len(_SAMPLED_DAYS)
        risen = directions[:, 2] > 0.0
        hours = days * _EVERY_S / 3600.0
        up[month], lost[month] = (hours * np.count_nonzero(one) for one in (risen, risen & profile.hides(directions)))
    return SunHours(up, lost)
