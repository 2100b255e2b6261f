"""Thousands of warm pixels at 5 % of full scale: with their list half as many stars again are named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.imager.workers.test_night import CAMERA, calibration_of, frame_at

from sunarc.common.array_types import Image
from sunarc.detection.stars.detect import detect_stars, outstanding_pixels, repaired, warm_pixels
from sunarc.detection.stars.matching import StarMatches, match_stars
from sunarc.detection.stars.warm_pixels import WarmPixelMap
from sunarc.imager.cameras.frame import Frame
from sunarc.lab.simulation.truth import SGP
from sunarc.sky.night import night_sky
from sunarc.stars.views import predict_stars

MINUTES = (0, 20, 40, 60, 80, 100)
COUNT, LEVEL = 3000, 0.05 * 4095.0


@cache
def warm_frame(minutes: int) -> Frame:
    frame, rng = frame_at(minutes), np.random.default_rng(minutes)
    at, level = warm_at()
    counts = frame.image.astype(float)
    counts.ravel()[at] += level + rng.normal(0.0, np.sqrt(level / 4.9))
    image: Image = np.clip(np.round(counts), 0, 4095).astype(np.uint16)
    return replace(frame, image=image)


@cache
def warm_at() -> tuple[Any, Any]:
    rng = np.random.default_rng(1)
    at = rng.choice(CAMERA.width * CAMERA.height, COUNT, replace=False)
    return at, LEVEL * 10.0 ** rng.uniform(-0.5, 0.5, COUNT)


def matched(image: Image, frame: Frame) -> StarMatches:
    sky = night_sky(frame.time.timestamp(), SGP, faintest=5.5)
    predicted = predict_stars(calibration_of(CAMERA), sky, within_px=1.0)
    return match_stars(detect_stars(image, full_scale=4095), predicted)


def test_of_a_night_with_warm_pixels_more_stars_are_named_with_their_list() -> None:
    known = WarmPixelMap()
    for minutes in MINUTES:
        frame = warm_frame(minutes)
        image = known.repair(frame, None)
    assert COUNT <= len(known) < 1.2 * COUNT  # the simulated sensor has some of its own
    without, with_list = matched(frame.image, frame), matched(image, frame)
    assert with_list.accepted
    assert with_list.star.size > 1.3 * without.star.size
    assert with_list.explained > without.explained + 0.1
    stars = detect_stars(frame.image, full_scale=4095)
    assert len(known.without_warm(stars)) < len(stars)


def test_a_list_takes_six_images_over_an_hour_and_a_half() -> None:
    known = WarmPixelMap()
    for minutes in MINUTES[:-1]:
        assert known.repair(warm_frame(minutes), None) is warm_frame(minutes).image
    hasty = WarmPixelMap()
    for number in range(8):
        hasty.repair(replace(warm_frame(0), time=warm_frame(number % 2 * 20).time), None)
    assert (len(known), len(hasty)) == (0, 0)


def test_stars_are_not_taken_for_warm_pixels() -> None:
    frames = [frame_at(minutes) for minutes in MINUTES]
    warm = warm_pixels([outstanding_pixels(frame.image) for frame in frames])
    for frame in (frames[0], frames[-1]):
        found = matched(frame.image, frame)
        stars = detect_stars(frame.image, full_scale=4095).select(found.detection)
        column, row = np.round(stars.pixels).astype(int).T
        assert int(np.sum(np.isin(row * CAMERA.width + column, warm))) <= 1


def test_another_region_begins_anew() -> None:
    known = WarmPixelMap()
    for minutes in MINUTES:
        known.repair(warm_frame(minutes), None)
    known.repair(replace(warm_frame(0), image=warm_frame(0).image[:-2]), None)
    assert len(known) == 0


@pytest.mark.parametrize("bayer", ["RGGB", "GBRG"])
def test_in_a_mosaic_a_pixel_is_compared_with_its_own_colour(bayer: Any) -> None:  # noqa: ANN401
    rows, columns = np.indices((64, 80))
    colours = {"R": 300.0, "G": 900.0, "B": 500.0}
    even = np.array([colours[one] for one in bayer])[2 * (rows % 2) + columns % 2]
    image: Image = (even + np.random.default_rng(2).normal(0.0, 3.0, even.shape)).astype(np.uint16)
    image[31, 44] += 200
    found = outstanding_pixels(image, bayer=bayer)
    assert found.tolist() == [31 * 80 + 44]
    assert abs(float(repaired(image, found, bayer=bayer)[31, 44]) - even[31, 44]) < 10.0
    assert warm_pixels([]).size == 0
