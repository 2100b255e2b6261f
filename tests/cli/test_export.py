from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from tests.exports.conftest import LENS, document_of

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc


@pytest.fixture
def calibration(tmp_path: Path) -> str:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(document_of(LENS)))
    return str(path)


def test_a_calibration_is_written_in_another_format_and_its_error_said(
    sunarc: Sunarc, calibration: str, tmp_path: Path
) -> None:
    target = tmp_path / "fisheye.yml"
    answer = sunarc("export", "--calibration", calibration, "--format", "opencv", "-o", str(target))
    assert (answer.code, answer.out) == (0, "")
    assert "px RMS" in answer.err
    storage = cv2.FileStorage(str(target), cv2.FILE_STORAGE_READ)
    assert np.asarray(storage.getNode("camera_matrix").mat()).shape == (3, 3)


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (("--format", "matlab"), "--format: 'matlab' is unknown; use one of json, opencv"),
        (("--format", "npz", "-o", "/nowhere/x.npz"), "cannot write /nowhere/x.npz"),
    ],
)
def test_what_cannot_be_exported_is_said_in_one_line(
    sunarc: Sunarc, calibration: str, arguments: tuple[str, ...], names: str
) -> None:
    answer = sunarc("export", "--calibration", calibration, *arguments)
    assert answer.code in {2, 3}
    assert names in answer.err
    assert answer.err.count("\n") == 1


def test_a_file_that_is_no_calibration_is_named(sunarc: Sunarc, tmp_path: Path) -> None:
    path = tmp_path / "list.json"
    path.write_text("[]")
    answer = sunarc("export", "--calibration", str(path), "--format", "mrcal")
    assert (answer.code, "list.json: is no JSON object" in answer.err) == (2, True)
