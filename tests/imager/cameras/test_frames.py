"""Frames as they come, exposures as they are asked for, timestamps, and the way of the packets."""

from __future__ import annotations

import threading
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sunarc.common.errors import CameraError, CameraTimeoutError, InputError
from sunarc.imager.cameras.aravis import (
    ExposureControl,
    NotedExposure,
    decode_frame,
    event_setter,
    exposure_control,
    follows,
    incomplete,
    require_exposure,
    wait_for_last_reference,
)
from sunarc.imager.cameras.features import Link, buffer_limit, route_mtu
from sunarc.imager.cameras.frame import CameraInfo, exposure_middle, largest_count
from sunarc.imager.cameras.options import AravisOptions, timestamp_to_utc
from sunarc.imager.cameras.packed import pack
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imaging.exposure import ExposureBounds


def info(pixel_format: str, *, width: int = 6, height: int = 4) -> CameraInfo:
    return CameraInfo(
        address="192.0.2.7", vendor="v", model="m", serial="s", width=width, height=height, pixel_format=pixel_format,
        full_scale=largest_count(pixel_format), exposure_min_us=10.0, exposure_max_us=1e6, exposure_step_us=1.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("previous", "now", "next_in_turn"),
    [
        (1, 2, True),
        (1, 3, False),
        (2, 1, False),
        (5, 5, False),
        (65_535, 1, True),
        (65_535, 65_536, True),
        (65_534, 1, False),
        (65_535, 2, False),
    ],
)
def test_frame_counts_follow_one_another(previous: int, now: int, *, next_in_turn: bool) -> None:
    assert follows(previous, now) == next_in_turn


@pytest.mark.parametrize(
    ("noted", "asked", "refused"),
    [
        (20.0, 20.0, False),
        (21.0, 20.0, False),
        (21.1, 20.0, True),
        (1009.0, 1000.0, False),
        (1011.0, 1000.0, True),
        (990.0, 1000.0, False),
        (float("nan"), 20.0, True),
    ],
)
def test_a_noted_exposure_is_within_a_microsecond_or_a_hundredth(noted: float, asked: float, *, refused: bool) -> None:
    if refused:
        with pytest.raises(CameraError):
            require_exposure(noted, asked)
    else:
        require_exposure(noted, asked)


@pytest.mark.parametrize("pixel_format", ["Mono8", "Mono12", "BayerRG16"])
def test_a_frames_bytes_are_its_counts(pixel_format: str) -> None:
    depth = np.uint8 if pixel_format == "Mono8" else np.uint16
    counts = np.arange(24).reshape(4, 6).astype(depth)
    found = decode_frame(counts.tobytes() + b"trailer", info(pixel_format))
    assert found.dtype == depth
    assert (found == counts).all()
    assert not found.flags.writeable


@pytest.mark.parametrize(("pixel_format", "packing"), [("Mono12p", "12p"), ("Mono10Packed", "10Packed")])
def test_a_packed_frame_is_unpacked_and_cannot_be_written(pixel_format: str, packing: str) -> None:
    counts = np.arange(24, dtype=np.uint16).reshape(4, 6) * 40
    found = decode_frame(pack(counts, packing), info(pixel_format))
    assert (found == counts).all()
    assert not found.flags.writeable


@pytest.mark.parametrize(("pixel_format", "needed"), [("Mono8", 24), ("Mono12", 48), ("Mono12p", 36), ("Mono10p", 30)])
def test_a_frame_that_was_cut_short_is_refused(pixel_format: str, needed: int) -> None:
    assert decode_frame(bytes(needed), info(pixel_format)).shape == (4, 6)
    with pytest.raises(CameraError):
        decode_frame(bytes(needed - 1), info(pixel_format))


@pytest.mark.parametrize(("status", "lost"), [("timeout", True), ("missing-packets", True), ("wrong-packet-id", False)])
def test_a_buffer_without_all_its_packets_is_a_timeout(status: str, *, lost: bool) -> None:
    assert isinstance(incomplete(status), CameraTimeoutError) == lost


