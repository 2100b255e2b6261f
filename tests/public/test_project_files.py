"""Directions and pixels as CSV agree with the calibration's own functions."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from tests.formats.conftest import LENS, document_of

from sunarc.calibration.answers.covariance import project_with_covariance, unproject_with_sigma
from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import from_document
from sunarc.public.calibration_files import project_csv, read_calibration, unproject_csv
from sunarc.sky.directions import angles_from_direction, direction_from_angles


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibration") / "calibration.json"
    path.write_text(json.dumps(document_of(LENS)))
    return path


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_a_projected_row_is_the_models_pixel_with_its_covariance(calibration: Path) -> None:
    target = io.StringIO()
    project_csv(calibration, io.StringIO("zenith_deg,azimuth_deg\n40,135\n0,0\n"), target)
    direction = direction_from_angles(zenith_deg=np.array([40.0, 0.0]), azimuth_deg=np.array([135.0, 0.0]))
    pixels, covariance = project_with_covariance(from_document(document_of(LENS)), direction)
    for row, pixel, of_pixel in zip(rows_of(target.getvalue()), pixels, covariance, strict=True):
        assert [float(row["x_px"]), float(row["y_px"])] == pytest.approx(pixel.tolist(), abs=1e-9)
        stated = [float(row[name]) for name in ("cov_xx", "cov_xy", "cov_yy")]
        assert stated == pytest.approx([of_pixel[0, 0], of_pixel[0, 1], of_pixel[1, 1]], abs=1e-9)
        assert row["inside"] == "1"


def test_sigma_is_the_root_of_the_mean_variance_of_the_axes(calibration: Path) -> None:
    target = io.StringIO()
    project_csv(calibration, io.StringIO("zenith_deg,azimuth_deg\n60,10\n"), target)
    (row,) = rows_of(target.getvalue())
    variance = 0.5 * (float(row["cov_xx"]) + float(row["cov_yy"]))
    assert float(row["sigma_px"]) == pytest.approx(variance**0.5, rel=1e-6)


def test_an_unprojected_row_is_the_models_direction(calibration: Path) -> None:
    target = io.StringIO()
    unproject_csv(calibration, io.StringIO("x_px,y_px\n600.5,700.25\n"), target)
    (row,) = rows_of(target.getvalue())
    direction, sigma_deg, _ = unproject_with_sigma(from_document(document_of(LENS)), np.array([[600.5, 700.25]]))
    zenith, azimuth = angles_from_direction(direction)
    assert float(row["zenith_deg"]) == pytest.approx(float(zenith[0]), abs=1e-9)
    assert float(row["azimuth_deg"]) == pytest.approx(float(azimuth[0]), abs=1e-9)
    assert float(row["sigma_deg"]) == pytest.approx(float(sigma_deg[0]), abs=1e-9)


def test_there_and_back_again_is_the_pixel_that_was_given(calibration: Path) -> None:
    angles, pixels = io.StringIO(), io.StringIO()
    unproject_csv(calibration, io.StringIO("x_px,y_px\n300,900\n1200.125,400.5\n"), angles)
    given = "\n".join(f"{row['zenith_deg']},{row['azimuth_deg']}" for row in rows_of(angles.getvalue()))
    project_csv(calibration, io.StringIO(f"zenith_deg,azimuth_deg\n{given}\n"), pixels)
    found = [(float(row["x_px"]), float(row["y_px"])) for row in rows_of(pixels.getvalue())]
    assert found == [pytest.approx((300.0, 900.0), abs=1e-6), pytest.approx((1200.125, 400.5), abs=1e-6)]


def test_a_pixel_outside_the_image_says_so(calibration: Path) -> None:
    target = io.StringIO()
    unproject_csv(calibration, io.StringIO("x_px,y_px\n-1,5\n800,800\n"), target)
    assert [row["inside"] for row in rows_of(target.getvalue())] == ["0", "1"]


@pytest.mark.parametrize("text", ["{", "", "\x00"])
def test_a_file_that_is_no_json_is_refused_by_its_path(tmp_path: Path, text: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        read_calibration(path)
    assert refused.value.field == str(path)


@pytest.mark.parametrize("text", ["[]", "3", "{}", '{"schema": "other/1"}', "null"])
def test_json_that_is_no_calibration_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(text)
    with pytest.raises(InputError):
        read_calibration(path)


@pytest.mark.parametrize("rows", ["x_px\n1\n", "x_px,y_px\n1,two\n", "x_px,y_px\n1,nan\n", ""])
def test_rows_that_are_no_pixels_are_refused(calibration: Path, rows: str) -> None:
    with pytest.raises(InputError) as refused:
        unproject_csv(calibration, io.StringIO(rows), io.StringIO())
    assert refused.value.field.startswith("standard input")
