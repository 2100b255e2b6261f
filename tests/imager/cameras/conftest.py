"""As much of Aravis as the adapter touches, with answers that a test can choose."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from functools import partial
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
    """Gives what `answers` holds after a trigger, and `late` what lies in the queue before one.

    The first triggers after each start are answered by `first`.
    """

    first: deque[Buffer | None] = field(default_factory=lambda: deque(Buffer() for _ in range(3)))
    answers: deque[Buffer | None] = field(default_factory=deque)
    late: deque[Buffer] = field(default_factory=deque)
    pushed: int = 0
    waits_us: list[int] = field(default_factory=list)
    starts: int = 0
    loses: int = 0

    def start(self) -> None:
        if self.starts or self.loses:
            lost = BufferStatus.MISSING_PACKETS
            self.first = deque(Buffer(status=lost if n < self.loses else BufferStatus.SUCCESS) for n in range(3))
        self.starts += 1

    def push_buffer(self, _buffer: object) -> None:
        self.pushed += 1

    def try_pop_buffer(self) -> Buffer | None:
        return self.late.popleft() if self.late else None

    def timeout_pop_buffer(self, wait_us: int) -> Buffer | None:
        if self.first:
            return self.first.popleft()
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

    def __init__(self, **features: object) -> None:
        self.device = Device()
        self.stream = Stream()
        self.calls: list[tuple[object, ...]] = []
        self.features: dict[str, Any] = {
            "ExposureTime": 3000.0,
            "ExposureAuto": "Continuous",
            "GainAuto": "Continuous",
            "Gain": 3.0,
            "GammaEnable": True,
            "DeviceSerialNumber": "77",
            "DeviceTemperature": 41.5,
            "TriggerMode": "On",
            "TriggerSource": "Software",
        } | features
        self.bounds = {"ExposureTime": (10.0, 1e6), "Gain": (0.0, 24.0)}
        self.steps = {"ExposureTime": 1.0}
        self.chunks = False
        self.noted_us: float | GLibError | None = None
        self.fails: dict[str, GLibError] = {}
        self.locked: dict[str, Callable[[dict[str, Any]], bool]] = {}
        self.unreadable: set[str] = set()
        self.pixel_format = "Mono12"
        self.packet_size = 1400

    def library(self) -> tuple[Any, Any]:
        return library(self)

    def feature(self, name: str, kind: str) -> Any:  # noqa: ANN401 - a stub of an untyped library
        value = self.features[name]
        if name in self.unreadable:
            raise GLibError(f"{name} cannot be read now", 17)
        if type(value).__name__ != {"string": "str", "boolean": "bool", "integer": "int"}.get(kind, kind):
            raise GLibError(f"{name} is no {kind}", 3)
        return value

    def feature_bounds(self, name: str, kind: str) -> tuple[float, float]:
        self.feature(name, kind)
        return self.bounds[name]

    def set_feature(self, name: str, value: object) -> None:
        if name in self.locked and self.locked[name](self.features):
            raise GLibError(f"{name} is locked", 17)
        self.features[name] = float(np.floor(value)) if name == "ExposureTime" else value  # type: ignore[call-overload]

    def noted_exposure(self, *_: object) -> float | None:
        if isinstance(self.noted_us, Exception):
            raise self.noted_us
        return self.noted_us

    def __getattr__(self, name: str) -> Callable[..., Any]:
        answers: dict[str, Callable[..., Any]] = {
            "get_device": lambda: self.device,
            "is_gv_device": lambda: True,
            "start_acquisition": self.stream.start,
            "create_stream": lambda *_: self.stream,
            "dup_available_pixel_formats_as_strings": lambda: ["Mono8", "Mono12", "Mono12Packed", "BayerRG8"],
            "get_pixel_format_as_string": lambda: self.pixel_format,
            "set_pixel_format_from_string": partial(setattr, self, "pixel_format"),
            "set_trigger": lambda source: self.features.update(TriggerMode="On", TriggerSource=source),
            "clear_triggers": lambda: self.features.update(TriggerMode="Off"),
            "get_sensor_size": lambda: (WIDTH, HEIGHT),
            "get_region": lambda: (0, 0, WIDTH, HEIGHT),
            "get_vendor_name": lambda: "Vendor",
            "get_model_name": lambda: None,
            "get_payload": lambda: 2 * WIDTH * HEIGHT,
            "gv_get_packet_size": lambda: self.packet_size,
            "gv_set_packet_size": partial(setattr, self, "packet_size"),
            "is_feature_available": self.features.__contains__,
            "is_enumeration_entry_available": lambda *_: True,
            "are_chunks_available": lambda: self.chunks,
            "create_chunk_parser": lambda: SimpleNamespace(get_float_value=self.noted_exposure),
        }
        for kind in ("string", "boolean", "float", "integer"):
            answers[f"get_{kind}"] = partial(self.feature, kind=kind)
            answers[f"set_{kind}"] = self.set_feature
            answers[f"get_{kind}_bounds"] = partial(self.feature_bounds, kind=kind)
            answers[f"get_{kind}_increment"] = self.steps.__getitem__

        def call(*arguments: Any) -> Any:  # noqa: ANN401 - a stub of an untyped library
            self.calls.append((name, *arguments))
            if name in self.fails:
                raise self.fails[name]
            answer = answers.get(name)
            return None if answer is None else answer(*arguments)

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
        disable_interface=lambda _name: None,
        device_error_quark=lambda: "device",
    )
    return aravis, SimpleNamespace(Error=GLibError)
