"""Priors of a lens, against draws of what they describe."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures.calibration import ideal_camera, small_camera

from sunarc.calibration.model.options import ImageCircle, LensTolerances
from sunarc.calibration.solve.priors import (
    DECENTERING,
    FREE,
    FREE_NAMES,
    LENS,
    N_LENS,
    RADIAL,
    Whitened,
    lens_prior,
    precisions,
    radial_basis,
)
from sunarc.optics.camera import PARAMETER_NAMES, POSE, Camera, Param
from sunarc.optics.forward import distorted_radius, project
from sunarc.optics.projections import Projection, ideal_radius

TOLERANCES = LensTolerances()
CIRCLE = ImageCircle(x=318.0, y=241.0, radius=231.0)


def test_the_indices_divide_the_parameters_into_lens_pose_and_translation() -> None:
    assert PARAMETER_NAMES[POSE] == ("rotation_x", "rotation_y", "rotation_z")
    translation = {i for i, name in enumerate(PARAMETER_NAMES) if name.startswith("translation")}
    assert sorted([*LENS, *np.r_[POSE], *translation]) == list(range(23))
    assert sorted(FREE) == sorted([*LENS, *np.r_[POSE]])
    assert tuple(name for name in PARAMETER_NAMES if not name.startswith("translation")) == FREE_NAMES
    lens_names = [PARAMETER_NAMES[i] for i in LENS]
    assert lens_names[RADIAL] == [f"k{n}" for n in range(2, 10)]
    assert lens_names[DECENTERING] == ["p1", "p2"]
    assert N_LENS == 17


def test_precisions_are_inverse_variances_of_the_two_scales() -> None:
    found = precisions(4.0, 0.5)
    np.testing.assert_allclose(found[RADIAL], 1.0 / 16.0)
    np.testing.assert_allclose(found[DECENTERING], 4.0)
    others = np.delete(found, np.r_[RADIAL, DECENTERING])
    assert others.size == 7
    np.testing.assert_allclose(others, 1.0)


def test_whitened_coordinates_and_the_lens_are_each_other_s_inverse() -> None:
    camera = small_camera()
    prior = lens_prior(camera, tolerances=TOLERANCES, circle=None, field_angle=math.pi / 2)
    z = prior.whitened(camera)
    assert z.shape == (N_LENS,)
    np.testing.assert_allclose(prior.lens(z), camera.to_vector()[LENS], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(prior.lens(np.zeros(N_LENS)), prior.mean)


def _covariance(circle: ImageCircle | None, camera: Camera) -> np.ndarray:
    prior = lens_prior(camera, tolerances=TOLERANCES, circle=circle, field_angle=math.pi / 2)
    return np.asarray(prior.basis @ prior.basis.T)


def test_the_variances_are_those_of_the_tolerances() -> None:
    camera = replace(ideal_camera(), focal_length_px=(198.0, 202.0))
    covariance = _covariance(None, camera)
    sigma = np.sqrt(np.diag(covariance))
    focal, aspect = 0.3 * 200.0, 0.02
    assert sigma[0] == pytest.approx(math.hypot(focal, 0.5 * aspect))
    difference = covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1]
    assert math.sqrt(difference) == pytest.approx(aspect, rel=1e-3)  # of alpha_x - alpha_y
    assert sigma[2] == pytest.approx(0.01)
    np.testing.assert_allclose(sigma[3:5], 0.03 * 480.0)
    np.testing.assert_allclose(sigma[15:17], 0.3)


def test_an_image_circle_tells_centre_and_focal_length() -> None:
    camera = ideal_camera()
    prior = lens_prior(camera, tolerances=TOLERANCES, circle=CIRCLE, field_angle=math.pi / 2)
    np.testing.assert_allclose(prior.mean[:5], [200.0, 200.0, 0.0, 318.0, 241.0])
    sigma = np.sqrt(np.diag(prior.basis @ prior.basis.T))
    np.testing.assert_allclose(sigma[3:5], 5.0)
    assert sigma[0] == pytest.approx(12.0, rel=1e-6)
    mirrored = lens_prior(replace(camera, mirrored=True), tolerances=TOLERANCES, circle=CIRCLE, field_angle=math.pi / 2)
    assert mirrored.mean[3] == 639.0 - 318.0


def test_without_a_circle_the_centre_is_the_image_s() -> None:
    prior = lens_prior(ideal_camera(), tolerances=TOLERANCES, circle=None, field_angle=math.pi / 2)
    np.testing.assert_allclose(prior.mean, [200.0, 200.0, 0.0, 319.5, 239.5, *([0.0] * 12)])


def test_one_unit_of_decentering_is_a_pixel_at_the_horizon() -> None:
    camera = ideal_camera()
    prior = lens_prior(camera, tolerances=TOLERANCES, circle=None, field_angle=math.pi / 2)
    p1 = prior.basis[13, 13]
    along_x = np.array([1.0, 0.0, 1e-12])  # the horizon in the direction in which p1 shifts the radius
    bent = replace(camera, decentering=(float(p1), 0.0, 0.0, 0.0))
    shift = project(bent, along_x) - project(camera, along_x)
    np.testing.assert_allclose(shift, [1.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("projection", ["equisolid", "equidistant", "stereographic"])
def test_the_radial_distortion_of_unit_scale_is_about_a_pixel_at_every_angle(projection: Projection) -> None:
    camera = replace(small_camera(), projection=projection, radial=(0.0,) * 8)
    basis = radial_basis(camera, length=math.radians(34.0), upto=math.pi / 2)
    theta = np.linspace(0.0, math.pi / 2, 90)
    powers = (theta / (math.pi / 2))[:, None] ** np.arange(2, 10)
    sigma_px = 220.5 * np.sqrt(np.sum((powers @ basis) ** 2, axis=-1))
    assert sigma_px[0] == 0.0
    assert 0.6 < np.sqrt(np.mean(sigma_px**2)) < 1.1  # the kernel's 1 px without its part that is a focal length


def test_the_radial_distortion_has_no_share_of_a_focal_length() -> None:
    camera = replace(small_camera(), radial=(0.0,) * 8)
    basis = radial_basis(camera, length=math.radians(34.0), upto=math.pi / 2)
    theta = np.linspace(0.0, math.pi / 2, 181)
    powers = (theta / (math.pi / 2))[:, None] ** np.arange(2, 10)
    ideal = ideal_radius(camera.projection, theta)
    share = 220.5 * (ideal @ powers @ basis) / np.linalg.norm(ideal) / math.sqrt(theta.size)
    # the gauge leaves 0.3 px (root mean square) of it at most
    assert 0.15 < np.linalg.norm(share) < 0.3


def test_radial_columns_are_independent_and_none_vanishes() -> None:
    basis = radial_basis(small_camera(), length=math.radians(34.0), upto=math.pi / 2)
    assert basis.shape == (8, 8)
    gram = basis.T @ basis
    scale = np.sqrt(np.diag(gram))
    np.testing.assert_allclose(gram / np.outer(scale, scale), np.eye(8), atol=1e-6)
    assert np.all(scale > 0.0)


def test_a_smoother_kernel_has_fewer_ways_to_bend() -> None:
    def shares(length_deg: float) -> np.ndarray:
        basis = radial_basis(small_camera(), length=math.radians(length_deg), upto=math.pi / 2)
        theta = np.linspace(0.05, math.pi / 2, 60)
        values = ((theta / (math.pi / 2))[:, None] ** np.arange(2, 10)) @ basis
        power = np.sort(np.linalg.svd(values, compute_uv=False) ** 2)[::-1]
        return np.asarray(power / power.sum())

    assert shares(60.0)[:2].sum() > shares(15.0)[:2].sum() + 0.05


def test_the_radius_of_a_drawn_lens_rises() -> None:
    camera = ideal_camera()
    prior = lens_prior(camera, tolerances=TOLERANCES, circle=CIRCLE, field_angle=math.pi / 2)
    rng = np.random.default_rng(3)
    theta = np.linspace(0.0, math.pi / 2, 90)
    for _ in range(20):
        vector = camera.to_vector()
        vector[LENS] = prior.lens(rng.standard_normal(17) / np.sqrt(precisions(2.0, 0.7)))
        assert np.all(np.diff(distorted_radius(camera.replace_parameters(vector), theta)) > 0.0)


@pytest.mark.parametrize(
    ("coordinate", "moved"),
    [
        (Whitened.FOCAL_LENGTH, (Param.FOCAL_LENGTH_X_PX, Param.FOCAL_LENGTH_Y_PX)),
        (Whitened.ASPECT, (Param.FOCAL_LENGTH_X_PX, Param.FOCAL_LENGTH_Y_PX)),
        (Whitened.SKEW, (Param.SKEW_PX,)),
        (Whitened.CENTER_X, (Param.PRINCIPAL_POINT_X_PX,)),
        (Whitened.CENTER_Y, (Param.PRINCIPAL_POINT_Y_PX,)),
        (Whitened.P1, (Param.P1,)),
        (Whitened.P2, (Param.P2,)),
        (Whitened.P3, (Param.P3,)),
        (Whitened.P4, (Param.P4,)),
    ],
)
def test_a_whitened_coordinate_moves_the_parameters_of_its_name_alone(
    coordinate: Whitened, moved: tuple[Param, ...]
) -> None:
    prior = lens_prior(small_camera(), tolerances=TOLERANCES, circle=CIRCLE, field_angle=math.pi / 2)
    z = np.zeros(N_LENS)
    z[coordinate] = 1.0
    assert tuple(LENS[np.flatnonzero(prior.lens(z) - prior.mean)]) == moved
