"""Stacks of exposures: the short ones rule, and what disagrees is left out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.detection.photo.suns import SUN, exposed
from tests.fixtures.finding_codes import codes

from sunarc.common.errors import InputError
from sunarc.detection.exposure_stack import detect_sun_in_stack
from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_photo


def stack(exposures: tuple[float, ...], slope: float = 0.0) -> list[Photo]:
    return [Photo(exposed(e, slope=slope, seed=k), 255, 1000.0 * e) for k, e in enumerate(exposures)]


def test_the_short_exposure_rules() -> None:
    found = detect_sun_in_stack(stack((1.0, 0.1, 0.01), slope=0.8))
    alone = detect_sun_in_photo(Photo(exposed(1.0, slope=0.8), 255))
    assert found.accepted
    assert codes(found.findings) == ["blob_found", "stack_mean"]
    assert found.findings[1].data["frames"] == 3
    assert (found.x_px, found.y_px) == pytest.approx(SUN, abs=0.35)
    assert found.exposure_us == 10.0
    assert found.sigma_px is not None
    assert found.sigma_px < 0.8 * (alone.sigma_px or 0.0)
    assert (found.radius_px or math.inf) < 0.5 * (alone.radius_px or 0.0)


def test_the_order_does_not_matter() -> None:
    frames = stack((1.0, 0.1, 0.01))
    one, other = (detect_sun_in_stack(each) for each in (frames, frames[::-1]))
    assert (one.x_px, one.y_px, one.sigma_px) == pytest.approx((other.x_px, other.y_px, other.sigma_px))


def test_without_times_the_lighter_exposure_is_the_longer_one() -> None:
    frames = stack((1.0, 0.1, 0.01))
    timed = detect_sun_in_stack(frames)
    untimed = detect_sun_in_stack([frames[1], frames[0]._replace(exposure_us=None), frames[2]])
    assert (untimed.x_px, untimed.y_px) == pytest.approx((timed.x_px, timed.y_px))
    short = [exposed(e, seed=3) for e in (0.005, 0.01)]
    for frames in ([Photo(one, 255, None) for one in short], [Photo(one, 255, None) for one in short[::-1]]):
        assert detect_sun_in_stack(frames) == detect_sun_in_photo(Photo(short[1], 255))


def test_one_exposure_is_an_ordinary_image() -> None:
    (frame,) = stack((1.0,))
    assert detect_sun_in_stack([frame]) == detect_sun_in_photo(Photo(frame.image, 255, exposure_us=frame.exposure_us))


def test_an_exposure_with_another_light_is_left_out() -> None:
    frames = stack((1.0, 0.1))
    lamp = np.zeros((300, 300), np.uint8)
    rows, columns = np.mgrid[:300, :300]
    lamp[np.hypot(columns - 60.0, rows - 220.0) < 4.0] = 255
    found = detect_sun_in_stack([*frames, Photo(lamp, 255, 5.0)])
    assert found.accepted
    assert (found.x_px, found.y_px) == pytest.approx(SUN, abs=0.5)
    assert found.findings[1].data["frames"] == 2


def test_short_exposures_alone_are_not_believed() -> None:
    assert not detect_sun_in_stack(stack((0.01, 0.005))).accepted


def test_no_exposures_and_several_sizes_are_refused() -> None:
    small = Photo(np.zeros((10, 10), np.uint8), 255, 1.0)
    for frames in ([], [small, *stack((1.0,))]):
        with pytest.raises(InputError) as error:
            detect_sun_in_stack(frames)
        assert error.value.field == "exposures"
