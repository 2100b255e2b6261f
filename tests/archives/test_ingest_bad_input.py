"""A folder with every kind of image that cannot be used: a reason each, and nothing stored of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from tests.detection.photo.suns import glare_image
from tests.fixtures.settings import new_settings

from sunarc.archives.ingest import IngestOptions, ingest_folder
from sunarc.imager.archive.archive import open_archive
from sunarc.sources.detect_files import detect_in_image

SIZE = (64, 48)
GREY = np.zeros((SIZE[1], SIZE[0]), dtype=np.uint8)
COLOURS = np.random.default_rng(2).integers(0, 90, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
ORIENTATION = 0x0112


def truncated(path: Path) -> None:
    path.write_bytes(cv2.imencode(".jpg", COLOURS)[1].tobytes()[:-200])


def for_print(path: Path) -> None:
    Image.fromarray(COLOURS).convert("CMYK").save(path, format="JPEG")


def deep_with_alpha(path: Path) -> None:
    cv2.imwrite(str(path), np.dstack([COLOURS, GREY]).astype(np.uint16) * 257)


def animated(path: Path) -> None:
    Image.fromarray(COLOURS).save(path, save_all=True, append_images=[Image.fromarray(255 - COLOURS)])


def resized(path: Path) -> None:
    cv2.imwrite(str(path), COLOURS[::2, ::2])


BAD = {
    "20130513T180000Z.jpg": (truncated, "file_truncated"),
    "20130513T180100Z.jpg": (for_print, "file_cmyk"),
    "20130513T180200Z.png": (deep_with_alpha, "file_transparent"),
    "20130513T180300Z.png": (animated, "file_animated"),
    "20130513T180600Z.png": (resized, "file_size_differs"),
    "20130513T060000Z.png": (lambda path: cv2.imwrite(str(path), COLOURS), "file_at_night"),
    "20130513T180700Z.tif": (lambda path: path.write_text("no image"), "file_not_image"),
    "yesterday.png": (lambda path: cv2.imwrite(str(path), COLOURS), "file_time_unknown"),
}


def test_each_bad_image_has_its_reason_and_nothing_of_it_is_stored(tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    for name, (write, _code) in BAD.items():
        write(images / name)
    good = [f"20130513T19{minute:02d}00Z.png" for minute in range(9)]  # most images have the camera's size
    for name in good:
        cv2.imwrite(str(images / name), GREY)
    summary = ingest_folder(new_settings(tmp_path), images, options=IngestOptions())
    assert {one.file: one.finding.code for one in summary.skipped} == {name: code for name, (_, code) in BAD.items()}
    with open_archive(tmp_path / "state" / "sunarc.sqlite") as archive:
        stored = archive.sightings.find("roof")
        assert archive.cameras.all()[0].image_size == SIZE
    assert [point.file for point in stored] == good
    assert not any(point.accepted for point in stored)


@pytest.mark.parametrize("name", ["20130513T180000Z.jpg", "yesterday.png"])
def test_a_folder_of_bad_images_alone_stores_nothing(tmp_path: Path, name: str) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / name).write_bytes(b"")
    summary = ingest_folder(new_settings(tmp_path), tmp_path / "images", options=IngestOptions())
    assert (summary.accepted, summary.rejected, len(summary.skipped), summary.contact_sheet) == (0, 0, 1, None)


def test_what_is_painted_into_the_images_of_a_day_is_no_sun(tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    for number in range(12):
        painted = glare_image(60.0, 100.0, radius=8.0, seed=number)
        hour, minute = divmod(13 * 60 + 45 * number, 60)
        cv2.imwrite(str(images / f"20130513T{hour:02d}{minute:02d}00Z.png"), painted)
    summary = ingest_folder(new_settings(tmp_path), images, options=IngestOptions())
    assert (summary.accepted, summary.rejected, summary.skipped) == (0, 12, ())
    assert detect_in_image(glare_image(60.0, 100.0, radius=8.0)).accepted  # but for the mask
