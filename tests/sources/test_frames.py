"""Images in files of every kind, in and out of archives; each that cannot be used gives its reason."""

from __future__ import annotations

import io
import json
import struct
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import h5netcdf
import numpy as np
import pytest
from astropy.io import fits
from numpy.typing import NDArray
from tests.fixtures.packed_archives import DEEP, GREY, encoded, folder_of, zip_of

from sunarc.common.array_types import Image
from sunarc.common.findings import Finding, FindingError
from sunarc.sources.fits_files import fits_bayer
from sunarc.sources.image_files import frames_in, images_in
from sunarc.sources.sources import open_source

SIZE = (24, 20)
NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
COLOURS = np.random.default_rng(3).integers(0, 255, (20, 24, 3)).astype(np.uint8)


def image_of(content: bytes, name: str, folder: Path, *, size: tuple[int, int] | None = SIZE) -> Image | Finding:
    ((_, found),) = images_in(open_source(str(folder_of({name: content}, folder))), name, [0], size=size)
    return found


def code_of(content: bytes, name: str, folder: Path, *, size: tuple[int, int] | None = SIZE) -> str:
    found = image_of(content, name, folder, size=size)
    assert isinstance(found, Finding)
    return found.code


def kept(where: str, files: dict[str, bytes], folder: Path) -> str:
    return str(zip_of(files, folder / "a.zip") if where == "zip" else folder_of(files, folder / "b"))


def fits_of(data: NDArray[np.generic], **header: object) -> bytes:
    file = io.BytesIO()
    fits.PrimaryHDU(data, fits.Header(header)).writeto(file)
    return file.getvalue()


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jp2"])
@pytest.mark.parametrize("image", [GREY, DEEP, COLOURS])
def test_lossless_pictures_of_8_and_16_bits_come_back_as_they_were(suffix: str, image: Image, tmp_path: Path) -> None:
    # JPEG 2000 takes none below 32 px
    wide = cv2.copyMakeBorder(image, 30, 30, 30, 30, cv2.BORDER_WRAP)
    found = image_of(encoded(wide, suffix), f"a{suffix}", tmp_path, size=(84, 80))
    assert isinstance(found, np.ndarray)
    assert found.dtype == image.dtype
    np.testing.assert_array_equal(found, wide)


@pytest.mark.parametrize("image", [GREY, DEEP])
def test_a_fits_image_has_its_rows_as_they_are_stored(image: Image, tmp_path: Path) -> None:
    found = image_of(fits_of(image), "a.fits", tmp_path)
    np.testing.assert_array_equal(found, image)
    assert isinstance(found, np.ndarray)
    assert found.dtype == image.dtype


