"""Images of a clear day in, obstruction mask and horizon out."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from tests.fixtures.calibrations import chosen_calibration
from tests.fixtures.command_line import Sunarc

from sunarc.formats.calibration_document import to_document
from sunarc.imaging.horizon import HorizonProfile
from sunarc.public.mask_files import pvgis_horizon
from sunarc.sky.site import Site

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs" / "studies"))
from obstruction_world import World
from obstructions import camera_of

SIZE = 256


@pytest.fixture(scope="module")
def world() -> World:
    return World(n=SIZE, seed=3, linear=False)


@pytest.fixture(scope="module")
def folder(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a day of JPEGs and the camera's calibration."""
    target = tmp_path_factory.mktemp("day")
    names = ("principal_point_x_px",)
    known = chosen_calibration(camera_of(world), names=names, covariance=np.eye(1) * 1e-4, orders=np.array([[1, 1]]))
    known = replace(known, site=Site(latitude=world.latitude_deg, longitude=world.longitude_deg, altitude=0.0))
    document = to_document(
        known,
        id="a",
        camera="c",
        state="current",
        created_at=datetime(2026, 5, 1, tzinfo=UTC),
        valid_from=None,
        valid_until=None,
        pose_epoch="e",
        software_version="0",
    )
    (target / "calibration.json").write_text(json.dumps(document))
    for time in world.times(0, every_min=20.0):
        cv2.imwrite(str(target / f"{time:%Y%m%dT%H%M%SZ}.png"), world.frame(time, "clear"))
    return target


def test_a_day_of_images_gives_the_mask_and_the_horizon_that_were_drawn(
    folder: Path, world: World, sunarc: Sunarc
) -> None:
    images = [str(path) for path in sorted(folder.glob("2*.png"), reverse=True)]
    written = {name: folder / f"out.{name}" for name in ("png", "csv", "txt")}
    done = sunarc(
        "mask",
        *images,
        "--calibration",
        str(folder / "calibration.json"),
        "-o",
        str(written["png"]),
        "--horizon",
        str(written["csv"]),
        "--userhorizon",
        str(written["txt"]),
        "--json",
    )
    assert done.code == 0, done.err
    said = json.loads(done.out)
    assert said["images"]["clear"] > 30
    assert abs(sum(said["shares_of_the_sky"].values()) - 1.0) < 1e-6
    mask = cv2.imread(str(written["png"]), cv2.IMREAD_UNCHANGED)
    sky, truth = world.elevation > 0.0, world.truth(crane=False)
    assert np.sum((mask == 0) & truth & sky) / np.sum(((mask == 0) | truth) & sky) > 0.95
    series = pd.read_csv(written["csv"], index_col="azimuth_deg")["horizon_elevation"]
    assert list(series.index) == list(range(360))
    assert np.median(np.abs(series.to_numpy() - world.horizon_deg())) < 0.5
    line = written["txt"].read_text().strip().split(",")
    assert np.allclose([float(value) for value in line], series.to_numpy(), atol=0.06)


def test_too_few_images_are_refused_with_what_is_missing(folder: Path, sunarc: Sunarc) -> None:
    images = [str(path) for path in sorted(folder.glob("2*.png"))[:5]]
    done = sunarc("mask", *images, str(folder / "calibration.json"), "--calibration", str(folder / "calibration.json"))
    assert done.code == 2
    assert "IMAGES" in done.err
    assert "1 unread" in done.err


def test_an_image_of_another_size_is_refused(folder: Path, sunarc: Sunarc, tmp_path: Path) -> None:
    path = tmp_path / "20260510T100000Z.png"
    cv2.imwrite(str(path), np.zeros((100, 120), np.uint8))
    done = sunarc("mask", str(path), "--calibration", str(folder / "calibration.json"))
    assert done.code == 2
    assert "120x100" in done.err


def test_pvgis_takes_no_gaps() -> None:

    elevation = np.full(360, 3.04)
    elevation[7] = np.nan
    text = pvgis_horizon(HorizonProfile(elevation_deg=elevation, sigma_deg=elevation, openings=((),) * 360))
    assert np.array_equal(np.loadtxt(StringIO(text), delimiter=","), [*[3.0] * 7, 0.0, *[3.0] * 352])
