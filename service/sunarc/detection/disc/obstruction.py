"""Detection of obstructions in front of the sun from the sky's own light."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray, Image
from sunarc.detection.disc.limits import MIN_PEAK_FRACTION
from sunarc.detection.values import Expectation, Sensor
from sunarc.findings import Finding

_TILE = 64
_TILE_ROWS = 8  # every so many rows are looked at
_DARK_SHARE = 0.5  # of the sky's light, below which no cloud is
_SIGNIFICANT = 6.0
_DETECTABLE = 3.0  # predicted level over the detection limit from which a missing disc is significant


def obstruction(image: Image, *, sensor: Sensor, expectation: Expectation, reach_px: float) -> Finding | None:
    """Return that a sun that was not found is behind a mast or a building; None where that is not certain.

    A cloud in front of the sun is brighter than most of the sky; a building is dark. So the surroundings of the
    predicted pixel must be darker than half of the sky (the brighter quarter of the image's 64 px tiles), the
    difference must exceed 6 of its sigmas, and a clear sun must be well above the detection limit at this exposure
    (`clear_peak_fraction`). Where an exposure is too short for the sky to show, or the obstruction is smaller than
    the surroundings, the result is None.

    Parameters
    ----------
    image : (rows, columns) counts.
    reach_px : half the square around the expected pixel that counts as its surroundings.
    """
    clear = expectation.clear_peak_fraction
    if clear is None or clear < _DETECTABLE * MIN_PEAK_FRACTION:
        return None
    x, y, reach = round(expectation.x_px), round(expectation.y_px), math.ceil(reach_px)
    part = image[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1].astype(np.float64)
    tiles = _tile_means(image)
    if tiles.size == 0 or part.size == 0:
        return None
    noise = math.hypot(sensor.read_noise_e / sensor.gain_e_per_count, 0.3)
    part = np.minimum(part, float(np.median(part)) + 5.0 * noise)  # hot pixels are clipped
    level, sky = float(part.mean()) - sensor.black_level, float(np.quantile(tiles, 0.75)) - sensor.black_level
    sigma = math.hypot(float(part.std()), noise) / math.sqrt(part.size)
    if level > _DARK_SHARE * sky or sky - level < _SIGNIFICANT * sigma:
        return None
    return Finding("sun_obstructed", {"level": level / sensor.full_scale, "sky": sky / sensor.full_scale})


def _tile_means(image: Image) -> FloatArray:
    """Return the mean of some rows of every whole tile, flat."""
    down, across = image.shape[0] // _TILE, image.shape[1] // _TILE
    rows = image[: down * _TILE : _TILE_ROWS, : across * _TILE]
    return np.asarray(rows.reshape(down, _TILE // _TILE_ROWS, across, _TILE).mean(axis=(1, 3))).ravel()
