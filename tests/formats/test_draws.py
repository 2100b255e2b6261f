"""Draws of an ensemble in NetCDF and npz files, and on the command line."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.fixtures.calibration import current_document, small_camera, stated_calibration
from tests.fixtures.command_line import Sunarc, sunarc

from sunarc.calibration.answers.error_model import draw_ensemble
from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import from_document
from sunarc.formats.formats import MOST_DRAWS_OF_A_FILE, export, export_draws

__all__ = ["sunarc"]


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return current_document(stated_calibration(small_camera()))


def opened(content: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(content)) as file:
        return {name: file[name] for name in file.files}


def test_a_file_has_the_directions_of_each_draw_beside_what_it_has_without(document: dict[str, Any]) -> None:
    found = opened(export_draws(document, "npz", draws=3, seed=5))
    plain = opened(export(document, "npz").content)
    for name in set(plain) - {"attributes"}:
        np.testing.assert_array_equal(found[name], plain[name])
    drawn = found["direction_draw"]
    assert drawn.shape == (3, len(found["y"]), len(found["x"]), 3)
    ensemble = draw_ensemble(from_document(document), draws=3, seed=5, calibration_id=document["id"])
    row, column = len(found["y"]) // 2, len(found["x"]) // 3
    pixel = np.array([[found["x"][column], found["y"][row]]], dtype=np.float64)
    for k in ensemble:
        np.testing.assert_allclose(drawn[k, row, column], ensemble.back_project(k, pixel)[0], atol=1e-6)
    beyond = np.isnan(found["direction"][..., 0])
    assert np.mean(np.isnan(drawn[0, ..., 0]) != beyond) < 0.02  # the field's edge is where the draw has it
    assert json.loads(str(found["attributes"]))["attributes"]["seed"] == 5


def test_draws_come_as_netcdf_too(document: dict[str, Any]) -> None:
    h5netcdf = pytest.importorskip("h5netcdf")
    with h5netcdf.File(io.BytesIO(export_draws(document, "netcdf", draws=2, seed=0)), "r") as file:
        variable = file.variables["direction_draw"]
        assert variable.dimensions == ("draw", "y", "x", "component")
        assert variable.shape[0] == 2


@pytest.mark.parametrize(
    ("draws", "seed", "field"), [(0, 0, "--draws"), (MOST_DRAWS_OF_A_FILE + 1, 0, "--draws"), (1, -1, "--seed")]
)
def test_numbers_out_of_bounds_are_refused(document: dict[str, Any], draws: int, seed: int, field: str) -> None:
    with pytest.raises(InputError) as caught:
        export_draws(document, "npz", draws=draws, seed=seed)
    assert caught.value.field == field


def test_the_command_writes_them_and_refuses_other_formats(
    document: dict[str, Any], sunarc: Sunarc, tmp_path: Path
) -> None:
    file, target = tmp_path / "calibration.json", tmp_path / "draws.npz"
    file.write_text(json.dumps(document), encoding="utf-8")
    command = ("export", "--calibration", str(file), "--draws", "4", "--seed", "2", "-o", str(target))
    assert sunarc(*command, "--format", "npz").code == 0
    assert opened(target.read_bytes())["direction_draw"].shape[0] == 4
    answer = sunarc(*command, "--format", "opencv")
    assert answer.code != 0
    assert "--draws" in answer.err