@pytest.mark.parametrize(
    "pixel_format", ["RGB8", "Mono9", "Mono12pp", "mono8", "BayerXX8", "Mono8Packed", "", "Mono1p"]
)
def test_a_format_that_is_not_one_channel_has_no_full_scale(pixel_format: str) -> None:
    with pytest.raises(InputError) as error:
        largest_count(pixel_format, field="camera.pixel_format")
    assert error.value.field == "camera.pixel_format"


def test_the_middle_of_an_exposure_is_half_of_it_later() -> None:
    start = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
    assert (exposure_middle(start, 48_000.0) - start).total_seconds() == 0.024


@pytest.mark.parametrize(
    ("scale", "offset_s", "seconds"), [("utc", 0.0, 0.0), ("tai", 0.0, -37.0), ("tai", 37.0, 0.0), ("utc", -0.5, -0.5)]
)
def test_a_timestamp_is_utc_by_its_scale_and_offset(scale: Any, offset_s: float, seconds: float) -> None:  # noqa: ANN401 - a word
    options = AravisOptions(address="192.0.2.7", timestamp_scale=scale, timestamp_offset_s=offset_s)
    at = datetime(2026, 11, 22, 5, 0, 0, 250_000, tzinfo=UTC)
    found = timestamp_to_utc(round(at.timestamp() * 1e6) * 1000 + 999, options)
    assert (found - at).total_seconds() == pytest.approx(seconds)


def control(**changes: Any) -> ExposureControl:  # noqa: ANN401 - the control's fields
    values: dict[str, Any] = {
        "feature": "ExposureTime",
        "kind": "float",
        "unit_us": 1.0,
        "bounds": ExposureBounds(minimum_us=12.0, maximum_us=1000.0, step_us=5.0),
    }
    return ExposureControl(**(values | changes))


@pytest.mark.parametrize(
    ("asked", "step", "taken"),
    [
        (1.0, 5.0, 12.0),
        (13.0, 5.0, 12.0),
        (15.0, 5.0, 17.0),
        (999.0, 5.0, 997.0),
        (2000.0, 5.0, 997.0),
        (500.3, 0.0, 500.3),
        (0.0, 0.0, 12.0),
    ],
)
def test_an_exposure_is_the_nearest_step_within_the_bounds(asked: float, step: float, taken: float) -> None:
    bounds = ExposureBounds(minimum_us=12.0, maximum_us=1000.0, step_us=step)
    assert bounds.nearest(asked) == pytest.approx(taken)


class Features:
    """A camera object of a library, as far as exposures go."""

    def __init__(self, values: dict[str, float], *, floats: bool = True, increment: float = 1.0) -> None:
        self.values = values
        self.floats = floats
        self.increment = increment

    def is_feature_available(self, name: str) -> bool:
        return name in self.values

    def get_float(self, name: str) -> float:
        return self.values[name]

    def get_float_bounds(self, name: str) -> tuple[float, float]:
        if not self.floats:
            raise TypeError(name)
        return 10.0, 5000.0

    def get_integer_bounds(self, name: str) -> tuple[int, int]:
        assert name in self.values
        return 2, 5000

    def get_float_increment(self, _: str) -> float:
        return self.increment

    get_integer_increment = get_float_increment


@pytest.mark.parametrize("name", ["ExposureTime", "ExposureTimeAbs"])
def test_a_float_exposure_is_set_in_microseconds(name: str) -> None:
    found = exposure_control(Features({name: 100.0}))
    assert (found.feature, found.kind, found.unit_us) == (name, "float", 1.0)
    assert (found.bounds.minimum_us, found.bounds.maximum_us, found.bounds.step_us) == (10.0, 5000.0, 1.0)


def test_a_raw_exposure_has_its_own_unit() -> None:
    found = exposure_control(Features({"ExposureTimeRaw": 3.0, "ExposureTimeBaseAbs": 20.0}, floats=False))
    assert (found.kind, found.unit_us) == ("integer", 20.0)
    assert (found.bounds.minimum_us, found.bounds.maximum_us, found.bounds.step_us) == (40.0, 100_000.0, 20.0)


