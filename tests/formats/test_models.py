"""The fitted models against the formulas of their authors and the equations of their files."""

from __future__ import annotations

import ast
import io
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io
from numpy.polynomial import Polynomial
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation
from tests.formats.conftest import LENS, FloatArray, document_of

from sunarc.calibration.answers.direction_table import BackProjectionMap
from sunarc.common.errors import InputError
from sunarc.formats.asi_core import asi_core_mask, asi_core_yaml, mask_files
from sunarc.formats.exported import Table, Variable
from sunarc.formats.fisheye import fisheye_model, fisheye_view, pixels_of_rays
from sunarc.formats.formats import FORMATS, export
from sunarc.formats.mrcal import cameramodel, spline_bending, spline_weights, splined_model, splined_view
from sunarc.formats.ocam import ocam_model
from sunarc.formats.tables import every_nth, netcdf_bytes, npz_bytes
from sunarc.formats.view import camera_sky, camera_view, compare
from sunarc.optics.camera import Camera

SKY = camera_sky(LENS, within=math.radians(80.0))


def test_the_projection_is_opencvs(camera: Camera) -> None:
    del camera
    parameters = np.array([600.0, 598.0, 870.0, 800.0, 0.01, -0.02, 0.0, 0.0, 0.003, -0.0004, 0.0, 0.0])
    matrix = np.array([[600.0, 0.0, 870.0], [0.0, 598.0, 800.0], [0.0, 0.0, 1.0]])
    distortion = parameters[[4, 5, 8, 9]]
    theirs, _ = cv2.fisheye.projectPoints(SKY.rays[:, None], np.zeros(3), np.zeros(3), matrix, distortion)
    assert pixels_of_rays(parameters, SKY.rays) == pytest.approx(theirs[:, 0], abs=1e-6)


def test_an_equidistant_lens_is_opencvs_without_distortion() -> None:
    plain = replace(LENS, projection="equidistant", skew_px=0.0, radial=(0.0,) * 8, decentering=(0.0,) * 4)
    model = fisheye_model(plain)
    assert model.distortion == pytest.approx(np.zeros(4), abs=1e-6)
    assert model.matrix[0, 0] == pytest.approx(plain.focal_length_px[0], abs=1e-3)
    assert model.matrix[:2, 2] == pytest.approx(plain.principal_point_px, abs=1e-3)
    view = fisheye_view("opencv", model, size=(plain.width, plain.height))
    assert compare(camera_view(plain), view).total.max_px < 1e-4


@pytest.mark.parametrize("u", [(0.0, 0.0), (0.31, -0.72), (-1.2, 0.4)])
def test_the_surface_is_scipys_cubic_b_spline(u: tuple[float, float]) -> None:
    control, per_u = np.random.default_rng(0).normal(size=(40, 40)), 10.0
    ours = (spline_weights(np.array([u]), per_u) @ control.ravel())[0]
    knots = np.arange(-2.0, 42.0)
    spline = [BSpline(knots, np.eye(40)[k], 3) for k in range(40)]
    x, y = (value * per_u + 19.5 for value in u)
    by_x, by_y = (np.array([float(one(at)) for one in spline]) for at in (x, y))
    assert ours == pytest.approx(float(by_y @ control @ by_x))


def test_the_weights_of_every_ray_sum_to_one_and_beyond_the_knots_too() -> None:
    u = np.random.default_rng(1).uniform(-9.0, 9.0, (50, 2))
    assert np.asarray(spline_weights(u, 10.0).sum(axis=1)) == pytest.approx(1.0)


def test_a_smooth_surface_is_not_bent() -> None:
    rows, columns = np.mgrid[:40, :40]
    surface = (0.3 + 0.1 * columns - 0.2 * rows + 0.01 * rows * columns + 0.005 * columns**2).ravel()
    assert np.abs(spline_bending() @ surface).max() < 1e-9
    assert np.abs(spline_bending() @ (columns**3).ravel()).max() == pytest.approx(6.0)


