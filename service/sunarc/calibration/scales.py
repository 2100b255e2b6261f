"""Which scales the data speak for: amplitude and length of the field, and of the residual radial distortion."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.evidence import Normal, Scales, log_evidences
from sunarc.calibration.field import WaveBasis, wave_basis

FloatArray = NDArray[np.float64]

_LENGTH_FRACTIONS = (0.16, 0.24, 0.36, 0.54)
"""Lengths tried, as fractions of the image's shorter side."""
_LARGEST_AMPLITUDE_PX = 3.2
_AMPLITUDES = 12
_RADIALS_PX = np.array([0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 8.0, 16.0, 32.0, 64.0])
_RADIAL_DOUBT = math.log(2.5)
_USUAL_FIELD_PX = 0.05
_FIELD_DOUBT = math.log(10.0)


class Grid(NamedTuple):
    """The scales that are tried."""

    amplitudes: FloatArray
    lengths: FloatArray
    radials: FloatArray
    log_prior: FloatArray
    basis: WaveBasis


def scale_grid(*, width: int, height: int, floor_px: float, radial_px: float) -> Grid:
    """Return the grid of scales for an image size.

    Parameters
    ----------
    width, height : px.
    floor_px : the smallest field that is ever assumed.
    radial_px : the usual scale of the residual radial distortion.
    """
    lengths = np.array(_LENGTH_FRACTIONS) * min(width, height)
    amplitudes = np.geomspace(max(floor_px, 1e-4), _LARGEST_AMPLITUDE_PX, _AMPLITUDES)
    radials = _RADIALS_PX * radial_px / 2.0
    of_amplitude = -0.5 * (np.log(amplitudes / _USUAL_FIELD_PX) / _FIELD_DOUBT) ** 2
    of_radial = -0.5 * (np.log(radials / radial_px) / _RADIAL_DOUBT) ** 2
    spacing = np.log(np.gradient(np.log(radials)))
    log_prior = of_amplitude[:, None, None] + np.zeros((1, lengths.size, 1)) + of_radial + spacing
    basis = wave_basis(width=width, height=height, shortest_px=float(lengths[0]), longest_px=float(lengths[-1]))
    return Grid(amplitudes, lengths, radials, log_prior, basis)


def likely_scales(normal: Normal, grid: Grid) -> Scales:
    """Return the scales' posterior means: of A² and of the logarithms of the two others."""
    log_weight = grid.log_prior + log_evidences(normal, grid.basis, grid.amplitudes, grid.lengths, grid.radials)
    weight = np.exp(log_weight - np.max(log_weight))
    weight /= weight.sum()
    amplitude = math.sqrt(float(np.sum(weight.sum(axis=(1, 2)) * grid.amplitudes**2)))
    by_length = np.einsum("ijk,i->j", weight, grid.amplitudes**2)
    length = math.exp(float(np.sum(by_length * np.log(grid.lengths)) / by_length.sum()))
    radial = math.exp(float(np.sum(weight.sum(axis=(0, 1)) * np.log(grid.radials))))
    return Scales(amplitude, length, radial)
