"""Images, tables and places at their limits, each against another way of computing it."""

from __future__ import annotations

import errno
import io
import math
import os
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyproj
import pytest

from sunarc.common.errors import InputError, OutsideError
from sunarc.common.utc import parse_time
from sunarc.formats.csv_files import read_pairs, read_sightings, write_columns, write_sightings
from sunarc.imager.archive.cameras import SITE_LIMIT_M, distance_m, require_same_site
from sunarc.imager.archive.database.store import Reserve
from sunarc.imager.archive.images import DiskOptions, ImageStore
from sunarc.imager.archive.values import CameraRecord
from sunarc.sky.site import Site

NOON = datetime(2013, 5, 13, 18, 30, 0, 123_456, tzinfo=UTC)
ROOF = CameraRecord(name="roof", latitude=36.604, longitude=-97.485, altitude=318.0, width=10, height=10)


def store_of(folder: Path, free: Callable[[Path], int] = lambda _: 10**12) -> ImageStore:
    return ImageStore(folder, options=DiskOptions(keep_free_mb=2.0, reserve_mb=1.0), free_bytes=free)


def test_a_name_has_milliseconds_cut_and_utc() -> None:
    store = store_of(Path("/images"))
    east = NOON.astimezone(datetime.fromisoformat("2013-01-01T00:00:00+09:00").tzinfo)
    assert store.path(east, kind="hdr.png") == store.path(NOON, kind="hdr.png")
    assert store.path(NOON.replace(microsecond=999_999), kind="hdr.jpg").name == "20130513T183000.999Z_hdr.jpg"


@pytest.mark.parametrize(("until_ms", "found"), [(-1, False), (0, True), (1, True)])
def test_the_newest_image_is_not_later_than_asked(tmp_path: Path, until_ms: int, *, found: bool) -> None:
    store = store_of(tmp_path)
    store.write(NOON, b"x", kind="hdr.png")
    until = NOON + timedelta(milliseconds=until_ms)
    assert (store.newest(kind="hdr.png", until=until) is not None) == found
    assert (store.newest_at(kind="hdr.png", until=until) is not None) == found


