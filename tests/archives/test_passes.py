"""Units of work, and predictions rounded so that a refined calibration has nothing looked at again."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from sunarc.archives.passes import (
    CHUNK,
    FoundSun,
    Looked,
    by_true_times,
    epoch_at,
    make_chunks,
    rounded,
    without_frozen,
)
from sunarc.archives.states import Epoch, State
from sunarc.common.utc import DAY_S
from sunarc.detection.values import Expectation
from sunarc.lab.simulation.truth import SGP
from sunarc.sky.sun import sun_angles
from sunarc.sources.index import ArchiveImage, CameraImages, CameraPlan, Selector
from sunarc.sources.look import Item

PLAN = CameraPlan(name="roof", site=SGP, selector=Selector(()))


def image(day: int, number: int, address: str = "a.zip") -> ArchiveImage:
    return ArchiveImage(round(1e6 * (day * DAY_S + 60.0 * number)), f"{day}-{number:03d}.jpg", 0, address, None, "1")


def camera(images: list[ArchiveImage]) -> CameraImages:
    return CameraImages(plan=PLAN, images=tuple(images), example=("", ""), family="", size=(9, 9))


def test_a_chunk_is_of_one_source_and_day_and_holds_64_images_at_most() -> None:
    images = [image(day, number) for day in (3, 1) for number in range(130)] + [image(1, 5, "b.zip")]
    chunks = make_chunks(camera(images), [(one, Item(one.file, 0, None)) for one in images], None)
    assert [(chunk.address, len(chunk.items)) for chunk in chunks] == [
        *[("a.zip", n) for n in (64, 64, 2, 64, 64, 2)], ("b.zip", 1),
    ]  # fmt: skip
    assert max(len(chunk.items) for chunk in chunks) == CHUNK
    assert [item.file for item in chunks[0].items] == [f"1-{n:03d}.jpg" for n in range(64)]
    assert all(len({item.file.partition("-")[0] for item in chunk.items}) == 1 for chunk in chunks)


def test_new_images_of_another_day_leave_the_chunks_of_the_others_as_they_were() -> None:
    def chunks(images: list[ArchiveImage]) -> set[object]:
        return set(make_chunks(camera(images), [(one, Item(one.file, 0, None)) for one in images], None))

    before = [image(1, number) for number in range(100)]
    assert chunks(before) < chunks([*before, *(image(2, number) for number in range(5))])


@pytest.mark.parametrize(
    ("x", "expected", "sigma", "sigma_rounded"),
    [(10.1, 10.0, 1.2, 1.0), (10.13, 10.25, 0.1, 0.5), (-0.2, -0.25, 1.3, 1.5)],
)
def test_a_prediction_is_rounded_to_a_quarter_of_a_pixel(
    x: float, expected: float, sigma: float, sigma_rounded: float
) -> None:
    one = rounded(Expectation(x_px=x, y_px=x, uncertainty_px=sigma, stretch_px_per_rad=((101.0, 1.0), (-2.0, 98.0))))
    assert one is not None
    assert (one.x_px, one.y_px, one.uncertainty_px) == (expected, expected, sigma_rounded)
    assert one.stretch_px_per_rad == ((100.0, 0.0), (0.0, 100.0))
    assert rounded(None) is None


def test_an_image_belongs_to_the_epoch_of_the_last_sighting_before_it() -> None:
    epochs = [Epoch(n, "start", 0, 0, start, start + 5.0) for n, start in enumerate((100.0, 200.0))]
    assert [epoch_at(epochs, t) for t in (-math.inf, 99.0, 100.0, 199.0, 200.0, np.inf)] == [0, 0, 0, 0, 1, 1]


def test_pictures_of_a_wrong_clocks_evening_and_night_are_of_the_day_by_its_true_time() -> None:
    every = [image(15_806, number) for number in range(0, 24 * 60, 20)]
    zenith = np.asarray(sun_angles(np.array([one.unix_s for one in every]), SGP).apparent_zenith)
    day, dusk, night = (
        tuple(one for one, angle in zip(every, zenith.tolist(), strict=True) if low < angle <= high)
        for low, high in ((0.0, 90.0), (90.0, 102.0), (102.0, 180.0))
    )
    stated = replace(camera(list(day)), dusk=dusk, nights=night)
    epochs = [Epoch(0, "start", 0, 0, day[0].unix_s, day[-1].unix_s)]
    ahead, right = (cast("State", SimpleNamespace(clock_offset_s=one)) for one in (2.5 * 3600.0, 0.0))
    assert by_true_times(stated, [right], epochs) == stated
    found = by_true_times(stated, [ahead], epochs)
    late = [one for one in (*dusk, *night) if one in found.images]
    angles = np.asarray(sun_angles(np.array([one.unix_s for one in late]) - 2.5 * 3600.0, SGP).apparent_zenith)
    assert set(found.images) == {*day, *late}
    assert len(late) in {7, 8}  # three an hour
    assert np.all(angles <= 90.0)
    assert list(found.images) == sorted(found.images)
    assert {*found.dusk, *found.nights} == {*dusk, *night} - set(late)


def test_a_sun_where_one_before_it_stood_is_frozen_once_the_sun_has_moved() -> None:
    def seen(place: tuple[float, float]) -> FoundSun:
        return FoundSun(accepted=True, verdict="clear", x_px=place[0], y_px=place[1], sigma_px=0.5)

    images = tuple(image(15_806, 1080 + 2 * number) for number in range(8))
    moving = [seen((100.0 + number, 200.0)) for number in range(8)]
    assert list(without_frozen(Looked(images, tuple(moving)), SGP).found) == moving
    stuck = [*moving[:3], *[moving[2]] * 3, *moving[6:]]
    found = without_frozen(Looked(images, tuple(stuck)), SGP).found
    assert [isinstance(one, FoundSun) and one.verdict for one in found] == [
        *["clear"] * 3,
        *["frozen"] * 3,
        "clear",
        "clear",
    ]
    assert [isinstance(one, FoundSun) and one.accepted for one in found] == [*[True] * 3, *[False] * 3, True, True]
    soon = tuple(one._replace(time_us=images[0].time_us + 1_000_000 * n) for n, one in enumerate(images))
    assert list(without_frozen(Looked(soon, tuple(stuck)), SGP).found) == stuck  # the sun has not moved
