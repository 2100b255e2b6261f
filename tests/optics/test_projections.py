"""The table of projections, and every other place that says what they are."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from tests.fixtures.calibration import current_document, distinctive_calibration, small_camera

from sunarc import _kernels
from sunarc.client import CameraModel
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import from_document
from sunarc.optics.forward import kernel_optics
from sunarc.optics.pose import right_jacobian, rotation_matrix
from sunarc.optics.projections import PROJECTIONS, Projection, ideal_radius, shape_angle, shape_radius
from sunarc.stars.sky_turn import Turns, count_on_detections

DOCS = Path(__file__).parents[2] / "docs"
UNKNOWN = (-1, len(PROJECTIONS), 255)


def test_the_table_has_each_projection_once_and_numbers_them() -> None:
    assert tuple(PROJECTIONS) == get_args(Projection)
    assert [lens.code for lens in PROJECTIONS.values()] == list(range(len(PROJECTIONS)))
    assert len({lens.shape for lens in PROJECTIONS.values()}) == len(PROJECTIONS)


def test_shapes_between_the_projections_pass_into_one_another() -> None:
    angle = np.radians(np.linspace(0.0, 80.0, 17))
    for shape in (-0.8, -1e-5, 1e-7, 1e-5, 0.3):
        np.testing.assert_allclose(shape_angle(shape, shape_radius(shape, angle)), angle, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(shape_radius(1e-5, angle), shape_radius(0.0, angle), rtol=1e-9)


def kernel_calls(code: int) -> list[Callable[[], object]]:
    camera = small_camera()
    vector, optics = camera.to_vector(), kernel_optics(camera)._replace(code=code)
    rotation, jacobian = rotation_matrix(camera.rotation_cam_enu), right_jacobian(camera.rotation_cam_enu)
    sky, radial, pixels = np.array([[0.1, 0.2, 0.97]]), np.array(camera.radial), np.array([[310.0, 220.0]])
    plane = np.array([500.0, 500.0, 0.0, 300.0, 200.0])
    return [
        lambda: _kernels.pixels_of(vector, *optics, rotation, sky),
        lambda: _kernels.pixels_and_rows_of(vector, *optics, rotation, jacobian, sky),
        lambda: _kernels.directions_of(code, -1.0, 1.0, plane, radial, np.zeros(4), rotation, pixels),
    ]


def test_every_kernel_refuses_a_code_that_is_not_in_the_table() -> None:
    for code in UNKNOWN:
        for call in kernel_calls(code):
            with pytest.raises(ValueError, match="code"):
                call()
    for lens in PROJECTIONS.values():
        for call in kernel_calls(lens.code):
            call()


def test_a_projection_without_a_row_is_refused_by_camera_document_and_client() -> None:
    with pytest.raises(InputError) as refused:
        replace(small_camera(), projection="cylindric")  # type: ignore[arg-type]
    assert refused.value.field == "projection"
    with pytest.raises(KeyError):
        ideal_radius("cylindric", 0.1)  # type: ignore[arg-type]
    document = current_document(distinctive_calibration())
    document["model"]["projection"] = "cylindric"
    with pytest.raises(InputError):
        from_document(document)
    with pytest.raises(ValueError, match="cylindric"):
        CameraModel(document)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_the_search_of_a_turn_maps_rays_as_the_projection_does(projection: Projection) -> None:
    angle, azimuth = np.meshgrid(np.radians(np.linspace(5.0, 60.0, 6)), np.linspace(0.0, 6.0, 12))
    rays = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1)
    radius = ideal_radius(projection, angle)
    onto = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth)], axis=-1)
    turns = Turns(poles=np.array([[0.0, 0.0, 1.0]] * 2), angles=np.array([0.0, 0.11]))
    shape = PROJECTIONS[projection].shape
    same, turned = count_on_detections(
        rays.reshape(-1, 3), onto.reshape(-1, 2), turns, shape=shape, reach=0.02, largest=1.5
    )
    assert same == pytest.approx(1.0, abs=1e-12)
    assert turned < 0.6


def written(name: str) -> dict[str, str]:
    """Return the formulae that a sentence "tan θ (perspective), …" of a page has, by projection."""
    text = " ".join((DOCS / name).read_text(encoding="utf-8").split())
    return {
        projection: formula.strip()
        for formula, projection in re.findall(r"([^,:()]*(?:\([^()]*\))?) \((\w+)\)", text)
        if projection in PROJECTIONS
    }


def value_of(formula: str, theta: FloatArray) -> FloatArray:
    python = re.sub(r"(tan|sin) θ", r"\1(θ)", formula).replace("2 ", "2 * ").replace("θ", "theta")
    names = {"tan": np.tan, "sin": np.sin, "theta": theta}
    return np.asarray(eval(python, {"__builtins__": {}}, names))  # noqa: S307 - a formula of our own page


def test_the_formulae_of_the_page_on_the_model_are_the_table_s() -> None:
    found = written("model.md")
    assert set(found) == set(PROJECTIONS)
    theta = np.linspace(0.0, 1.5, 11)
    for name in PROJECTIONS:
        np.testing.assert_allclose(value_of(found[name], theta), ideal_radius(name, theta), rtol=1e-14)


def test_schema_and_settings_name_the_projections_of_the_table() -> None:
    schema = json.loads((DOCS / "calibration.schema.json").read_text(encoding="utf-8"))
    named = [part["enum"] for part in _objects(schema) if "equisolid" in part.get("enum", ())]
    assert named
    assert all(set(one) == set(PROJECTIONS) for one in named)
    shown = (DOCS.parent / "deploy" / "sunarc.toml").read_text(encoding="utf-8")
    line = next(one for one in shown.splitlines() if re.match(r"# projection\b", one))
    assert set(line.rpartition("# or one of ")[2].replace(" ", "").split(",")) == set(PROJECTIONS)
    assert tomllib.loads(line.removeprefix("#").strip())["projection"] == "auto"


def _objects(node: object) -> list[dict[str, list[str]]]:
    if isinstance(node, list):
        return [one for part in node for one in _objects(part)]
    if not isinstance(node, dict):
        return []
    return [node, *(one for part in node.values() for one in _objects(part))]


def test_the_largest_angle_of_each_is_where_its_radius_ends() -> None:
    for lens in PROJECTIONS.values():
        assert lens.largest_angle == (math.pi if abs(lens.shape) < 0.7 else 0.5 * math.pi)
