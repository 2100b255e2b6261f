"""The least-squares fit of a disc, on frames of the model itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.detection.disc.fitting import (
    BACKGROUND,
    CENTER,
    FLUX,
    PRIOR,
    PSF_PX,
    SENSOR,
    SHAPE,
    SOURCES,
    STRETCH,
    disc_counts,
    noisy,
    plain_window,
    problem_of,
    window_of,
)
from tests.detection.rendering import FloatArray

from sunarc.detection.disc.fit import DiscFit, fit_disc
from sunarc.detection.disc.model import VALUE, WING_PSF, DiscState, Prior, evaluate, normal_equations, render_disc
from sunarc.detection.disc.window import Window
from sunarc.detection.values import Sensor

FIRST = (100.0, 200.0)  # the window's first pixel in the image


def fitted(
    window: Window,
    *,
    off: tuple[float, float] = (0.4, -0.3),
    shape: FloatArray = STRETCH,
    prior: Prior = PRIOR,
    sensor: Sensor = SENSOR,
) -> DiscFit:
    start = (CENTER[0] + FIRST[0] + off[0], CENTER[1] + FIRST[1] + off[1])
    found = fit_disc(window, start=start, shapes=[(PSF_PX, shape)], sources=SOURCES, sensor=sensor, prior=prior)
    assert found is not None
    return found


def place_of(found: DiscFit) -> tuple[float, float]:
    return found.x_px - FIRST[0], found.y_px - FIRST[1]


@pytest.mark.parametrize("off", [(0.0, 0.0), (1.0, -1.0), (-0.8, 0.9)])
def test_a_noiseless_disc_is_found_from_any_start_near_it(off: tuple[float, float]) -> None:
    found = fitted(plain_window(), off=off, shape=np.diag([2.2, 2.2]))
    assert found.converged
    assert place_of(found) == pytest.approx(CENTER, abs=1e-3)
    assert found.stretch @ found.stretch == pytest.approx(STRETCH @ STRETCH, abs=0.02)  # a mirror image is the same
    assert found.width_px == pytest.approx(PSF_PX, rel=5e-3)
    assert found.background == pytest.approx(BACKGROUND, abs=1.0)
    assert found.level == pytest.approx(FLUX / (math.pi * 0.8 * np.linalg.det(STRETCH)), rel=5e-3)
    assert (found.residual, found.used_px) == (0.0, SHAPE[0] * SHAPE[1])
    assert found.chi2 < 1e-3


def test_chi2_is_one_where_the_noise_is_the_stated() -> None:
    rng = np.random.default_rng(0)
    chi2 = [fitted(plain_window(rng)).chi2 for _ in range(20)]
    assert np.mean(chi2) == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / 470.0 / 20.0))


def test_sigma_is_that_of_the_normal_matrix_and_of_repetition() -> None:
    rng = np.random.default_rng(1)
    found = [fitted(plain_window(rng), off=(0.1, 0.1)) for _ in range(60)]
    errors = np.array([place_of(one) for one in found]) - CENTER
    problem = problem_of(plain_window())
    state = DiscState(
        np.array([*CENTER, math.log(PSF_PX), 0.0, 2.9, 0.2, 2.5]), np.array([FLUX]), np.array([BACKGROUND]), np.zeros(4)
    )
    matrix, _ = normal_equations(problem, state, evaluate(problem, state))
    bound = math.sqrt(0.5 * float(np.trace(np.linalg.inv(matrix)[:2, :2])))
    sigma = float(np.mean([one.sigma_px for one in found]))
    assert sigma == pytest.approx(bound, rel=0.15)
    assert float(np.sqrt(np.mean(errors**2))) == pytest.approx(sigma, rel=0.2)  # 120 errors: ± 6.5 % is one sigma


def test_the_signal_to_noise_ratio_is_flux_over_its_sigma_at_a_known_shape() -> None:
    found = fitted(plain_window(), prior=PRIOR._replace(free_stretch=False), off=(0.0, 0.0))
    disc = disc_counts().ravel()
    rows, columns = (each.ravel() for each in np.mgrid[: SHAPE[0], : SHAPE[1]])
    dx, dy = columns - CENTER[0], rows - CENTER[1]
    glare = 1.0 / (1.0 + np.sum((np.linalg.inv(2.0 * STRETCH) @ np.stack([dx, dy])) ** 2, axis=0))
    smear = disc.reshape(SHAPE).sum(axis=0)[columns]
    design = np.column_stack([disc, np.ones(disc.size), dx, dy, smear, glare])
    variance = (12.0 / 4.884) ** 2 + (FLUX * disc + BACKGROUND) / 4.884 + 1.0 / 12.0
    covariance = np.linalg.inv(design.T @ (design / variance[:, None]))
    assert found.snr == pytest.approx(FLUX / math.sqrt(covariance[0, 0]), rel=0.02)


def test_the_brightest_colour_gives_level_and_background() -> None:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    colour = (rows % 2 + columns % 2).astype(np.intp)
    counts = np.array([0.5, 1.0, 0.4])[colour] * FLUX * disc_counts() + np.array([10.0, 20.0, 30.0])[colour]
    found = fitted(window_of(counts, colour=colour, colours=3))
    assert found.level == pytest.approx(FLUX / (math.pi * 0.8 * np.linalg.det(STRETCH)), rel=0.01)
    assert found.background == pytest.approx(20.0, abs=0.5)


@pytest.mark.parametrize(("used", "fits"), [(33, False), (34, True)])
def test_a_fit_takes_34_pixels_of_one_colour(used: int, *, fits: bool) -> None:
    usable = np.zeros(SHAPE, np.bool_)
    usable[7:13, 8:15] = True
    usable.ravel()[np.flatnonzero(usable)[used:]] = False
    found = fit_disc(
        window_of(FLUX * disc_counts(), usable=usable),
        start=(CENTER[0] + FIRST[0], CENTER[1] + FIRST[1]),
        shapes=[(PSF_PX, STRETCH)],
        sources=SOURCES,
        sensor=SENSOR,
        prior=PRIOR._replace(free_stretch=False),
    )
    assert (found is not None) == fits


@pytest.mark.parametrize(("count", "left_out"), [(1, 1), (3, 3), (4, 0)])
def test_up_to_three_hot_pixels_are_left_out(count: int, left_out: int) -> None:
    window = plain_window(np.random.default_rng(2))
    hot = [(9, 13), (12, 10), (7, 11), (9, 9)][:count]
    for place in hot:
        window.counts[place] += 1500.0
    found = fitted(window, off=(0.0, 0.0))
    assert found.used_px == SHAPE[0] * SHAPE[1] - left_out
    if left_out:
        assert place_of(found) == pytest.approx(CENTER, abs=0.02)


@pytest.mark.parametrize(("off_sigmas", "left_out"), [(5.0, 0), (10.0, 1)])
def test_a_pixel_is_left_out_beyond_six_sigmas(off_sigmas: float, left_out: int) -> None:
    window = plain_window()
    sigma = math.sqrt((12.0 / 4.884) ** 2 + BACKGROUND / 4.884 + 1.0 / 12.0)
    window.counts[2, 3] += off_sigmas * sigma
    assert fitted(window, off=(0.0, 0.0)).used_px == SHAPE[0] * SHAPE[1] - left_out


def test_wings_of_the_point_spread_are_fitted_where_they_show() -> None:
    wings = SOURCES.wings
    wide = render_disc(SHAPE, *CENTER, WING_PSF * PSF_PX, STRETCH, wings)
    counts = FLUX * (0.92 * disc_counts() + 0.08 * wide[VALUE]) + BACKGROUND
    window = window_of(noisy(counts, np.random.default_rng(3)))
    found = fitted(window, prior=PRIOR._replace(free_stretch=False))
    assert found.chi2 == pytest.approx(1.0, abs=0.35)
    assert place_of(found) == pytest.approx(CENTER, abs=0.015)


def test_a_saturated_disc_is_extrapolated() -> None:
    counts = 8.0 * FLUX * disc_counts() + BACKGROUND
    linear = counts < 4000.0
    window = window_of(np.minimum(counts, 4095.0), usable=linear, linear=linear, saturated_px=int(np.sum(~linear)))
    found = fitted(window, prior=PRIOR._replace(free_stretch=False))
    assert found.level == pytest.approx(8.0 * FLUX / (math.pi * 0.8 * np.linalg.det(STRETCH)), rel=0.02)
    assert place_of(found) == pytest.approx(CENTER, abs=5e-3)
    assert found.used_px == np.count_nonzero(linear)


def test_what_noise_does_not_explain_is_the_residual() -> None:
    window = plain_window()
    ripple = 60.0 * (-1.0) ** np.add(*np.mgrid[: SHAPE[0], : SHAPE[1]])
    found = fitted(window._replace(counts=window.counts + ripple), prior=PRIOR._replace(free_stretch=False))
    noise = float(np.mean((12.0 / 4.884) ** 2 + (FLUX * disc_counts() + BACKGROUND) / 4.884 + 1.0 / 12.0))
    assert found.residual == pytest.approx(math.sqrt(60.0**2 - noise) / found.level, rel=0.05)
    assert found.chi2 > 10.0


def test_a_tilted_disc_is_uneven_and_a_plain_one_is_not() -> None:
    sources = SOURCES.core
    tilted = render_disc(
        SHAPE,
        *CENTER,
        PSF_PX,
        STRETCH,
        sources._replace(weights=sources.weights * (1.0 + 0.5 * sources.positions[:, 0])),
    )
    uneven = fitted(window_of(FLUX * tilted[VALUE] + BACKGROUND), prior=PRIOR._replace(free_stretch=False))
    assert uneven.uneven > 16.0
    assert fitted(plain_window()).uneven < 1.0


def test_of_several_starts_the_best_is_taken_where_the_first_fits_poorly() -> None:
    window = plain_window(np.random.default_rng(5))
    shapes = [(PSF_PX * 2.5, 0.3 * STRETCH), (PSF_PX, STRETCH)]
    start = (CENTER[0] + FIRST[0] + 0.5, CENTER[1] + FIRST[1] - 0.5)
    found = fit_disc(window, start=start, shapes=shapes, sources=SOURCES, sensor=SENSOR, prior=PRIOR)
    assert found is not None
    assert found.stretch == pytest.approx(STRETCH, abs=0.05)


def test_binned_pixels_have_the_same_fit() -> None:
    sensor = replace(SENSOR, binning=2, full_scale=65535)
    found = fitted(plain_window(), sensor=sensor)
    assert place_of(found) == pytest.approx(CENTER, abs=2e-3)
    assert found.stretch == pytest.approx(STRETCH, abs=0.02)


def test_the_residual_of_a_saturated_disc_is_a_share_of_the_range_above_black() -> None:
    counts = 8.0 * FLUX * disc_counts() + BACKGROUND + 60.0 * (-1.0) ** np.add(*np.mgrid[: SHAPE[0], : SHAPE[1]])
    linear = counts < 3000.0
    window = window_of(np.minimum(counts, 4095.0), usable=linear, linear=linear, saturated_px=int(np.sum(~linear)))
    plain, raised = (
        fitted(window, sensor=sensor, prior=PRIOR._replace(free_stretch=False))
        for sensor in (SENSOR, replace(SENSOR, full_scale=4595, black_level=500.0))
    )
    assert plain.level > 4095.0
    assert plain.residual == pytest.approx(60.0 / 4095.0, rel=0.1)
    assert raised.residual == pytest.approx(plain.residual, rel=1e-9)
