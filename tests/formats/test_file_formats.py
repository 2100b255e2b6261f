"""Files that `sunarc export` writes for other programs, read by the formulas of those programs."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io
import yaml
from tests.formats.conftest import LENS, FloatArray, apart_deg, document_of, worst_stated_deg, worst_stated_px

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.common.errors import InputError
from sunarc.formats.exported import Exported
from sunarc.formats.formats import FORMATS, export, read_view
from sunarc.formats.remap import ground_grid, remap_tables, sky_grid
from sunarc.formats.view import camera_view, compare
from sunarc.optics.camera import camera_sees
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.sky.directions import angles_from_direction, direction_from_angles

SMALL = replace(
    LENS, width=330, height=300, focal_length_px=(112.0, 112.3), principal_point_px=(164.2, 150.9), skew_px=0.0,
    decentering=(4e-3, -2e-3, 0.1, 0.0),
)  # fmt: skip
MIRRORED = replace(SMALL, mirrored=True)
FILES = [
    name for name, one in FORMATS.items() if one.media_type is None and one.read is not None and name[:4] != "map-"
]
IMAGES = ("azimuth-zenith-png", "azimuth-zenith-jp2")


@cache
def made(form: str, *, mirrored: bool = False) -> Exported:
    return export(document_of(MIRRORED if mirrored else SMALL), form)


def sky() -> tuple[FloatArray, FloatArray]:
    directions = hemisphere(2003)
    pixels = project(SMALL, directions)
    seen = camera_sees(SMALL, pixels)
    return directions[seen], pixels[seen]


@pytest.mark.parametrize("form", FILES)
def test_a_file_that_is_read_is_off_by_the_stated_error(form: str) -> None:
    exported = made(form)
    view = read_view(exported.content, name=exported.name, beside=exported.beside.get)
    found = compare(camera_view(SMALL), view)
    assert (view.form, view.has_pose) == (form, True)
    assert found.total.max_px == pytest.approx(worst_stated_px(exported.error), rel=0.1)
    assert found.total.max_deg == pytest.approx(worst_stated_deg(exported.error), rel=0.1)
    assert found.undescribed < 0.04


@pytest.mark.parametrize("form", [form for form in FILES if form not in ("colmap", "ros")])
def test_mirrored_images_are_described_by_tables(form: str) -> None:
    exported = made(form, mirrored=True)
    view = read_view(exported.content, name=exported.name, beside=exported.beside.get)
    assert compare(camera_view(MIRRORED), view).total.max_deg < 0.01


@pytest.mark.parametrize("form", ["colmap", "ros"])
def test_formats_without_a_mirror_refuse_mirrored_images(form: Any) -> None:  # noqa: ANN401 - a format
    with pytest.raises(InputError, match="mirrored images"):
        made(form, mirrored=True)


def rotation_of(text: str) -> FloatArray:
    line = next(line for line in text.splitlines() if "rotation_cam_enu" in line)
    return np.array(line.rpartition(": ")[2].split(), dtype=np.float64).reshape(3, 3)


def test_colmaps_formula_agrees_to_the_stated_error() -> None:
    """COLMAP's THIN_PRISM_FISHEYE: fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1; (0, 0) is a corner."""
    exported = made("colmap")
    text = exported.content.decode()
    number, kind, width, height, *values = text.splitlines()[-1].split()
    assert (number, kind, width, height) == ("1", "THIN_PRISM_FISHEYE", "330", "300")
    fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1 = (float(value) for value in values)
    directions, pixels = sky()
    x, y, z = (directions @ rotation_of(text).T).T
    near = z > math.sin(math.radians(0.5))
    r = np.hypot(x, y)
    theta = np.arctan2(r, z)
    u, v = theta * x / r, theta * y / r
    r2 = u * u + v * v
    radial = k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
    du = u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u) + sx1 * r2
    dv = v * radial + 2.0 * p2 * u * v + p1 * (r2 + 2.0 * v * v) + sy1 * r2
    theirs = np.stack([fx * (u + du) + cx - 0.5, fy * (v + dv) + cy - 0.5], axis=-1)
    off = np.linalg.norm(theirs - pixels, axis=-1)[near]
    assert off.max() == pytest.approx(worst_stated_px(exported.error), rel=0.1)
    assert off.max() < 0.5 * worst_stated_px(made("ros").error)  # decentering is what the others lack
    assert exported.error in text


