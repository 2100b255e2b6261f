from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from sunarc.common.errors import InputError, OutsideError
from sunarc.imager.archive.database.store import Reserve
from sunarc.imager.archive.images import DiskOptions, ImageStore

NOON = datetime(2013, 5, 13, 18, 30, 0, 123_456, tzinfo=UTC)


def test_images_stand_in_folders_by_utc_date(tmp_path: Path) -> None:
    path = ImageStore(tmp_path).write(NOON, b"image", kind="hdr.png")
    assert path == tmp_path / "2013/05/13/20130513T183000.123Z_hdr.png"
    assert path.read_bytes() == b"image"


def test_an_image_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    store = ImageStore(tmp_path)
    target = store.path(NOON, kind="hdr.png")
    target.mkdir(parents=True)  # a folder in the way: the rename must fail
    with pytest.raises(OutsideError, match=target.name):
        store.write(NOON, b"image", kind="hdr.png")
    assert list(target.parent.glob("*.part")) == []


def test_the_newest_image_of_a_kind_is_found(tmp_path: Path) -> None:
    store = ImageStore(tmp_path)
    assert store.newest(kind="hdr.jpg") is None
    store.write(NOON, b"older", kind="hdr.jpg")
    newest = store.write(NOON.replace(month=6), b"newer", kind="hdr.jpg")
    store.write(NOON.replace(month=7), b"other", kind="hdr.png")
    assert store.newest(kind="hdr.jpg") == newest


def disk_of(size_bytes: int, folder: Path) -> Callable[[Path], int]:
    """Return how much is free on a disk of this size that holds this folder alone."""
    return lambda _: size_bytes - sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def small_store(folder: Path) -> ImageStore:
    options = DiskOptions(keep_free_mb=2.0, reserve_mb=1.0)
    return ImageStore(folder, options=options, free_bytes=disk_of(5_000_000, folder))


MB = bytes(1_000_000)


def test_the_oldest_images_make_room_for_new_ones(tmp_path: Path) -> None:
    store = small_store(tmp_path)
    written = [store.write(NOON + timedelta(days=day), MB, kind="hdr.png") for day in range(6)]
    assert [path.exists() for path in written] == [False] * 3 + [True] * 3
    assert not written[0].parent.exists()
    usage = store.usage()
    assert (usage.free_bytes, usage.images_bytes) == (2_000_000, 3_000_000)
    assert usage.oldest_image_at == (NOON + timedelta(days=3)).replace(microsecond=123_000)


def test_what_others_put_there_stays_and_an_image_without_room_is_refused(tmp_path: Path) -> None:
    store = small_store(tmp_path)
    theirs = [tmp_path / "notes.txt", store.path(NOON, kind="hdr.png").with_name("holiday_hdr.png")]
    theirs[1].parent.mkdir(parents=True)
    for path in theirs:
        path.write_bytes(MB + MB[:500_000])
    with pytest.raises(OutsideError, match="hdr"):
        store.write(NOON, MB, kind="hdr.png")
    assert all(path.exists() for path in theirs)


def test_images_older_than_is_wanted_are_removed(tmp_path: Path) -> None:
    store = small_store(tmp_path)
    written = [store.write(NOON + timedelta(days=day), b"image", kind="hdr.png") for day in range(4)]
    assert store.expire(NOON + timedelta(days=1.5)) == 2
    assert [path.exists() for path in written] == [False, False, True, True]


def test_the_count_of_a_store_agrees_with_a_fresh_one(tmp_path: Path) -> None:
    store = small_store(tmp_path)
    assert store.usage().images_bytes == 0
    for day in range(6):
        store.write(NOON + timedelta(days=day), MB[: 400_000 + day], kind="hdr.png")
    store.expire(NOON + timedelta(days=1))
    assert store.usage() == small_store(tmp_path).usage()


def test_what_an_interrupted_write_left_is_cleared_up(tmp_path: Path) -> None:
    store = small_store(tmp_path)
    whole = store.write(NOON, b"image", kind="hdr.png")
    part = whole.with_name("20130513T183030.000Z_hdr.png.part")
    part.write_bytes(b"im")
    store.clear_up()
    assert (whole.exists(), part.exists()) == (True, False)


def test_the_reserve_is_given_up_when_the_disk_is_full_and_taken_again(tmp_path: Path) -> None:
    reserve = Reserve(tmp_path / "reserve", size_bytes=400_000)
    reserve.balance(10_000_000)
    assert (tmp_path / "reserve").stat().st_size == 400_000
    reserve.balance(200_000)
    assert reserve.held()
    reserve.balance(50_000)
    assert not reserve.held()
    reserve.balance(500_000)
    assert not reserve.held()
    reserve.balance(900_000)
    assert reserve.held()


def test_limits_that_leave_the_database_no_room_are_refused() -> None:
    with pytest.raises(InputError, match=r"disk\.keep_free_mb"):
        DiskOptions(keep_free_mb=10.0, reserve_mb=6.0)
