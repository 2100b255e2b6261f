"""Noiseless frames of the model itself, and problems made of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from tests.detection.rendering import FloatArray

from sunarc.detection.disc.fit import DiscFit
from sunarc.detection.disc.model import VALUE, DiscProblem, Prior, SunSources, make_problem, render_disc, sun_sources
from sunarc.detection.disc.window import Window
from sunarc.detection.values import Sensor

SHAPE = (21, 23)
CENTER = (11.3, 9.8)
STRETCH = np.array([[2.9, 0.2], [0.2, 2.5]])
PSF_PX = 0.7
SENSOR = Sensor(full_scale=4095, gain_e_per_count=4.884, read_noise_e=12.0)
SOURCES = sun_sources(radius_px=2.7, psf_px=PSF_PX, limb_darkening=0.6)
PRIOR = Prior(math.log(PSF_PX), 0.3, 0.05, free_stretch=True)
NONLINEAR = np.array([*CENTER, math.log(PSF_PX), 0.0, STRETCH[0, 0], STRETCH[0, 1], STRETCH[1, 1]])
FLUX, BACKGROUND = 60_000.0, 40.0


def disc_counts(
    x: float = CENTER[0], y: float = CENTER[1], psf: float = PSF_PX, stretch: FloatArray = STRETCH
) -> FloatArray:
    """Return a disc of unit flux on the window's pixels."""
    core: FloatArray = render_disc(SHAPE, x, y, psf, stretch, SOURCES.core)
    return np.asarray(core[VALUE])


def window_of(counts: FloatArray, **changes: Any) -> Window:  # noqa: ANN401 - a window's fields
    """Return a window of all usable pixels, one colour."""
    everywhere = np.ones(counts.shape, np.bool_)
    colour = np.zeros(counts.shape, np.intp)
    return Window(counts, everywhere, everywhere, colour, 1, (100, 200), 0)._replace(**changes)


def plain_window(rng: np.random.Generator | None = None) -> Window:
    """Return the window of the disc, with the sensor's noise where a generator is given."""
    counts = FLUX * disc_counts() + BACKGROUND
    return window_of(counts if rng is None else noisy(counts, rng))


def noisy(counts: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return counts with photon noise, read noise and rounding."""
    electrons = rng.poisson(counts * SENSOR.gain_e_per_count) + rng.normal(0.0, SENSOR.read_noise_e, counts.shape)
    return np.asarray(np.rint(electrons / SENSOR.gain_e_per_count))


def problem_of(
    window: Window, *, prior: Prior = PRIOR, sensor: Sensor = SENSOR, sources: SunSources = SOURCES
) -> DiscProblem:
    """Return the problem whose slope turns about (11, 10)."""
    return make_problem(window, origin=np.array([11.0, 10.0]), sensor=sensor, sources=sources, prior=prior)


def good_fit(**changes: Any) -> DiscFit:  # noqa: ANN401 - a fit's fields
    """Return a fit that no limit rejects: half of full scale, 2.6 px of radius, 0.003 px of sigma."""
    values: dict[str, Any] = {
        "x_px": 24.0,
        "y_px": 24.0,
        "sigma_px": 0.003,
        "width_px": 0.7,
        "stretch": np.diag([2.5, 2.7]),
        "level": 0.5 * SENSOR.full_scale,
        "background": 8.0,
        "snr": 900.0,
        "chi2": 1.0,
        "residual": 0.002,
        "uneven": 3.0,
        "bands": (6.0, 6.0),
        "used_px": 400,
        "converged": True,
    }
    return DiscFit(**(values | changes))