def test_signed_counts_of_a_fits_file_are_counts_where_none_is_below_zero(tmp_path: Path) -> None:
    signed = (DEEP // 2).astype(np.int16)
    found = image_of(fits_of(signed), "a.fits", tmp_path)
    assert isinstance(found, np.ndarray)
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, DEEP // 2)


@pytest.mark.parametrize(
    ("header", "bayer"),
    [
        ({}, None),
        ({"BAYERPAT": "RGGB"}, "RGGB"),
        ({"BAYERPAT": "gbrg "}, "GBRG"),
        ({"BAYERPAT": "RGGB", "XBAYROFF": 1}, "GRBG"),
        ({"BAYERPAT": "RGGB", "YBAYROFF": 1}, "GBRG"),
        ({"BAYERPAT": "RGGB", "XBAYROFF": 1, "YBAYROFF": 3}, "BGGR"),
        ({"BAYERPAT": "TRUE"}, None),
    ],
)
def test_the_mosaic_of_a_fits_file_is_that_of_its_header(header: dict[str, object], bayer: str | None) -> None:
    assert fits_bayer(fits_of(GREY, **header), "a.fits") == bayer


def test_three_planes_of_a_fits_file_are_red_green_blue(tmp_path: Path) -> None:
    planes = np.moveaxis(COLOURS[..., ::-1], -1, 0)
    np.testing.assert_array_equal(image_of(fits_of(planes), "a.fit", tmp_path), COLOURS)


def test_of_a_meteor_stations_fits_file_the_mean_is_taken(tmp_path: Path) -> None:
    file = io.BytesIO()
    layers = [fits.ImageHDU(GREY, name="MAXPIXEL"), fits.ImageHDU(GREY // 2, name="AVEPIXEL")]
    fits.HDUList([fits.PrimaryHDU(), *layers]).writeto(file)
    found = image_of(file.getvalue(), "FF_HR0001_20240101_120000_123_0000000.fits", tmp_path)
    np.testing.assert_array_equal(found, GREY // 2)


@pytest.mark.parametrize(
    ("content", "size", "code"),
    [
        (b"", SIZE, "file_not_image"),
        (b"SIMPLE  = nothing", SIZE, "file_not_image"),
        (fits_of(np.full(GREY.shape, np.nan, np.float32)), SIZE, "file_not_image"),
        (fits_of(np.zeros((4, 20, 24), np.uint8)), SIZE, "file_not_image"),
        (fits_of(GREY), (20, 24), "file_size_differs"),
        (fits_of(np.zeros((200, 240), np.uint8))[:9000], (240, 200), "file_truncated"),
    ],
)
def test_a_fits_file_that_cannot_be_used_gives_its_reason(
    content: bytes, size: tuple[int, int], code: str, tmp_path: Path
) -> None:
    assert code_of(content, "a.fits", tmp_path, size=size) == code


@pytest.mark.parametrize(
    ("header", "time", "exposure_us"),
    [
        ({"DATE-OBS": "2013-05-13T18:29:55", "EXPTIME": 10.0}, NOON, 1e7),
        ({"DATE-OBS": "2013-05-13T18:30:00.000"}, NOON, None),
        ({"DATE-OBS": "2013-05-13", "TIME-OBS": "18:30:00"}, NOON, None),
        ({"DATE-AVG": "2013-05-13T18:30:00", "DATE-OBS": "2013-05-13T18:00:00"}, NOON, None),
        ({"DATE-OBS": "2013-05-13T18:30:00", "TIMESYS": "TAI"}, None, None),
        ({"DATE-OBS": "yesterday"}, None, None),
        ({"JD": 2456426.25}, NOON - timedelta(minutes=30), None),
        ({"DATE": "2013-05-13", "UT": "18:30:00"}, NOON, None),
        ({"DATE-OBS": "2013-05-13", "UTC": "18:30:00.0"}, NOON, None),
        ({"DATE": "2013-05-13T18:30:00"}, None, None),
        ({"MJD": 56425.770833333336}, NOON, None),
        ({"DATE-OBS": "2013-05-13   18:30:00"}, NOON, None),
        ({"DATE-OBS": "2013-05-13T20:30:00+02:00"}, NOON, None),
        ({"DATE-OBS": "2013-05-13 18:30:00"}, NOON, None),
        ({"DATE_OBS": "2013-05-13T18:30:00"}, NOON, None),
        ({"MJD-OBS": 56425.770833333336}, NOON, None),
        ({"MJD-OBS": 0.0}, None, None),
        ({"DATE-OBS": "0001-01-01T00:00:00", "MJD-OBS": 56425.770833333336}, NOON, None),
        ({"DATE-AVG": "1900-01-01T00:00:00", "DATE-OBS": "2013-05-13T18:30:00"}, NOON, None),
        ({"DATE-BEG": "2013-05-13T18:29:30", "DATE-END": "2013-05-13T18:30:30"}, NOON, 6e7),
    ],
)
def test_the_time_of_a_fits_file_is_its_mid_exposure(
    header: dict[str, object], time: datetime | None, exposure_us: float | None, tmp_path: Path
) -> None:
    source = open_source(str(folder_of({"a.fits": fits_of(GREY, **header)}, tmp_path)))
    (frame,) = frames_in(source, "a.fits", sidecar=lambda: None)
    assert (frame.time, frame.exposure_us) == (time, exposure_us)


def netcdf_of(path: Path, images: NDArray[np.generic], units: str) -> bytes:
    with h5netcdf.File(path, "w") as file:
        file.dimensions = dict(zip(("time", "y", "x", "band"), images.shape, strict=False))
        times = file.create_variable("time", ("time",), data=np.arange(len(images), dtype=np.float64))
        times.attrs["units"] = units
        file.create_variable("sky", ("time", "y", "x", "band")[: images.ndim], data=images)
    return path.read_bytes()


@pytest.mark.parametrize(
    ("units", "step"),
    [
        ("seconds since 2013-05-13 18:30:00", timedelta(seconds=1)),
        ("minutes since 2013-05-13T18:30:00Z", timedelta(minutes=1)),
        ("hours since 2013-05-13 18:30:00 UTC", timedelta(hours=1)),
        ("seconds since 2013-05-13 18:30:00 0:00", timedelta(seconds=1)),
    ],
)
@pytest.mark.parametrize("where", ["zip", "folder"])
def test_frames_of_a_netcdf_file_have_the_times_of_its_coordinate(
    units: str, step: timedelta, where: str, tmp_path: Path
) -> None:
    images = np.stack([DEEP, DEEP + 1, DEEP + 2])
    content = netcdf_of(tmp_path / "made.nc", images, units)
    source = open_source(kept(where, {"a.nc": content}, tmp_path))
    frames = frames_in(source, "a.nc", sidecar=lambda: None)
    assert [frame.time for frame in frames] == [NOON, NOON + step, NOON + 2 * step]
    found = dict(images_in(source, "a.nc", [0, 2], size=SIZE))
    np.testing.assert_array_equal(found[2], images[2])
    assert sorted(found) == [0, 2]


def test_colours_of_a_netcdf_file_are_red_green_blue(tmp_path: Path) -> None:
    content = netcdf_of(tmp_path / "made.nc", COLOURS[None, ..., ::-1], "seconds since 2013-05-13")
    np.testing.assert_array_equal(image_of(content, "a.nc", tmp_path / "b"), COLOURS)


@pytest.mark.parametrize(
    "units", ["seconds", "fortnights since 2013-05-13", "seconds since yesterday", "days since 2013-13-13", ""]
)
def test_netcdf_times_that_mean_nothing_are_refused(units: str, tmp_path: Path) -> None:
    content = netcdf_of(tmp_path / "made.nc", GREY[None], units)
    source = open_source(str(folder_of({"a.nc": content}, tmp_path / "b")))
    with pytest.raises(FindingError) as refused:
        frames_in(source, "a.nc", sidecar=lambda: None)
    assert refused.value.finding.code == "file_time_units"


@pytest.mark.parametrize("content", [b"", b"CDF\x01" + bytes(40), b"\x89HDF\r\n\x1a\n" + bytes(40)])
def test_what_is_no_netcdf_file_gives_its_reason(content: bytes, tmp_path: Path) -> None:
    assert code_of(content, "a.nc", tmp_path) == "file_not_image"


def video_of(path: Path, n: int, *, fps: float) -> bytes:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, (96, 64))
    for number in range(n):
        writer.write(np.full((64, 96, 3), 20 * number, dtype=np.uint8))
    writer.release()
    return path.read_bytes()


@pytest.mark.parametrize("where", ["zip", "folder"])
def test_frames_of_a_video_are_those_that_were_asked_for(where: str, tmp_path: Path) -> None:
    content = video_of(tmp_path / "made.mp4", 6, fps=25.0)
    found = dict(images_in(open_source(kept(where, {"a.mp4": content}, tmp_path)), "a.mp4", [1, 4, 9], size=(96, 64)))
    assert [round(float(np.mean(found[n])) / 20) for n in (1, 4)] == [1, 4]  # type: ignore[arg-type]
    assert found[9] == Finding("file_truncated")


SIDECARS = {
    "start and interval": {"start_utc": "2013-05-13T18:30:00Z", "interval_s": 30},
    "every time": {"times_utc": [f"2013-05-13T18:3{n // 2}:{30 * (n % 2):02d}Z" for n in range(3)]},
}


@pytest.mark.parametrize("kind", SIDECARS)
def test_the_frame_times_of_a_time_lapse_are_those_of_its_sidecar(kind: str, tmp_path: Path) -> None:
    source = open_source(str(folder_of({"a.mp4": video_of(tmp_path / "made.mp4", 3, fps=25.0)}, tmp_path / "b")))
    frames = frames_in(source, "a.mp4", sidecar=lambda: json.dumps(SIDECARS[kind]).encode())
    assert [frame.time for frame in frames] == [NOON + timedelta(seconds=30 * n) for n in range(3)]


@pytest.mark.parametrize(
    ("sidecar", "code"),
    [
        (None, "file_video_times"),
        (b"{}", "file_sidecar"),
        (b'{"times_utc": ["2013-05-13T18:30:00Z"]}', "file_sidecar"),  # one time for three frames
        (b'{"start_utc": "2013-05-13T18:30:00", "interval_s": 30}', "file_sidecar"),  # no zone
    ],
)
def test_a_time_lapse_whose_times_nothing_tells_is_refused(sidecar: bytes | None, code: str, tmp_path: Path) -> None:
    source = open_source(str(folder_of({"a.mp4": video_of(tmp_path / "made.mp4", 3, fps=25.0)}, tmp_path / "b")))
    with pytest.raises(FindingError) as refused:
        frames_in(source, "a.mp4", sidecar=lambda: sidecar)
    assert refused.value.finding.code == code


def test_a_container_that_keeps_real_time_tells_the_times_itself(tmp_path: Path) -> None:
    content = bytearray(video_of(tmp_path / "made.mp4", 3, fps=0.5))
    begin = int((NOON - datetime(1904, 1, 1, tzinfo=UTC)).total_seconds())
    struct.pack_into(">I", content, content.index(b"mvhd") + 8, begin)
    source = open_source(str(folder_of({"a.mp4": bytes(content)}, tmp_path / "b")))
    frames = frames_in(source, "a.mp4", sidecar=lambda: None)
    assert [frame.time for frame in frames] == [NOON + timedelta(seconds=2 * n) for n in range(3)]


@pytest.mark.parametrize("content", [b"", b"no video", bytes(5000)])
def test_what_is_no_video_gives_its_reason(content: bytes, tmp_path: Path) -> None:
    assert code_of(content, "a.mp4", tmp_path) == "file_not_image"
