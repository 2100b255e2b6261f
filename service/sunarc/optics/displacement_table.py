"""The displacement taken out of many pixels at once, from cubic splines on a grid over the image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import spline_filter

from sunarc.array_types import FloatArray
from sunarc.jit import njit
from sunarc.optics.cubic_spline import spline_weights
from sunarc.optics.displacement import Displacement

_PER_HALF_WAVE = 32.0
"""Nodes a half wave of the shortest: a cubic spline is then off by (pi / 32)⁴ / 384 of its amplitude, 2e-7."""
_MARGIN = 4
"""Nodes beyond the image on each side: the spline's edge does not reach back further."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DisplacementTable:
    """A displacement's inverse, ready for many pixels.

    Attributes
    ----------
    displacement : answers beyond the grid.
    origin_px, step_px : of the grid, along x and y.
    coefficients : (rows, columns, 2) of the splines of the displacement, as a function of the displaced pixel, px.
    """

    displacement: Displacement
    origin_px: tuple[float, float]
    step_px: tuple[float, float]
    coefficients: FloatArray

    def taken_out(self, pixels: FloatArray) -> FloatArray:
        """Return (n, 2): what `Displacement.taken_out` returns for pixels (n, 2), to 1e-6 px."""
        pixel = np.ascontiguousarray(pixels, dtype=np.float64)
        result = np.empty(pixel.shape)
        if _write_taken_out(self.coefficients, self.origin_px, self.step_px, pixel, result):
            beyond = np.isinf(result[:, 0])
            result[beyond] = self.displacement.taken_out(pixel[beyond])
        return result


def displacement_table(displacement: Displacement, *, width: int, height: int) -> DisplacementTable:
    """Return the table of a displacement over an image of `width` by `height` px."""
    orders = np.max(np.array(displacement.orders), axis=0, initial=1)
    steps = [2.0 * half / (_PER_HALF_WAVE * order) for half, order in zip(displacement.half_px, orders, strict=True)]
    counts = [math.ceil(size / step) + 1 + 2 * _MARGIN for size, step in zip((width, height), steps, strict=True)]
    origin = (-0.5 - _MARGIN * steps[0], -0.5 - _MARGIN * steps[1])
    axes = [origin[a] + steps[a] * np.arange(counts[a]) for a in (0, 1)]
    nodes = np.stack(np.meshgrid(*axes, indexing="xy"), axis=-1)
    shift = nodes - displacement.taken_out(nodes.reshape(-1, 2)).reshape(nodes.shape)
    coefficients = np.stack([spline_filter(shift[..., a], order=3, mode="mirror") for a in (0, 1)], axis=-1)
    return DisplacementTable(
        displacement=displacement,
        origin_px=origin,
        step_px=(steps[0], steps[1]),
        coefficients=np.ascontiguousarray(coefficients),
    )


@njit(nogil=True)
def _write_taken_out(
    coefficients: FloatArray,
    origin: tuple[float, float],
    step: tuple[float, float],
    pixels: FloatArray,
    result: FloatArray,
) -> bool:
    """Write the pixels without the displacement; infinite beyond the grid, and whether any is."""
    rows, columns = coefficients.shape[0], coefficients.shape[1]
    any_beyond = False
    for i in range(pixels.shape[0]):
        x, y = pixels[i, 0], pixels[i, 1]
        across, down = (x - origin[0]) / step[0] - 1.0, (y - origin[1]) / step[1] - 1.0
        if math.isnan(across) or math.isnan(down):
            result[i, 0], result[i, 1] = np.nan, np.nan
            continue
        if not (0.0 <= across < columns - 3.0 and 0.0 <= down < rows - 3.0):
            result[i, 0], any_beyond = np.inf, True
            continue
        a, a0, a1, a2, a3 = spline_weights(across, columns - 4)
        b, b0, b1, b2, b3 = spline_weights(down, rows - 4)
        shift_x, shift_y = 0.0, 0.0
        for k, weight in enumerate((b0, b1, b2, b3)):
            for m, along in enumerate((a0, a1, a2, a3)):
                shift_x += weight * along * coefficients[b + k, a + m, 0]
                shift_y += weight * along * coefficients[b + k, a + m, 1]
        result[i, 0], result[i, 1] = x - shift_x, y - shift_y
    return any_beyond
