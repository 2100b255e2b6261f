"""Several exposures of the same scene as one image, linear in radiance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sunarc import _kernels
from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.detection.values import Sensor

_FULL = 65535.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HdrImage:
    """An image linear in radiance.

    Attributes
    ----------
    image : (rows, columns) uint16; a Bayer mosaic stays one.
    counts_per_us : the camera's counts per microsecond that one unit of `image` stands for.
    exposures_us : what it was merged from, shortest first.
    saturated_px : pixels that were saturated even in the shortest exposure; they hold its limit.
    """

    image: NDArray[np.uint16]
    counts_per_us: float
    exposures_us: tuple[float, ...]
    saturated_px: int


def merge_hdr(images: Sequence[Image], exposures_us: Sequence[float], *, sensor: Sensor) -> HdrImage:
    """Merge exposures, each weighted by its noise, saturated pixels left out.

    Parameters
    ----------
    images : raw frames of one shape and type, mono or Bayer (merged pixel by pixel, so that a mosaic stays one).
    exposures_us : their exposures.
    sensor : full scale, gain, read noise, black level.

    Returns
    -------
    The image; full scale of the shortest exposure is 65535.

    Raises
    ------
    InputError : no images, unlike shapes, or an exposure that is not positive.
    """
    _require_alike(images, exposures_us)
    order = np.argsort(np.asarray(exposures_us, dtype=np.float64), kind="stable")
    stack = cast("Image", np.stack([images[int(i)] for i in order]))
    exposures = np.asarray(exposures_us, dtype=np.float64)[order]
    read_variance = (sensor.read_noise_e / sensor.gain_e_per_count) ** 2 + 1.0 / 12.0
    full = float(sensor.full_scale)
    merged, saturated = _kernels.merge_exposures(
        stack, exposures, sensor.black_level, full, read_variance, 1.0 / sensor.gain_e_per_count
    )
    return HdrImage(
        image=merged,
        counts_per_us=(full - sensor.black_level) / float(exposures[0]) / _FULL,
        exposures_us=tuple(exposures.tolist()),
        saturated_px=saturated,
    )


def _require_alike(images: Sequence[Image], exposures_us: Sequence[float]) -> None:
    if not images or len(images) != len(exposures_us):
        raise InputError(field="images", problem="not one exposure to each image", remedy="give as many of each")
    if any(image.shape != images[0].shape or image.dtype != images[0].dtype or image.ndim != 2 for image in images):
        raise InputError(field="images", problem="unlike shapes or types", remedy="give raw frames of one camera")
    if not all(math.isfinite(exposure) and exposure > 0.0 for exposure in exposures_us):
        raise InputError(field="exposures_us", problem="not positive", remedy="give microseconds")