def test_mrcals_file_has_the_pose_and_the_size() -> None:
    model = splined_model(LENS)
    read = ast.literal_eval(cameramodel(model, LENS, notes=["a note"]).decode())
    assert read["extrinsics"] == pytest.approx([*LENS.rotation_cam_enu, 0.0, 0.0, 0.0])
    assert read["imagersize"] == [LENS.width, LENS.height]
    assert read["intrinsics"] == pytest.approx(model.intrinsics.tolist(), rel=1e-9)
    fov = int(read["lensmodel"].rpartition("=")[2])
    assert 2.0 * math.degrees(LENS.max_angle) < fov <= 330


def test_a_stereographic_lens_needs_no_control_points() -> None:
    plain = replace(LENS, projection="stereographic", skew_px=0.0, radial=(0.0,) * 8, decentering=(0.0,) * 4)
    model = splined_model(plain)
    assert model.intrinsics[:4] == pytest.approx([*plain.focal_length_px, *plain.principal_point_px])
    assert np.abs(model.intrinsics[4:]).max() < 1e-6
    view = splined_view(model, size=(plain.width, plain.height))
    assert compare(camera_view(plain), view).total.max_px < 1e-4


@pytest.mark.parametrize("cubic", [False, True])
def test_scaramuzzas_two_polynomials_are_inverses(*, cubic: bool) -> None:
    model = ocam_model(LENS, cubic=cubic)
    theta = np.radians(np.linspace(-80.0, -5.0, 40))  # above the image plane; the sky is below it
    radius = Polynomial(model.ray_to_pixel)(theta)
    assert np.arctan2(Polynomial(model.pixel_to_ray)(radius), radius) == pytest.approx(
        theta, abs=5e-3 if cubic else 5e-4
    )
    assert (np.diff(radius) > 0.0).all()
    assert model.pixel_to_ray[1] == 0.0 or cubic
    assert len(model.pixel_to_ray) == 4 or not cubic


def test_the_affine_part_is_symmetric_and_the_rotation_proper(camera: Camera) -> None:
    model = ocam_model(camera)
    sign = -1.0 if camera.mirrored else 1.0
    c, d, e = model.affine
    assert c * sign == pytest.approx(1.0, abs=5e-3)
    assert e == pytest.approx(sign * d)
    assert model.rotation @ model.rotation.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(model.rotation) == pytest.approx(1.0)


def test_a_cubic_model_is_mirrored_or_not_and_nothing_else(camera: Camera) -> None:
    model = ocam_model(camera, cubic=True)
    assert model.affine.tolist() == [-1.0 if camera.mirrored else 1.0, 0.0, 0.0]


def test_asi_cores_angles_are_those_of_its_rotation() -> None:
    model = ocam_model(LENS, cubic=True)
    site: dict[str, str | float] = {
        "camera_name": "it's", "camera_mask_file": "m.mat", "celestial_coordinate_masks": "",
        "mounted": "2013-05-13", "demounted": "2014-01-01",
        "latitude": 36.6, "longitude": -97.5, "altitude": 318.0,
    }  # fmt: skip
    text = asi_core_yaml(model, width=1748, height=1600, camera=site, notes=["one", "two"]).decode()
    assert text.startswith("# one\n# two\ncamera_name: 'it''s'\n")
    numbers = re.search(r"external_orientation: \[(.*)\]", text)
    assert numbers is not None
    alpha, beta, gamma = (float(one) for one in numbers.group(1).split(","))
    rotation = (
        Rotation.from_rotvec([alpha, 0, 0]) * Rotation.from_rotvec([0, beta, 0]) * Rotation.from_rotvec([0, 0, gamma])
    )
    assert rotation.as_matrix() == pytest.approx(model.rotation.T, abs=1e-9)


