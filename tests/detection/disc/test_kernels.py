"""The compiled loops against the same sums in numpy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.detection.rendering import FloatArray

from sunarc import _kernels
from sunarc.detection.disc.model import normal_matrix, pixel_information

ROWS, COLUMNS, GAIN, READ = 5, 6, 5.0, 2.0
GLARE = (0.4, 0.1, 0.5, 2.2, 1.8)


def inputs(*, colours: int = 1, binning: int = 1, seed: int = 0, **changes: Any) -> dict[str, Any]:  # noqa: ANN401 - mixed
    """Return arguments of `likelihood_of`: random planes, every pixel but two used."""
    rng = np.random.default_rng(seed)
    pixel = np.delete(np.arange(ROWS * COLUMNS), [3, 17])
    rows, columns = np.divmod(pixel, COLUMNS)
    return {
        "planes": rng.uniform(0.1, 1.0, (4, ROWS * binning, COLUMNS * binning)),
        "moved": np.array([1, 3], np.intp),
        "scale": np.array([1.0, 0.7]),
        "glare": GLARE,
        "places": (
            pixel,
            rng.uniform(50.0, 900.0, pixel.size),
            rng.integers(0, colours, pixel.size),
            offset(rows, columns),
        ),
        "flux": np.linspace(500.0, 700.0, colours),
        "background": np.linspace(20.0, 30.0, colours),
        "around": np.array([0.5, -0.25, 0.01, 4.0]),
        "noise": (READ, GAIN),
        "by_counts": False,
        "binning": binning,
        "clip": math.inf,
    } | changes


def offset(rows: FloatArray, columns: FloatArray) -> FloatArray:
    return np.column_stack([columns - 2.0, rows - 2.5])


def compared(arguments: dict[str, Any]) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    names = ("planes", "moved", "scale", "flux", "background", "around", "binning", "clip", "by_counts")
    given = {name: arguments[name] for name in names} | {"glare": np.array(arguments["glare"])}
    given |= dict(zip(("places", "counts", "colour", "offset"), arguments["places"], strict=True))
    given |= dict(zip(("noise", "gain"), arguments["noise"], strict=True))
    return _kernels.likelihood_of(**given)


def model_of(arguments: dict[str, Any]) -> FloatArray:
    """Return the model of the used pixels, written as its definition."""
    pixel, _, colour, place = arguments["places"]
    n, planes = arguments["binning"], arguments["planes"]
    smear = planes[0].sum(axis=0).reshape(COLUMNS, n).sum(axis=1) / n**2
    a, b, c, x, y = arguments["glare"]
    dx, dy = place[:, 0] - x, place[:, 1] - y
    glare = 1.0 / (1.0 + (a * dx - b * dy) ** 2 + (c * dy - b * dx) ** 2)
    around = np.column_stack([place, smear[pixel % COLUMNS], glare]) @ arguments["around"]
    value = planes[0].reshape(ROWS, n, COLUMNS, n).transpose(0, 2, 1, 3).reshape(ROWS * COLUMNS, n * n)[pixel]
    light = arguments["flux"][colour][:, None] * value + (arguments["background"][colour] + around)[:, None]
    return np.asarray(np.minimum(light, arguments["clip"]).mean(axis=1))


@pytest.mark.parametrize(
    ("colours", "binning", "clip"), [(1, 1, math.inf), (3, 1, math.inf), (1, 2, math.inf), (3, 2, 400.0)]
)
def test_residual_weight_and_cost_are_those_of_the_definition(colours: int, binning: int, clip: float) -> None:
    arguments = inputs(colours=colours, binning=binning, clip=clip)
    cost, residual, weight, _ = compared(arguments)
    model = model_of(arguments)
    variance = READ**2 + model / GAIN + 1.0 / 12.0
    assert residual == pytest.approx(arguments["places"][1] - model)
    assert weight == pytest.approx(1.0 / variance)
    assert cost == pytest.approx(float(np.sum(residual**2 / variance + np.log(variance))))


@pytest.mark.parametrize(
    ("colours", "binning", "clip"), [(1, 1, math.inf), (3, 1, math.inf), (1, 2, 420.3), (3, 2, 400.7)]
)
def test_the_jacobian_of_flux_background_and_surroundings_is_that_of_finite_differences(
    colours: int, binning: int, clip: float
) -> None:
    arguments = inputs(colours=colours, binning=binning, clip=clip)
    *_, jacobian = compared(arguments)
    step, column = 1e-4, 2
    for name, size in (("flux", colours), ("background", colours), ("around", 4)):
        for index in range(size):
            by = np.where(np.arange(size) == index, step, 0.0)
            up, down = (model_of(arguments | {name: arguments[name] + sign * by}) for sign in (1.0, -1.0))
            assert jacobian[:, column] == pytest.approx((up - down) / (2.0 * step), abs=1e-5)
            column += 1
    assert column == jacobian.shape[1]


def test_the_jacobian_of_the_nonlinear_parameters_is_the_plane_times_flux_and_scale() -> None:
    arguments = inputs(colours=3)
    *_, jacobian = compared(arguments)
    pixel, _, colour, _ = arguments["places"]
    for column, (plane, scale) in enumerate(((1, 1.0), (3, 0.7))):
        expected = scale * arguments["flux"][colour] * arguments["planes"][plane].ravel()[pixel]
        assert jacobian[:, column] == pytest.approx(expected)


def test_what_is_clipped_does_not_change_with_the_parameters() -> None:
    arguments = inputs(binning=2, clip=10.0)
    *_, jacobian = compared(arguments)
    assert not jacobian.any()
    assert model_of(arguments) == pytest.approx(10.0)


def test_variance_by_counts_is_that_of_the_counts() -> None:
    arguments = inputs(by_counts=True)
    _, _, weight, _ = compared(arguments)
    assert weight == pytest.approx(1.0 / (READ**2 + arguments["places"][1] / GAIN + 1.0 / 12.0))


@pytest.mark.parametrize(("read", "variance"), [(0.3, 0.25), (0.33, 0.33**2 + 1.0 / 12.0)])
def test_without_noise_rounding_is_not_uniform(read: float, variance: float) -> None:
    dark = {"flux": np.zeros(1), "background": np.zeros(1), "around": np.zeros(4)}
    _, _, weight, _ = compared(inputs(noise=(read, GAIN)) | dark)
    assert weight == pytest.approx(1.0 / variance)


def test_a_negative_model_adds_no_photon_noise() -> None:
    dark = {"flux": np.zeros(1), "background": np.array([-50.0]), "around": np.zeros(4)}
    _, _, weight, _ = compared(inputs() | dark)
    assert weight == pytest.approx(1.0 / (READ**2 + 1.0 / 12.0))


def test_normal_matrix_and_gradient_are_those_of_weighted_least_squares() -> None:
    rng = np.random.default_rng(3)
    jacobian, weight, residual = rng.normal(size=(40, 5)), rng.uniform(0.1, 2.0, 40), rng.normal(size=40)
    jacobian[rng.random(jacobian.shape) < 0.3] = 0.0
    matrix, gradient = normal_matrix(jacobian, weight, residual)
    assert matrix == pytest.approx(jacobian.T @ (jacobian * weight[:, None]))
    assert gradient == pytest.approx(jacobian.T @ (weight * residual))


def test_information_is_that_of_the_hat_matrix() -> None:
    rng = np.random.default_rng(4)
    jacobian, weight, residual = rng.normal(size=(30, 4)), rng.uniform(0.5, 2.0, 30), rng.normal(size=30)
    jacobian[0] *= 40.0  # a leverage near 1, whose divisor is bounded by 0.05
    covariance: FloatArray = np.asarray(np.linalg.inv(jacobian.T @ (jacobian * weight[:, None])), np.float64)
    by_pixel, chi2 = pixel_information(jacobian, weight, residual, covariance)
    hat = np.sqrt(weight)[:, None] * jacobian @ covariance @ jacobian.T * np.sqrt(weight)
    assert hat[0, 0] > 0.96
    assert chi2 == pytest.approx(weight * residual**2 / np.maximum(1.0 - np.diag(hat), 0.05))
    assert by_pixel == pytest.approx(
        [w * float(np.sum((covariance[:2] @ row) ** 2)) for row, w in zip(jacobian, weight, strict=True)]
    )
    assert float(by_pixel.sum()) == pytest.approx(float(np.trace(covariance[:2, :2])))
