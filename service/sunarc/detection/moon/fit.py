"""Least squares of the moon's image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.detection.moon.limb import PointSpread, Surface, surface_images

_WIDTH_SD, _WIDTH_PX = 0.5, 0.9
_LAMBERT_MEAN, _LAMBERT_SD = 0.3, 0.5
_SEAS_SD = (0.12,) * 2 + (0.10,) * 3 + (0.07,) * 4
"""Of the polynomials' coefficients: seas are half as bright as highlands, and cover a third of the disc."""
_ASTIGMATISM_SD = 0.15
_AUREOLE_SD = 0.1
_AUREOLE_RADII, _AUREOLE_WIDTHS = 1.5, 2.0
_SHAPE = 4
"""After x, y and the logarithms of the point spread's width and of its axes' ratio to that: Lambert's share, the seas,
the covariance of the point spread, and the aureole's share; then a level and a background of each colour."""
_SEAS = slice(_SHAPE + 1, _SHAPE + 1 + len(_SEAS_SD))
_PRIOR_MEAN = np.array([np.log(_WIDTH_PX), 0.0, _LAMBERT_MEAN, *(0.0 for _ in _SEAS_SD), 0.0, 0.0])
_PRIOR_SD = np.array([_WIDTH_SD, _ASTIGMATISM_SD, _LAMBERT_SD, *_SEAS_SD, _ASTIGMATISM_SD, _AUREOLE_SD])
_LINEAR = 2 + _PRIOR_MEAN.size
_ROUNDS = 40
_STEPS = np.full(_SHAPE, 1e-3)


class Pixels(NamedTuple):
    """A stamp: first pixel, counts (side, side), variance (infinite where left out), and the colour of each pixel."""

    origin: tuple[int, int]
    counts: FloatArray
    variance: FloatArray
    colour: IntArray


class FittedMoon(NamedTuple):
    """Results of the fit.

    centre : (2,) px. variance : of it per axis, px², of counts with their stated variance. width_px : of the point
    spread. snr : of the light. chi2 : reduced. residual_rms : counts. light : (side, side) counts without background.
    aureole : the aureole's brightest pixel over that of the light.
    shape_misfit : mean square of the seas' coefficients over their prior's 1-sigma.
    """

    centre: FloatArray
    variance: float
    width_px: float
    snr: float
    chi2: float
    residual_rms: float
    light: FloatArray
    aureole: float
    shape_misfit: float


