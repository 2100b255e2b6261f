"""Lens prior files and joint fits of files: written, combined, used, and refused by name."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from tests.fixtures.clear_day import SGP, TRUTH, simulate

import sunarc
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.lens_library.lens_type import UnitSpread
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.common.errors import InputError
from sunarc.common.utc import utc_time
from sunarc.formats.calibration_document import to_document
from sunarc.formats.csv_files import write_sightings
from sunarc.formats.lens_prior import read_lens_type
from sunarc.optics.camera import Camera
from sunarc.public.calibrate_files import (
    LENS_FILE,
    calibrate_file,
    calibrate_joint,
    combined_lens,
    read_joint_spec,
    write_lens_prior,
)

NOW = datetime(2013, 5, 14, tzinfo=UTC)
SPREAD = UnitSpread(focal_length=0.003, center_px=8.0)
Document = dict[str, Any]


def write_csv(path: Path, camera: Camera = TRUTH, *, seed: int = 1) -> Path:
    points = simulate(camera, cadence_s=900.0, sigma_px=0.1, seed=seed).points
    rows = zip(points.unix_s.tolist(), points.pixels.tolist(), strict=True)
    with path.open("w") as file:
        write_sightings(file, [(utc_time(t), x, y, 0.1, "sun") for t, (x, y) in rows])
    return path


@pytest.fixture(scope="module")
def document() -> Document:
    day = simulate(cadence_s=900.0, sigma_px=0.1)
    return to_document(
        calibrate(day.points, site=SGP, image_size=(1748, 1748)),
        id="a",
        camera="north",
        state="candidate",
        created_at=NOW,
        valid_from=NOW,
        valid_until=None,
        pose_epoch="",
        software_version=sunarc.__version__,
    )


def test_a_lens_prior_is_written_combined_read_and_used(document: Document, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    other.write_text(json.dumps({**document, "camera": "south"}))
    lens = combined_lens([document], [other], spread=SPREAD)
    assert lens.cameras == ("north", "south")
    write_lens_prior(tmp_path / "lens.json", lens)
    read = read_lens_type((tmp_path / "lens.json").read_bytes(), name="lens.json")
    assert read.camera.to_vector() == pytest.approx(lens.camera.to_vector())
    points = write_csv(tmp_path / "new.csv", replace(TRUTH, rotation_cam_enu=(0.0, 0.0, 1.0)))
    found = calibrate_file(
        points,
        site=SGP,
        image_size=(1748, 1748),
        options=CalibrationOptions(),
        now=NOW,
        lens=read,
    )
    assert found["verdict"]["accepted"]
    assert found["evidence"]["options"]["lens_prior"]["cameras"] == ["north", "south"]
    with pytest.raises(InputError) as refused:
        combined_lens([found], [], spread=None)
    assert refused.value.field == "new"


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"size": (1740, 1748)}, "image size"),
        ({"options": CalibrationOptions(projection="equidistant")}, "projection"),
        ({"options": CalibrationOptions(mirrored="yes")}, "mirrored"),
    ],
)
def test_a_lens_prior_of_other_cameras_is_refused(
    document: Document, tmp_path: Path, change: dict[str, Any], problem: str
) -> None:
    path = tmp_path / "few.csv"
    path.write_text("time_utc,x_px,y_px\n2013-05-13T18:30:00Z,800,700\n")
    given: dict[str, Any] = {"size": (1748, 1748), "options": CalibrationOptions()} | change
    with pytest.raises(InputError) as refused:
        calibrate_file(
            path,
            site=SGP,
            image_size=given["size"],
            options=given["options"],
            now=NOW,
            lens=combined_lens([document], [], spread=None),
        )
    assert refused.value.field == "--lens-prior"
    assert problem in refused.value.problem


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["verdict"].update(accepted=False),
        lambda d: d["evidence"]["options"].update(free="pose"),
        lambda d: d["evidence"]["options"].update(lens_prior={}),
    ],
)
def test_what_says_nothing_of_its_lens_is_not_combined(document: Document, change: Callable[[Document], None]) -> None:
    one = json.loads(json.dumps(document))
    change(one)
    with pytest.raises(InputError) as refused:
        combined_lens([one], [], spread=None)
    assert refused.value.field == "north"


def test_a_camera_is_not_counted_twice(document: Document, tmp_path: Path) -> None:
    same = tmp_path / "same.json"
    same.write_text(json.dumps(document))
    with pytest.raises(InputError) as refused:
        combined_lens([document], [same], spread=None)
    assert refused.value.field == "north"


def test_a_file_that_is_no_lens_prior_is_named(document: Document, tmp_path: Path) -> None:
    path = tmp_path / "lens.json"
    path.write_text("{")
    with pytest.raises(InputError):
        read_lens_type(path.read_bytes(), name=path.name)
    path.write_text(json.dumps(document))
    with pytest.raises(InputError) as refused:
        read_lens_type(path.read_bytes(), name=path.name)
    assert refused.value.field == "lens.json, schema"


SPEC = """
latitude = 36.604043
longitude = -97.484856
altitude = 318.0
image_size = [1748, 1748]
[spread]
center_px = 5.0
[[entry]]
camera = "roof"
epoch = "spring"
file = "a.csv"
[[entry]]
camera = "roof"
epoch = "autumn"
file = "b.csv"
"""


def test_epochs_of_one_camera_are_fitted_together(tmp_path: Path) -> None:
    moved = replace(TRUTH, rotation_cam_enu=(0.0, 0.02, 1.5))
    write_csv(tmp_path / "a.csv")
    write_csv(tmp_path / "b.csv", moved, seed=2)
    spec = tmp_path / "joint.toml"
    spec.write_text(SPEC)
    documents = calibrate_joint(spec, folder=tmp_path / "out", now=NOW)
    written = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert written == sorted([LENS_FILE, "roof-autumn.json", "roof-spring.json"])
    assert [one["pose_epoch"] for one in documents] == ["spring", "autumn"]
    assert all(one["verdict"]["accepted"] for one in documents)
    assert read_lens_type((tmp_path / "out" / LENS_FILE).read_bytes(), name=LENS_FILE).cameras == ("roof",)
    assert documents[1]["model"]["rotation_cam_enu"] == pytest.approx([0.0, 0.02, 1.5], abs=2e-3)


def test_the_clock_column_of_an_entrys_file_is_the_bound_of_its_clock(tmp_path: Path) -> None:
    """A minute turns the camera about the pole by a quarter of a degree; the other entry states no clock."""
    write_csv(tmp_path / "a.csv")
    write_csv(tmp_path / "b.csv", seed=2)
    lines = (tmp_path / "b.csv").read_text().splitlines()
    stated = [f"{lines[0]},clock_error_s", *(f"{line},60" for line in lines[1:])]
    (tmp_path / "b.csv").write_text("\n".join(stated) + "\n")
    spec = tmp_path / "joint.toml"
    spec.write_text(SPEC)
    assumed, bounded = calibrate_joint(spec, folder=tmp_path / "out", now=NOW)
    assert "clock_unbounded" in [one["code"] for one in assumed["verdict"]["findings"]]
    assert "clock_unbounded" not in [one["code"] for one in bounded["verdict"]["findings"]]
    sky = bounded["uncertainty"]
    more = math.sqrt(sky["sky_rms_deg"] ** 2 - sky["sky_rms_without_clock_deg"] ** 2)
    assert 0.1 < more < 0.25


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("latitude = 36", "latitud = 36", "joint.toml"),
        ('file = "b.csv"', 'files = "b.csv"', "joint.toml, entry 2"),
        ('file = "b.csv"', "", "joint.toml, entry 2, file"),
        ('camera = "roof"', 'camera = "../roof"', "joint.toml, entry 1, camera"),
        ("[1748, 1748]", "[1748]", "joint.toml, entry 1, image_size"),
        ('"autumn"', '"spring"', "joint.toml, roof"),
        ("center_px = 5.0", "colour = 5.0", "joint.toml, spread"),
        ("center_px = 5.0", "center_px = -5.0", "spread.center_px"),
        ("[[entry]]", "[[entries]]", "joint.toml"),
        ("[[entry]]", "[[entry", "joint.toml"),
    ],
)
def test_what_is_wrong_in_a_joint_file_is_named(tmp_path: Path, old: str, new: str, field: str) -> None:
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text("time_utc,x_px,y_px\n2013-05-13T18:30:00Z,800,700\n")
    spec = tmp_path / "joint.toml"
    spec.write_text(SPEC)
    assert [entry.epoch for entry in read_joint_spec(spec).entries] == ["spring", "autumn"]
    spec.write_text(SPEC.replace(old, new, 1) if old != "[[entry]]" else SPEC.replace(old, new))
    with pytest.raises(InputError) as refused:
        read_joint_spec(spec)
    assert refused.value.field.endswith(field)
