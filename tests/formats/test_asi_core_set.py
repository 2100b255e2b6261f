"""asi_core's set against the rules of its schema and the formulas of its loader, written from its documentation.

`docs/studies/asi_core_load.py` asks the loader itself.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from datetime import UTC, datetime
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io
import yaml
from tests.formats.conftest import LENS, FloatArray, document_of

from sunarc.common.errors import InputError
from sunarc.formats.asi_core import asi_core_set
from sunarc.formats.formats import export
from sunarc.formats.matlab import matlab_bytes
from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject

SMALL = Camera(
    width=220, height=200, projection="equisolid", focal_length_px=(75.0, 75.0), principal_point_px=(110.0, 98.0),
    rotation_cam_enu=(0.02, -0.03, 1.0), radial=(0.01, *(0.0,) * 7),
)  # fmt: skip
TIMES = ("2013-05-13T00:00:00Z", "2013-06-01T12:30:00Z", "2014-01-01T00:00:00Z")


def document(epoch: str, start: str | None, end: str | None, **more: Any) -> dict[str, Any]:  # noqa: ANN401 - of a document
    return document_of(SMALL) | {"pose_epoch": epoch, "valid_from": start, "valid_until": end} | more


def kept_by_its_rules(text: bytes) -> dict[str, Any]:
    """Return a camera file that keeps what asi_core's schema and loader ask for."""
    camera: dict[str, Any] = yaml.safe_load(text)
    assert all(isinstance(camera[name], str) for name in ("camera_name", "camera_model", "camera_mask_file"))
    for name, low, high in (
        ("latitude", -90, 90), ("longitude", -180, 180), ("altitude", -150, 9000), ("min_ele_evaluated", 0, 90),
    ):  # fmt: skip
        assert low <= camera[name] <= high
    assert re.search(r"(Europe/Berlin|GMT|UTC)[+-]?(1[0-2]|[0-9])?([0-5][0-9])?", camera["timezone"])
    assert all(isinstance(camera[name], datetime) and camera[name].tzinfo for name in ("mounted", "demounted"))
    inner = camera["internal_calibration"]
    assert len(inner["ss"]) == 4
    assert all(isinstance(value, float) for value in inner["ss"])
    assert all(isinstance(inner[name], int) and 1 <= inner[name] <= 20000 for name in ("width", "height", "diameter"))
    assert all(0 <= inner[name] <= 20000 for name in ("xc", "yc"))
    assert (abs(inner["c"]), inner["d"], inner["e"]) == (1.0, 0.0, 0.0)
    assert len(camera["external_orientation"]) == 3
    return camera


def loaded(content: bytes, name: str) -> Any:  # noqa: ANN401 - of scipy
    return scipy.io.loadmat(io.BytesIO(content))[name]  # type: ignore[arg-type]


def test_each_epoch_has_one_file_and_no_two_overlap() -> None:
    first, second, third = TIMES
    made = asi_core_set(
        [
            document("2", second, third, state="retired", id="two", created_at=second),
            document("1", first, second, state="retired", id="one", created_at=first),
            document("2", third, None, state="current", id="three", created_at=third),
            document("3", third, None, state="refused", id="four", created_at=third),
        ]
    )
    cameras = [kept_by_its_rules(one.content) for one in made]
    assert [one.name for one in made] == ["the_roof_s_20130513000000.yaml", "the_roof_s_20130601123000.yaml"]
    assert [b"calibration one" in made[0].content, b"calibration three" in made[1].content] == [True, True]
    assert cameras[0]["demounted"] == cameras[1]["mounted"] == datetime(2013, 6, 1, 12, 30, tzinfo=UTC)
    assert (cameras[0]["mounted"].month, cameras[1]["demounted"].year) == (5, 2199)
    assert len({name for one in made for name in one.files}) == 2 * 6
    assert all(one["celestial_coordinate_masks"] in file.beside for one, file in zip(cameras, made, strict=True))


