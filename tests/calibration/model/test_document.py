"""The document: the field travels whole, documents of the first schema are read as before, other shapes are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures.calibration import current_document, distinctive_calibration

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.model.document import field_document, from_document
from sunarc.calibration.model.residual_field import Field, wave_basis
from sunarc.errors import InputError


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
