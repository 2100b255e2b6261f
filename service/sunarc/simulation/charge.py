"""What a sensor does to light before it is counted: a mosaic of colours, and wells that run over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sunarc.detection.values import Bayer
from sunarc.jit import njit

_TRANSMISSION = {"R": 0.6, "G": 1.0, "B": 0.7}  # of white light, of the most sensitive colour's


def behind_mosaic(light: NDArray[np.float32], bayer: Bayer, *, first: tuple[int, int]) -> None:
    """Dim each pixel as its colour filter does; `first` is the sensor's column and row of the first pixel."""
    for k, letter in enumerate(bayer):
        row, column = (k // 2 - first[1]) % 2, (k % 2 - first[0]) % 2
        light[row::2, column::2] *= _TRANSMISSION[letter]


@njit(nogil=True)
def run_over(light: NDArray[np.float32], most: float, share: float) -> None:
    """Let what a well cannot hold run along its column, half up and half down, until wells with room have taken it.

    Parameters
    ----------
    light : (h, w), changed in place; what exceeds `most` stays as it is (it is cut off when counted).
    most : light that fills a well.
    share : of the excess that runs; the rest is drained.
    """
    height, width = light.shape
    for column in range(width):
        for way in range(2):
            carried = 0.0
            for step in range(height):
                row = step if way == 0 else height - 1 - step
                level = light[row, column]
                if level > most:
                    carried += 0.5 * share * (level - most)
                elif carried > 0.0:
                    added = min(carried, most - level)
                    light[row, column] = level + added
                    carried -= added
