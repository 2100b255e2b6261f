"""One more sighting: whether it agrees with those before it, and if not, what has changed.

The look at every sighting is cheap; only when several do not agree, or agree with a bias, are the explanations weighed
against each other.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from sunarc.array_types import FloatArray
from sunarc.calibration.change_detection.hypotheses import best_hypothesis
from sunarc.calibration.change_detection.residual_model import ResidualModel, window_of
from sunarc.calibration.change_detection.values import Change, Sighting, SightingWindow, WatchOptions
from sunarc.calibration.model.result import Calibration
from sunarc.sky.site import Site

REMEMBERED = 56
_TRUSTED_SQUARE = 30.0
_RECENT = 6
_DISTRUSTED = 3
_SPANS = (4, 8, 16, 32)
_BIASED = 25.0


def update_window(
    watch: SightingWindow,
    sighting: Sighting,
    *,
    calibration: Calibration,
    site: Site,
    options: WatchOptions,
    clock_stepped: bool = False,
    posed_from_few: bool = False,
) -> tuple[SightingWindow, Change | None]:
    """Return what is remembered after one more sighting, and the change that it makes plain, if any.

    Parameters
    ----------
    watch : what is remembered.
    sighting : the sighting, later than those remembered.
    calibration : what it is held to.
    site : where the camera is said to stand.
    options : what is not reported as a change.
    clock_stepped : whether the host says that its clock was set while these sightings were made.
    posed_from_few : whether the calibration was posed from these very sightings: then its lens is in question too.
    """
    grown = watch.last(REMEMBERED - 1).with_one(sighting, trusted=True, surprise=np.zeros(2))
    window = window_of(grown, calibration, options)
    surprise = _surprise(window)
    trusted = bool(surprise @ surprise < _TRUSTED_SQUARE)
    grown = watch.last(REMEMBERED - 1).with_one(
        sighting, trusted=trusted, surprise=surprise if trusted else np.zeros(2)
    )
    one_sided = biased(grown)
    if not (one_sided or distrusted(grown)):
        return grown, None
    change = best_hypothesis(
        window_of(grown, calibration, options),
        site=site,
        small=one_sided,
        clock_stepped=clock_stepped,
        posed_from_few=posed_from_few,
    )
    return grown, change


def biased(watch: SightingWindow) -> bool:
    """Return whether the trusted sightings of late lie off all to one side."""
    agreeing = watch.surprise[watch.trusted]
    spans = [agreeing[-span:] for span in _SPANS if agreeing.shape[0] >= span]
    return any(float(np.sum(part.sum(axis=0) ** 2)) / part.shape[0] > _BIASED for part in spans)


def distrusted(watch: SightingWindow) -> bool:
    """Return whether half of the last sightings disagree with those before them, the last one too."""
    late = watch.trusted[-_RECENT:]
    return not watch.trusted[-1] and int(np.sum(~late)) >= _DISTRUSTED


def _surprise(window: ResidualModel) -> FloatArray:
    """Return (2,): how far the last sighting lies from what the trusted ones before let one expect, whitened."""
    trusted_axes = np.repeat(window.watch.trusted, 2)
    trusted_axes[-2:] = False
    noise = np.repeat(window.sightings.variance, 2)
    mean, spread = window.sightings.residual[-1], window.covariance[-2:, -2:] + np.diag(noise[-2:])
    if np.any(trusted_axes):
        before = window.covariance[np.ix_(trusted_axes, trusted_axes)] + np.diag(noise[trusted_axes])
        shared = window.covariance[trusted_axes][:, -2:]
        gain = cho_solve((cholesky(before, lower=True), True), shared)
        mean = mean - gain.T @ window.sightings.residual.ravel()[trusted_axes]
        spread = spread - gain.T @ shared
    # whitened: the sum of squares is then chi-square of two if nothing has changed
    root = cholesky(0.5 * (spread + spread.T), lower=True)
    return (
        np.asarray(solve_triangular(root, mean, lower=True)) if math.isfinite(float(mean @ mean)) else np.full(2, 1e6)
    )
