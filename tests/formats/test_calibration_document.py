"""The document: the field travels whole, documents of the first schema are read as before, other shapes are refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures.calibration import current_document, distinctive_calibration

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance, replace_covariance
from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.result import ErrorMixture, distances_holding
from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import field_document, from_document
from sunarc.optics.displacement import wave_basis


@pytest.fixture
def field() -> Field:
    basis = wave_basis(width=640, height=480, shortest_px=160.0, longest_px=160.0)
    cross = np.zeros((2, 3, len(basis.orders)))
    cross[0, 0, :3] = 1.0, 2e-5, 5e-6
    return Field(amplitude_px=0.3, length_px=160.0, basis=basis, cross=cross)


def test_a_field_travels_whole_and_none_has_no_waves(field: Field) -> None:
    document = field_document(field)
    assert document["orders"] == field.basis.orders.tolist()
    np.testing.assert_allclose(document["cross"], field.cross, rtol=1e-7)
    assert field_document(replace(field, amplitude_px=0.0))["orders"] == []


def test_a_displacement_travels_with_its_field_and_without_one(field: Field) -> None:
    mean = np.zeros((2, len(field.basis.orders)))
    mean[0, 7], mean[1, 3] = 12.0, -5.0
    shift = field.basis.displacement(mean)
    np.testing.assert_allclose(field_document(field, shift)["mean"], mean)
    alone = field_document(replace(field, amplitude_px=0.0), shift)
    np.testing.assert_allclose(alone["mean"], mean)
    assert alone["known"] == []
    assert alone["coupling"] == [[], []]


def test_a_document_of_the_first_schema_is_read_as_before() -> None:
    made = distinctive_calibration()
    document = current_document(made)
    field = document["uncertainty"]["field"]
    for key in ("mean", "known", "coupling"):
        del field[key]
    with pytest.raises(InputError) as refused:
        from_document(document)
    assert refused.value.field.startswith("uncertainty.field")
    # the first schema left out waves of small cross terms
    field["orders"], field["cross"] = field["orders"][:-5], [[row[:-5] for row in part] for part in field["cross"]]
    first = from_document(document | {"schema": "sunarc.calibration/1"})
    assert first.camera == made.camera.lens_alone()
    sky = hemisphere(30)
    cross = np.concatenate([made.field.cross[..., :-5], np.zeros((*made.field.cross.shape[:2], 5))], axis=-1)
    alone = replace(made.field, cross=cross, known=np.zeros(0), coupling=np.zeros(0))
    expected = project_with_covariance(replace(made, camera=made.camera.lens_alone(), field=alone), sky)
    found = project_with_covariance(first, sky)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-9)


def test_a_parameter_of_a_newer_version_is_refused_by_its_name() -> None:
    document = current_document(distinctive_calibration())
    document["uncertainty"]["parameters"][-1] = "clock_drift_s"
    with pytest.raises(InputError) as refused:
        from_document(document)
    assert refused.value.field == "uncertainty.parameters"
    assert "clock_drift_s" in refused.value.problem


def test_the_document_says_what_the_calibration_does() -> None:
    made, sky = distinctive_calibration(), hemisphere(30)
    read = from_document(current_document(made))
    for one, other in zip(project_with_covariance(read, sky), project_with_covariance(made, sky), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("mean", [[1.0], [2.0]]),
        ("known", [[1.0]]),
        ("coupling", [[[1.0]], [[2.0]]]),
        ("orders", [[1, 10**6]]),
        ("mean", None),
        ("coupling", [[], 5]),
    ],
)
def test_a_field_of_other_shapes_is_refused(key: str, value: object) -> None:
    document = current_document(distinctive_calibration())
    document["uncertainty"]["field"][key] = value
    with pytest.raises(InputError) as refused:
        from_document(document)
    assert refused.value.field.startswith("uncertainty.field")


MIXTURE = ErrorMixture(
    shares=np.array([0.7, 0.3]),
    pixels_px=np.array([[600.0, 400.0], [800.0, 500.0]]),
    scales=np.array([[0.5, 1.5], [0.8, 1.2]]),
)


def test_the_mixture_is_read_as_it_was_written_and_none_where_there_is_none() -> None:
    made = replace(distinctive_calibration(), mixture=MIXTURE)
    document = current_document(made)
    found = from_document(document).mixture
    assert found is not None
    for name in ("shares", "pixels_px", "scales"):
        np.testing.assert_allclose(getattr(found, name), getattr(MIXTURE, name))
    del document["uncertainty"]["mixture"]
    assert from_document(document).mixture is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("shares", [0.7, 0.7]),
        ("shares", [1.2, -0.2]),
        ("shares", []),
        ("shares", None),
        ("pixels_px", []),
        ("pixels_px", [[1.0, 2.0]]),
        ("scales", [[1.0, 0.0], [1.0, 1.0]]),
        ("scales", [[1.0], [1.0]]),
    ],
)
def test_a_mixture_that_is_none_is_refused(key: str, value: object) -> None:
    document = current_document(replace(distinctive_calibration(), mixture=MIXTURE))
    document["uncertainty"]["mixture"][key] = value
    with pytest.raises(InputError) as refused:
        from_document(document)
    assert refused.value.field.startswith("uncertainty.mixture")


def test_a_mixture_holds_the_shares_that_draws_of_it_have() -> None:
    places = np.array([[600.0, 400.0], [800.0, 500.0], [500.0, 300.0]])
    rng = np.random.default_rng(1)
    drawn = MIXTURE.at(places)[:, rng.choice(2, 40_000, p=MIXTURE.shares)]
    distance = drawn * np.hypot(*rng.standard_normal((2, 3, 40_000)))
    np.testing.assert_allclose(MIXTURE.at(places[:2]), MIXTURE.scales, rtol=1e-6)
    for share in (0.5, 0.68, 0.95, 0.99):
        limits = MIXTURE.sigma_factors(places, share) * math.sqrt(-2.0 * math.log(1.0 - share))
        np.testing.assert_allclose(np.mean(distance < limits[:, None], axis=1), share, atol=0.01)
        held = distances_holding(np.ones(1), np.full((3, 1), 2.0), share)
        np.testing.assert_allclose(held**2, -8.0 * math.log(1.0 - share))


def test_errors_beside_a_gaussian_are_less_of_a_mixture() -> None:
    """Of a class of 1-sigma s, half of whose stated variance is another Gaussian's, (s² + 1) / 2 is left."""
    np.testing.assert_allclose(MIXTURE.beside(np.array([1.0, 1.0])).scales, MIXTURE.scales)
    np.testing.assert_allclose(MIXTURE.beside(np.array([0.5, 0.5])).scales ** 2, 0.5 * (MIXTURE.scales**2 + 1.0))
    np.testing.assert_allclose(MIXTURE.about(2.0).scales, 0.5 * MIXTURE.scales)


def test_a_covariance_with_further_errors_has_a_mixture_that_is_nearer_to_a_gaussian() -> None:
    made = replace(distinctive_calibration(), mixture=MIXTURE)
    covariance = made.covariance.copy()
    pose = slice(5, 8)
    covariance[pose, pose] += 100.0 * np.max(np.abs(covariance)) * np.eye(3)
    found = replace_covariance(made, covariance)
    assert found.mixture is not None
    assert np.all(np.abs(found.mixture.scales - 1.0) < np.abs(MIXTURE.scales - 1.0))
    assert replace_covariance(replace(made, mixture=None), covariance).mixture is None
