"""A folder played again: in order, with its own times and exposures, and with what cannot be used named."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest

from sunarc.common.errors import CameraLostError, InputError
from sunarc.imager.cameras.frame import SkyCamera
from sunarc.imager.cameras.options import ReplayOptions
from sunarc.imager.cameras.replay import open_replay, parse_name_time
from sunarc.sources.image_times import parse_name_exposure


def write(folder: Path, name: str, level: int = 7, shape: tuple[int, ...] = (4, 6), depth: type = np.uint8) -> None:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full(shape, level, dtype=depth))


def test_images_come_in_order_of_time_with_their_exposures(tmp_path: Path) -> None:
    write(tmp_path, "b/20130513T173030.500Z_48000us.png", 3, depth=np.uint16)
    write(tmp_path, "z_20130513T173000Z_12.5us.tiff", 1, depth=np.uint16)
    write(tmp_path, "a/cam1_20130513T173000.250Z_3000us.png", 2, depth=np.uint16)
    camera: SkyCamera = open_replay(ReplayOptions(folder=tmp_path))
    frames = [camera.expose(10.0) for _ in range(3)]
    assert [int(frame.image[0, 0]) for frame in frames] == [1, 2, 3]
    assert [frame.exposure_us for frame in frames] == [12.5, 3000.0, 48_000.0]
    assert frames[1].time == datetime(2013, 5, 13, 17, 30, 0, 250_000, tzinfo=UTC)
    assert [frame.frame_id for frame in frames] == [1, 2, 3]
    assert frames[0].full_scale == camera.info.full_scale == 65_535
    assert (camera.info.width, camera.info.height) == (6, 4)
    assert (camera.info.exposure_min_us, camera.info.exposure_max_us) == (12.5, 48_000.0)
    assert not frames[0].image.flags.writeable
    with pytest.raises(CameraLostError):
        camera.expose(10.0)


def test_what_cannot_be_played_is_left_out_with_its_reason(tmp_path: Path) -> None:
    write(tmp_path, "20130513T170000Z_10us.png")
    write(tmp_path, "20130513T170030Z_10us.png", shape=(5, 6))
    write(tmp_path, "20130513T170100Z_10us.png", shape=(4, 6, 3))
    write(tmp_path, "20130513T170130Z.png")
    write(tmp_path, "20139913T170130Z_10us.png")
    (tmp_path / "20130513T170200Z_10us.png").write_bytes(b"")
    (tmp_path / "20130513T170230Z_10us.jpg").write_bytes(b"\xff\xd8\xff\xe0 cut short")
    huge = struct.pack(">IIBBBBB", 200_000, 200_000, 8, 0, 0, 0, 0)
    parts = [(b"IHDR", huge), (b"IDAT", zlib.compress(bytes(100))), (b"IEND", b"")]
    (tmp_path / "20130513T170245Z_10us.png").write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + b"".join(
            struct.pack(">I", len(one)) + kind + one + struct.pack(">I", zlib.crc32(kind + one)) for kind, one in parts
        )
    )
    (tmp_path / "notes.txt").write_text("no image")
    write(tmp_path, "20130513T170300Z_10us.png", 9)
    camera = open_replay(ReplayOptions(folder=tmp_path))
    assert [int(camera.expose(10.0).image[0, 0]) for _ in range(2)] == [7, 9]
    assert Counter(skipped.reason for skipped in camera.skipped) == {
        "another size than the first one": 1,
        "not a single channel of 8 or 16 bits": 1,
        "no exposure in its name": 1,
        "no time in its name": 1,
        "not readable": 3,
    }


def test_an_exposure_can_be_given_for_images_that_do_not_say(tmp_path: Path) -> None:
    write(tmp_path, "20130513T170130Z.png")
    camera = open_replay(ReplayOptions(folder=tmp_path, exposure_us=25.0))
    assert camera.expose(10.0).exposure_us == 25.0


def test_twelve_bits_in_sixteen_are_taken_as_told(tmp_path: Path) -> None:
    write(tmp_path, "20130513T170130Z_10us.png", 4000, depth=np.uint16)
    write(tmp_path, "20130513T170230Z_10us.png")
    camera = open_replay(ReplayOptions(folder=tmp_path, pixel_format="Mono12"))
    assert camera.expose(10.0).full_scale == 4095
    assert [skipped.reason for skipped in camera.skipped] == ["not of depth Mono12"]


def test_a_folder_with_nothing_to_play_says_why(tmp_path: Path) -> None:
    (tmp_path / "20130513T170200Z_10us.png").write_bytes(b"")
    with pytest.raises(InputError, check=lambda error: error.field == "folder"):
        open_replay(ReplayOptions(folder=tmp_path))
    with pytest.raises(InputError, check=lambda error: error.field == "folder"):
        open_replay(ReplayOptions(folder=tmp_path / "absent"))


def test_a_closed_replay_gives_nothing(tmp_path: Path) -> None:
    write(tmp_path, "20130513T170130Z_10us.png")
    camera = open_replay(ReplayOptions(folder=tmp_path))
    camera.close()
    with pytest.raises(CameraLostError):
        camera.expose(10.0)


@pytest.mark.parametrize(
    ("name", "time"),
    [
        ("20240229T235959.999999Z.png", datetime(2024, 2, 29, 23, 59, 59, 999_999, tzinfo=UTC)),
        ("site-20240229T000000Z_5us.png", datetime(2024, 2, 29, tzinfo=UTC)),
        ("20230229T000000Z.png", None),
        ("20240229T000000.png", None),
    ],
)
def test_times_are_read_from_names(name: str, time: datetime | None) -> None:
    assert parse_name_time(name) == time


@pytest.mark.parametrize(
    ("name", "exposure_us"), [("a_48000us.png", 48_000.0), ("a_2.5us_x.png", 2.5), ("48us.png", None)]
)
def test_exposures_are_read_from_names(name: str, exposure_us: float | None) -> None:
    assert parse_name_exposure(name) == exposure_us
