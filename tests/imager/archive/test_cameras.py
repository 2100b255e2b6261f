"""Cameras as the archive has them."""

from __future__ import annotations

from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.values import CameraRecord
from sunarc.sky.site import Site

SITE = Site(latitude=36.6, longitude=-97.5, altitude=318.0, temperature=15.0)


def test_a_camera_is_found_by_its_name_alone(archive: Archive) -> None:
    mast = CameraRecord.at(SITE, name="mast", width=640, height=480, serial="7")
    archive.cameras.save(mast)
    assert archive.cameras.get("mast") == mast
    assert archive.cameras.get("mas") is None


def test_a_record_has_its_site_without_the_air_and_its_image_size() -> None:
    record = CameraRecord.at(SITE, name="mast", width=640, height=480)
    assert record.site == Site(latitude=36.6, longitude=-97.5, altitude=318.0)
    assert record.image_size == (640, 480)
