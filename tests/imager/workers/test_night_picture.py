"""The picture of a night: the image with the most stars, what is named in it, and what was not detected."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.fixtures.archive import new_archive
from tests.imager.workers.test_night import CAMERA, Bench, clear, frame_at

from sunarc.imager.archive.images import DiskOptions, ImageStore
from sunarc.imager.archive.values import CameraRecord
from sunarc.imager.workers.night.images import night_picture
from sunarc.lab.simulation.truth import SGP
from sunarc.optics.forward import project
from sunarc.sky.night import body_directions, common_name


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    archive = new_archive(tmp_path)
    archive.cameras.save(CameraRecord.at(SGP, name="roof", width=CAMERA.width, height=CAMERA.height))
    store = ImageStore(tmp_path / "images", options=DiskOptions(keep_free_mb=64.0))
    yield Bench(archive, store=store)
    archive.close()


def kept(bench: Bench) -> tuple[np.ndarray[Any, Any], dict[str, Any]]:
    """Return the one picture of the store, and its names."""
    assert bench.store is not None
    ((time, path),) = bench.store.between(kind="night.jpg", limit=9)
    ((same, names),) = bench.store.between(kind="night.json", limit=9)
    assert time == same
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    return picture, json.loads(names.read_text())


def test_the_picture_has_the_bright_stars_where_they_are_and_says_which_were_not_detected(bench: Bench) -> None:
    bench.serve(CAMERA)
    frames = clear()
    covered = frames[1].image.copy()
    covered[: CAMERA.height // 3] = np.median(covered)  # a roof before the upper third
    bench.night(frames[0], replace(frames[1], image=covered), frames[2])
    picture, names = kept(bench)
    assert picture.shape == (CAMERA.height, CAMERA.width)
    assert picture.size > 60_000
    times = {frame.time.isoformat(timespec="milliseconds").replace("+00:00", "") for frame in (frames[0], frames[2])}
    assert names["time"][:23] in times  # not the covered one: it has fewer stars
    assert (names["calibration"], names["image_size"]) == ("day", [CAMERA.width, CAMERA.height])
    stars = [one for one in names["bodies"] if one["body"] != "moon"]
    assert 30 < len(stars) <= 150
    assert np.mean([one["found"] for one in stars]) > 0.85
    unix_s = next(frame.time.timestamp() for frame in frames if frame.time.isoformat()[:22] == names["time"][:22])
    bodies = np.array([one["body"] for one in stars])
    true = project(CAMERA, body_directions(bodies, np.full(bodies.size, unix_s), SGP))
    assert np.max(np.abs(true - [one["pixel"] for one in stars])) < 0.02
    assert {"Arcturus", "Vega", "Saturn"} <= {one["title"] for one in stars}
    assert [one["magnitude"] for one in stars] == sorted(one["magnitude"] for one in stars)
    bright = [picture[round(one["pixel"][1]), round(one["pixel"][0])] for one in stars if one["magnitude"] < 2.0]
    assert np.median(bright) > 2.0 * np.median(picture)


def test_stars_behind_a_roof_are_predicted_and_not_found(bench: Bench) -> None:
    bench.serve(CAMERA)
    roof = slice(0, CAMERA.height // 4)
    frames = []
    for frame in clear():
        image = frame.image.copy()
        image[roof] = np.median(image)
        frames.append(replace(frame, image=image))
    bench.night(*frames)
    _, names = kept(bench)
    stars = [one for one in names["bodies"] if one["body"] != "moon"]
    behind = [one["found"] for one in stars if one["pixel"][1] < CAMERA.height // 4 - 5]
    free = [one["found"] for one in stars if one["pixel"][1] > CAMERA.height // 4 + 5]
    assert len(behind) >= 3
    assert np.mean(behind) <= 0.2
    assert np.mean(free) > 0.85


def test_without_a_calibration_the_picture_has_no_names(bench: Bench) -> None:
    bench.night(frame_at(0))
    picture, names = kept(bench)
    assert picture.size > 0
    assert names["bodies"] == []
    assert names["calibration"] is None


def test_a_large_image_is_small_and_an_even_one_is_dark() -> None:
    rng = np.random.default_rng(1)
    large = rng.poisson(200.0, (1200, 1600)).astype(np.uint16)
    made = night_picture(large, frame_at(0).time, 3)
    shown = cv2.imdecode(np.frombuffer(made.jpeg, np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown is not None
    assert shown.shape == (768, 1024)
    assert len(made.jpeg) < 800_000
    even = night_picture(np.full((60, 80, 3), 200, np.uint8), frame_at(0).time, 0)
    assert len(even.jpeg) < 5_000


def test_bodies_have_the_names_that_people_use() -> None:
    assert [common_name(one) for one in ("star:HIP32349", "star:HIP11767", "star:HIP5", "venus")] == [
        "Sirius", "Polaris", "HIP 5", "Venus",
    ]  # fmt: skip
