"""The learned obstruction mask and the horizon, over HTTP and in the archive's folder."""

from __future__ import annotations

import csv
import io
import sys
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from tests.fixtures.calibrations import SITE

from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.obstructions import ObstructionLearner

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs" / "studies"))
from obstruction_world import World
from obstructions import camera_of

if TYPE_CHECKING:
    from tests.api.conftest import Made, Make

SIZE = 256


@pytest.fixture(scope="module")
def day() -> tuple[World, list[np.ndarray]]:
    """Return a world at the archive's site, and its images of a clear day."""
    world = World(n=SIZE, seed=3, latitude_deg=SITE.latitude, longitude_deg=SITE.longitude)
    return world, [world.frame(time, "clear") for time in world.times(0, every_min=20.0)]


@pytest.fixture
def learner(make: Make, day: tuple[World, list[np.ndarray]], tmp_path: Path) -> ObstructionLearner:
    """Return what has seen the day, at the times of its world."""
    return learner_of(make(history="filled"), day, tmp_path)


def learner_of(made: Made, day: tuple[World, list[np.ndarray]], folder: Path) -> ObstructionLearner:
    world, _ = day
    camera = CameraArchive(made.archive, name="roof", site=SITE)
    found = ObstructionLearner(camera, folder / "obstructions.npz")
    model, record = made.archive.calibrations.current_model("roof"), made.archive.calibrations.current("roof")
    assert model is not None
    assert record is not None
    found._follow("second", replace(model, camera=camera_of(world)))
    found._calibration = record.id
    return found


def show(learner: ObstructionLearner, day: tuple[World, list[np.ndarray]], later: timedelta = timedelta(0)) -> None:
    world, images = day
    for time, image in zip(world.times(0, every_min=20.0), images, strict=True):
        learner.take(image, time + later)


def test_there_is_no_mask_before_a_clear_day_and_the_reason_is_given(make: Make, learner: ObstructionLearner) -> None:
    made = make(history="filled", obstructions=learner)
    for path in ("/v1/masks/obstructions", "/v1/horizon"):
        answer = made.client.get(path)
        assert answer.status_code == 404
        assert "4.0 h more" in answer.text
    assert make(history="filled").client.get("/v1/horizon").status_code == 404


def test_after_a_clear_day_mask_and_horizon_are_served(
    make: Make, learner: ObstructionLearner, day: tuple[World, list[np.ndarray]]
) -> None:
    show(learner, day)
    show(learner, day, timedelta(days=1))
    made = make(history="filled", obstructions=learner)
    answer = made.client.get("/v1/masks/obstructions")
    assert answer.headers["content-type"] == "image/png"
    mask = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    world = day[0]
    sky, truth = world.elevation > 0.0, world.truth(crane=False)
    assert np.sum((mask == 0) & truth & sky) / np.sum(((mask == 0) | truth) & sky) > 0.95
    with np.load(io.BytesIO(made.client.get("/v1/masks/obstructions?format=npz").content)) as arrays:
        assert arrays["probability"].shape == arrays["state"].shape == (SIZE, SIZE)
    horizon = made.client.get("/v1/horizon").json()
    assert horizon["azimuth_deg"] == list(range(360))
    assert np.median(np.abs(np.array(horizon["elevation_deg"]) - world.horizon_deg())) < 0.6
    rows = list(csv.DictReader(io.StringIO(made.client.get("/v1/horizon?format=csv").text)))
    assert [float(row["horizon_elevation"]) for row in rows] == horizon["elevation_deg"]


def test_the_sums_outlive_a_restart_and_a_damaged_file_begins_anew(
    make: Make, learner: ObstructionLearner, day: tuple[World, list[np.ndarray]], tmp_path: Path
) -> None:
    show(learner, day)
    show(learner, day, timedelta(days=1))
    made = make(history="filled")
    again = learner_of(made, day, tmp_path)
    assert again.missing.startswith("too little sunshine was seen: 0.0 h")
    (tmp_path / "obstructions.npz").write_bytes(b"PK\x03\x04 no longer one")
    damaged = learner_of(made, day, tmp_path)
    assert "4.0 h more" in damaged.missing


def test_an_image_of_another_size_is_left_out_and_nothing_is_lost(
    learner: ObstructionLearner, day: tuple[World, list[np.ndarray]]
) -> None:
    show(learner, day)
    missing = learner.missing
    learner.take(np.zeros((100, 100), np.uint8), day[0].times(1)[5])
    assert learner.missing == missing
