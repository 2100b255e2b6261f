"""Rows of another frame in a frame: a camera that answers a packet resend wrongly puts them where packets were lost.

Packets hold consecutive pixels, so that what is foreign is a band of rows. Of the same scene at another exposure it
has another background and another brightness of the disc than the rest; of another place or time it is approximated by
that. What a lens or the air does to the disc shows in columns as it does in rows, foreign pixels show in rows alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import FloatArray
from sunarc.detection.disc.model import Evaluation, Problem, State

Solved = tuple[FloatArray, FloatArray]

_LEAST_SHIFT = 0.3
"""Shift of the centre, over its sigma, below which a band is of no matter."""
_RIDGE = 0.02
"""Share by which the bands' own information is enlarged: a band of nearly all rows is the disc and background again."""
_LEAST_REST = 0.1
"""Share of the position's information that must lie outside of a band to tell how well the model fits otherwise."""
_BAND, _OVER_COLUMNS = 35.0, 3.0
"""Decrease of chi², over that of the other pixels, that a band's two parameters gain, and by how much more the best
band of rows gains than the best of columns."""
_LARGE_BAND, _LARGE_OVER_COLUMNS = 200.0, 1.5
"""The same for much that is foreign, which the columns notice too."""


def is_foreign(rows: float, columns: float) -> bool:
    """Return whether bands of rows explain so much more than bands of columns that only foreign rows can be the cause.

    Parameters
    ----------
    rows, columns : of `band_evidence`.
    """
    return rows > max(_BAND, _OVER_COLUMNS * columns) or rows > max(_LARGE_BAND, _LARGE_OVER_COLUMNS * columns)


def band_evidence(
    problem: Problem, state: State, evaluation: Evaluation, solved: Solved, *, sigma_px: float
) -> tuple[float, float]:
    """Return how much the best band of rows, and the best band of columns, lowers the fit's chi².

    Parameters
    ----------
    problem, state, evaluation : of the fit.
    solved : (p, p) covariance of its parameters, and (p,) gradient: a fit that creeps on is not quite at its end.
    sigma_px : of its centre.

    Returns
    -------
    Decrease of chi² by a background and a brightness of the disc of the band's own, over the mean chi² of the pixels
    outside of it; the largest of all bands that would shift the centre noticeably.
    """
    height, width = problem.window.counts.shape
    row, column = np.divmod(problem.pixel, width)
    disc = evaluation.planes[0].reshape(height, problem.sensor.binning, width, problem.sensor.binning).mean(axis=(1, 3))
    light = disc.ravel()[problem.pixel] * state.flux[problem.colour]
    own = np.stack([np.ones(light.size), light / max(float(light.max()), 1e-9)], axis=-1)
    least_px = _LEAST_SHIFT * sigma_px
    return (
        _best_band(row, height, own, evaluation, solved, least_px=least_px),
        _best_band(column, width, own, evaluation, solved, least_px=least_px),
    )


def _best_band(
    line: NDArray[np.intp],
    lines: int,
    own: FloatArray,
    evaluation: Evaluation,
    solved: Solved,
    *,
    least_px: float,
) -> float:
    """Return the largest decrease of chi² of all bands of lines: a score test, its sums taken line by line."""
    jacobian, weight, residual = evaluation.jacobian, evaluation.weight, evaluation.residual
    covariance, gradient = solved
    p = jacobian.shape[1]
    beside = np.concatenate([jacobian, own, residual[:, None]], axis=1)
    first, last = np.triu_indices(lines + 1, 1)
    products = (own * weight[:, None])[:, :, None] * beside[:, None, :]
    sums = _of_bands(products.reshape(line.size, -1), line, lines, first, last).reshape(-1, 2, p + 3)
    pull = sums[:, :, :p] @ covariance  # of the band's parameters on the disc's
    matrix = sums[:, :, p : p + 2] - pull @ np.swapaxes(sums[:, :, :p], 1, 2)
    own_information = np.einsum("mii->mi", sums[:, :, p : p + 2])
    matrix += np.eye(2) * (_RIDGE * own_information + 1e-12)[:, :, None]
    score = sums[:, :, p + 2] - pull @ gradient
    fitted = np.linalg.solve(matrix, score[:, :, None])[:, :, 0]
    gained = np.einsum("mi,mi->m", score, fitted)
    shift_px = np.linalg.norm(np.einsum("mik,mi->mk", pull[:, :, :2], fitted), axis=1)
    total = float(weight @ residual**2)
    misfit = np.maximum((total - gained) / max(line.size - p - 2, 1), _misfit(line, lines, evaluation, covariance))
    noticeable = shift_px > least_px
    return float(np.max(gained[noticeable] / np.maximum(misfit[noticeable], 1.0), initial=0.0))


def _misfit(line: NDArray[np.intp], lines: int, evaluation: Evaluation, covariance: FloatArray) -> FloatArray:
    """Return the mean chi² of the pixels outside of each band, each counting as much as it tells of the position."""
    jacobian, weight = evaluation.jacobian, evaluation.weight
    moved = jacobian @ covariance
    leverage = np.einsum("ik,ik->i", moved, jacobian) * weight
    information = np.sum(moved[:, :2] ** 2, axis=1) * weight
    chi2 = weight * evaluation.residual**2 / np.maximum(1.0 - leverage, 0.05)
    first, last = np.triu_indices(lines + 1, 1)
    values = np.stack([information, information * chi2], axis=-1)
    total = values.sum(axis=0)
    rest = total - _of_bands(values, line, lines, first, last)
    enough = rest[:, 0] > _LEAST_REST * total[0]
    return np.asarray(
        np.where(enough, rest[:, 1] / np.maximum(rest[:, 0], 1e-300), total[1] / max(float(total[0]), 1e-300))
    )


def _of_bands(
    values: FloatArray, line: NDArray[np.intp], lines: int, first: NDArray[np.intp], last: NDArray[np.intp]
) -> FloatArray:
    """Return the sums of (n, k) values over the lines from each `first` to before each `last`."""
    by_line = np.zeros((lines + 1, values.shape[1]))
    np.add.at(by_line, line + 1, values)
    until = np.cumsum(by_line, axis=0)
    return np.asarray(until[last] - until[first])
