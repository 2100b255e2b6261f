"""What is in the sky or before the lens at night and is no star: no false sighting, and the reason in the verdict."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.archive import new_archive
from tests.imager.workers.test_night import BEGIN, CAMERA, EXPOSURE_US, Bench, frame_at

from sunarc.common.array_types import Image
from sunarc.imager.archive.values import CameraRecord, Event
from sunarc.imager.cameras.frame import Frame
from sunarc.lab.simulation.options import SceneOptions, SimulatedNight
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP
from sunarc.optics.forward import project
from sunarc.sky.night import body_directions, body_position

MINUTES = (0, 40, 80)
CONJUNCTION = datetime(2015, 7, 1, 3, 25, tzinfo=UTC)
"""Venus and Jupiter 0.33 degrees apart, 14 degrees high."""
SIDEREAL_DAY = timedelta(seconds=86_164.0905)
"""After which the stars stand where they stood."""
BLACK = 32.0
"""Level of the simulated sensor without light, counts."""
Counts = NDArray[np.float64]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    archive = new_archive(tmp_path)
    archive.cameras.save(CameraRecord.at(SGP, name="roof", width=CAMERA.width, height=CAMERA.height))
    made = Bench(archive)
    made.serve(CAMERA)
    yield made
    archive.close()


@cache
def clear_at(minutes: int) -> Frame:
    return frame_at(minutes)


def with_light(change: Callable[[Counts, int], Counts]) -> list[Frame]:
    """Return the frames of a clear night with light added, in electrons' noise of its own."""
    frames = []
    for number, minutes in enumerate(MINUTES):
        frame = clear_at(minutes)
        added = change(np.zeros(frame.image.shape), number)
        noise = np.random.default_rng(number).normal(0.0, 1.0, added.shape) * np.sqrt(np.maximum(added, 0.0) / 4.9)
        image: Image = np.clip(frame.image + np.round(added + noise), 0, 4095).astype(np.uint16)
        frames.append(replace(frame, image=image))
    return frames


def line(counts: Counts, start: tuple[int, int], end: tuple[int, int], level: float) -> Counts:
    drawn = np.zeros(counts.shape, dtype=np.float32)
    cv2.line(drawn, start, end, 1.0, 1)
    return np.asarray(counts + level * cv2.GaussianBlur(drawn, (0, 0), 0.9), dtype=np.float64)


def spot(counts: Counts, at: tuple[float, float], level: float, width: float = 1.0) -> Counts:
    rows, columns = np.indices(counts.shape)
    return np.asarray(counts + level * np.exp(-0.5 * ((columns - at[0]) ** 2 + (rows - at[1]) ** 2) / width**2))


def aurora(counts: Counts, number: int) -> Counts:
    """Curtains over the whole sky, ten times as bright as it, that move between the images."""
    rng = np.random.default_rng(number)
    coarse = rng.uniform(0.0, 1.0, (12, 40)).astype(np.float32) ** 3
    return np.asarray(1200.0 * cv2.resize(coarse, counts.shape[::-1], interpolation=cv2.INTER_CUBIC).clip(0.0))


def station(counts: Counts, number: int) -> Counts:
    """Return the space station in the second image: a trail of 5 degrees, clipped in its middle."""
    return line(counts, (430, 300), (470, 325), 6000.0) if number == 1 else counts


def aircraft(counts: Counts, number: int) -> Counts:
    """Three aircraft in each image, a flash a second and a faint trail between."""
    for plane in range(3):
        x, y = 250 + 150 * plane + 40 * number, 300 + 120 * plane
        counts = line(counts, (x, y), (x + 60, y + 25), 25.0)
        for flash in range(5):
            counts = spot(counts, (x + 12 * flash + 0.3, y + 5 * flash + 0.2), 1500.0)
    return counts


def lamp(counts: Counts, number: int) -> Counts:
    """Street lamps on the horizon that are lit in the first and last image."""
    if number == 1:
        return counts
    for at in ((120.4, 500.2), (135.1, 560.7), (860.3, 420.6)):
        counts = spot(counts, at, 3000.0, width=1.1)
    return counts


def false_sightings(bench: Bench) -> int:
    columns = bench.archive.sightings.columns("roof", body=None)
    true = project(CAMERA, body_directions(columns.body, columns.unix_s, SGP))
    return int(np.sum(np.linalg.norm(columns.pixels - true, axis=-1) > 1.0))


def codes(event: Event) -> set[str]:
    return {finding["code"] for finding in event.details["findings"]}


@pytest.mark.parametrize("change", [station, aircraft, lamp], ids=lambda one: one.__name__)
def test_lights_that_are_no_stars_leave_the_stars_and_no_false_sighting(
    bench: Bench, change: Callable[[Counts, int], Counts]
) -> None:
    event = bench.night(*with_light(change))
    assert event.details["verdict"] in {"clear", "partly"}
    assert event.details["n_stored"] >= 40
    assert false_sightings(bench) == 0


