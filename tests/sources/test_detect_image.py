"""What a process answers for one image."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest
from tests.detection.photo.suns import glare_image

from sunarc.common.findings import Finding
from sunarc.detection.values import Detection
from sunarc.sources.detect_files import Method
from sunarc.sources.look import Chunk, Item, PackedMask, look_at, pack_mask

SIZE = (60, 50)


def answer(
    path: Path,
    *,
    method: Method = "auto",
    size: tuple[int, int] = SIZE,
    outside: bool = False,
    static: PackedMask | None = None,
) -> object:
    """Return what comes of one image."""
    items = (Item(path.name, 0, 20.0, outside=outside),)
    (found,) = look_at(Chunk("roof", str(path.parent), method, size, items, static))
    return found.found


@pytest.mark.parametrize(
    ("level", "method", "expected"),
    [(0, "auto", "disc"), (90, "auto", "paper"), (90, "disc", "disc"), (0, "paper", "paper")],
)
def test_an_image_without_the_sun_in_its_field_is_answered_by_the_method_that_would_have_looked(
    tmp_path: Path, level: int, method: Method, expected: Literal["disc", "paper"]
) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.full((SIZE[1], SIZE[0]), level, dtype=np.uint8))
    found = answer(tmp_path / "a.png", method=method, outside=True)
    assert isinstance(found, Detection)
    assert (found.method, found.accepted, found.verdict, found.exposure_us) == (expected, False, "hidden", 20.0)
    assert [one.code for one in found.findings] == ["sun_outside_image"]


@pytest.mark.parametrize("hidden", [False, True])
def test_what_stands_still_takes_no_part(tmp_path: Path, hidden: bool) -> None:  # noqa: FBT001 - a parameter of the test
    image = glare_image(100.0, 90.0, size=200)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    still = np.zeros(image.shape, dtype=np.bool_)
    still[60:120, 70:130] = hidden
    found = answer(tmp_path / "a.png", method="paper", size=(200, 200), static=pack_mask(still))
    assert isinstance(found, Detection)
    assert found.accepted is not hidden
    if not hidden:
        assert (found.x_px, found.y_px) == pytest.approx((100.0, 90.0), abs=1.0)


def test_a_refused_image_is_a_finding_and_colours_are_taken_by_the_disc_model(tmp_path: Path) -> None:
    assert answer(tmp_path / "b.png") == Finding("file_not_image", {"error": "No such file or directory"})
    cv2.imwrite(str(tmp_path / "c.png"), np.zeros((SIZE[1], SIZE[0], 3), dtype=np.uint8))
    found = answer(tmp_path / "c.png", method="disc")
    assert isinstance(found, Detection)
    assert (found.method, found.accepted) == ("disc", False)
