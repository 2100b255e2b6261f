from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from tests.fixtures.calibrations import chosen_calibration
from tests.formats.conftest import LENS, document_of, document_of_fit

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
        (("--format", "matlabs"), "[format_unknown]"),
        (("--format", "npz", "-o", "/nowhere/x.npz"), "cannot write /nowhere/x.npz"),
        (("--format", "json", "--at", "yesterday"), "--at: 'yesterday' is not a time"),
        (("--format", "json", "--at", "2014-05-13T18:30:00"), "--at: '2014-05-13T18:30:00' has no time zone"),
        (("--format", "json", "--at", "0001-01-01T00:00:00+12:00"), "--at: '0001-01-01T00:00:00+12:00' is not within"),
    ],
)
def test_what_cannot_be_exported_is_said_in_one_line(
    sunarc: Sunarc, calibration: str, arguments: tuple[str, ...], names: str
) -> None:
    answer = sunarc("export", "--calibration", calibration, *arguments)
    assert answer.code in {2, 3}
    assert names in answer.err
    assert answer.err.count("\n") == 1


def test_asi_cores_set_is_written_into_a_folder_and_a_camera_file_beside_its_mask(
    sunarc: Sunarc, tmp_path: Path
) -> None:
    small = replace(LENS, width=220, height=200, focal_length_px=(75.0, 75.0), principal_point_px=(110.0, 100.0))
    first, second = (
        document_of(small) | {"id": name, "pose_epoch": name, "valid_from": f"2013-0{name}-01T00:00:00Z"}
        for name in "12"
    )
    documents = tmp_path / "calibrations"
    documents.mkdir()
    (documents / "1.json").write_text(json.dumps(first))
    (documents / "2.json").write_text(json.dumps(second))
    target = tmp_path / "a" / "cameras"
    answer = sunarc("export", "--calibration", str(documents), "--format", "asi-core", "-o", str(target))
    assert (answer.code, answer.err.count("\n")) == (0, 2)
    assert len(list(target.iterdir())) == 12
    assert len(list(target.glob("*.yaml"))) == 2
    one = tmp_path / "camera.yaml"
    assert (
        sunarc("export", "--calibration", str(documents / "1.json"), "--format", "asi-core", "-o", str(one)).code == 0
    )
    assert sorted(path.suffix for path in tmp_path.iterdir() if path.is_file()) == [".mat", ".png", ".yaml"]
    blocked = one / "folder"
    answer = sunarc("export", "--calibration", str(documents), "--format", "asi-core", "-o", str(blocked))
    assert (answer.code, str(blocked) in answer.err) == (3, True)


def test_two_images_are_written_into_a_folder_and_one_file_as_it_is_called(sunarc: Sunarc, tmp_path: Path) -> None:
    small = replace(LENS, width=220, height=200, focal_length_px=(75.0, 75.0), principal_point_px=(110.0, 100.0))
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(document_of(small)))
    answer = sunarc(
        "export", "--calibration", str(path), "--format", "azimuth-zenith-jp2", "-o", str(tmp_path / "visible")
    )
    assert (answer.code, "px RMS" in answer.err) == (0, True)
    assert sorted(one.name for one in (tmp_path / "visible").iterdir()) == ["azimuth_visible.jp2", "zenith_visible.jp2"]
    camera = tmp_path / "cameras.txt"
    assert sunarc("export", "--calibration", str(path), "--format", "colmap", "-o", str(camera)).code == 0
    assert "1 THIN_PRISM_FISHEYE 220 200" in camera.read_text()
    compared = sunarc("compare", str(path), str(tmp_path / "visible" / "zenith_visible.jp2"), "--json")
    assert json.loads(compared.out)["formats"] == ["json", "azimuth-zenith-jp2"]


def test_a_file_that_is_no_calibration_is_named(sunarc: Sunarc, tmp_path: Path) -> None:
    path = tmp_path / "list.json"
    path.write_text("[]")
    answer = sunarc("export", "--calibration", str(path), "--format", "mrcal")
    assert (answer.code, "list.json: " in answer.err) == (2, True)


@pytest.mark.parametrize(
    ("at", "aged_days"),
    [
        ("2013-05-16T18:30:00Z", 0),  # within a week of the sightings
        ("2013-11-13T19:30:00+01:00", 183),
        ("2012-11-13T18:30:00Z", -183),  # before the calibration: the season differs as much
    ],
)
def test_the_exported_uncertainty_is_that_of_a_time(sunarc: Sunarc, tmp_path: Path, at: str, aged_days: int) -> None:
    made = chosen_calibration(
        LENS,
        names=("focal_length_x_px", "focal_length_y_px", "rotation_z"),
        covariance=np.diag([1e-4, 1e-4, 1e-10]),
        orders=np.array([[1, 1]]),
    )
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(document_of_fit(made)))

    def exported(*arguments: str) -> dict[str, Any]:
        target = tmp_path / "exported.json"
        answer = sunarc("export", "--calibration", str(path), "--format", "json", "-o", str(target), *arguments)
        assert answer.code == 0
        found: dict[str, Any] = json.loads(target.read_text())
        return found

    of_fit, then = exported(), exported("--at", at)
    assert then["uncertainty"].get("aged_days", 0) == aged_days
    assert {key for key in then if then[key] != of_fit[key]} == ({"uncertainty"} if aged_days else set())
    # half a wave of 1-sigma 3e-4 and a tenth of it that years differ by, of 601 px
    more_px = float(np.sqrt(then["uncertainty"]["covariance"][0][0] - of_fit["uncertainty"]["covariance"][0][0]))
    assert (2.0 * 3e-4 * 601.32 <= more_px <= 2.4 * 3e-4 * 601.32) if aged_days else more_px == 0.0
    assert (then["uncertainty"]["sky_rms_deg"] > of_fit["uncertainty"]["sky_rms_deg"]) is bool(aged_days)
