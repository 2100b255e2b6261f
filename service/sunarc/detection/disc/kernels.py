"""Compiled loops over pixels of the disc fit: per-call cost of numpy would dominate.

Plain loops, which compile in seconds; kept on disk (`cache=True`), without the interpreter's lock (`nogil`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import FloatArray
from sunarc.jit import njit

Indices = NDArray[np.intp]
Compared = tuple[float, FloatArray, FloatArray, FloatArray]

_STEPPED = 0.1  # counts² of noise below which it does not blur the steps of rounding


@njit(nogil=True)
def compared(  # noqa: PLR0917 - compiled functions take positions
    planes: FloatArray,
    moved: Indices,
    scale: FloatArray,
    glare: tuple[float, float, float, float, float],
    pixels: tuple[Indices, FloatArray, Indices, FloatArray],
    flux: FloatArray,
    background: FloatArray,
    around: FloatArray,
    noise: tuple[float, float],
    by_counts: bool,  # noqa: FBT001 - as above
    binning: int,
    clip: float,
) -> Compared:
    """Compare a disc's model with the pixels.

    Parameters
    ----------
    planes : (k, binning rows, binning columns) the disc of unit flux, first its value, on the sensor's pixels.
    moved, scale : the planes that are derivatives by the free nonlinear parameters, and what each is multiplied by.
    glare : u and v are (a dx - b dy, c dy - b dx) and dx, dy are what a pixel is off (x, y): a, b, c, x, y.
    pixels : of the pixels used flat position, counts, colour, and offset (n, 2).
    flux, background : one per colour. around : the background's slope in x and y, smear of the columns, glare.
    noise : read noise in counts, electrons per count.
    by_counts : take the variance that the counts tell, not the model.
    binning, clip : each pixel is the mean of binning² of the sensor's, which are clipped at so many counts.

    Returns
    -------
    Twice the negative log likelihood, residual (n,), weight (n,) and Jacobian (n, p), its columns the free nonlinear
    parameters, flux and background of each colour, slope in x and y, smear and glare.
    """
    pixel, counts, colour, offset = pixels
    a, b, c, x, y = glare
    columns, share = planes.shape[2] // binning, 1.0 / binning**2
    nonlinear, colours = moved.size, flux.size
    smear = np.zeros(columns)
    for j in range(planes.shape[1]):
        for i in range(columns * binning):
            smear[i // binning] += planes[0, j, i] * share
    first = nonlinear + 2 * colours
    jacobian = np.zeros((pixel.size, first + 4))
    residual, weight, misfit = np.empty(pixel.size), np.empty(pixel.size), 0.0
    for i in range(pixel.size):
        channel, (j, k) = colour[i], divmod(pixel[i], columns)
        dx, dy = offset[i, 0] - x, offset[i, 1] - y
        u, v = a * dx - b * dy, c * dy - b * dx
        jacobian[i, first], jacobian[i, first + 1] = offset[i, 0], offset[i, 1]
        jacobian[i, first + 2], jacobian[i, first + 3] = smear[k], 1.0 / (1.0 + u * u + v * v)
        beside, model, unclipped = background[channel], 0.0, 0.0
        for m in range(4):
            beside += around[m] * jacobian[i, first + m]
        for row in range(j * binning, (j + 1) * binning):
            for column in range(k * binning, (k + 1) * binning):
                value = flux[channel] * planes[0, row, column] + beside
                if value >= clip:  # more light changes nothing
                    model += clip * share
                    continue
                model, unclipped = model + value * share, unclipped + share
                for m in range(nonlinear):
                    jacobian[i, m] += share * flux[channel] * scale[m] * planes[moved[m], row, column]
                jacobian[i, nonlinear + channel] += share * planes[0, row, column]
        jacobian[i, nonlinear + colours + channel] = unclipped
        for m in range(4):
            jacobian[i, first + m] *= unclipped
        variance = noise[0] ** 2 + max(counts[i] if by_counts else model, 0.0) / noise[1]
        variance = 0.25 if variance < _STEPPED else variance + 1.0 / 12.0
        residual[i], weight[i] = counts[i] - model, 1.0 / variance
        misfit += residual[i] * residual[i] / variance + math.log(variance)
    return misfit, residual, weight, jacobian


@njit(nogil=True)
def normal_of(jacobian: FloatArray, weight: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix (p, p) and the gradient (p,) of weighted least squares."""
    n, p = jacobian.shape
    matrix, gradient = np.zeros((p, p)), np.zeros(p)
    for i in range(n):
        for a in range(p):
            weighted = weight[i] * jacobian[i, a]
            if weighted != 0.0:
                gradient[a] += weighted * residual[i]
                for b in range(a, p):
                    matrix[a, b] += weighted * jacobian[i, b]
    for a in range(p):
        for b in range(a):
            matrix[a, b] = matrix[b, a]
    return matrix, gradient


@njit(nogil=True)
def information_sums(
    jacobian: FloatArray, weight: FloatArray, residual: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Return three sums over the pixels of their information on the first two parameters.

    They are the sum, the sum of squares, and the sum times each pixel's chi². A pixel's chi² is divided by one minus
    its leverage.
    """
    n, p = jacobian.shape
    sums, row = np.zeros(3), np.empty(p)
    for i in range(n):
        leverage = 0.0
        for a in range(p):
            row[a] = 0.0
            for b in range(p):
                row[a] += covariance[a, b] * jacobian[i, b]
            leverage += row[a] * jacobian[i, a] * weight[i]
        information = (row[0] * row[0] + row[1] * row[1]) * weight[i]
        sums[0] += information
        sums[1] += information * information
        sums[2] += information * weight[i] * residual[i] * residual[i] / max(1.0 - leverage, 0.05)
    return sums
