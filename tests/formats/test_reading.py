"""Files of every format: read back they are off as stated, and what is none is refused by name."""

from __future__ import annotations

import io
import json
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io
from tests.formats.conftest import LENS, Export, document_of, worst_stated_deg, worst_stated_px

from sunarc.common.errors import InputError
from sunarc.formats.formats import SERVED, export, read_view
from sunarc.formats.view import camera_view, closest_camera, compare
from sunarc.optics.camera import Camera

SMALL = Camera(
    width=220, height=200, projection="equidistant", focal_length_px=(62.0, 62.0), principal_point_px=(110.0, 100.0),
    rotation_cam_enu=(0.02, -0.03, 1.0),
)  # fmt: skip


@pytest.mark.parametrize("form", SERVED)
def test_an_export_that_is_read_is_off_by_the_stated_error(form: Any, exported: Export, camera: Camera) -> None:  # noqa: ANN401 - a format
    made = exported(form)
    view = read_view(made.content, name="file", beside=made.beside.get)
    found = compare(camera_view(camera), view)
    assert view.form == ("netcdf" if form == "npz" else form)
    if form == "json":
        assert found.total.max_px == 0.0
        return
    assert found.total.max_px == pytest.approx(worst_stated_px(made.error), rel=0.1)
    assert found.total.max_deg == pytest.approx(worst_stated_deg(made.error), rel=0.1)


@pytest.mark.parametrize("form", ["opencv", "mrcal", "netcdf"])
def test_the_camera_of_ours_that_is_closest_to_a_file_is_close(form: Any, exported: Export, camera: Camera) -> None:  # noqa: ANN401 - a format
    found, error = closest_camera(read_view(exported(form).content, name="file"))
    assert found.mirrored == camera.mirrored
    assert error.total.max_px < 0.02
    same, _ = closest_camera(read_view(exported(form).content, name="file"), projection="equisolid")
    assert same.projection == "equisolid"
    assert same.focal_length_px == pytest.approx(camera.focal_length_px, rel=0.02)
    ours = compare(camera_view(camera), camera_view(same)).total.rms_px
    assert ours == pytest.approx(0.144 if form == "opencv" else 0.005, rel=0.1, abs=0.005)


def test_a_document_is_its_own_camera() -> None:
    found, error = closest_camera(read_view(json.dumps(document_of(LENS)).encode(), name="file"))
    assert (found, error.total.max_px) == (LENS, 0.0)


def test_a_file_without_a_pose_says_so_and_its_lens_is_the_same() -> None:
    text = export(document_of(LENS), "ocamcalib").content.decode()
    bare = "\n".join(line for line in text.splitlines() if not line.startswith("# "))
    view = read_view(bare.encode(), name="calib_results.txt")
    assert not view.has_pose
    ray = view.unproject(np.array([[872.0, 803.0], [1172.0, 803.0]]))
    assert ray[0] == pytest.approx([0.0, 0.0, 1.0], abs=5e-3)
    assert ray[1, 0] > 0.4  # x to the right
    assert compare(camera_view(LENS), view).total.rms_px < 0.2


