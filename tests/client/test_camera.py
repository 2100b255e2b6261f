"""A document evaluated by the client: against the service's own code, for every projection."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.fixtures.calibration import current_document, distinctive_calibration

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance, unproject_with_sigma
from sunarc.calibration.model.result import ErrorMixture
from sunarc.client import CameraModel
from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import camera_document, from_document
from sunarc.optics.projections import PROJECTIONS

SKY = hemisphere(60)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_it_is_what_the_service_says(projection: str, *, mirrored: bool) -> None:
    made = distinctive_calibration(projection, mirrored=mirrored, higher=0.03)
    model = CameraModel(current_document(made))
    pixels, covariance = project_with_covariance(made, SKY)
    found = model.project(5.0 * SKY.reshape(-1, 2, 3))
    assert found.pixels.shape == (len(SKY) // 2, 2, 2)
    np.testing.assert_allclose(found.pixels.reshape(-1, 2), pixels, atol=1e-9)
    np.testing.assert_allclose(found.covariance_px2.reshape(-1, 2, 2), covariance, rtol=1e-5, atol=1e-8)
    inside = found.inside.ravel()
    assert 10 < inside.sum() < len(SKY)
    seen = pixels[inside]
    directions, sigma, _ = unproject_with_sigma(made, seen)
    back = model.back_project(seen)
    np.testing.assert_allclose(back.direction, directions, atol=1e-9)
    np.testing.assert_allclose(back.sigma_deg, sigma, rtol=1e-4)
    zenith = np.degrees(np.arccos(directions[:, 2]))
    np.testing.assert_allclose(back.zenith_deg, zenith, atol=1e-6)
    assert back.inside.all()
    assert (found.calibration, back.calibration) == (model.id, model.id)


@pytest.mark.parametrize("many", [False, True])
def test_the_camera_alone_projects_and_has_no_sigma(*, many: bool) -> None:
    whole = current_document(distinctive_calibration(higher=0.03))
    alone = camera_document(whole)
    assert len(json.dumps(alone)) < min(8000, len(json.dumps(whole)))
    assert whole["uncertainty"]["field"]["mean"] == alone["uncertainty"]["field"]["mean"]
    sky = np.repeat(SKY, 40, axis=0) if many else SKY
    found, expected = (CameraModel(one).project(sky) for one in (alone, whole))
    np.testing.assert_array_equal(found.pixels, expected.pixels)
    assert np.isnan(found.sigma_px).all()
    assert np.isnan(found.covariance_px2).all()
    back, expected_back = (CameraModel(one).back_project(expected.pixels) for one in (alone, whole))
    np.testing.assert_array_equal(back.direction, expected_back.direction)
    assert np.isnan(back.sigma_deg).all()


def test_the_camera_alone_is_no_whole_document() -> None:
    with pytest.raises(InputError, match="schema"):
        from_document(camera_document(current_document(distinctive_calibration())))


def test_the_distances_that_hold_a_share_are_those_of_the_mixture() -> None:
    made = distinctive_calibration()
    mixture = ErrorMixture(
        shares=np.array([0.7, 0.3]),
        pixels_px=np.array([[100.0, 100.0], [900.0, 500.0]]),
        scales=np.array([[0.5, 1.5], [0.8, 1.2]]),
    )
    pixels = np.array([[[100.0, 100.0], [400.0, 300.0]]])
    gaussian = np.sqrt(-2.0 * np.log(0.05))
    plain = current_document(made)
    np.testing.assert_allclose(CameraModel(plain).distances(pixels, 0.95), gaussian)
    del plain["uncertainty"]["mixture"]
    np.testing.assert_allclose(CameraModel(plain).distances(pixels, 0.95), gaussian)
    for share in (0.5, 0.99):
        found = CameraModel(current_document(replace(made, mixture=mixture))).distances(pixels, share)
        expected = mixture.sigma_factors(pixels.reshape(-1, 2), share) * np.sqrt(-2.0 * np.log(1.0 - share))
        np.testing.assert_allclose(found, expected[None], rtol=1e-6)


def test_without_a_field_and_outside_the_field_of_view() -> None:
    made = distinctive_calibration(field_px=0.0, higher=0.03)
    model = CameraModel(current_document(made))
    np.testing.assert_allclose(
        model.project(SKY[:5]).covariance_px2, project_with_covariance(made, SKY[:5])[1], rtol=1e-5, atol=1e-8
    )
    beyond = model.project([[0.0, 0.1, -1.0], [0.0, 0.0, 1.0]])
    assert np.isnan(beyond.pixels[0]).all()
    assert beyond.inside.tolist() == [False, True]
    outside = model.back_project([[5.0, 5.0], [650.0, 470.0], [-3.0, 2.0], [np.nan, 4.0]])
    assert outside.inside.tolist() == [False, True, False, False]
    assert np.isnan(outside.direction[[0, 3]]).all()


@pytest.mark.parametrize("projection", ["perspective", "equidistant", "equisolid", "stereographic", "orthographic"])
def test_many_points_have_their_uncertainty_from_a_table_to_a_percent(projection: str) -> None:
    model = CameraModel(current_document(distinctive_calibration(projection, mirrored=True, higher=0.03)))
    rows, columns = np.mgrid[0 : model.height - 1 : 70j, 0 : model.width - 1 : 70j]
    pixels = np.stack([columns, rows], axis=-1)
    many, few = model.back_project(pixels), [model.back_project(row) for row in pixels]
    np.testing.assert_allclose(many.direction, [row.direction for row in few], atol=1e-10)
    np.testing.assert_allclose(many.sigma_deg, [row.sigma_deg for row in few], rtol=0.01)
    assert np.isfinite(many.sigma_deg).sum() > 1000
    seen = many.direction[np.isfinite(many.sigma_deg)]
    parts = np.array_split(seen, 3)
    exact = np.concatenate([model.project(part).covariance_px2 for part in parts])
    covariance = model.project(np.concatenate([seen] * 3)).covariance_px2[: len(seen)]
    trace = np.trace(exact, axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(covariance / trace, exact / trace, atol=0.01)


@pytest.mark.parametrize("change", [{"schema": "sunarc.calibration/3"}, {"schema": None}])
def test_another_version_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"sunarc\.calibration/2"):
        CameraModel(current_document(distinctive_calibration(higher=0.03)) | change)
