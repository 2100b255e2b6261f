"""Which detector and which full scale an image file gets, and what is drawn of the result."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.detection.photo.stack_series import Series, series

from sunarc.common.errors import OutsideError
from sunarc.sources.detect_files import (
    METHODS,
    detect_in_files,
    detect_in_image,
    draw_overlay,
    estimated_full_scale,
    selected_method,
)

CENTRE = (61.3, 48.8)
RADIUS = 8.0


def disc(full_scale: int, *, sky: float = 0.0) -> NDArray[np.uint16]:
    """Return a 16-bit image of a sharp disc at half of full scale."""
    y, x = np.mgrid[:100, :120]
    edge = np.clip(RADIUS + 0.5 - np.hypot(x - CENTRE[0], y - CENTRE[1]), 0.0, 1.0)
    counts: NDArray[np.uint16] = np.round((sky + 0.5 * edge) * full_scale).astype(np.uint16)
    return counts


@pytest.mark.parametrize(
    ("brightest", "full_scale"),
    [
        (0, 255),
        (255, 255),
        (256, 1023),
        (1023, 1023),
        (1024, 4095),
        (4095, 4095),
        (4096, 16383),
        (16384, 65535),
        (65535, 65535),
    ],
)
def test_the_full_scale_of_a_16_bit_image_is_the_smallest_usual_one_that_holds_it(
    brightest: int, full_scale: int
) -> None:
    image = np.zeros((4, 4), dtype=np.uint16)
    image[1, 1] = brightest
    assert estimated_full_scale(image) == full_scale


def test_the_full_scale_of_an_8_bit_image_is_255_whatever_it_holds() -> None:
    assert estimated_full_scale(np.full((4, 4), 3, dtype=np.uint8)) == 255


@pytest.mark.parametrize(("share", "method"), [(0.029, "disc"), (0.031, "paper")])
def test_an_image_whose_median_is_above_3_percent_of_full_scale_is_an_ordinary_one(share: float, method: str) -> None:
    assert selected_method(np.full((16, 16), round(share * 65535), dtype=np.uint16), "auto", full_scale=65535) == method


def test_a_dark_image_in_colours_is_an_ordinary_one() -> None:
    assert selected_method(np.zeros((16, 16, 3), dtype=np.uint8), "auto", full_scale=255) == "paper"


def test_the_disc_is_found_where_it_was_drawn() -> None:
    found = detect_in_image(disc(4095), exposure_us=12.0)
    assert (found.method, found.exposure_us) == ("disc", 12.0)
    assert (found.x_px, found.y_px) == pytest.approx(CENTRE, abs=0.05)


def test_the_method_that_is_asked_for_is_used() -> None:
    assert detect_in_image(disc(65535), method="paper").method == "paper"
    assert detect_in_image(disc(65535, sky=0.1), method="disc").method == "disc"


def test_a_short_exposure_in_colours_goes_to_the_disc_model() -> None:
    colours = np.stack([np.round(gain * disc(4095)).astype(np.uint16) for gain in (0.7, 1.0, 0.8)], axis=-1)
    for method in METHODS[:2]:
        found = detect_in_image(colours, method=method, full_scale=4095)
        assert (found.x_px, found.y_px) == pytest.approx(CENTRE, abs=0.05)
        assert (found.sigma_px or 0.0) >= 0.1  # of the colours' interpolation
    dark = np.zeros((20, 20, 3), dtype=np.uint8)
    assert [detect_in_image(dark, method=method).method for method in METHODS[:2]] == ["paper", "disc"]
    assert detect_in_image(series(Series(sun=(301.3, 212.6)), 1)[10]).accepted


def test_a_stated_full_scale_decides_what_is_saturated() -> None:
    image = disc(4095)
    image[image == image.max()] = 2000
    assert detect_in_image(image, full_scale=4095).saturated_px == 0
    assert (detect_in_image(image, full_scale=2000).saturated_px or 0) > 100


def test_a_file_that_is_no_image_gets_a_row_and_the_others_theirs(tmp_path: Path) -> None:
    torn, good = tmp_path / "torn.png", tmp_path / "good.png"
    torn.write_bytes(b"torn")
    cv2.imwrite(str(good), disc(65535))
    rows = detect_in_files([torn, good])
    assert [(row["file"], row["x_px"] is None) for row in rows] == [(str(torn), True), (str(good), False)]
    assert (rows[0]["verdict"], rows[0]["accepted"]) == ("no_frame", False)
    assert rows[0].keys() == rows[1].keys()


@pytest.mark.parametrize(("accepted", "colour"), [(True, (0, 200, 0)), (False, (0, 140, 255))])
@pytest.mark.parametrize("kind", ["8 bit", "16 bit", "colours"])
def test_the_cross_stands_on_the_sun_in_the_colour_of_the_verdict(
    tmp_path: Path, *, accepted: bool, colour: tuple[int, int, int], kind: str
) -> None:
    path, target = tmp_path / "sky.png", tmp_path / "drawn.png"
    image = disc(65535)
    if kind != "16 bit":
        image = (image // 256).astype(np.uint8)
    cv2.imwrite(str(path), np.dstack([image] * 3) if kind == "colours" else image)
    draw_overlay(path, {"x_px": 61.3, "y_px": 48.8, "radius_px": 8.0, "accepted": accepted}, target)
    drawn = cv2.imread(str(target))
    assert drawn is not None
    assert drawn.shape == (100, 120, 3)
    assert tuple(drawn[49, 61].tolist()) == colour
    assert tuple(drawn[49, 61 + 16].tolist()) == colour  # the circle of twice the radius
    assert tuple(drawn[30, 61 - 30].tolist()) != colour  # neither on an arm nor on the circle


def test_without_a_sun_nothing_is_drawn(tmp_path: Path) -> None:
    path, target = tmp_path / "sky.png", tmp_path / "drawn.png"
    image = np.full((20, 20, 3), 90, dtype=np.uint8)
    cv2.imwrite(str(path), image)
    draw_overlay(path, {"x_px": None, "y_px": None, "radius_px": None, "accepted": False}, target)
    np.testing.assert_array_equal(cv2.imread(str(target)), image)


def test_a_target_that_cannot_be_written_is_an_outside_fault(tmp_path: Path) -> None:
    path = tmp_path / "sky.png"
    cv2.imwrite(str(path), disc(65535))
    with pytest.raises(OutsideError):
        draw_overlay(path, {"x_px": None, "accepted": False}, tmp_path / "absent" / "drawn.png")
