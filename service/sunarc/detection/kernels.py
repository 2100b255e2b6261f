"""Compiled loops over pixels of the disc fit: per-call cost of numpy would dominate.

Plain loops, which compile in seconds; kept on disk (`cache=True`), without the interpreter's lock (`nogil`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sunarc.detection.values import FloatArray
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
    places: tuple[Indices, FloatArray, Indices, FloatArray],
    flux: FloatArray,
    background: FloatArray,
    around: FloatArray,
    noise: tuple[float, float],
    by_counts: bool,  # noqa: FBT001 - as above
) -> Compared:
    """Compare a disc's model with the pixels.

    Parameters
    ----------
    planes : (k, rows, columns) the disc of unit flux, first its value.
    moved, scale : the planes that are derivatives by the free nonlinear parameters, and what each is multiplied by.
    glare : u and v are (a dx - b dy, c dy - b dx) and dx, dy are what a pixel is off (x, y): a, b, c, x, y.
    places : of the pixels used flat position, counts, colour, and offset (n, 2).
    flux, background : one per colour. around : the background's slope in x and y, smear of the columns, glare.
    noise : read noise in counts, electrons per count.
    by_counts : take the variance that the counts tell, not the model.

    Returns
    -------
    Twice the negative log likelihood, residual (n,), weight (n,) and Jacobian (n, p), its columns the free nonlinear
    parameters, flux and background of each colour, slope in x and y, smear and glare.
    """
    pixel, counts, colour, offset = places
    a, b, c, x, y = glare
    rows, columns = planes.shape[1:]
    nonlinear, colours = moved.size, flux.size
    smear = np.zeros(columns)
    for j in range(rows):
        for i in range(columns):
            smear[i] += planes[0, j, i]
    first = nonlinear + 2 * colours
    jacobian = np.zeros((pixel.size, first + 4))
    residual, weight, misfit = np.empty(pixel.size), np.empty(pixel.size), 0.0
    for i in range(pixel.size):
        own, (j, k) = colour[i], divmod(pixel[i], columns)
        for m in range(nonlinear):
            jacobian[i, m] = flux[own] * scale[m] * planes[moved[m], j, k]
        jacobian[i, nonlinear + own] = planes[0, j, k]
        jacobian[i, nonlinear + colours + own] = 1.0
        dx, dy = offset[i, 0] - x, offset[i, 1] - y
        u, v = a * dx - b * dy, c * dy - b * dx
        jacobian[i, first], jacobian[i, first + 1] = offset[i, 0], offset[i, 1]
        jacobian[i, first + 2], jacobian[i, first + 3] = smear[k], 1.0 / (1.0 + u * u + v * v)
        model = flux[own] * planes[0, j, k] + background[own]
        for m in range(4):
            model += around[m] * jacobian[i, first + m]
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
