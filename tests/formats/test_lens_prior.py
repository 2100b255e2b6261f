"""The lens prior file: written and read alike, and what is wrong with one named."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread
from sunarc.common.errors import InputError
from sunarc.formats.lens_prior import LENS_SCHEMA, lens_type_from_json, lens_type_to_json

Change = Callable[[dict[str, Any]], object]


def test_what_is_written_is_read(lens: LensType) -> None:
    content = json.loads(json.dumps(lens_type_to_json(lens, software_version="1"), allow_nan=False))
    assert content["schema"] == LENS_SCHEMA
    assert content["provenance"] == {"cameras": ["one", "two"], "days": ["2013-05-13"]}
    center = content["lens"]["principal_point_from_center_px"]
    assert center == pytest.approx([871.96 - 873.5, 883.0 - 873.5])
    found = lens_type_from_json(content)
    assert found.camera.to_vector() == pytest.approx(lens.camera.to_vector(), abs=1e-12)
    assert found.covariance == pytest.approx(lens.covariance, rel=1e-12)
    assert (found.spread, found.cameras, found.days) == (lens.spread, lens.cameras, lens.days)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda d: d.update(schema="sunarc.calibration/1"), "schema"),
        (lambda d: d.pop("lens"), "lens"),
        (lambda d: d["lens"].update(radial=[0.0]), "radial, decentering"),
        (lambda d: d["lens"].update(focal_length_px=[1.0]), "lens prior"),
        (lambda d: d["lens"].update(projection="flat"), "projection"),
        (lambda d: d["uncertainty"].update(covariance=[[1.0]]), "uncertainty.covariance"),
        (lambda d: d["uncertainty"]["covariance"][0].__setitem__(0, -1.0), "uncertainty.covariance"),
        (lambda d: d["uncertainty"]["covariance"][0].__setitem__(1, 9.0), "uncertainty.covariance"),
        (lambda d: d["uncertainty"].update(parameters=["a"]), "uncertainty.parameters"),
        (lambda d: d["uncertainty"]["field"].update(amplitude_px=-1.0), "uncertainty.field.amplitude_px"),
        (lambda d: d["spread"].update(center_px=0.0), "spread.center_px"),
        (lambda d: d["spread"].update(colour=1.0), "lens prior"),
    ],
)
def test_what_is_wrong_is_named(lens: LensType, change: Change, field: str) -> None:
    content = json.loads(json.dumps(lens_type_to_json(lens, software_version="1")))
    change(content)
    with pytest.raises(InputError) as refused:
        lens_type_from_json(content)
    assert refused.value.field == field


def test_no_json_object_is_refused() -> None:
    with pytest.raises(InputError) as refused:
        lens_type_from_json([1])
    assert refused.value.field == "schema"


def test_a_spread_is_bounded() -> None:
    with pytest.raises(InputError) as refused:
        UnitSpread(focal_length=0.2)
    assert refused.value.field == "spread.focal_length"
