"""Which scales the data speak for: the field's amplitude and length, the radial distortion's and the decentering's."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.marginal_likelihood import NormalEquations, Scales, log_evidences
from sunarc.calibration.model.residual_field import WaveBasis, wave_basis

_LENGTH_FRACTIONS = (0.16, 0.24, 0.36)
"""Lengths tried, as fractions of the image's shorter side."""
_LARGEST_AMPLITUDE_PX = 8.0
_AMPLITUDES = 16
_RADIALS_PX = np.array([0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 8.0, 16.0, 32.0, 64.0])
RADIAL_LOG_SIGMA = math.log(2.5)
_DECENTERING_FACTORS = np.array([0.5, 1.0, 2.0, 4.0, 10.0])
DECENTERING_LOG_SIGMA = math.log(1.6)
"""1-sigma of the logarithms of the two scales about their tolerances."""
_USUAL_FIELD_PX = 0.3
_FIELD_LOG_SIGMA = math.log(3.0)
"""Where a lens is not as modelled, it is by tenths of px: the paper's own data miss the model by 0.5 to 1.2 px."""
_LARGEST_FIELD_PX = 1.5
"""1-sigma, px, of a Gaussian bound on the amplitude. A displacement of several px is a matter of the lens's own
parameters; without the bound, a large field beside a lens that fits nothing can be the more probable explanation of a
lens with a strong radial residual."""
_NO_FIELD = 1.5
"""Odds, before the sightings are looked at, that there is no field but the floor's."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HyperparameterGrid:
    """The scales that are tried.

    Attributes
    ----------
    amplitudes (i,), lengths (j,) of the field; lens_scales (k, 2) of radial distortion and decentering; px.
    log_prior : (i, j, k) how plausible they are before the sightings.
    basis : the field's basis functions.
    """

    amplitudes: FloatArray
    lengths: FloatArray
    lens_scales: FloatArray
    log_prior: FloatArray
    basis: WaveBasis

    def up_to(self, amplitude_px: float) -> HyperparameterGrid:
        """Return the grid without larger fields than this; the smallest one always stays."""
        count = max(int(np.sum(self.amplitudes <= amplitude_px)), 1)
        return replace(self, amplitudes=self.amplitudes[:count], log_prior=self.log_prior[:count])


def scale_grid(
    *, width: int, height: int, floor_px: float, radial_px: float, decentering_px: float
) -> HyperparameterGrid:
    """Return the grid of scales for an image size.

    Parameters
    ----------
    width, height : px.
    floor_px : the smallest field that is ever assumed.
    radial_px, decentering_px : the usual scales of the residual radial distortion and of the decentering.
    """
    lengths = np.array(_LENGTH_FRACTIONS) * min(width, height)
    amplitudes = np.geomspace(max(floor_px, 1e-4), _LARGEST_AMPLITUDE_PX, _AMPLITUDES)
    radial, decentering = np.meshgrid(0.5 * _RADIALS_PX, _DECENTERING_FACTORS, indexing="ij")
    # the grid's steps differ: each place counts by the interval of the logarithm that it stands for
    of_lens = np.log(np.gradient(np.log(_RADIALS_PX)))[:, None] + np.log(np.gradient(np.log(_DECENTERING_FACTORS)))
    of_lens = of_lens - 0.5 * (np.log(radial) / RADIAL_LOG_SIGMA) ** 2
    of_lens = of_lens - 0.5 * (np.log(decentering) / DECENTERING_LOG_SIGMA) ** 2
    of_amplitude = -0.5 * (np.log(amplitudes / _USUAL_FIELD_PX) / _FIELD_LOG_SIGMA) ** 2
    of_amplitude -= 0.5 * (amplitudes / _LARGEST_FIELD_PX) ** 2
    # the floor stands for no field, too: its prior odds are added to it
    of_amplitude[0] = np.logaddexp(of_amplitude[0], math.log(_NO_FIELD) + np.logaddexp.reduce(of_amplitude))
    return HyperparameterGrid(
        amplitudes=amplitudes,
        lengths=lengths,
        lens_scales=np.stack([radial_px * radial.ravel(), decentering_px * decentering.ravel()], axis=-1),
        log_prior=of_amplitude[:, None, None] + np.zeros((1, lengths.size, 1)) + of_lens.ravel(),
        basis=wave_basis(width=width, height=height, shortest_px=float(lengths[0]), longest_px=float(lengths[-1])),
    )


def log_weights(normal: NormalEquations, grid: HyperparameterGrid) -> FloatArray:
    """Return the log of prior times evidence of each choice of scales, (i, j, k), but for one constant."""
    return grid.log_prior + log_evidences(
        normal, grid.basis, amplitudes=grid.amplitudes, lengths=grid.lengths, lens_scales=grid.lens_scales
    )


def log_evidence(log_weight: FloatArray) -> float:
    """Return the log evidence over all scales together, but for a constant that depends on the sightings alone."""
    return float(np.logaddexp.reduce(log_weight, axis=None))


def normalised(log_weight: FloatArray) -> FloatArray:
    """Return how probable each choice of scales is, (i, j, k)."""
    weight = np.exp(log_weight - np.max(log_weight))
    return np.asarray(weight / weight.sum())


def likely_scales(weight: FloatArray, grid: HyperparameterGrid) -> Scales:
    """Return the scales to fit with: the mean amplitude, and the mean logarithms of the others.

    Parameters
    ----------
    weight : (i, j, k), see `normalised`.
    """
    radial, decentering = np.exp(np.sum(weight, axis=(0, 1)) @ np.log(grid.lens_scales))
    moment = np.sum(weight, axis=2) * grid.amplitudes[:, None]
    length = math.exp(float(np.sum(moment * np.log(grid.lengths)) / moment.sum()))
    return Scales(float(moment.sum()), length, float(radial), float(decentering))


def log_odds_of_a_field(log_weight: FloatArray) -> float:
    """Return the log odds that there is a field larger than the floor; -inf where none larger is tried."""
    return float(np.logaddexp.reduce(log_weight[1:], axis=None) - np.logaddexp.reduce(log_weight[0], axis=None))