def test_a_refused_calibration_counts_where_there_is_nothing_else_and_two_cameras_are_two_sets() -> None:
    made = asi_core_set([document("1", None, None, state="refused"), document("", None, TIMES[1], camera="ö/1")])
    cameras = [kept_by_its_rules(one.content) for one in made]
    assert sorted(camera["camera_name"] for camera in cameras) == ["the roof's", "ö/1"]
    assert {camera["mounted"].year for camera in cameras} == {1970}
    assert {camera["demounted"].year for camera in cameras} == {2199, 2013}
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+", name) for one in made for name in one.files)


def test_the_mask_is_of_the_images_size_and_the_same_twice() -> None:
    (made,) = asi_core_set([document("1", *TIMES[:2])])
    camera = kept_by_its_rules(made.content)
    mask = loaded(made.beside[camera["camera_mask_file"]], "Mask")[0][0][0]
    assert (mask.shape, mask.dtype.kind) == ((SMALL.height, SMALL.width), "u")
    png = made.beside[camera["camera_mask_file"].replace(".mat", ".png")]
    image = cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert np.array_equal(image, 255 * mask)
    assert (mask[98, 110], mask[0, 0]) == (1, 0)


def theirs(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return azimuth and elevation as asi_core counts them: radians, from east counter-clockwise, NaN below 0."""
    y, x = np.mgrid[: camera.height, : camera.width]
    east, north, up = np.moveaxis(unproject(camera, np.stack([x, y], axis=-1).astype(np.float64)), -1, 0)
    with np.errstate(invalid="ignore"):
        above = up > 0.0
    elevation = np.arctan2(up, np.hypot(east, north))
    return np.where(above, np.arctan2(north, east), np.nan), np.where(above, elevation, np.nan)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_matrices_are_exact_where_four_coefficients_are_not(*, mirrored: bool) -> None:
    lens = (
        LENS if not mirrored else Camera(**{name: getattr(LENS, name) for name in LENS.__slots__} | {"mirrored": True})
    )
    (made,) = asi_core_set([document_of(lens)])
    azimuth, elevation = theirs(lens)
    stem = "_matrix_the_roof_s_20130513000000"
    read = [np.load(io.BytesIO(made.beside[f"{name}{stem}.npy"])) for name in ("azimuth", "elevation")]
    struct = loaded(made.beside[f"angle{stem}.mat"], "AngleMatrix")
    for found_azimuth, found_elevation in (read, [struct[0][field][0] for field in ("AZ", "ELE")]):
        assert (found_azimuth.shape, found_azimuth.dtype) == ((1600, 1748), np.float32)
        both = np.isfinite(elevation) & np.isfinite(found_elevation)
        assert np.mean(np.isfinite(elevation) != np.isfinite(found_elevation)) < 1e-5
        assert np.degrees(np.abs(found_elevation - elevation)[both]).max() < 1e-4
        turn = (found_azimuth - azimuth + math.pi) % (2.0 * math.pi) - math.pi
        assert np.degrees(np.abs(turn * np.cos(elevation))[both]).max() < 1e-4


def test_over_http_the_set_is_a_zip_of_the_same_bytes_each_time() -> None:
    made = export(document("1", *TIMES[:2]), "asi-core")
    with zipfile.ZipFile(io.BytesIO(made.sent)) as found:
        assert {name: found.read(name) for name in found.namelist()} == made.files
    assert made.sent == export(document("1", *TIMES[:2]), "asi-core").sent
    assert export(document("1", *TIMES[:2]), "mrcal").sent.startswith(b"#")


def test_a_matlab_file_is_the_same_whenever_it_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    content = {"Mask": {"BW": np.eye(3, dtype=np.uint8)}}
    first = matlab_bytes(content)
    monkeypatch.setattr("time.asctime", lambda: "Mon Jan  1 00:00:00 2001")
    assert matlab_bytes(content) == first
    assert first.startswith(b"MATLAB 5.0 MAT-file")
    found = scipy.io.loadmat(io.BytesIO(first))  # type: ignore[arg-type]
    np.testing.assert_array_equal(found["Mask"][0][0][0], np.eye(3))


@pytest.mark.parametrize("documents", [[], [{"schema": "something/else", "camera": "x"}]])
def test_nothing_and_no_documents_are_refused(documents: list[dict[str, Any]]) -> None:
    with pytest.raises(InputError):
        asi_core_set(documents)
