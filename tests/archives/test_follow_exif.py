"""Pictures that are turned as their EXIF orientation states, where that is asked for; Pillow is the oracle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageOps
from tests.detection.photo.suns import glare_image
from tests.fixtures.settings import new_settings

from sunarc.archives.ingest import IngestOptions, ingest_folder
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import open_archive
from sunarc.public.star_files import StarOptions, read_timed
from sunarc.sky.site import Site
from sunarc.sources.detect_files import detect_in_files
from sunarc.sources.files import read_image
from sunarc.sources.image_files import image_size, read_one_image
from sunarc.sources.index import CameraPlan, Selector, index_archive, read_cameras
from sunarc.sources.sources import HashedSource, open_folder, open_source

ORIENTATION = 0x0112
ROWS, COLUMNS = 150, 200
SUN = (60.0, 90.0)


def written(path: Path, orientation: int) -> Path:
    """Write a picture of the sun, whose rows are stored as an orientation states."""
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    sun = (glare_image(*SUN, radius=8.0)[:ROWS] // 16).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.stack([sun, sun // 2, sun], axis=-1)).save(path, exif=exif)
    return path


def upright_sun(orientation: int) -> tuple[float, float]:
    """Return where the sun is in the upright picture, by a mark in Pillow's."""
    mark = np.zeros((ROWS, COLUMNS), dtype=np.uint8)
    mark[int(SUN[1]), int(SUN[0])] = 255
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    picture = Image.fromarray(mark)
    picture.getexif()[ORIENTATION] = orientation
    row, column = np.argwhere(np.asarray(ImageOps.exif_transpose(picture)) == 255)[0]
    return float(column), float(row)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_upright_as_pillow_has_it(tmp_path: Path, orientation: int) -> None:
    path = written(tmp_path / "a.png", orientation)
    with Image.open(path) as picture:
        expected = np.asarray(ImageOps.exif_transpose(picture))[..., ::-1]
    source = HashedSource(open_source(f"exif:{tmp_path}"))
    size = (expected.shape[1], expected.shape[0])
    np.testing.assert_array_equal(read_one_image(source, path.name, size=size), expected)
    assert image_size(source, path.name) == size
    np.testing.assert_array_equal(read_image(path, follow_exif=True), expected)
    assert read_image(path).shape == (ROWS, COLUMNS, 3)


@pytest.mark.parametrize("orientation", [0, 9, 70_000])
def test_an_orientation_that_is_none_turns_nothing(tmp_path: Path, orientation: int) -> None:
    path = tmp_path / "a.png"
    exif = Image.Exif()
    exif[ORIENTATION] = min(orientation, 65_535)
    Image.fromarray(np.arange(200, dtype=np.uint8).reshape(10, 20)).save(path, exif=exif)
    assert read_image(path, follow_exif=True).shape == (10, 20)


def test_a_size_that_is_only_the_stored_one_is_refused(tmp_path: Path) -> None:
    written(tmp_path / "a.png", 6)
    found = read_one_image(open_folder(tmp_path, follow_exif=True), "a.png", size=(COLUMNS, ROWS))
    assert isinstance(found, Finding)
    assert found.code == "file_size_differs"


@pytest.mark.parametrize("orientation", [3, 5, 6])
def test_detect_finds_the_sun_in_the_upright_picture(tmp_path: Path, orientation: int) -> None:
    path = written(tmp_path / "a.png", orientation)
    stored, upright = (detect_in_files([path], follow_exif=turned)[0] for turned in (False, True))
    assert (stored["x_px"], stored["y_px"]) == pytest.approx(SUN, abs=0.5)
    assert (upright["x_px"], upright["y_px"]) == pytest.approx(upright_sun(orientation), abs=0.5)


def test_stars_are_sought_in_the_upright_picture(tmp_path: Path) -> None:
    path = written(tmp_path / "20130513T040000Z.png", 8)
    assert read_timed(path, StarOptions())[1].shape[:2] == (ROWS, COLUMNS)
    assert read_timed(path, StarOptions(follow_exif=True))[1].shape[:2] == (COLUMNS, ROWS)


def test_an_archive_has_the_upright_size_and_says_nothing_of_orientations(tmp_path: Path) -> None:
    for hour in range(15, 21):
        written(tmp_path / "hut" / f"20130513T{hour}0000Z.jpg", 6)
    site = Site(latitude=36.6, longitude=-97.5)
    common = CameraPlan(name="hut", site=site, selector=Selector((str(tmp_path / "hut"),)))
    table = tmp_path / "cameras.toml"
    table.write_text('[cameras.hut]\nsources = ["hut"]\nfollow_exif = true\n')
    (stored,) = index_archive([common]).cameras
    (upright,) = index_archive(read_cameras(table, common=common)).cameras
    assert (stored.size, [one.code for one in stored.findings]) == ((COLUMNS, ROWS), ["file_rotated"])
    assert (upright.size, upright.findings) == ((ROWS, COLUMNS), ())
    assert read_cameras(table, common=common, follow_exif=True)[0].selector == upright.plan.selector
    table.write_text('[cameras.hut]\nsources = ["hut"]\nfollow_exif = "perhaps"\n')
    with pytest.raises(InputError, match="follow_exif"):
        read_cameras(table, common=common)


def test_ingest_stores_pixels_of_the_upright_picture(tmp_path: Path) -> None:
    written(tmp_path / "images" / "20130513T180000Z.png", 6)
    ingest_folder(new_settings(tmp_path), tmp_path / "images", options=IngestOptions(follow_exif=True, method="paper"))
    with open_archive(tmp_path / "state" / "sunarc.sqlite") as archive:
        assert archive.cameras.all()[0].image_size == (ROWS, COLUMNS)
        (point,) = archive.sightings.find("roof")
    assert (point.x_px, point.y_px) == pytest.approx(upright_sun(6), abs=0.5)
