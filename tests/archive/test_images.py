from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from sunarc.archive import ImageStore
from sunarc.errors import OutsideError

NOON = datetime(2013, 5, 13, 18, 30, 0, 123_456, tzinfo=UTC)


def test_images_stand_in_folders_by_utc_date(tmp_path: Path) -> None:
    path = ImageStore(tmp_path).write(NOON, b"image", kind="hdr.png")
    assert path == tmp_path / "2013/05/13/20130513T183000.123Z_hdr.png"
    assert path.read_bytes() == b"image"


def test_an_image_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    store = ImageStore(tmp_path)
    target = store.path(NOON, kind="hdr.png")
    target.mkdir(parents=True)  # a folder in the way: the rename must fail
    with pytest.raises(OutsideError, match="could not be written"):
        store.write(NOON, b"image", kind="hdr.png")
    assert list(target.parent.glob("*.part")) == []


def test_the_newest_image_of_a_kind_is_found(tmp_path: Path) -> None:
    store = ImageStore(tmp_path)
    assert store.newest(kind="hdr.jpg") is None
    store.write(NOON, b"older", kind="hdr.jpg")
    newest = store.write(NOON.replace(month=6), b"newer", kind="hdr.jpg")
    store.write(NOON.replace(month=7), b"other", kind="hdr.png")
    assert store.newest(kind="hdr.jpg") == newest
