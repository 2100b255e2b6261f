from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.formats.conftest import LENS, document_of

from sunarc.formats.formats import export

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc


@pytest.fixture
def calibration(tmp_path: Path) -> str:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(document_of(LENS)))
    return str(path)


def test_the_differences_are_printed_by_zenith_angle(sunarc: Sunarc, calibration: str, tmp_path: Path) -> None:
    other = tmp_path / "fisheye.yml"
    other.write_bytes(export(document_of(LENS), "opencv").content)
    answer = sunarc("compare", calibration, str(other))
    assert answer.code == 0
    assert "whole sky" in answer.out
    assert "zenith angle 80-90" in answer.out
    assert "fisheye.yml cannot describe 1.5" in answer.out
    printed = sunarc("compare", calibration, str(other), "--json")
    found = json.loads(printed.out)
    assert found["rms_px"] == pytest.approx(0.144, abs=0.001)
    assert [one["zenith_deg"] for one in found["by_zenith"]] == [[0, 30], [30, 60], [60, 80], [80, 90]]


def test_a_camera_without_a_pose_and_images_of_another_size(sunarc: Sunarc, calibration: str, tmp_path: Path) -> None:
    other = tmp_path / "calib_results.txt"
    lines = export(document_of(LENS), "ocamcalib").content.decode().splitlines()
    other.write_text("\n".join(line for line in lines if not line.startswith("# ")))
    assert "has no pose" in sunarc("compare", calibration, str(other)).out
    small = tmp_path / "small.json"
    small.write_text(json.dumps(document_of(replace(LENS, width=1600))))
    answer = sunarc("compare", calibration, str(small))
    assert (answer.code, "1748x1600 and 1600x1600" in answer.err) == (2, True)