@pytest.mark.parametrize("ending", ["yml", "xml", "json"])
def test_the_files_of_opencv_are_read_in_its_three_forms(ending: str) -> None:
    storage = cv2.FileStorage(f".{ending}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("note", "K: [1, 2]")
    storage.write("image_width", 220)
    storage.write("image_height", 200)
    storage.write("K", np.array([[62.0, 0.0, 110.0], [0.0, 62.0, 100.0], [0.0, 0.0, 1.0]]))
    storage.write("D", np.full(4, 1e-12))  # an array of one dimension
    plain = read_view(storage.releaseAndGetString().encode(), name=f"fisheye.{ending}")
    assert not plain.has_pose
    assert compare(camera_view(SMALL), plain).total.max_px < 1e-6
    camera, _ = closest_camera(plain)
    assert camera.projection == "equidistant"
    assert camera.focal_length_px == pytest.approx((62.0, 62.0), rel=1e-6)


def test_without_the_inverse_polynomial_asi_cores_four_coefficients_are_inverted() -> None:
    made = export(document_of(LENS), "asi-core")
    bare = b"\n".join(line for line in made.content.splitlines() if b"invpol" not in line)
    view = read_view(bare, name="camera.yaml", beside=made.beside.get)
    pixels = np.random.default_rng(0).uniform(300.0, 1300.0, (200, 2))
    assert view.project(view.unproject(pixels)) == pytest.approx(pixels, abs=1e-4)


def mask_of(shape: tuple[int, int]) -> bytes:
    target = io.BytesIO()
    scipy.io.savemat(target, {"Mask": np.ones((1, 1, 1, *shape), dtype=np.uint8)})  # type: ignore[arg-type]
    return target.getvalue()


def with_nan(*keys: str) -> dict[str, Any]:
    """Return a calibration document with NaN where a number stood."""
    document = json.loads(json.dumps(document_of(SMALL)))
    place: Any = document
    for key in keys:
        place = place[key]
    while isinstance(place[0], list):
        place = place[0]
    place[0] = float("nan")
    return dict(document)


YAML = export(document_of(SMALL), "asi-core").content
OCAM = export(document_of(SMALL), "ocamcalib").content
OPENCV = export(document_of(SMALL), "opencv").content
MRCAL = b"{'lensmodel': 'LENSMODEL_CAHVORE', 'extrinsics': [0,0,0,0,0,0], 'intrinsics': [1], 'imagersize': [2, 2]}"
NOTHING = io.BytesIO()
np.savez(NOTHING, x=np.arange(4), y=np.arange(3), direction=np.full((3, 4, 3), np.nan))
OTHER = io.BytesIO()
np.savez(OTHER, x=np.arange(4), y=np.arange(3), direction=np.ones((4, 3, 3)))
TWICE = io.BytesIO()
np.savez_compressed(TWICE, x=np.array([0, 1, 1, 2]), y=np.arange(3), direction=np.ones((3, 4, 3)))
DEFLATED = TWICE.getvalue().replace(TWICE.getvalue()[40:60], b"\xff" * 20)
TEN = YAML.replace(b"  ss: [", b"  ss: [" + b"0.0, " * 6)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"\x00\x01", "no known format"),
        (b"{}", "schema"),
        (json.dumps(document_of(SMALL) | {"schema": "sunarc.calibration/3"}).encode(), "calibration/3"),
        (TEN, "10 coefficients"),
        (YAML.replace(b"  xc:", b"  x_center:"), "another schema"),
        (YAML.replace(b"external_orientation: [", b"external_orientation: [0.0, "), "4 angles"),
        (b"internal_calibration: [", "another schema"),
        (OCAM.replace(b"#center", b"7 7\n#center"), "five blocks"),
        (OCAM.replace(b"\n\n", b"\n\n1", 1), "not as long"),
        (OCAM.replace(b"e+", b"f+"), "no OCamCalib"),
        (OPENCV.replace(b"rows: 4", b"rows: 5"), "no distortion"),
        (OPENCV.replace(b"camera_matrix", b"matrix_of_it"), "camera matrix"),
        (OPENCV.replace(b"image_width", b"image_breadth"), "image size"),
        (b"%YAML:1.0\n---\na: [", "cannot read|camera matrix"),
        (MRCAL, "LENSMODEL_CAHVORE"),
        (b"{'lensmodel': 'LENSMODEL_", "camera model of mrcal"),
        (b"PK\x03\x04", "no map"),
        (b"\x89HDF", "no map"),
        (NOTHING.getvalue(), "NaN"),
        (YAML.replace(b"  xc: ", b"  xc: .nan #"), "no pixel"),
        (json.dumps(with_nan("uncertainty", "covariance")).encode(), "not finite"),
        (json.dumps(with_nan("model", "radial")).encode(), "not finite"),
        (OTHER.getvalue(), "shape"),
        (TWICE.getvalue(), "ascend"),
        (DEFLATED, "no map"),
        (OCAM.replace(b";", b" "), "rotation"),
    ],
)  # fmt: skip
def test_what_is_not_what_it_says_is_refused(content: bytes, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        read_view(content, name="file")


@pytest.mark.parametrize(
    ("mask", "problem"), [(mask_of((200, 221)), "221x200"), (b"nothing", "MATLAB"), (b"", "MATLAB")]
)
def test_a_mask_of_another_size_is_refused(mask: bytes, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        read_view(YAML, name="camera.yaml", beside=lambda _: mask)
    assert read_view(YAML, name="camera.yaml", beside=lambda _: mask_of((200, 220))).width == 220
    assert read_view(YAML, name="camera.yaml", beside=lambda _: None).height == 200
