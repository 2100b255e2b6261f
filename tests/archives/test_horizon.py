"""Mask and horizon of each epoch, from the images of its clearest days."""

from __future__ import annotations

import csv
import io
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from tests.fixtures.calibrations import SITE

from sunarc.archives.fit import Final
from sunarc.archives.obstructions import EpochImage, EpochImages, epoch_obstructions, select_epoch_images
from sunarc.archives.passes import FoundSun, Looked
from sunarc.archives.states import Epoch
from sunarc.common.utc import DAY_S
from sunarc.sources.index import ArchiveImage

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs" / "studies"))
from obstruction_world import World
from obstructions import camera_of

SIZE = 192


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> tuple[World, EpochImages]:
    """Return a world, and its images of a clear day in a folder."""
    folder = tmp_path_factory.mktemp("day")
    world = World(n=SIZE, seed=3, latitude_deg=SITE.latitude, longitude_deg=SITE.longitude)
    images = []
    for number, time in enumerate(world.times(0, every_min=20.0)):
        cv2.imwrite(str(folder / f"{number:03d}.png"), world.frame(time, "clear"))
        images.append(EpochImage(str(folder), f"{number:03d}.png", 0, time.timestamp()))
    calibration = cast("Any", SimpleNamespace(camera=camera_of(world), site=SITE, sky_rms_deg=0.05))
    return world, EpochImages(calibration, (SIZE, SIZE), tuple(images))


def test_an_epoch_with_a_clear_day_has_mask_and_horizon(given: tuple[World, EpochImages]) -> None:
    world, images = given
    found = epoch_obstructions(images)
    assert found.missing is None
    rows = list(csv.DictReader(io.StringIO(found.files["csv"].decode())))
    error = np.array([float(row["horizon_elevation"]) for row in rows]) - world.horizon_deg()
    assert np.median(np.abs(error)) < 0.8
    assert found.seen == 360
    assert found.hidden == pytest.approx(np.sum(world.horizon_deg() >= 1.0), abs=25)
    mask, below = (
        np.asarray(cv2.imdecode(np.frombuffer(one, np.uint8), -1)) for one in (found.files["png"], found.picture)
    )
    sky = world.elevation > 1.0
    assert mask.shape == below.shape == (SIZE, SIZE)
    assert np.mean((mask[sky] == 0) == world.truth(crane=False)[sky]) > 0.97
    under = world.elevation < np.interp(world.azimuth, np.arange(360.0), world.horizon_deg(), period=360.0)
    assert np.mean((below[sky] == 0) == under[sky]) > 0.95


def test_an_epoch_without_a_clear_day_says_what_is_missing(given: tuple[World, EpochImages]) -> None:
    few = given[1]._replace(images=given[1].images[10:16])
    found = epoch_obstructions(few)
    assert found.files == {}
    assert "h more are needed" in (found.missing or "")
    gone = few._replace(images=tuple(one._replace(file="gone.png") for one in few.images))
    assert "6 unread" in (epoch_obstructions(gone).missing or "")


def test_images_of_an_epoch_are_those_of_its_clearest_days_ten_minutes_apart_by_the_true_clock() -> None:
    images = [
        ArchiveImage(round(1e6 * (day * DAY_S + 3e4 + 60.0 * minute)), "a", minute, "", None, "")
        for day in range(8)
        for minute in range(601)
    ]
    found = [FoundSun(one.unix_s // DAY_S % 2 == 0, "clear", 1.0, 1.0) for one in images]
    epochs = (Epoch(0, "start", 0, 9, 0.0, 4.0 * DAY_S - 1.0), Epoch(1, "clock", 9, 9, 4.0 * DAY_S, 9.0 * DAY_S))
    states = cast("Any", (SimpleNamespace(pose=0, clock_offset_s=0.0), SimpleNamespace(pose=0, clock_offset_s=60.0)))
    fitted = cast("Any", {0: SimpleNamespace(calibration=None)})
    final = Final(states, epochs, np.zeros(0, dtype=np.int64), fitted)
    first, second = select_epoch_images(Looked(tuple(images), tuple(found)), final, (SIZE, SIZE))
    days = {int(one.unix_s // DAY_S) for one in first.images}
    assert {0, 2} <= days <= {0, 1, 2, 3}
    times = np.array([one.unix_s for one in first.images])
    assert np.all(np.diff(times) >= 540.0)
    assert len(first.images) <= 240
    assert {(one.unix_s + 60.0) % 60.0 for one in second.images} == {0.0}
    assert min(one.unix_s for one in second.images) == 4.0 * DAY_S + 3e4 - 60.0
