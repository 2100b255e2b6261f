"""As much of Aravis as the adapter touches, with answers that a test can choose."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

WIDTH, HEIGHT = 6, 4


class GLibError(Exception):
    """Stands for GLib.Error."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.message = message
        self.code = code

    def matches(self, quark: object, code: int) -> bool:
        return quark == "device" and self.code == code


class DeviceError(IntEnum):
    FEATURE_NOT_FOUND = 1
    NOT_CONNECTED = 2
    TIMEOUT = 5
    NOT_FOUND = 6
    NOT_CONTROLLER = 10


class BufferStatus(Enum):
    SUCCESS = "success"
    TIMEOUT = "timeout"
    MISSING_PACKETS = "missing-packets"
    ABORTED = "aborted"

    @property
    def value_nick(self) -> str:
        return self.value


@dataclass
class Buffer:
    frame_id: int = 0
    status: BufferStatus = BufferStatus.SUCCESS
    data: bytes = bytes(range(2 * WIDTH * HEIGHT))
    size: tuple[int, int] = (WIDTH, HEIGHT)
    timestamp_ns: int = 1_368_469_800_123_456_789

    def get_status(self) -> BufferStatus:
        return self.status

    def get_image_width(self) -> int:
        return self.size[0]

    def get_image_height(self) -> int:
        return self.size[1]

    def get_image_data(self) -> bytes:
        return self.data

    def get_frame_id(self) -> int:
        return self.frame_id

    def get_timestamp(self) -> int:
        return self.timestamp_ns


@dataclass
class Stream:
    """Gives what `answers` holds after a trigger, and `late` what lies in the queue before one."""

    answers: deque[Buffer | None] = field(default_factory=deque)
    late: deque[Buffer] = field(default_factory=deque)
    pushed: int = 0
    waits_us: list[int] = field(default_factory=list)

    def push_buffer(self, _buffer: object) -> None:
        self.pushed += 1

    def try_pop_buffer(self) -> Buffer | None:
        return self.late.popleft() if self.late else None

    def timeout_pop_buffer(self, wait_us: int) -> Buffer | None:
        self.waits_us.append(wait_us)
        return self.answers.popleft() if self.answers else None

    def set_property(self, _name: str, _value: object) -> None: ...


@dataclass
class Device:
    controller: bool = True
    handlers: dict[int, Callable[..., None]] = field(default_factory=dict)

    def connect(self, _signal: str, handler: Callable[..., None]) -> int:
        self.handlers[1] = handler
        return 1

    def disconnect(self, number: int) -> None:
        del self.handlers[number]

    def is_controller(self) -> bool:
        return self.controller


class Camera:
    """A camera with a few features; every call is recorded."""

    def __init__(self) -> None:
        self.device = Device()
        self.stream = Stream()
        self.calls: list[tuple[object, ...]] = []
        self.exposure_us = 0.0
        self.features = {"ExposureAuto", "GainAuto", "Gain", "GammaEnable", "DeviceSerialNumber"}
        self.fails: dict[str, GLibError] = {}

    def library(self) -> tuple[Any, Any]:
        return library(self)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        answers: dict[str, Any] = {
            "get_device": self.device,
            "is_gv_device": True,
            "create_stream": self.stream,
            "dup_available_pixel_formats_as_strings": ["Mono8", "Mono12"],
            "get_pixel_format_as_string": "Mono12",
            "get_sensor_size": (WIDTH, HEIGHT),
            "get_region": (0, 0, WIDTH, HEIGHT),
            "get_exposure_time_bounds": (10.0, 1e6),
            "get_gain_bounds": (0.0, 24.0),
            "get_gain": 3.0,
            "get_vendor_name": "Vendor",
            "get_model_name": None,
            "get_string": "77",
            "get_payload": 2 * WIDTH * HEIGHT,
        }

        def call(*arguments: Any) -> Any:  # noqa: ANN401 - a stub of an untyped library
            self.calls.append((name, *arguments))
            if name in self.fails:
                raise self.fails[name]
            if name == "is_feature_available":
                return arguments[0] in self.features
            if name == "set_exposure_time":
                self.exposure_us = float(np.floor(arguments[0]))
            return self.exposure_us if name == "get_exposure_time" else answers.get(name)

        return call


@pytest.fixture
def stub() -> SimpleNamespace:
    """Return the parts of a stubbed library."""
    return SimpleNamespace(
        Camera=Camera, Buffer=Buffer, BufferStatus=BufferStatus, GLibError=GLibError, library=library
    )


def library(camera: Camera) -> tuple[Any, Any]:
    """Return what the adapter takes for Aravis and GLib."""
    aravis = SimpleNamespace(
        Camera=SimpleNamespace(new=lambda _address: camera),
        Buffer=SimpleNamespace(new_allocate=lambda _size: Buffer()),
        BufferStatus=BufferStatus,
        DeviceError=DeviceError,
        GvStreamOption=SimpleNamespace(PACKET_SOCKET_DISABLED="udp"),
        GvStreamSocketBuffer=SimpleNamespace(FIXED="fixed"),
        device_error_quark=lambda: "device",
    )
    return aravis, SimpleNamespace(Error=GLibError)
