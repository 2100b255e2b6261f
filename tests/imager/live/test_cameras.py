"""The camera of the settings is stored once, and one of another size or site is refused."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.settings import SGP, new_settings

from sunarc.common.errors import InputError
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.live.camera_record import known_camera, register_camera


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    make_empty(tmp_path / "state" / "sunarc.sqlite")
    with open_archive(tmp_path / "state" / "sunarc.sqlite") as opened:
        yield opened


def test_a_camera_is_stored_with_the_site_and_the_size(archive: Archive, tmp_path: Path) -> None:
    settings = new_settings(tmp_path)
    assert known_camera(archive, settings) is None
    register_camera(archive, settings, (8, 6))
    stored = known_camera(archive, settings)
    assert stored is not None
    assert (stored.name, stored.width, stored.height) == ("roof", 8, 6)
    assert (stored.latitude, stored.longitude, stored.altitude) == (SGP.latitude, SGP.longitude, SGP.altitude)


def test_a_camera_that_is_stored_is_returned_as_it_is(archive: Archive, tmp_path: Path) -> None:
    first = register_camera(archive, new_settings(tmp_path), (8, 6))
    assert register_camera(archive, new_settings(tmp_path), (8, 6)) == first
    assert len(archive.cameras.all()) == 1


@pytest.mark.parametrize("size", [(6, 8), (8, 7), (9, 6)])
def test_another_size_is_refused(archive: Archive, tmp_path: Path, size: tuple[int, int]) -> None:
    register_camera(archive, new_settings(tmp_path), (8, 6))
    with pytest.raises(InputError) as refused:
        register_camera(archive, new_settings(tmp_path), size)
    assert refused.value.field == "image size"


def test_another_site_is_refused(archive: Archive, tmp_path: Path) -> None:
    register_camera(archive, new_settings(tmp_path), (8, 6))
    elsewhere = new_settings(tmp_path, site={"latitude": 48.1, "longitude": 11.6})
    with pytest.raises(InputError):
        known_camera(archive, elsewhere)


def test_another_name_is_another_camera(archive: Archive, tmp_path: Path) -> None:
    register_camera(archive, new_settings(tmp_path), (8, 6))
    mast = new_settings(tmp_path, name="mast", site={"latitude": 48.1, "longitude": 11.6})
    register_camera(archive, mast, (4, 4))
    assert {camera.name: camera.width for camera in archive.cameras.all()} == {"roof": 8, "mast": 4}
