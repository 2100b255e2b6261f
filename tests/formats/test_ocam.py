"""Readers of OCamCalib's and asi_core's files, written from their definitions."""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
import pytest
import scipy.io
import yaml
from tests.formats.conftest import Export, FloatArray, apart_deg, document_of, worst_stated_deg, worst_stated_px

from sunarc.formats.calibration_document import from_document
from sunarc.formats.formats import export
from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.directions import angles_from_direction, direction_from_angles

Sky = tuple[FloatArray, FloatArray]


class Ocam:
    """Scaramuzza's model: points are (row, column), rays (down, right, into the camera)."""

    def __init__(self, ss: list[float], invpol: list[float], xc: float, yc: float, affine: list[float]) -> None:
        self.ss, self.invpol, self.xc, self.yc = ss, invpol, xc, yc
        self.c, self.d, self.e = affine

    def cam2world(self, points: FloatArray) -> FloatArray:
        determinant = self.c - self.d * self.e
        row, column = points[:, 0] - self.xc, points[:, 1] - self.yc
        x, y = (row - self.d * column) / determinant, (self.c * column - self.e * row) / determinant
        radius = np.hypot(x, y)
        z = sum(coefficient * radius**power for power, coefficient in enumerate(self.ss))
        ray = np.stack([x, y, z], axis=-1)
        return np.asarray(ray / np.linalg.norm(ray, axis=-1, keepdims=True))

    def world2cam(self, rays: FloatArray) -> FloatArray:
        across = np.hypot(rays[:, 0], rays[:, 1])
        theta = np.arctan(rays[:, 2] / across)
        radius = sum(coefficient * theta**power for power, coefficient in enumerate(self.invpol))
        x, y = rays[:, 0] / across * radius, rays[:, 1] / across * radius
        return np.stack([x * self.c + y * self.d + self.xc, x * self.e + y + self.yc], axis=-1)


def read_calib_results(text: str) -> tuple[Ocam, FloatArray, tuple[int, int]]:
    """Read five blocks, each after one line of comment, as the toolbox's C code does; then R from the notes."""
    lines = [line for line in text.splitlines() if line.strip()]
    ss, invpol = (([float(v) for v in lines[i].split()]) for i in (1, 3))
    assert [len(ss) - 1, len(invpol) - 1] == [int(ss[0]), int(invpol[0])]
    assert [lines[i][0] for i in (0, 2, 4, 6, 8)] == ["#"] * 5
    xc, yc = (float(v) for v in lines[5].split())
    height, width = (int(v) for v in lines[9].split())
    turn = next(line for line in lines if line.startswith("# R from")).rpartition(": ")[2]
    rotation = np.array([[float(v) for v in row.split()] for row in turn.split(";")])
    return Ocam(ss[1:], invpol[1:], xc, yc, [float(v) for v in lines[7].split()]), rotation, (height, width)


def test_both_polynomials_of_ocamcalib_agree_to_their_stated_errors(exported: Export, camera: Camera, sky: Sky) -> None:
    made = exported("ocamcalib")
    ocam, rotation, size = read_calib_results(made.content.decode())
    assert size == (camera.height, camera.width)
    directions, pixels = sky
    off = ocam.world2cam(directions @ rotation.T)[:, ::-1] - pixels
    assert np.linalg.norm(off, axis=-1).max() == pytest.approx(worst_stated_px(made.error), rel=0.1)
    apart = apart_deg(ocam.cam2world(pixels[:, ::-1]) @ rotation, directions)
    assert apart.max() == pytest.approx(worst_stated_deg(made.error), rel=0.1)
    assert (worst_stated_px(made.error) < 0.5, worst_stated_deg(made.error) < 0.05) == (True, True)
    assert ocam.ss[1] == 0.0
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert made.error in made.content.decode()


def test_the_centre_is_the_row_first_and_counted_from_0(straight: dict[str, Any]) -> None:
    ocam, _, _ = read_calib_results(export(straight, "ocamcalib").content.decode())
    assert ocam.xc == pytest.approx(803.0, abs=1.0)  # the principal point's y
    assert ocam.yc == pytest.approx(871.96, abs=1.0)  # and its x


def read_asi_core(text: str) -> tuple[Ocam, FloatArray, dict[str, Any]]:
    """Return the model and the matrix from its frame to east-north-up: Rx(alpha) Ry(beta) Rz(gamma)."""
    camera = yaml.safe_load(text)
    inner = camera["internal_calibration"]
    alpha, beta, gamma = camera["external_orientation"]
    ca, sa, cb, sb, cg, sg = (f(v) for v in (alpha, beta, gamma) for f in (math.cos, math.sin))
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_z = np.array([[cg, -sg, 0], [sg, cg, 0], [0, 0, 1]])
    affine = [inner["c"], inner["d"], inner["e"]]
    ocam = Ocam(inner["ss"], inner["invpol"], inner["xc"], inner["yc"], affine)
    return ocam, about_x @ about_y @ about_z, camera


