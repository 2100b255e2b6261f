"""What stands still in a folder's images, once the sun has moved far enough to tell."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.fixtures.settings import SGP

from sunarc.archives.ledger import Ledger
from sunarc.archives.passes import Passes
from sunarc.archives.pool import ProcessRunner
from sunarc.sources.index import ArchiveImage, CameraImages, CameraPlan, Selector
from sunarc.sources.look import PackedMask, pack_mask

MORNING = datetime(2013, 5, 13, 14, 0, tzinfo=UTC)
SIZE = (160, 120)
STAMP = (slice(4, 16), slice(8, 60))


def series(folder: Path, *, every_min: float, count: int = 12) -> list[ArchiveImage]:
    """Write images of a sun that moves under a stamp that does not; one of them is torn."""
    made = []
    for number in range(count):
        image = np.full((SIZE[1], SIZE[0], 3), 60, dtype=np.uint8)
        cv2.circle(image, (20 + 10 * number, 80), 8, (255, 255, 255), -1)
        image[STAMP] = 250
        time = MORNING + timedelta(minutes=every_min * number)
        name = f"{number:02d}.png"
        cv2.imwrite(str(folder / name), image)
        made.append(ArchiveImage(round(time.timestamp() * 1e6), name, 0, str(folder), None, ""))
    (folder / made[3].path).write_bytes(b"torn")
    return made


def series_mask(images: list[ArchiveImage], *, size: tuple[int, int] = SIZE) -> PackedMask | None:
    plan = CameraPlan(name="roof", site=SGP, selector=Selector(()))
    camera = CameraImages(plan=plan, images=tuple(images), example=("", ""), family="", size=size)
    with Ledger("sqlite://") as ledger:
        (mask,) = Passes(ledger, ProcessRunner(1), lambda *_: None).masks([camera])
    return mask


def test_the_stamp_is_masked_and_the_sun_is_not(tmp_path: Path) -> None:
    mask = series_mask(series(tmp_path, every_min=45.0))
    assert mask is not None
    hidden = mask.unpacked()
    assert hidden.shape == (SIZE[1], SIZE[0])
    assert np.all(hidden[STAMP])
    assert not np.any(hidden[60:])


def test_a_sun_that_has_hardly_moved_is_not_taken_for_a_stamp(tmp_path: Path) -> None:
    assert series_mask(series(tmp_path, every_min=5.0)) is None


def test_images_of_another_size_tell_nothing(tmp_path: Path) -> None:
    assert series_mask(series(tmp_path, every_min=45.0), size=(161, 120)) is None


@pytest.mark.parametrize("shape", [(7, 9), (640, 300), (1200, 1920)])
def test_a_packed_mask_hides_all_that_was_hidden(shape: tuple[int, int]) -> None:
    mask = np.zeros(shape, dtype=np.bool_)
    mask[shape[0] // 2, shape[1] // 3] = True
    unpacked = pack_mask(mask).unpacked()
    assert max(unpacked.shape) <= 640
    back = cv2.resize(unpacked.astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST)
    assert back[shape[0] // 2, shape[1] // 3] == 1
    assert 1 <= int(back.sum()) <= 64
    assert len(pack_mask(mask).compressed) < 400