def test_opencvs_fisheye_reads_ros_camera_info() -> None:
    exported = made("ros")
    text = exported.content.decode()
    read = yaml.safe_load(text)
    assert (read["distortion_model"], read["image_width"], read["image_height"]) == ("equidistant", 330, 300)
    assert (read["camera_name"], read["rectification_matrix"]["data"]) == ("the_roof_s", np.eye(3).ravel().tolist())
    assert (
        np.reshape(read["projection_matrix"]["data"], (3, 4))[:, :3].ravel().tolist() == read["camera_matrix"]["data"]
    )
    directions, pixels = sky()
    rays = directions @ rotation_of(text).T
    near = rays[:, 2] > math.sin(math.radians(0.5))
    matrix = np.reshape(read["camera_matrix"]["data"], (3, 3)).astype(np.float64)
    distortion = np.array(read["distortion_coefficients"]["data"])
    theirs, _ = cv2.fisheye.projectPoints(rays[near][:, None], np.zeros(3), np.zeros(3), matrix, distortion)
    off = np.linalg.norm(theirs[:, 0] - pixels[near], axis=-1)
    assert off.max() == pytest.approx(worst_stated_px(exported.error), rel=0.1)


def angles_of(form: str) -> tuple[FloatArray, FloatArray]:
    """Return azimuth and zenith in degrees as each format's readers get them."""
    exported = made(form)
    if form == "matlab":
        file = scipy.io.loadmat(io.BytesIO(exported.content))  # type: ignore[arg-type]
        assert exported.error in str(file["notes"])
        return file["azimuth"], file["zenith"]
    if form == "fits":
        return fits_layer(exported.content, "AZIMUTH"), fits_layer(exported.content, "ZENITH")
    raw = []
    for name in ("azimuth", "zenith"):
        image = cv2.imdecode(np.frombuffer(exported.files[f"{name}_visible.{form[-3:]}"], dtype=np.uint8), -1)
        assert image is not None
        assert (image.dtype.name, image.shape) == ("uint16", (300, 330))
        raw.append(image.astype(np.float64))
    azimuth = np.degrees(2.0 * np.pi * raw[0] / 64_000 - np.pi) + 180.0  # skycam counts from south
    return azimuth, np.where(raw[1] == 65_535, np.nan, 90.0 * raw[1] / 64_000)


def fits_layer(content: bytes, wanted: str) -> FloatArray:
    """Read an image by sections 3.3 and 4.4 of the FITS standard: blocks of 2880 bytes, cards of 80 characters."""
    assert len(content) % 2880 == 0
    place = 0
    while place < len(content):
        cards: list[str] = []
        while not cards or not cards[-1].startswith("END"):
            cards.append(content[place : place + 80].decode("ascii"))
            place += 80
        place += -place % 2880
        values = {card[:8].strip(): card[10:].strip() for card in cards if card[8:10] == "= "}
        assert cards[0][:30].rstrip() in ("SIMPLE  =                    T", "XTENSION= 'IMAGE   '")
        assert [card[:8].strip() for card in cards[1:5]] == ["BITPIX", "NAXIS", "NAXIS1", "NAXIS2"]
        shape = int(values["NAXIS2"]), int(values["NAXIS1"])
        data = np.frombuffer(content, dtype=">f4", count=shape[0] * shape[1], offset=place).reshape(shape)
        place += data.nbytes + -data.nbytes % 2880
        if values["EXTNAME"].strip("' ") == wanted:
            assert values["BUNIT"].strip("' ") == "deg"
            return data.astype(np.float64)
    raise AssertionError(wanted)


@pytest.mark.parametrize("form", ["fits", "matlab", *IMAGES])
def test_each_pixel_has_the_direction_of_the_model(form: Any) -> None:  # noqa: ANN401 - a format
    azimuth, zenith = angles_of(form)
    y, x = np.mgrid[:300, :330]
    exact = unproject(SMALL, np.stack([x, y], axis=-1).astype(np.float64))
    true_zenith = angles_from_direction(exact)[0]
    with np.errstate(invalid="ignore"):
        above = true_zenith < 89.99
    assert np.isfinite(zenith[above]).all()
    apart = apart_deg(direction_from_angles(zenith_deg=zenith[above], azimuth_deg=azimuth[above]), exact[above])
    assert apart.max() < (0.0031 if form in IMAGES else 1e-4)  # half a step of azimuth: 0.0028 degrees
    assert form not in IMAGES or np.isnan(zenith[true_zenith > 90.01]).all()


def test_the_two_kinds_of_image_hold_the_same() -> None:
    pairs = zip(angles_of("azimuth-zenith-png"), angles_of("azimuth-zenith-jp2"), strict=True)
    assert all(np.array_equal(png, jp2, equal_nan=True) for png, jp2 in pairs)


