"""Every limit of the classification from both sides."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.detection.disc.fitting import SENSOR, good_fit

from sunarc.detection.disc.detect import is_flat, judge_fit, make_detection
from sunarc.detection.values import Expectation, Verdict

FULL = float(SENSOR.full_scale)
STRETCH = ((565.0, 0.0), (0.0, 640.0))
PREDICTED = Expectation(x_px=24.0, y_px=24.0, uncertainty_px=0.4, stretch_px_per_rad=STRETCH)
SHAPELESS = Expectation(x_px=24.0, y_px=24.0, uncertainty_px=0.4)


def verdict(
    expectation: Expectation | None = PREDICTED,
    fit: dict[str, float] | None = None,
    **more: Any,  # noqa: ANN401 - a fit's fields
) -> tuple[Verdict, bool]:
    name, accepted = judge_fit(good_fit(**(fit or {}), **more), expectation=expectation, sensor=SENSOR)[:2]
    return name, accepted


@pytest.mark.parametrize("expectation", [None, SHAPELESS, PREDICTED])
def test_a_good_disc_is_clear(expectation: Expectation | None) -> None:
    assert verdict(expectation) == ("clear", True)


@pytest.mark.parametrize("field", ["x_px", "y_px", "sigma_px", "level", "chi2", "snr"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_fit_that_is_not_finite_is_no_disc(field: str, value: float) -> None:
    assert verdict(fit={field: value}) == ("hidden", False)


def test_a_fit_that_did_not_converge_is_no_disc() -> None:
    assert verdict(converged=False) == ("hidden", False)


@pytest.mark.parametrize(
    ("limit", "inside", "outside", "name"),
    [
        pytest.param("snr", 12.0, 11.9, "hidden", id="signal-to-noise ratio"),
        pytest.param("level", 0.0701 * FULL, 0.0699 * FULL, "veiled", id="level that is accepted"),
        pytest.param("width_px", 0.7 * math.exp(1.19), 0.7 * math.exp(1.21), "hidden", id="wide point spread"),
        pytest.param("width_px", 0.7 * math.exp(-1.19), 0.7 * math.exp(-1.21), "hidden", id="narrow point spread"),
        pytest.param("x_px", 24.0 + 2.99, 24.0 + 3.01, "reflection", id="distance in x"),
        pytest.param("y_px", 24.0 - 2.99, 24.0 - 3.01, "reflection", id="distance in y"),
        pytest.param("residual", 0.02, 0.0201, "partly_covered", id="residual"),
        pytest.param("sigma_px", 0.06, 0.0601, "veiled", id="sigma"),
    ],
)
def test_a_limit_is_where_the_options_put_it(limit: str, inside: float, outside: float, name: Verdict) -> None:
    assert verdict(fit={limit: inside}) == ("clear", True)
    assert verdict(fit={limit: outside}) == (name, False)


def test_a_level_below_the_least_is_no_disc() -> None:
    assert verdict(level=0.0101 * FULL, background=0.0) == ("veiled", False)
    assert verdict(level=0.0099 * FULL, background=0.0) == ("hidden", False)


@pytest.mark.parametrize(("share", "expected"), [(0.151, ("veiled", True)), (0.149, ("hidden", False))])
def test_a_disc_needs_a_seventh_of_its_surroundings_light(share: float, expected: tuple[Verdict, bool]) -> None:
    assert verdict(level=share * 3000.0, background=3000.0) == expected


@pytest.mark.parametrize(
    ("axes", "expected"),
    [
        ((1.21, 2.0), ("clear", True)),
        ((1.19, 2.0), ("hidden", False)),
        ((6.0, 9.99), ("clear", True)),
        ((6.0, 10.01), ("hidden", False)),
        ((2.01, 5.0), ("clear", True)),
        ((1.99, 5.0), ("partly_covered", False)),
    ],
)
@pytest.mark.parametrize("expectation", [None, SHAPELESS])
def test_size_and_ellipticity_have_limits_where_no_shape_is_predicted(
    axes: tuple[float, float], expected: tuple[Verdict, bool], expectation: Expectation | None
) -> None:
    assert verdict(expectation, stretch=np.diag(axes)) == expected
    assert verdict(PREDICTED, stretch=np.diag(axes)) == ("clear", True)


@pytest.mark.parametrize(
    ("inside", "outside"),
    [
        ({"level": 0.0801 * FULL}, {"level": 0.0799 * FULL}),
        ({"residual": 0.01}, {"residual": 0.0101}),
        ({"sigma_px": 0.016}, {"sigma_px": 0.0161}),
        ({"chi2": 3.0, "residual": 0.0031}, {"chi2": 3.01, "residual": 0.0031}),
        ({"chi2": 9.0, "residual": 0.003}, {"chi2": 9.0, "residual": 0.0031}),
    ],
)
def test_without_a_prediction_the_limits_are_narrower(inside: dict[str, float], outside: dict[str, float]) -> None:
    assert verdict(None, fit=inside) == ("clear", True)
    assert verdict(None, fit=outside) == ("hidden", False)
    assert verdict(PREDICTED, fit=outside) == ("clear", True)


@pytest.mark.parametrize(
    ("uneven", "sigma_px", "expected"),
    [
        (16.0, 0.05, ("clear", True)),  # 16 is chance
        (16.1, 0.05, ("partly_covered", False)),
        (100.0, 0.0029, ("clear", True)),  # 10 sigma of 0.0029 px is less than 0.03 px
        (100.0, 0.0031, ("partly_covered", False)),
        (-5.0, 0.05, ("clear", True)),
    ],
)
def test_an_uneven_disc_is_covered_where_that_is_significant_and_moves_it(
    uneven: float, sigma_px: float, expected: tuple[Verdict, bool]
) -> None:
    assert verdict(uneven=uneven, sigma_px=sigma_px) == expected


@pytest.mark.parametrize(("peak", "name"), [(0.99, "clear"), (1.01, "veiled")])
def test_a_disc_below_half_of_the_clear_level_is_veiled_and_accepted(peak: float, name: Verdict) -> None:
    expectation = Expectation(x_px=24.0, y_px=24.0, stretch_px_per_rad=STRETCH, clear_peak_fraction=peak)
    assert verdict(expectation) == (name, True)


@pytest.mark.parametrize(("background", "name"), [(0.99, "clear"), (1.01, "veiled")])
def test_a_disc_brighter_than_its_surroundings_by_less_than_they_are_is_veiled(
    background: float, name: Verdict
) -> None:
    assert verdict(level=500.0, background=500.0 * background) == (name, True)


@pytest.mark.parametrize(("chi2", "flat"), [(0.959, True), (0.961, False)])
def test_a_disc_is_flat_where_that_explains_16_more(chi2: float, *, flat: bool) -> None:
    assert is_flat(good_fit(), good_fit(chi2=chi2)) == flat


def test_a_flat_fit_of_fewer_pixels_counts_by_its_chi2_in_all_and_none_is_not_flat() -> None:
    assert is_flat(good_fit(), good_fit(used_px=380))
    assert not is_flat(good_fit(), None)


def test_the_detection_holds_the_fits_numbers() -> None:
    fit = good_fit(stretch=np.diag([2.0, 3.0]), background=0.1 * FULL, level=0.4 * FULL)
    found = make_detection(fit, judge_fit(fit, expectation=None, sensor=SENSOR), sensor=SENSOR, saturated_px=7)
    assert (found.method, found.x_px, found.y_px, found.sigma_px) == ("disc", 24.0, 24.0, 0.003)
    assert (found.residual_chi2, found.snr, found.saturated_px) == (1.0, 900.0, 7)
    assert found.peak_fraction == pytest.approx(0.5)
    assert found.background_fraction == pytest.approx(0.1)
    assert found.radius_px == pytest.approx(math.sqrt(6.0))
    assert found.ellipticity == pytest.approx(1.0 / 3.0)


def test_a_negative_background_does_not_lower_the_peak() -> None:
    fit = good_fit(background=-0.1 * FULL)
    found = make_detection(fit, judge_fit(fit, expectation=None, sensor=SENSOR), sensor=SENSOR, saturated_px=0)
    assert found.peak_fraction == pytest.approx(0.5)
    assert found.background_fraction == pytest.approx(-0.1)