def fit_moon(pixels: Pixels, surface: Surface, edges_px: FloatArray, start: FloatArray) -> FittedMoon:
    """Fit centre, point spread, brightness law, aureole, and level and background of each colour.

    Parameters
    ----------
    pixels : the stamp.
    surface, edges_px : the lit part.
    start : (2,) px to begin at.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 - the command line loads without it

    problem = _Problem(pixels, surface, edges_px)
    found = least_squares(
        problem.residuals, problem.start(start), jac=problem.jacobian, method="trf", x_scale="jac", max_nfev=_ROUNDS
    )
    return problem.fitted(found.x)


class _Problem:
    """Residuals and their derivatives; the shape's images of the last parameters are kept."""

    def __init__(self, pixels: Pixels, surface: Surface, edges_px: FloatArray) -> None:
        self._pixels, self._surface, self._edges = pixels, surface, edges_px
        self._used = np.isfinite(pixels.variance)
        self._sigma = np.sqrt(pixels.variance[self._used])
        self._colours = int(pixels.colour.max()) + 1
        self._is = [pixels.colour == one for one in range(self._colours)]
        self._sky = [float(np.median(pixels.counts[self._used & one])) for one in self._is]
        first = self._used & self._is[0]
        mean = float(np.mean((pixels.counts - self._sky[0])[first]))
        self._scale = max(mean * pixels.colour.size, 1.0)

    def start(self, centre: FloatArray) -> FloatArray:
        """Return the parameters to begin at."""
        return np.asarray(np.r_[centre, _PRIOR_MEAN, np.ones(self._colours), self._sky])

    def residuals(self, parameters: FloatArray) -> FloatArray:
        """Return the misfit of the pixels over their sigma, and that of the priors."""
        total, _ = self._model(parameters)
        misfit = (total - self._pixels.counts)[self._used] / self._sigma
        return np.asarray(np.r_[misfit, (parameters[2:_LINEAR] - _PRIOR_MEAN) / _PRIOR_SD])

    def jacobian(self, parameters: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals."""
        parts = self._parts(parameters)
        level = self._levels(parameters)
        columns = []
        for row, step in enumerate(_STEPS):
            moved = parameters.copy()
            moved[row] += step
            columns.append(level * (_sum(self._parts(moved), parameters) - _sum(parts, parameters)) / step)
        columns += [level * part for part in parts[1:]]
        shape = _sum(parts, parameters)
        columns += [np.where(one, self._scale * shape, 0.0) for one in self._is]
        columns += [np.where(one, 1.0, 0.0) for one in self._is]
        by_pixels = np.stack([column[self._used] / self._sigma for column in columns], axis=-1)
        prior = np.zeros((_PRIOR_MEAN.size, by_pixels.shape[1]))
        prior[:, 2:_LINEAR] = np.diag(1.0 / _PRIOR_SD)
        return np.asarray(np.concatenate([by_pixels, prior]))

    def fitted(self, parameters: FloatArray) -> FittedMoon:
        """Return the results at the best parameters."""
        total, light = self._model(parameters)
        misfit = (total - self._pixels.counts)[self._used]
        jacobian = self.jacobian(parameters)
        covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
        weight = light[self._used] / self._sigma
        return FittedMoon(
            centre=parameters[:2],
            variance=0.5 * float(covariance[0, 0] + covariance[1, 1]),
            width_px=float(np.exp(parameters[2])),
            snr=float(np.linalg.norm(weight)),
            chi2=float(np.sum((misfit / self._sigma) ** 2)) / max(misfit.size - parameters.size, 1),
            residual_rms=float(np.sqrt(np.mean(misfit**2))),
            light=light,
            aureole=self._aureole(parameters),
            shape_misfit=float(np.mean((parameters[_SEAS] / _SEAS_SD) ** 2)),
        )

    def _model(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the counts, and those of the moon alone."""
        light = self._levels(parameters) * _sum(self._parts(parameters), parameters)
        sky = parameters[_LINEAR + self._colours :][self._pixels.colour]
        return light + sky, light

    def _aureole(self, parameters: FloatArray) -> float:
        parts = self._parts(parameters)
        return float(parameters[_LINEAR - 1] * np.max(parts[-1] + parts[0]) / np.max(_sum(parts, parameters)))

    def _levels(self, parameters: FloatArray) -> FloatArray:
        return np.asarray(self._scale * parameters[_LINEAR : _LINEAR + self._colours][self._pixels.colour])

    def _parts(self, parameters: FloatArray) -> FloatArray:
        """Return the image of unit light, and by what Lambert's law, the seas and the aureole change it."""
        side, origin = self._pixels.counts.shape[0], self._pixels.origin
        width, ratio = (float(np.exp(np.clip(one, -2.0, 2.5))) for one in parameters[2:4])
        spread = PointSpread(width * ratio, width / ratio)
        images = surface_images(self._surface, self._edges, parameters[:2], spread, origin=origin, side=side)
        middle = parameters[:2] + self._edges @ (self._surface.nodes.T @ self._surface.light[0])
        broad = _AUREOLE_RADII * np.sqrt(abs(float(np.linalg.det(self._edges)))) + _AUREOLE_WIDTHS * width
        x, y = (np.exp(-0.5 * ((origin[axis] + np.arange(side) - middle[axis]) / broad) ** 2) for axis in (0, 1))
        aureole = y[:, None] * x / (2.0 * np.pi * broad**2)
        return np.concatenate([images, (aureole - images[0])[None]])


def _sum(parts: FloatArray, parameters: FloatArray) -> FloatArray:
    return np.asarray(parts[0] + np.tensordot(parameters[_SHAPE:_LINEAR], parts[1:], axes=1))
