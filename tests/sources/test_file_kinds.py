"""Files of every kind are read by every command alike; what programs made of images is left out by all."""

from __future__ import annotations

import gzip
import io
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
from astropy.io import fits
from tests.fixtures.packed_archives import DEEP, GREY, encoded, folder_of

from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.imager.live.folder_files import is_image
from sunarc.sky.site import Site
from sunarc.sources.file_kinds import FILE_KINDS, UNREAD, find_kind, is_derived, listed_ending, path_stem
from sunarc.sources.files import read_image
from sunarc.sources.fits_files import counts
from sunarc.sources.image_files import image_size, read_one_image
from sunarc.sources.image_times import TimeRules, timed_frames
from sunarc.sources.index import CameraPlan, Selector, index_archive
from sunarc.sources.sources import open_source

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
COLOURS = np.random.default_rng(3).integers(0, 255, (40, 48, 3)).astype(np.uint8)
ARCHIVES = Path(__file__).parents[2] / "docs/operating/archives.md"


def tiles(image: np.ndarray[Any, Any]) -> bytes:
    file = io.BytesIO()
    header = fits.Header({"DATE-OBS": "2013-05-13T18:30:00"})
    fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(image, header)]).writeto(file)
    return file.getvalue()


def plain(image: np.ndarray[Any, Any], **header: object) -> bytes:
    file = io.BytesIO()
    fits.PrimaryHDU(image, fits.Header({"DATE-OBS": "2013-05-13T18:30:00", **header})).writeto(file)
    return file.getvalue()


FILES: dict[str, tuple[bytes, np.ndarray[Any, Any]]] = {
    "a.pgm": (encoded(GREY, ".pgm"), GREY),
    "b.pgm": (encoded(DEEP, ".pgm"), DEEP),
    "c.ppm": (encoded(COLOURS, ".ppm"), COLOURS),
    "d.pgm.gz": (gzip.compress(encoded(DEEP, ".pgm")), DEEP),
    "e.bmp": (encoded(COLOURS, ".bmp"), COLOURS),
    "f.bmp.gz": (gzip.compress(encoded(COLOURS, ".bmp")), COLOURS),
    "g.webp": (cv2.imencode(".webp", COLOURS, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes(), COLOURS),
    "h.fits.gz": (gzip.compress(plain(DEEP)), DEEP),
    "i.fits.fz": (tiles(DEEP), DEEP),
    "j.fits": (tiles(DEEP), DEEP),
    "k.pnm": (b"P5 24 20 4095\n" + (DEEP % 4096).astype(">u2").tobytes(), DEEP % 4096),
    "m.pgm": (b"P2\n# 12 bits\n24 20\n4095\n" + " ".join(map(str, (DEEP % 4096).ravel())).encode(), DEEP % 4096),
    "n.ppm": (b"P3 48 40 255\n" + "\n".join(map(str, COLOURS[..., ::-1].ravel())).encode(), COLOURS),
    "l.png": (encoded(GREY, ".pgm"), GREY),  # a wrong ending
}


@pytest.mark.parametrize("name", FILES)
def test_an_image_is_the_same_whatever_file_holds_it(name: str, tmp_path: Path) -> None:
    content, image = FILES[name]
    source = open_source(str(folder_of({name: content}, tmp_path)))
    found = read_one_image(source, name)
    np.testing.assert_array_equal(found, image)
    np.testing.assert_array_equal(read_image(tmp_path / name), image)  # as `sunarc detect` does
    assert found.dtype == image.dtype  # type: ignore[union-attr]
    if name != "l.png":
        assert image_size(source, name) == (image.shape[1], image.shape[0])


@pytest.mark.parametrize("name", [name for name in FILES if not name.endswith((".fits", ".fz"))])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.97])
def test_a_file_that_ends_too_early_is_refused_in_a_line(name: str, share: float, tmp_path: Path) -> None:
    content = FILES[name][0][: int(share * len(FILES[name][0]))]
    found = read_one_image(open_source(str(folder_of({name: content}, tmp_path))), name)
    assert isinstance(found, Finding)
    assert found.code in {"file_truncated", "file_not_image"}
    assert "\n" not in found.sentence


