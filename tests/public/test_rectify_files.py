"""A bright dot in a known direction lands on the grid where that direction belongs."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.formats.conftest import LENS, FloatArray, document_of

from sunarc.common.errors import InputError, OutsideError
from sunarc.imaging.metadata import png_with
from sunarc.optics.forward import project
from sunarc.public.calibration_files import rectify_files
from sunarc.sky.directions import direction_from_angles

CAMERA = replace(
    LENS, width=640, height=600, focal_length_px=(212.0, 212.0), principal_point_px=(318.0, 301.0), skew_px=0.0
)
ZENITH, AZIMUTH = 40.0, 65.0


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibration") / "calibration.json"
    path.write_text(json.dumps(document_of(CAMERA)))
    return path


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an image with a red dot where the camera sees a direction."""
    direction = direction_from_angles(zenith_deg=np.array([ZENITH]), azimuth_deg=np.array([AZIMUTH]))
    x, y = project(CAMERA, direction)[0]
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    dot = 250.0 * np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / 9.0)
    path = tmp_path_factory.mktemp("images") / "noon.png"
    cv2.imwrite(str(path), np.dstack([np.zeros_like(dot), np.zeros_like(dot), dot]).astype(np.uint8))
    return path


def center(values: FloatArray) -> tuple[float, float]:
    """Return row and column of the centre of mass."""
    rows, columns = np.mgrid[: values.shape[0], : values.shape[1]]
    return float(np.sum(rows * values) / values.sum()), float(np.sum(columns * values) / values.sum())


def test_a_composite_that_is_a_mosaic_is_mapped_in_its_colours(calibration: Path, tmp_path: Path) -> None:
    mosaic = np.zeros((CAMERA.height, CAMERA.width), dtype=np.uint16)
    mosaic[0::2, 0::2] = 40_000  # red alone, of an RGGB sensor
    document = {"schema": "sunarc.image/1", "bayer": "RGGB"}
    png = png_with(
        cv2.imencode(".png", mosaic)[1].tobytes(), document, software="sunarc", created="2013-05-13T18:30:00Z"
    )
    (tmp_path / "raw.png").write_bytes(png)
    (done,) = rectify_files(
        [tmp_path / "raw.png"],
        calibration,
        grid="sky",
        size=100,
        cloud_height_m=None,
        half_width_m=None,
        folder=tmp_path / "maps",
    )
    found = cv2.imread(done["written"], cv2.IMREAD_UNCHANGED)
    assert found is not None
    assert found.shape == (100, 100, 3)
    assert found.dtype == np.dtype(np.uint16)
    np.testing.assert_allclose(found[50, 50], [0, 0, 40_000], atol=1)


def test_on_the_map_of_the_sky_north_is_up_and_east_is_left(calibration: Path, image: Path, tmp_path: Path) -> None:
    (done,) = rectify_files(
        [image], calibration, grid="sky", size=500, cloud_height_m=None, half_width_m=None, folder=tmp_path / "maps"
    )
    found = cv2.imread(done["written"])
    assert found is not None
    assert (found.shape, Path(done["written"]).name) == ((500, 500, 3), "noon_sky.png")
    row, column = center(found[..., 2].astype(np.float64))
    radius = ZENITH / 90.0 * 250.0
    assert column == pytest.approx(249.5 - radius * math.sin(math.radians(AZIMUTH)), abs=0.1)
    assert row == pytest.approx(249.5 - radius * math.cos(math.radians(AZIMUTH)), abs=0.1)
    assert found[..., :2].max() == 0
    assert 0.7 < done["seen"] < 0.8  # a circle in its square: pi / 4


def test_on_the_ground_a_cloud_is_at_its_distance(calibration: Path, image: Path, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    (done,) = rectify_files(
        [image], calibration, grid="ground", size=801, cloud_height_m=1500.0, half_width_m=4000.0, folder=tmp_path
    )
    with rasterio.open(done["written"]) as file:
        assert (file.count, file.shape, file.crs.to_dict()["proj"]) == (3, (801, 801), "aeqd")
        assert file.crs.to_dict()["lat_0"] == pytest.approx(36.604043)
        row, column = center(file.read(1).astype(np.float64))  # red comes first
        east, north = (
            file.transform.c + file.transform.a * (column + 0.5),
            file.transform.f + file.transform.e * (row + 0.5),
        )
        assert file.read(3).max() == 0
    away = 1500.0 * math.tan(math.radians(ZENITH))
    assert east == pytest.approx(away * math.sin(math.radians(AZIMUTH)), abs=5.0)
    assert north == pytest.approx(away * math.cos(math.radians(AZIMUTH)), abs=5.0)


def test_unless_said_the_ground_reaches_to_78_degrees(calibration: Path, image: Path, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    (done,) = rectify_files(
        [image], calibration, grid="ground", size=101, cloud_height_m=1000.0, half_width_m=None, folder=tmp_path
    )
    with rasterio.open(done["written"]) as file:
        assert file.bounds.right == pytest.approx(1000.0 * math.tan(math.radians(78.0)) * 101 / 100)
        assert file.bounds.left == pytest.approx(-file.bounds.right)


def test_what_cannot_be_mapped_is_refused(calibration: Path, image: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.png"
    cv2.imwrite(str(other), np.zeros((10, 12), dtype=np.uint8))
    with pytest.raises(InputError, match="12x10"):
        rectify_files(
            [other], calibration, grid="sky", size=50, cloud_height_m=None, half_width_m=None, folder=tmp_path
        )
    with pytest.raises(InputError) as refused:
        rectify_files(
            [image], calibration, grid="ground", size=50, cloud_height_m=None, half_width_m=None, folder=tmp_path
        )
    assert refused.value.field == "--cloud-height"
    for size, height in ((1, 5.0), (50, -1.0), (50, math.nan)):
        with pytest.raises(InputError, match="not positive"):
            rectify_files(
                [image],
                calibration,
                grid="ground",
                size=size,
                cloud_height_m=height,
                half_width_m=None,
                folder=tmp_path,
            )
    with pytest.raises(OutsideError):
        rectify_files(
            [image], calibration, grid="sky", size=50, cloud_height_m=None, half_width_m=None, folder=other / "below"
        )
