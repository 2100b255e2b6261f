"""The paper's penalties c1, c2, c3 (section 4.2) against their definitions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from tests.calibration.paper.equations_reference import Penalties, penalties
from tests.fixtures.calibration import ideal_camera, numerical_derivative, small_camera

from sunarc.calibration.model.options import PaperOptions
from sunarc.optics.camera import Camera
from sunarc.optics.forward import distorted_radius
from sunarc.optics.projections import ideal_radius

EDGE = math.pi / 2


def _parts(camera: Camera, options: PaperOptions) -> tuple[float, np.ndarray, np.ndarray]:
    found = penalties(camera, options, largest_angle=EDGE)
    assert found.size == 1 + 24 + 181
    return float(found[0]), found[1:25], found[25:]


def test_an_ideal_round_lens_has_no_penalty() -> None:
    np.testing.assert_allclose(penalties(ideal_camera(), PaperOptions(), largest_angle=EDGE), 0.0, atol=1e-9)


@pytest.mark.parametrize("order", [2, 5, 9])
def test_c1_is_the_weighted_integral_of_ideal_times_residual_distortion(order: int) -> None:
    radial = tuple(0.03 if n == order else 0.0 for n in range(2, 10))
    camera = replace(ideal_camera(), radial=radial)

    def product(theta: float) -> float:
        return float(ideal_radius("equidistant", theta)) * 0.03 * (theta / (math.pi / 2)) ** order

    expected, _ = quad(product, 0.0, EDGE)
    first, _, _ = _parts(camera, PaperOptions(orthogonality_weight=7.0))
    assert first == pytest.approx(7.0 * expected, rel=1e-3)


def test_c2_is_the_scatter_of_the_ellipse_s_radius() -> None:
    camera = replace(ideal_camera(), focal_length_px=(202.0, 198.0))
    _, second, _ = _parts(camera, PaperOptions(circularity_weight=3.0))
    azimuth = 2.0 * math.pi * np.arange(24) / 24.0
    radius = math.pi / 2 * np.hypot(202.0 * np.cos(azimuth), 198.0 * np.sin(azimuth))
    assert math.sqrt(float(np.sum(second**2))) == pytest.approx(3.0 * float(np.std(radius)))
    assert float(np.sum(second)) == pytest.approx(0.0, abs=1e-9)


def test_c2_knows_the_skew_and_by_choice_the_decentering() -> None:
    skewed = _parts(replace(ideal_camera(), skew_px=2.0), PaperOptions())[1]
    # to first order the skew makes an ellipse with a half difference of half the skew
    assert float(np.sqrt(np.mean(skewed**2) * 24)) == pytest.approx(750.0 * math.pi / 2 / math.sqrt(2.0), rel=0.02)
    bent = replace(ideal_camera(), decentering=(1e-3, 0.0, 0.0, 0.0))
    without = _parts(bent, PaperOptions())[1]
    with_it = _parts(bent, PaperOptions(ellipse_scope="with_decentering"))[1]
    np.testing.assert_allclose(without, 0.0, atol=1e-9)
    # the radius is shifted by 3 p1 r^2 cos: its root mean square is that over the root of two
    expected = 750.0 * 200.0 * 3e-3 * (math.pi / 2) ** 2 / math.sqrt(2.0)
    assert float(np.sqrt(np.sum(with_it**2))) == pytest.approx(expected, rel=0.02)


def test_c3_is_the_falling_part_of_the_radius() -> None:
    camera = replace(ideal_camera(), radial=(-1.2, *([0.0] * 7)))
    _, _, third = _parts(camera, PaperOptions(monotony_weight=5.0))
    theta = np.linspace(0.0, EDGE, 181)
    slope = np.gradient(distorted_radius(camera, theta), theta)
    expected = 5.0 * np.minimum(slope, 0.0) / math.sqrt(181.0)
    np.testing.assert_allclose(third[1:-1], expected[1:-1], atol=2e-3)
    assert np.count_nonzero(third) > 20
    rising = _parts(small_camera(), PaperOptions())[2]
    np.testing.assert_array_equal(rising, 0.0)


def test_weights_of_nothing_leave_no_penalty() -> None:
    options = PaperOptions(orthogonality_weight=0.0, circularity_weight=0.0, monotony_weight=0.0)
    np.testing.assert_array_equal(penalties(small_camera(), options, largest_angle=EDGE), 0.0)


@pytest.mark.parametrize("scope", ["focal_lengths", "with_decentering"])
def test_slopes_are_the_differences_of_the_values(scope: str) -> None:
    options = PaperOptions(ellipse_scope=scope)  # type: ignore[arg-type]
    camera = replace(small_camera(), radial=(-1.2, 0.1, *([0.02] * 6)), skew_px=0.3)
    of = Penalties.of(camera.projection, options, largest_angle=EDGE)
    values, slopes = of.values_and_slopes(camera.to_vector())
    np.testing.assert_array_equal(values, of.values(camera.to_vector()))
    expected = numerical_derivative(of.values, camera.to_vector())
    np.testing.assert_allclose(slopes, expected, rtol=1e-5, atol=1e-4)
    assert np.count_nonzero(values[25:]) > 10
    assert np.any(slopes[1:25, 19:] != 0.0) == (scope == "with_decentering")