def test_numbers_that_are_no_counts_keep_their_shape_and_full_scale() -> None:
    share = np.linspace(0.0, 1.0, 480).reshape(20, 24)
    data: np.ndarray[Any, Any]
    for data in (share.astype(np.float32), (255.0 * share).astype(np.float64), (1e8 * share).astype(np.int32)):
        found = counts(data)
        assert found is not None
        assert float(np.abs(found.astype(np.float64) - 65_535 * share).max()) <= 0.6
    np.testing.assert_array_equal(counts((4000 * share).astype(np.int32)), (4000 * share).astype(np.int32))
    signed = counts(np.round(60_000 * share - 30_000).astype(np.int16))
    assert signed is not None
    np.testing.assert_allclose(signed, 60_000 * share, atol=200)
    dead = np.tile(share * 1000.0, (50, 50)).astype(np.float32)
    dead[3, 3], dead[4, 4] = np.nan, -1e9
    repaired = counts(dead)
    assert repaired is not None
    assert (repaired[3, 3], repaired[19, 23]) == (0, 1000)
    assert counts(np.full((4, 4), np.nan)) is None
    assert counts(np.zeros((4, 4), np.complex64)) is None


def stacked(times: list[datetime], *, stated: bool = True) -> bytes:
    """Return images as aurora imagers of Calgary write them: one behind the other, each with comments."""
    parts = []
    for number, time in enumerate(times):
        request = f'#"Image request start" {time:%Y-%m-%d %H:%M:%S.%f} UTC\n' if stated else ""
        comments = f'#"Site unique ID" gill\n{request}#"Subframe requested exposure" 1000.000 ms\n'
        parts.append(f"P5\n{comments}24 20\n65535\n".encode() + (DEEP + number).astype(">u2").tobytes())
    return gzip.compress(b"".join(parts))


def test_each_image_of_an_aurora_imagers_minute_has_its_own_time(tmp_path: Path) -> None:
    name, starts = "20130513_1830_gill_themis19_full.pgm.gz", [NOON + timedelta(seconds=3 * n) for n in range(20)]
    source = open_source(str(folder_of({name: stacked(starts)}, tmp_path)))
    frames = timed_frames(source, name, TimeRules(), names={name})
    assert [one.time for one in frames] == [one + timedelta(seconds=0.5) for one in starts]
    assert {(one.exposure_us, one.family) for one in frames} == {(1e6, "PGM header")}
    np.testing.assert_array_equal(read_one_image(source, name, 7), DEEP + 7)
    for content in (stacked(starts, stated=False), stacked(starts)[:900]):
        source = open_source(str(folder_of({name: content}, tmp_path / "b")))
        with pytest.raises(InputError):
            timed_frames(source, name, TimeRules(), names={name})