def test_opencvs_remap_puts_the_sky_where_the_grid_says() -> None:
    with np.load(io.BytesIO(made("opencv-remap").content)) as file:
        map_x, map_y, said = file["map_x"], file["map_y"], json.loads(str(file["attributes"]))["attributes"]
    assert (map_x.dtype, map_x.shape, said["image_size"]) == (np.float32, (300, 300), [330, 300])
    assert made("opencv-remap").error in said["notes"][-1]
    x, y = np.meshgrid(np.arange(330.0), np.arange(300.0))
    seen = [cv2.remap(image.astype(np.float32), map_x, map_y, cv2.INTER_LINEAR) for image in (x, y)]
    # In the row just below the middle, to the right of it: west, and a little south of it.
    down, right = 150 - 149.5, 217 - 149.5
    zenith_deg, azimuth_deg = 90.0 * math.hypot(down, right) / 150.0, 270.0 - math.degrees(math.atan2(down, right))
    direction = direction_from_angles(zenith_deg=np.array([zenith_deg]), azimuth_deg=np.array([azimuth_deg]))
    assert [float(image[150, 217]) for image in seen] == pytest.approx(project(SMALL, direction)[0].tolist(), abs=0.02)
    assert (map_x[0, 0], map_y[0, 0]) == (-1.0, -1.0)


def test_the_grids_are_of_unit_vectors_and_meet_what_they_say() -> None:
    grid = sky_grid(101)
    assert np.linalg.norm(grid, axis=-1)[np.isfinite(grid[..., 0])] == pytest.approx(1.0)
    assert grid[50, 50] == pytest.approx([0.0, 0.0, 1.0])
    assert grid[50, 25, 0] == pytest.approx(math.sin(25 / 50.5 * math.pi / 2))
    assert np.isnan(grid[0, 0]).all()
    ground = ground_grid(101, half_width_m=5000.0, height_m=2000.0)
    east, north, up = ground[10, 70]
    assert (2000.0 * east / up, 2000.0 * north / up) == pytest.approx((2000.0, 4000.0), rel=2e-3)  # the earth is round
    far = ground_grid(3, half_width_m=300_000.0, height_m=2000.0)
    assert np.isnan(far[1, 2]).all()  # below the horizon
    map_x, map_y = remap_tables(replace(SMALL, max_angle=0.5), ground)
    assert (map_x[0, 0], map_y[50, 50] > 0.0) == (-1.0, True)


GREY = cv2.imencode(".png", np.zeros((3, 4), dtype=np.uint8))[1].tobytes()
DEEP = cv2.imencode(".png", np.zeros((3, 4), dtype=np.uint16))[1].tobytes()
NOTHING = cv2.imencode(".png", np.full((3, 4), 65_535, dtype=np.uint16))[1].tobytes()


@pytest.mark.parametrize(
    ("form", "change", "name", "problem"),
    [
        ("colmap", (b"THIN_PRISM_FISHEYE", b"RADIAL_FISHEYE"), "cameras.txt", "RADIAL_FISHEYE"),
        ("ros", (b"equidistant", b"plumb_bob"), "a.yaml", "plumb_bob"),
        ("ros", (b"image_width", b"image_breadth"), "a.yaml", "camera_info"),
        ("fits", (b"'ZENITH  '", b"'HEIGHT  '"), "a.fits", "FITS"),
        ("fits", (b"                 -32", b"                 -64"), "a.fits", "BITPIX"),
        ("opencv-remap", (b"map_y.npy", b"map_z.npy"), "a.npz", "no remap tables"),
    ],
)
def test_a_changed_file_is_refused(form: Any, change: tuple[bytes, bytes], name: str, problem: str) -> None:  # noqa: ANN401
    with pytest.raises(InputError, match=problem):
        read_view(made(form).content.replace(*change), name=name)


@pytest.mark.parametrize(
    ("content", "name", "problem"),
    [
        (b"# A_FISHEYE \n", "cameras.txt", "no camera"),
        (b"SIMPLE  = ", "a.fits", "FITS"),
        (b"MATLAB 5.0 MAT-file", "a.mat", "MATLAB"),
        (DEEP, "picture.png", "pair"),
        (GREY, "azimuth_a.png", "16 bits"),
        (DEEP, "zenith_a.png", "different sizes"),
    ],
)
def test_what_is_not_what_it_says_is_refused(content: bytes, name: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        read_view(content, name=name, beside=lambda _: made("azimuth-zenith-png").content)


def test_a_map_of_nothing_is_refused_and_nan_is_outside_the_field() -> None:
    with pytest.raises(InputError, match="NaN everywhere"):
        read_view(NOTHING, name="azimuth_a.png", beside=lambda _: NOTHING)
    target = io.BytesIO()
    azimuth, zenith = (np.array(layer) for layer in angles_of("matlab"))
    zenith[100:110, 100:110] = np.nan
    scipy.io.savemat(target, {"azimuth": azimuth, "zenith": zenith})  # type: ignore[arg-type]
    view = read_view(target.getvalue(), name="a.mat")
    assert np.isnan(view.unproject(np.array([[105.0, 105.0]]))).all()


def test_the_names_of_formats_are_those_that_others_call() -> None:
    assert set(FILES) == {"opencv-remap", "colmap", "ros", "fits", "matlab", *IMAGES}