@pytest.mark.parametrize(("free_bytes", "written"), [(2_000_100, True), (2_000_099, False)])
def test_what_is_to_stay_free_stays_free(tmp_path: Path, free_bytes: int, *, written: bool) -> None:
    store = store_of(tmp_path, lambda _: free_bytes)
    if written:
        store.write(NOON, b"x" * 100, kind="hdr.png")
    else:
        with pytest.raises(OutsideError):
            store.write(NOON, b"x" * 100, kind="hdr.png")
    assert len(list(tmp_path.rglob("*.png"))) == written


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
def test_a_disk_that_is_full_all_the_same_loses_its_oldest_image(
    tmp_path: Path, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, plain = store_of(tmp_path), os.fdatasync
    oldest = store.write(NOON, b"old", kind="hdr.png")

    def full(descriptor: int) -> None:
        if oldest.exists():
            raise OSError(code, os.strerror(code))
        plain(descriptor)

    monkeypatch.setattr(os, "fdatasync", full)
    newest = store.write(NOON + timedelta(hours=1), b"new", kind="hdr.png")
    assert (oldest.exists(), newest.read_bytes()) == (False, b"new")


def test_a_write_that_fails_for_good_leaves_no_part_and_loses_no_image(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = store_of(tmp_path)
    kept = store.write(NOON, b"old", kind="hdr.png")

    def failing(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fdatasync", failing)
    with pytest.raises(OutsideError):
        store.write(NOON + timedelta(hours=1), b"new", kind="hdr.png")
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == [kept]


@pytest.mark.parametrize(("keep", "left"), [(0, 0), (1, 1), (2, 2), (9, 3)])
def test_the_newest_days_stay_whatever_their_age(tmp_path: Path, keep: int, left: int) -> None:
    store = store_of(tmp_path)
    for day in range(3):
        store.write(NOON + timedelta(days=day), b"x", kind="hdr.png")
    assert store.expire(NOON + timedelta(days=400), keep_newest_days=keep) == 3 - left
    assert len(list(tmp_path.rglob("*.png"))) == left


def test_an_image_of_the_limits_own_time_stays(tmp_path: Path) -> None:
    store = store_of(tmp_path)
    whole = NOON.replace(microsecond=123_000)
    store.write(whole, b"x", kind="hdr.png")
    assert store.expire(whole) == 0
    assert store.expire(whole + timedelta(milliseconds=1)) == 1
    assert list(tmp_path.iterdir()) == []  # the folders of the date went too


@pytest.mark.parametrize(("free_share", "held"), [(0.24, False), (0.26, True), (1.9, True), (2.1, True)])
def test_the_reserve_is_given_up_below_a_quarter(tmp_path: Path, free_share: float, *, held: bool) -> None:
    reserve = Reserve(tmp_path / "reserve", size_bytes=4096)
    assert reserve.hold()
    assert (tmp_path / "reserve").stat().st_size == 4096
    reserve.balance(round(free_share * 4096))
    assert reserve.held() == held


@pytest.mark.parametrize(("free_share", "held"), [(1.9, False), (2.1, True)])
def test_the_reserve_is_taken_again_above_twice_its_size(tmp_path: Path, free_share: float, *, held: bool) -> None:
    reserve = Reserve(tmp_path / "reserve", size_bytes=4096)
    reserve.balance(round(free_share * 4096))
    assert reserve.held() == held


def test_a_reserve_of_nothing_is_always_held(tmp_path: Path) -> None:
    reserve = Reserve(tmp_path / "reserve", size_bytes=0)
    assert reserve.held()
    assert reserve.hold()
    assert list(tmp_path.iterdir()) == []


def test_a_reserve_that_finds_no_room_leaves_nothing(tmp_path: Path) -> None:
    reserve = Reserve(tmp_path / "missing" / "reserve", size_bytes=4096)
    assert not reserve.hold()
    assert not reserve.held()
    too_large = Reserve(tmp_path / "reserve", size_bytes=2**62)  # more than a file may have
    assert not too_large.hold()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("other", [(36.604, -97.485), (36.7, -97.4), (-36.0, 80.0), (89.9, 10.0)])
def test_the_distance_of_two_places_is_that_on_a_sphere(other: tuple[float, float]) -> None:
    sphere = pyproj.Geod(a=6_371_000.0, b=6_371_000.0)
    _, _, true = sphere.inv(ROOF.longitude, ROOF.latitude, other[1], other[0])
    assert distance_m(ROOF.site, Site(latitude=other[0], longitude=other[1])) == pytest.approx(true, abs=1e-3)


@pytest.mark.parametrize(("metres", "refused"), [(0.0, False), (499.0, False), (501.0, True)])
def test_another_site_is_refused_from_its_limit_on(metres: float, *, refused: bool) -> None:
    north = Site(latitude=ROOF.latitude + math.degrees(metres / 6_371_000.0), longitude=ROOF.longitude)
    assert SITE_LIMIT_M == 500.0
    if not refused:
        require_same_site(ROOF, north)
        return
    with pytest.raises(InputError) as error:
        require_same_site(ROOF, north)
    assert error.value.field == "site"


def test_tables_are_read_back_to_their_last_digit() -> None:
    rng, target = np.random.default_rng(0), io.StringIO()
    times = [NOON + timedelta(microseconds=int(n)) for n in np.sort(rng.integers(0, 10**11, 50))]
    x, y = rng.uniform(-5.0, 3000.0, (2, 50))
    sigma = [None if n % 3 == 0 else 0.01 * (n + 1) for n in range(50)]
    rows = zip(times, x.tolist(), y.tolist(), sigma, ["sun"] * 50, strict=True)
    assert write_sightings(target, rows) == 50
    found = read_sightings(io.StringIO(target.getvalue()), name="t")
    assert found.unix_s == pytest.approx([time.timestamp() for time in times], abs=1e-6)
    assert found.pixels == pytest.approx(np.stack([x, y], axis=-1), abs=5.1e-7)
    np.testing.assert_allclose(found.sigma_px, [math.nan if s is None else s for s in sigma])
    assert np.isnan(found.temperature).all()


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("2013-05-13T18:30:00Z", 0.0),
        (" 2013-05-13T18:30:00.5+00:00 ", 0.5),
        ("2013-05-13T20:30:00+02:00", 0.0),
        ("2013-05-13 18:30:00.000001Z", 1e-6),
    ],
)
def test_a_time_states_its_zone(text: str, seconds: float) -> None:
    assert (parse_time(text, where="w") - NOON.replace(microsecond=0)).total_seconds() == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "noon", "2013-05-13T18:30:00", "2013-13-13T18:30:00Z", "1368469800"])
def test_a_time_without_a_zone_or_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError) as error:
        parse_time(text, where="time_utc")
    assert error.value.field == "time_utc"


@pytest.mark.parametrize("cell", ["nan", "inf", "-inf", "1e999", "1,5", "0x10", ""])
def test_a_cell_that_is_no_finite_number_is_named_by_line_and_column(cell: str) -> None:
    quoted = f'"{cell}"'
    with pytest.raises(InputError) as error:
        read_pairs(["x,y", "1,2", f"3,{quoted}"], columns=("x", "y"), name="file.csv")
    assert error.value.field.split(", ") == ["file.csv", "line 3", "y"]


def test_columns_have_their_places_and_empty_cells() -> None:
    target = io.StringIO()
    write_columns(target, {"a": np.array([1.0 / 3.0, math.nan]), "b": np.array([-0.5, 1e6])}, places={"a": 3, "b": 0})
    assert target.getvalue() == "a,b\n0.333,-0\n,1000000\n"