def test_an_aurora_over_the_whole_sky_leaves_no_false_sighting(bench: Bench) -> None:
    event = bench.night(*with_light(aurora))
    assert false_sightings(bench) == 0
    if event.details["n_accepted"] < len(MINUTES):
        assert any(code.startswith("stars_") for code in codes(event))


@pytest.mark.parametrize("level", [0.0, 900.0], ids=["a closed dome", "snow lit from below"])
def test_a_cover_before_the_lens_is_named(bench: Bench, level: float) -> None:
    frames = []
    for minutes in MINUTES:
        noise = np.random.default_rng(minutes).normal(0.0, 4.0, (CAMERA.height, CAMERA.width))
        image = np.clip(32.0 + level + noise, 0, 4095).astype(np.uint16)
        frames.append(replace(clear_at(0), image=image, time=BEGIN + timedelta(minutes=minutes)))
    event = bench.night(*frames)
    assert event.details["n_stored"] == 0
    assert event.details["verdict"] == "cloudy"
    assert "stars_few" in codes(event)


def test_a_frozen_image_is_named_and_counts_once(bench: Bench) -> None:
    event = bench.night(*(replace(clear_at(0), time=clear_at(minutes).time) for minutes in MINUTES))
    assert event.details["n_images"] == 1
    assert {"night_frozen", "night_few_images"} <= codes(event)
    times = {point.time for point in bench.archive.sightings.find("roof", body=None)}
    assert times <= {clear_at(0).time}


@pytest.mark.parametrize("longer", [1.0, 1.3, 4.0, 16.0])
def test_an_image_that_was_exposed_for_longer_than_stated_is_named_and_stores_no_star(
    bench: Bench, longer: float
) -> None:
    """Its stars have moved on: at 16 times the exposure by 37 s of the sky's rotation, 0.16 degrees."""
    frames = [clear_at(minutes) for minutes in MINUTES]
    options = SimulatedNight(moon=False, star_e_per_s=50_000.0, faintest=6.0, warm_spots=120)
    scene = Scene(CAMERA, SGP, options=SceneOptions(night=options))
    start = BEGIN + timedelta(minutes=MINUTES[1])
    image = scene.render(int(start.timestamp() * 1e6), exposure_us=EXPOSURE_US * longer)
    frames[1] = replace(frames[1], image=image)
    event, is_refused = bench.night(*frames), longer > 2.0
    assert ("night_exposed_longer" in codes(event)) == is_refused
    stored = {point.time for point in bench.archive.sightings.find("roof", body=None)}
    assert stored == {frame.time for frame in frames if not (is_refused and frame is frames[1])}
    assert false_sightings(bench) == 0


def test_a_gap_in_the_haze_is_no_longer_exposure_where_the_nights_before_were_as_bright(bench: Bench) -> None:
    """Half of the light is lost to haze in two of three images, so the third is .75 mag brighter than most."""
    bench.night(*(clear_at(minutes) for minutes in MINUTES))
    for number, minutes in enumerate(MINUTES):
        frame = clear_at(minutes)
        hazy = np.round(BLACK + (frame.image - BLACK) / (1.0 if number == 1 else 2.0)).astype(np.uint16)
        bench.worker.look_at(replace(frame, image=hazy, time=frame.time + SIDEREAL_DAY))
    night = bench.worker.finish()
    assert night.n_images == night.n_accepted == 3
    assert "night_exposed_longer" not in {found.code for found in night.findings}


def test_two_planets_close_together_are_not_taken_for_one_another(bench: Bench) -> None:
    options: Any = {"star_e_per_s": 50_000.0, "faintest": 5.0, "warm_spots": 0}
    scene = Scene(CAMERA, SGP, options=SceneOptions(night=SimulatedNight(**options)))
    frames = []
    for number in range(3):
        start = CONJUNCTION + timedelta(minutes=5 * number)
        image = scene.render(int(start.timestamp() * 1e6), exposure_us=0.5e6)
        middle = start + timedelta(seconds=0.25)
        frames.append(replace(clear_at(0), image=image, time=middle, exposure_us=0.5e6, frame_id=number))
    venus, jupiter = (
        project(CAMERA, np.array(body_position(name, CONJUNCTION.timestamp(), SGP).direction))
        for name in ("venus", "jupiter")
    )
    assert np.linalg.norm(venus - jupiter) < 3.5
    bench.night(*frames)
    assert false_sightings(bench) == 0
    assert not {"venus", "jupiter"} & set(bench.archive.sightings.columns("roof", body=None).body.tolist())
