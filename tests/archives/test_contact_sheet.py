"""A contact sheet: a row a verdict, five examples at most, the mark where the sighting is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from sunarc.archives.ingest_summary import ACCEPTED, REJECTED, TILE_PX, TITLE_PX, write_contact_sheet
from sunarc.common.errors import OutsideError
from sunarc.imager.archive.sightings import FileSighting
from sunarc.sources.index import ArchiveImage

Pixels = np.ndarray[Any, np.dtype[Any]]
SIDE = 2 * TILE_PX
ROW_PX = TILE_PX + TITLE_PX


def read(path: Path) -> Pixels:
    pixels = cv2.imread(str(path))
    assert pixels is not None
    return pixels


def image(folder: Path, number: int, *, deep: bool = False) -> ArchiveImage:
    path = f"{number}.png"
    pixels = np.full((SIDE, SIDE), 40, dtype=np.uint16 if deep else np.uint8)
    cv2.imwrite(str(folder / path), pixels)
    return ArchiveImage(number, path, 0, str(folder), None, "")


def sighting(one: ArchiveImage, verdict: str, *, x: float | None = None) -> FileSighting:
    time_us, exposure_us, file, _ = one.key
    y = None if x is None else 100.0
    return FileSighting(
        time_us, exposure_us, file, "paper", verdict == "clear", verdict, 1, x_px=x, y_px=y, radius_px=8.0
    )


def marked(tile: Pixels, colour: tuple[int, int, int]) -> Pixels:
    """Return the rows and columns of a tile in a colour, (n, 2)."""
    return np.argwhere(np.all(tile == colour, axis=-1))


def test_a_row_for_each_verdict_the_most_frequent_first(tmp_path: Path) -> None:
    images = [image(tmp_path, number, deep=number == 8) for number in range(9)]
    found = {one: sighting(one, "clear" if number < 7 else "veiled", x=300.0) for number, one in enumerate(images)}
    target = tmp_path / "new" / "sheet.png"
    write_contact_sheet(found, target)
    sheet = read(target)
    assert sheet.shape == (2 * ROW_PX, 10 * TILE_PX, 3)
    first, second = sheet[TITLE_PX:ROW_PX], sheet[ROW_PX + TITLE_PX :]
    for number in range(5):
        tile = first[:, SIDE * number : SIDE * (number + 1)]
        row, column = np.median(marked(tile[:, :TILE_PX], ACCEPTED), axis=0)
        assert (row, column) == pytest.approx((50.0, 150.0), abs=1.0)  # half the size
        row, column = np.median(marked(tile[:, TILE_PX:], ACCEPTED), axis=0)
        assert (row, column) == pytest.approx((TILE_PX / 2, TILE_PX / 2), abs=2.0)
    assert marked(second, REJECTED).size
    assert not marked(second, ACCEPTED).size
    assert not second[:, 2 * SIDE :].any()  # two examples


def test_an_image_without_a_sun_and_one_that_is_gone_are_no_fault(tmp_path: Path) -> None:
    images = [image(tmp_path, number) for number in range(2)]
    (tmp_path / images[1].path).unlink()
    write_contact_sheet({one: sighting(one, "hidden") for one in images}, tmp_path / "sheet.png")
    sheet = read(tmp_path / "sheet.png")
    assert sheet[TITLE_PX : ROW_PX - 20, :TILE_PX].min() == 40
    assert not sheet[TITLE_PX:, SIDE : 2 * SIDE].any()


def test_a_sheet_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    one = image(tmp_path, 0)
    with pytest.raises(OutsideError):
        write_contact_sheet({one: sighting(one, "hidden")}, tmp_path / "0.png" / "sheet.png")