@pytest.mark.parametrize(("increment", "step"), [(0.5, 0.5), (0.0, 0.0), (float("nan"), 0.0), (1e-9, 0.0), (1e7, 0.0)])
def test_an_increment_that_is_none_is_not_used(increment: float, step: float) -> None:
    assert exposure_control(Features({"ExposureTime": 1.0}, increment=increment)).bounds.step_us == step


def test_a_camera_without_an_exposure_is_refused() -> None:
    with pytest.raises(CameraError):
        exposure_control(Features({"Gain": 1.0}))


class ParserError(Exception):
    """The library's."""


def noted(*, chunks: bool, value: float | None) -> NotedExposure:
    def parsed(buffer: object, name: str) -> float:
        assert (buffer, name) == ("buffer", "ChunkExposureTime")
        if value is None:
            raise ParserError
        return value

    camera = SimpleNamespace(
        are_chunks_available=lambda: chunks,
        set_chunks=lambda _: None,
        create_chunk_parser=lambda: SimpleNamespace(get_float_value=parsed),
        get_float=lambda _: 77.0,
    )
    return NotedExposure(camera, control(), error=ParserError)


def test_a_frame_that_notes_its_exposure_is_believed() -> None:
    exposure = noted(chunks=True, value=48.0)
    assert exposure.from_frame
    assert exposure.of("buffer") == 48.0


@pytest.mark.parametrize("chunks", [True, False])
def test_without_readable_chunks_the_register_is_read_from_then_on(*, chunks: bool) -> None:
    exposure = noted(chunks=chunks, value=None)
    assert [exposure.of("buffer"), exposure.of("buffer")] == [77.0, 77.0]
    assert not exposure.from_frame


def link(**changes: Any) -> Link:  # noqa: ANN401 - a link's fields
    values: dict[str, Any] = {
        "packet_bytes": 1500,
        "frame_bytes": 4_000_000,
        "mtu": 1500,
        "packet_socket": False,
        "buffer_limit_bytes": 8_000_000,
    }
    return Link(**(values | changes))


@pytest.mark.parametrize(
    ("changes", "count"),
    [
        ({}, 0),
        ({"packet_bytes": 1501}, 1),
        ({"packet_bytes": 9000, "mtu": None}, 0),
        ({"buffer_limit_bytes": 7_999_999}, 1),
        ({"buffer_limit_bytes": 1, "packet_socket": True}, 0),
        ({"packet_bytes": 9000, "buffer_limit_bytes": 1}, 2),
    ],
)
def test_what_will_lose_packets_is_named(changes: dict[str, Any], count: int) -> None:
    assert len(link(**changes).complaints) == count


def test_the_buffer_that_is_advised_holds_two_frames() -> None:
    advised = link(frame_bytes=20_000_000, buffer_limit_bytes=1).complaints[0]
    assert f"rmem_max={1 << 26}" in advised  # the power of two above 40 MB
    assert f"rmem_max={32 << 20}" in link(buffer_limit_bytes=1).complaints[0]


def test_the_kernel_is_asked_without_a_packet() -> None:
    assert (route_mtu("127.0.0.1") or 0) >= 1500
    assert route_mtu("not an address") is None
    assert buffer_limit() >= 4096


@pytest.mark.parametrize(("references", "alone"), [(1, True), (2, False)])
def test_the_last_reference_is_waited_for_half_a_second(references: int, *, alone: bool) -> None:
    clock = VirtualClock(datetime(2013, 5, 13, tzinfo=UTC))
    before = clock.monotonic()
    device = SimpleNamespace(__grefcount__=references)
    assert wait_for_last_reference(device, clock) == alone
    assert clock.monotonic() - before == pytest.approx(0.0 if alone else 0.5)


def test_a_signal_sets_the_event_whatever_it_carries() -> None:
    event = threading.Event()
    event_setter(event)("camera", 1, None)
    assert event.is_set()