def test_images_of_trex_in_hdf5_have_the_times_of_their_texts(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["data/images"] = np.stack([COLOURS[..., ::-1], 255 - COLOURS[..., ::-1]], axis=-1)
        texts = [f"{NOON + timedelta(seconds=3 * n):%Y-%m-%d %H:%M:%S.%f} UTC".encode() for n in range(2)]
        file["data/timestamp"] = np.array(texts)
    source = open_source(str(tmp_path))
    frames = timed_frames(source, "a.h5", TimeRules(), names={"a.h5"})
    assert [one.time for one in frames] == [NOON, NOON + timedelta(seconds=3)]
    np.testing.assert_array_equal(read_one_image(source, "a.h5", 1), 255 - COLOURS)


@pytest.mark.parametrize("ending", UNREAD)
def test_what_no_reader_takes_is_named_with_what_to_do(ending: str, tmp_path: Path) -> None:
    files = {f"20130513_183000{ending}": b"content", "20130513_183100.png": encoded(GREY, ".png")}
    plan = CameraPlan(
        name="roof", site=Site(latitude=36.6, longitude=-97.5), selector=Selector((str(folder_of(files, tmp_path)),)),
        rules=TimeRules(offset=timedelta(0)),
    )  # fmt: skip
    (left_out,) = index_archive([plan]).failures
    assert left_out.finding.code == "file_kind_not_read"
    assert left_out.finding.data["kind"] == UNREAD[ending][0]
    with pytest.raises(InputError, match="no reader"):
        read_image(tmp_path / f"20130513_183000{ending}")


def test_an_iphones_image_is_named_whatever_it_is_called(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"\0\0\0\x18ftypheic" + bytes(100))
    with pytest.raises(InputError, match="HEIC"):
        read_image(tmp_path / "a.jpg")


DERIVED = (
    "20240611/thumbnails/image-20240611044800.jpg", "keogram/keogram-20240611.jpg", "startrails-20240611.jpg",
    "keogram-20240611.jpg", "allsky-20240611.mp4", "allsky-keogram_ccd1_20240611_night.jpg",
    "allsky-startrail_ccd1_20240611_night.jpg", "panorama_ccd1_20240611_064800.jpg", "thumbnail_ccd1_20240611.jpg",
    "HR0001_20240611_captured_stack.jpg", "HR0001_20240611_stack_21_meteors.jpg", "HR0001_20240611_DETECTED_thumbs.jpg",
    ".hidden/a.jpg", "allsky-timelapse_ccd1_20240611_day.mp4",
)  # fmt: skip
ORIGINAL = (
    "20240611/image-20240611044800.jpg", "exposures/20240611/day/06/ccd1_20240611_064800.jpg",
    "FF_HR0001_20240611_123000_250_0000000.fits", "allsky-camera_20240611_064800.jpg", "stack_20240611_064800.jpg",
)  # fmt: skip


def test_what_allsky_programs_make_of_images_is_left_out_by_archives_and_live_folders() -> None:
    assert [name for name in (*DERIVED, *ORIGINAL) if is_derived(name)] == list(DERIVED)
    assert [name for name in (*DERIVED, *ORIGINAL) if is_image(name, "*")] == list(ORIGINAL)


def test_every_kind_stands_in_the_page_and_an_example_of_it_is_dated() -> None:
    page = ARCHIVES.read_text(encoding="utf-8")
    for kind in FILE_KINDS:
        row = f"| {kind.label} | {', '.join(f'`{one}`' for one in kind.endings)} | {kind.reader} | "
        assert f"{row}{'–' if kind.extra is None else f'`{kind.extra}`'} |" in page
        assert find_kind(kind.example) == kind.kind
        assert path_stem(kind.example) + listed_ending(kind.example) == kind.example
    assert all(f"`{ending}`" in page for ending in UNREAD)
    assert find_kind("notes.txt") is None


def test_images_whose_size_changes_are_two_cameras_and_the_day_is_said(tmp_path: Path) -> None:
    files = {
        f"201305{13 + (n >= 12)}_18{n:02d}00.png": encoded(GREY if n < 12 else GREY[:10], ".png") for n in range(20)
    }
    plan = CameraPlan(
        name="roof", site=Site(latitude=36.6, longitude=-97.5), selector=Selector((str(folder_of(files, tmp_path)),)),
        rules=TimeRules(offset=timedelta(0)),
    )  # fmt: skip
    cameras = {one.plan.name: one for one in index_archive([plan]).cameras}
    assert {name: (len(one.images), one.size) for name, one in cameras.items()} == {
        "roof": (12, (24, 20)), "roof-24x10": (8, (24, 10))
    }  # fmt: skip
    assert {one.findings[0].data["first"] for one in cameras.values()} == {"2013-05-14T18:12:00Z"}


BOMBS: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "pgm": ("a.pgm.gz", lambda zeros: b"P5\n4000 4000\n255\n" + zeros),
    "bmp": ("a.bmp.gz", lambda zeros: encoded(GREY, ".bmp") + zeros),
    "fits": ("a.fits.gz", lambda zeros: plain(DEEP) + zeros),
}
READ = """
import resource, sys
from sunarc.sources.image_files import read_one_image
from sunarc.sources.sources import open_source
import astropy.io.fits
read_one_image(open_source(sys.argv[1] + "/small"), sys.argv[2])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
found = read_one_image(open_source(sys.argv[1] + "/large"), sys.argv[2])
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024, getattr(found, "nbytes", 0) / 2**20)
"""


@pytest.mark.parametrize("kind", BOMBS)
def test_a_bomb_takes_hardly_more_memory_than_the_image_that_its_header_states(kind: str, tmp_path: Path) -> None:
    name, made = BOMBS[kind]
    folder_of({name: gzip.compress(made(bytes(100)))}, tmp_path / "small")
    folder_of({name: gzip.compress(made(bytes(300 << 20)), 1)}, tmp_path / "large")
    asked = [sys.executable, "-c", READ, str(tmp_path), name]
    taken, image = map(float, subprocess.run(asked, check=True, capture_output=True, text=True).stdout.split())
    assert taken < 2.0 * image + 40.0


@pytest.mark.parametrize(
    "counts_of_it", [b"300 3", b"4294967297 3", b"99999999999999999999 3", b"1 2a", b"1 -2", b"1\x00 2", b"1", b""]
)
def test_a_text_image_with_other_than_its_counts_is_refused(counts_of_it: bytes, tmp_path: Path) -> None:
    source = open_source(str(folder_of({"a.pgm": b"P2\n2 1\n255\n" + counts_of_it}, tmp_path)))
    found = read_one_image(source, "a.pgm")
    assert isinstance(found, Finding)
    assert found.code in {"file_not_image", "file_truncated"}