def test_asi_core_sees_each_pixel_where_we_see_it(exported: Export, sky: Sky) -> None:
    made = exported("asi-core")
    ocam, turn, told = read_asi_core(made.content.decode())
    directions, pixels = sky
    apart = apart_deg(ocam.cam2world(pixels[:, ::-1]) @ turn.T, directions)
    assert 0.5 * worst_stated_deg(made.error) < apart.max() < 1.05 * worst_stated_deg(made.error)  # at the horizon
    assert 0.05 < np.sqrt(np.mean(apart**2)) < 0.15  # four coefficients can no more
    off = ocam.world2cam(directions @ turn)[:, ::-1] - pixels
    assert np.linalg.norm(off, axis=-1).max() == pytest.approx(worst_stated_px(made.error), rel=0.1)
    assert (told["camera_name"], told["latitude"]) == ("the roof's", 36.604043)
    assert told["mounted"].year == 2013
    assert all(isinstance(value, float) for value in told["internal_calibration"]["ss"])
    assert made.error in made.content.decode()


def test_asi_core_takes_the_file_by_its_own_rules(exported: Export, camera: Camera) -> None:
    made = exported("asi-core")
    told = yaml.safe_load(made.content)
    required = ("camera_name", "camera_model", "camera_mask_file", "timezone", "mounted", "demounted")
    assert all(told[name] for name in required)
    assert all(isinstance(told[name], float) for name in ("latitude", "longitude", "altitude", "min_ele_evaluated"))
    inner = told["internal_calibration"]
    assert all(isinstance(inner[name], int) for name in ("width", "height", "diameter"))
    assert len(inner["ss"]) == 4
    assert (inner["c"], inner["d"], inner["e"]) == (-1.0 if camera.mirrored else 1.0, 0.0, 0.0)
    assert 1670 < inner["diameter"] < 1730  # 2 · 601.32 · √2 = 1701, and the radial distortion
    name = told["camera_mask_file"]
    mask = scipy.io.loadmat(io.BytesIO(made.beside[name]))["Mask"][0][0][0]  # type: ignore[arg-type]
    assert mask.shape == (camera.height, camera.width)
    lookup_x = camera.width - 1 - 872 if camera.mirrored else 872
    assert (mask[803, lookup_x], mask[0, 0]) == (1, 0)


@pytest.mark.parametrize("wanted", ["ocamcalib", "asi-core"])
def test_no_rotation_and_no_scale_hide_in_the_affine_part(exported: Export, wanted: Any) -> None:  # noqa: ANN401
    content = exported(wanted).content.decode()
    ocam = (read_calib_results if wanted == "ocamcalib" else read_asi_core)(content)[0]
    plane = np.array([[ocam.c, ocam.d], [ocam.e, 1.0]])
    if np.linalg.det(plane) < 0.0:
        plane = plane @ np.diag([-1.0, 1.0])  # mirrored
    assert abs(plane[0, 1] - plane[1, 0]) < 1e-9
    assert np.linalg.norm(plane - np.eye(2)) < 5e-3


def test_asi_cores_azimuth_matrix_runs_counter_clockwise_from_east(straight: dict[str, Any]) -> None:
    ocam, turn, _ = read_asi_core(export(straight, "asi-core").content.decode())
    pixel = np.array([[700.0, 950.0]])
    east, north, up = (ocam.cam2world(pixel[:, ::-1]) @ turn.T)[0]
    theirs_deg = math.degrees(math.atan2(north, east))  # as its cartesian_to_spherical(x=east, y=north, z=up)
    ours = unproject(from_document(straight).camera, pixel)
    zenith, azimuth = angles_from_direction(ours)
    assert (90.0 - theirs_deg) % 360.0 == pytest.approx(float(azimuth[0]), abs=0.1)
    assert math.degrees(math.acos(up)) == pytest.approx(float(zenith[0]), abs=0.1)


def test_the_centre_of_asi_core_is_the_row_first(straight: dict[str, Any]) -> None:
    _, _, told = read_asi_core(export(straight, "asi-core").content.decode())
    inner = told["internal_calibration"]
    assert (round(inner["xc"]), round(inner["yc"])) == (803, 872)
    assert (inner["width"], inner["height"]) == (1748, 1600)


def test_a_sky_with_north_on_top_has_west_on_its_right_there_too() -> None:
    level = Camera(
        width=1001,
        height=1001,
        projection="equidistant",
        focal_length_px=(300.0, 300.0),
        principal_point_px=(500.0, 500.0),
        rotation_cam_enu=(0.0, 0.0, math.pi),
    )
    ocam, turn, _ = read_asi_core(export(document_of(level), "asi-core").content.decode())
    top_and_right = np.array([[300.0, 500.0], [500.0, 700.0]])  # rows and columns
    found = ocam.cam2world(top_and_right) @ turn.T
    wanted = direction_from_angles(zenith_deg=[math.degrees(2 / 3)] * 2, azimuth_deg=[0.0, 270.0])
    np.testing.assert_allclose(found, wanted, atol=1e-3)
    assert np.linalg.norm(rotation_matrix(level.rotation_cam_enu)[2] - [0, 0, 1]) < 1e-12
