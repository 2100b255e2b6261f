"""Checks that an array is an image."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import Image
from sunarc.detection.values import Sensor
from sunarc.errors import InputError


def require_raw(image: Image, sensor: Sensor) -> None:
    """Raise InputError unless the image is a (rows, columns) array of the sensor's counts."""
    if image.ndim != 2 or min(image.shape) < 1:
        raise InputError(
            field="image", problem=f"its shape is {image.shape}", remedy="give one raw plane: rows and columns"
        )
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(field="image", problem=f"its type is {image.dtype}", remedy="give uint8 or uint16")
    if image.dtype == np.uint8 and sensor.full_scale > 255:
        raise InputError(
            field="image",
            problem=f"8 bits cannot hold a full scale of {sensor.full_scale}",
            remedy="correct full_scale",
        )


def require_photo(image: Image, *, full_scale: int) -> None:
    """Raise InputError unless the image is a (rows, columns) or (rows, columns, 3) array that holds the full scale."""
    if image.ndim not in {2, 3} or (image.ndim == 3 and image.shape[2] != 3) or min(image.shape) < 1:
        raise InputError(
            field="image", problem=f"its shape is {image.shape}", remedy="give rows, columns (and 3 colours)"
        )
    if image.dtype not in (np.uint8, np.uint16) or not 0 < full_scale <= np.iinfo(image.dtype).max:
        raise InputError(
            field="image", problem=f"{image.dtype} with full scale {full_scale}", remedy="give uint8 or uint16 counts"
        )