def test_the_mask_is_one_down_to_the_horizon_and_zero_below_and_outside(tmp_path: Path) -> None:
    zenith = np.array([[0.0, 89.9, 90.0], [90.1, np.nan, 45.0]], dtype=np.float32)
    none, directions = np.zeros_like(zenith), np.zeros((2, 3, 3), dtype=np.float32)
    found = BackProjectionMap(
        zenith_deg=zenith, azimuth_deg=none, directions=directions, sigma_deg=none, inside=np.isfinite(zenith)
    )
    files = mask_files(asi_core_mask(found), stem="roof")
    path = tmp_path / "mask.mat"
    path.write_bytes(files["roof_mask.mat"])
    assert scipy.io.loadmat(str(path))["Mask"][0][0][0].tolist() == [[1, 1, 1], [0, 0, 1]]
    png = cv2.imdecode(np.frombuffer(files["roof_mask.png"], dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    assert png is not None
    assert png.tolist() == [[255, 255, 255], [0, 0, 255]]


@pytest.mark.parametrize(
    ("step", "size", "rows"), [(8, 17, [0, 8, 16]), (8, 18, [0, 8, 16, 17]), (8, 1, [0]), (1, 3, [0, 1, 2])]
)
def test_a_grid_has_its_last_pixel_once(step: int, size: int, rows: list[int]) -> None:
    assert every_nth(step, size).tolist() == rows


def table() -> Table:
    return Table(
        variables={
            "x": Variable(dimensions=("x",), values=np.arange(3, dtype=np.int32), attributes={"units": "1"}),
            "label": Variable(dimensions=("x",), values=np.array(["a", "bc", "ü"]), attributes={}),
            "v": Variable(
                dimensions=("x",), values=np.array([1.5, np.nan, -2.0]), attributes={"k": np.array([1.0, 2.0])}
            ),
        },
        attributes={"title": "three"},
    )


def test_a_table_is_read_back_by_xarray() -> None:
    xarray: Any = pytest.importorskip("xarray")
    found = xarray.load_dataset(io.BytesIO(netcdf_bytes(table())), engine="h5netcdf")
    assert found["label"].values.tolist() == ["a", "bc", "ü"]
    np.testing.assert_array_equal(found["v"], [1.5, np.nan, -2.0])
    assert (found.attrs["title"], found["x"].attrs["units"]) == ("three", "1")
    assert found["v"].attrs["k"].tolist() == [1.0, 2.0]


def test_a_table_is_read_back_by_numpy_without_pickle() -> None:
    found = np.load(io.BytesIO(npz_bytes(table())), allow_pickle=False)
    assert found["label"].tolist() == ["a", "bc", "ü"]
    said = json.loads(str(found["attributes"]))
    assert said["attributes"] == {"title": "three"}
    assert (said["x"], said["v"]) == ({"units": "1"}, {"k": [1.0, 2.0]})


def test_json_is_the_document_itself(straight: dict[str, Any]) -> None:
    assert json.loads(export(straight, "json").content) == straight


@pytest.mark.parametrize("wanted", FORMATS)
def test_what_is_no_document_is_refused_in_every_format(wanted: Any) -> None:  # noqa: ANN401 - a format
    with pytest.raises(InputError):
        export({"schema": "something/else"}, wanted)


def test_a_calibration_without_an_end_is_mounted_for_long() -> None:
    small = replace(LENS, width=220, height=200, focal_length_px=(75.0, 75.0), principal_point_px=(110.0, 100.0))
    content = export(document_of(small) | {"valid_from": None}, "asi-core").content.decode()
    assert "mounted: !!timestamp '1970-01-01T00:00:00Z'" in content
    assert "demounted: !!timestamp '2199-12-31T00:00:00Z'" in content


def test_a_ray_at_a_known_angle_lands_at_the_polynomials_radius() -> None:
    theta = math.acos(0.8)
    plain: FloatArray = np.array([100.0, 100.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = pixels_of_rays(plain, np.array([[0.6, 0.0, 0.8]]))[0]
    assert found == pytest.approx([100.0 * theta * (1.0 + 0.5 * theta**2), 0.0])
