"""What a calibration from a file refuses before it fits, and how an image circle is read."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.fixtures.settings import SGP
from tests.formats.conftest import LENS, document_of

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.stated_prior import PriorTolerances
from sunarc.common.errors import InputError
from sunarc.common.utc import rfc3339, utc_time
from sunarc.formats.calibration_document import from_document
from sunarc.formats.formats import export
from sunarc.optics.forward import project
from sunarc.public.calibrate_files import calibrate_file, parse_image_circle, read_start
from sunarc.public.stated_fit import start_camera
from sunarc.sky.sun import sun_angles, sun_directions

NOW = datetime(2013, 5, 14, tzinfo=UTC)


def points_file(folder: Path, *rows: str) -> Path:
    path = folder / "roof.csv"
    path.write_text("\n".join(["time_utc,x_px,y_px", *rows, ""]))
    return path


def calibrated(path: Path, *, size: tuple[int, int] = (1748, 1600), **more: Any) -> dict[str, Any]:  # noqa: ANN401 - options
    return calibrate_file(path, site=SGP, image_size=size, options=CalibrationOptions(), now=NOW, **more)


def test_without_sightings_the_document_is_refused_and_dated_now(tmp_path: Path) -> None:
    document = calibrated(points_file(tmp_path))
    assert (document["state"], document["verdict"]["accepted"]) == ("refused", False)
    assert document["camera"] == "roof"
    assert document["valid_from"] == document["created_at"]


def test_too_few_sightings_are_refused_and_the_document_is_valid_from_the_first(tmp_path: Path) -> None:
    document = calibrated(points_file(tmp_path, "2013-05-13T18:30:00Z,800,700", "2013-05-13T18:40:00Z,810,700"))
    assert document["state"] == "refused"
    assert datetime.fromisoformat(document["valid_from"]) == datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
    assert datetime.fromisoformat(document["created_at"]) == NOW


def test_a_sighting_outside_the_image_is_refused_by_its_number(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        calibrated(points_file(tmp_path, "2013-05-13T18:30:00Z,800,700", "2013-05-13T18:40:00Z,1750,700"))
    assert refused.value.field.split(", ") == ["roof.csv", "sighting 2"]


def test_the_lens_of_other_images_is_not_kept(tmp_path: Path) -> None:
    start = tmp_path / "start.json"
    start.write_text(json.dumps(document_of(LENS)))
    path = points_file(tmp_path, "2013-05-13T18:30:00Z,80,70")
    with pytest.raises(InputError) as refused:
        calibrated(path, size=(640, 480), start=start, pose_only=True)
    assert refused.value.field == "--start"


def test_a_start_of_another_format_is_the_closest_camera(tmp_path: Path) -> None:
    start = tmp_path / "fisheye.yml"
    start.write_bytes(export(document_of(LENS), "opencv").content)
    camera = start_camera(read_start(start), (1748, 1600), CalibrationOptions(projection="equisolid"))
    assert (camera.projection, camera.mirrored, camera.max_angle) == ("equisolid", False, math.radians(100.0))
    assert camera.focal_length_px == pytest.approx(LENS.focal_length_px, rel=0.02)
    assert camera.rotation_cam_enu == pytest.approx(LENS.rotation_cam_enu, abs=0.01)


@pytest.mark.parametrize(("mirrored", "hand"), [("yes", False), ("no", True)])
def test_a_start_of_the_other_handedness_is_refused(tmp_path: Path, mirrored: Any, *, hand: bool) -> None:  # noqa: ANN401
    start = tmp_path / "start.json"
    start.write_text(json.dumps(document_of(replace(LENS, mirrored=hand))))
    with pytest.raises(InputError) as refused:
        start_camera(read_start(start), (1748, 1600), CalibrationOptions(mirrored=mirrored))
    assert refused.value.field == "--start"
    assert start_camera(read_start(start), (1748, 1600), CalibrationOptions(mirrored="auto")).mirrored == hand


def test_a_file_without_a_pose_is_no_prior_of_the_pose(tmp_path: Path) -> None:
    start = tmp_path / "fisheye.yml"
    content = export(document_of(LENS), "opencv").content
    start.write_bytes(content.replace(b"rotation_cam_enu", b"rotation_of_another"))
    path = points_file(tmp_path, "2013-05-13T18:30:00Z,800,700")
    with pytest.raises(InputError) as refused:
        calibrated(path, start=start, within=PriorTolerances(lens_px=1.0, pose_deg=1.0))
    assert refused.value.field == "--pose-within"
    document = calibrated(path, start=start, within=PriorTolerances(lens_px=1.0))
    assert document["state"] == "refused"  # of one sighting


def a_day_of(folder: Path, *, clock_s: float = 0.0, flip: bool = False) -> Path:
    """Return sightings of a day by `LENS`, their columns in reverse order or their clock ahead."""
    times = 1_371_700_000.0 + np.arange(0.0, 90_000.0, 900.0)
    pixels = project(LENS, sun_directions(times, SGP))
    rows = np.isfinite(pixels).all(axis=1) & (sun_angles(times, SGP).apparent_zenith < 80.0)
    pixels = pixels + np.random.default_rng(2).normal(0.0, 0.1, pixels.shape)
    pixels[:, 0] = LENS.width - 1.0 - pixels[:, 0] if flip else pixels[:, 0]
    shown = [
        f"{rfc3339(utc_time(t + clock_s))},{x:.3f},{y:.3f}" for t, (x, y) in zip(times[rows], pixels[rows], strict=True)
    ]
    return points_file(folder, *shown)


@pytest.mark.parametrize("form", ["opencv", "matlab", "netcdf", "ocamcalib"])
def test_a_lens_of_any_format_is_kept_within_a_pixel_and_posed(tmp_path: Path, form: str) -> None:
    made = export(document_of(LENS), form)
    for name, content in made.files.items():
        (tmp_path / (name or made.name or "lens.nc")).write_bytes(content)
    start = next(path for path in sorted(tmp_path.iterdir()) if path.suffix != ".csv")
    document = calibrated(a_day_of(tmp_path), start=start, pose_only=True)
    assert document["verdict"]["accepted"], document["verdict"]
    found = from_document(document)
    directions = sun_directions(1_371_700_000.0 + np.array([45e3, 55e3, 65e3]), SGP)
    assert project(found.camera, directions) == pytest.approx(project(LENS, directions), abs=0.5)
    assert 0.01 < found.sky_rms_deg < 0.3  # a lens that states no uncertainty is not taken as exact


@pytest.mark.parametrize(("clock_s", "flip", "said"), [(0.0, True, True), (7200.0, False, False)])
@pytest.mark.parametrize("known", [{"pose_only": True}, {}, {"within": PriorTolerances(lens_px=1.0, pose_deg=1.0)}])
def test_the_other_handedness_is_tried_where_a_known_lens_is_refused(
    tmp_path: Path, known: dict[str, Any], *, clock_s: float, flip: bool, said: bool
) -> None:
    start = tmp_path / "start.yml"  # not one of this camera's: its pose is another
    start.write_bytes(export(document_of(LENS), "opencv").content)
    document = calibrated(a_day_of(tmp_path, clock_s=clock_s, flip=flip), start=start, **known)
    codes = [one["code"] for one in document["verdict"]["findings"]]
    assert any(code.startswith("other_handedness") for code in codes) == said
    assert not (document["verdict"]["accepted"] and flip)


def test_a_circle_is_read_from_three_numbers() -> None:
    circle = parse_image_circle("870.5, 880, 850")
    assert (circle.x, circle.y, circle.radius, circle.angle_deg) == (870.5, 880.0, 850.0, 90.0)


def test_a_circle_is_found_in_an_image(tmp_path: Path) -> None:
    y, x = np.mgrid[:400, :500]
    path = tmp_path / "noon.png"
    cv2.imwrite(str(path), np.where(np.hypot(x - 245.0, y - 203.0) < 180.0, 160, 4).astype(np.uint8))
    circle = parse_image_circle(str(path))
    assert (circle.x, circle.y, circle.radius) == pytest.approx((245.0, 203.0, 180.0), abs=1.0)


@pytest.mark.parametrize("text", ["1,2,0", "1,2,-3", "1,2,nan", "inf,2,3", "1,2", "1,2,3,4"])
def test_what_is_no_circle_and_no_file_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        parse_image_circle(text)


def test_an_image_without_a_circle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "plain.png"
    cv2.imwrite(str(path), np.zeros((200, 200), dtype=np.uint8))
    with pytest.raises(InputError) as refused:
        parse_image_circle(str(path))
    assert refused.value.field == "--image-circle"
