"""Aravis's fake GigE Vision camera, driven by ctypes: its frames are ours to fill.

The introspected binding frees the fill callback as soon as it is set, so that the first frame would crash; plain
ctypes keeps it. Nothing of Python's `gi` is needed here.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.common.errors import ConfigurationError, OutsideError

_log = logging.getLogger(__name__)

GVCP_PORT = 3956
_TRIGGER_POLLS_PER_S = 100.0
_FILL = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)


class Request(NamedTuple):
    """The settings of a frame, by the registers."""

    exposure_us: int
    gain_steps: int
    pixel_format: int
    region: tuple[int, int, int, int]


class FakeCamera:
    """A running fake camera; made by `fake_camera`.

    Parameters
    ----------
    library : libaravis.
    handle : the GigE Vision side.
    """

    def __init__(self, library: ctypes.CDLL, handle: int) -> None:
        self._library = library
        self._handle = handle
        self._camera = library.arv_gv_fake_camera_get_fake_camera(handle)
        self._callback: object = None
        self._lock = threading.Lock()
        self._closed = False

    def read(self, address: int) -> int:
        """Return the register at an address."""
        value = ctypes.c_uint32()
        self._library.arv_fake_camera_read_register(self._camera, address, ctypes.byref(value))
        return value.value

    def write(self, address: int, value: int) -> None:
        """Set the register at an address."""
        self._library.arv_fake_camera_write_register(self._camera, address, value)

    def write_text(self, address: int, text: str, *, length: int) -> None:
        """Set a string register."""
        data = text.encode("ascii", "replace")[: length - 1].ljust(length, b"\0")
        self._library.arv_fake_camera_write_memory(self._camera, address, length, data)

    def request(self) -> Request:
        """Return the settings of a frame that is triggered now."""
        return Request(self.read(EXPOSURE), self.read(GAIN), self.read(PIXEL_FORMAT), self._read_region())

    def _read_region(self) -> tuple[int, int, int, int]:
        """Return x, y, width and height."""
        x, y, width, height = map(self.read, (OFFSET_X, OFFSET_Y, WIDTH, HEIGHT))
        return x, y, width, height

    def lose_packets(self, share: float) -> None:
        """Drop this share of the stream's packets from now on."""
        self._library.g_object_set(
            ctypes.c_void_p(self._handle), b"gvsp-lost-ratio", ctypes.c_double(share), ctypes.c_void_p(None)
        )

    def fill_with(self, fill: Callable[[Request], tuple[NDArray[np.uint8], int]]) -> None:
        """Have every frame filled: `fill` returns its bytes and its timestamp in nanoseconds.

        It is called in the thread that also answers the control channel: within 500 ms, or clients ask again. What it
        raises is logged, and the frame is left as it is.
        """

        def answer_while_open(buffer: int, _: object, exposure_us: int, gain_steps: int, pixel_format: int) -> None:
            with self._lock:
                if not self._closed:
                    render_into_buffer(buffer, exposure_us, gain_steps, pixel_format)

        def render_into_buffer(buffer: int, exposure_us: int, gain_steps: int, pixel_format: int) -> None:
            try:
                request = Request(exposure_us, gain_steps, pixel_format, self._read_region())
                self._write_frame(buffer, *fill(request))
            except Exception:  # noqa: BLE001 - nothing may pass through the C frames above
                _log.exception("a frame could not be rendered")

        self._callback = _FILL(answer_while_open)  # kept for as long as the library may call it
        self._library.arv_fake_camera_set_fill_pattern(self._camera, self._callback, None, None)

    def close(self) -> None:
        """Let a frame that is being filled be the last one.

        A call that held the camera while it is let go would end it in its own thread, which then waits for itself.
        """
        with self._lock:
            self._closed = True

    def _write_frame(self, buffer: int, image: NDArray[np.uint8], timestamp_ns: int) -> None:
        # the library has compared the buffer with what the registers say; a larger image would end the process
        bits = self.read(PIXEL_FORMAT) >> 16 & 0xFF
        expected = self.read(WIDTH) * self.read(HEIGHT) * bits // 8
        if image.nbytes < expected or image.nbytes > expected + 1:
            raise ValueError(f"a frame of {image.nbytes} bytes where {expected} are due")
        target = self._library.arv_buffer_get_data(buffer, ctypes.byref(ctypes.c_size_t()))
        ctypes.memmove(target, image.ctypes.data, expected)
        self._library.arv_buffer_set_timestamp(buffer, timestamp_ns)


@contextlib.contextmanager
def fake_camera(*, address: str, serial: str, description: str) -> Iterator[FakeCamera]:
    """Run a fake GigE Vision camera at an address of this machine, described by GenICam XML.

    Raises
    ------
    ConfigurationError
        Aravis is not installed.
    OutsideError
        The port is taken, or no interface has the address.
    """
    library = _load_aravis()
    _require_free_port(address)
    with TemporaryDirectory(prefix="sunarc-imager-") as folder:
        path = Path(folder) / "xml"
        path.write_text(description, encoding="utf-8")
        handle = library.arv_gv_fake_camera_new_full(address.encode(), serial.encode(), str(path).encode())
        try:
            if not handle or not library.arv_gv_fake_camera_is_running(handle):
                raise OutsideError(
                    f"the simulated imager does not start: no network interface has {address}; "
                    f"use 127.0.0.1, or run: ip address add {address}/8 dev lo"
                )
            camera = FakeCamera(library, handle)
            library.arv_fake_camera_set_trigger_frequency(camera._camera, _TRIGGER_POLLS_PER_S)  # noqa: SLF001 - its maker
            try:
                yield camera
            finally:
                camera.close()
        finally:
            if handle:
                library.g_object_unref(handle)


def _require_free_port(address: str) -> None:
    """Bind the control port for a moment: the library only logs when it cannot."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, GVCP_PORT))
        except OSError as error:
            raise OutsideError(
                f"UDP port {GVCP_PORT} at {address} cannot be used ({error.strerror}); "
                "is another simulated imager running?"
            ) from None


def _load_aravis() -> ctypes.CDLL:
    try:
        library = ctypes.CDLL("libaravis-0.8.so.0")
    except OSError:
        raise ConfigurationError(
            "the simulated imager needs Aravis; run: apt-get install python3-gi gir1.2-aravis-0.8"
        ) from None
    pointer, text, number, size = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_uint32, ctypes.c_size_t
    signatures: dict[str, tuple[object, list[object]]] = {
        "arv_gv_fake_camera_new_full": (pointer, [text, text, text]),
        "arv_gv_fake_camera_is_running": (ctypes.c_int, [pointer]),
        "arv_gv_fake_camera_get_fake_camera": (pointer, [pointer]),
        "arv_fake_camera_read_register": (ctypes.c_int, [pointer, number, ctypes.POINTER(number)]),
        "arv_fake_camera_write_register": (ctypes.c_int, [pointer, number, number]),
        "arv_fake_camera_write_memory": (ctypes.c_int, [pointer, number, number, text]),
        "arv_fake_camera_set_trigger_frequency": (None, [pointer, ctypes.c_double]),
        "arv_fake_camera_set_fill_pattern": (None, [pointer, _FILL, pointer, pointer]),
        "arv_buffer_get_data": (pointer, [pointer, ctypes.POINTER(size)]),
        "arv_buffer_set_timestamp": (None, [pointer, ctypes.c_uint64]),
        "g_object_unref": (None, [pointer]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


WIDTH, HEIGHT, GAIN, SENSOR_HEIGHT, SENSOR_WIDTH = 0x100, 0x104, 0x110, 0x118, 0x11C
EXPOSURE, PIXEL_FORMAT, OFFSET_X, OFFSET_Y = 0x120, 0x128, 0x130, 0x134
VENDOR, MODEL, SERIAL = 0x48, 0x68, 0xD8
BINNING_X, BINNING_Y, ACQUISITION, TRIGGER_MODE, TRIGGER_SOURCE = 0x108, 0x10C, 0x124, 0x300, 0x304
TRIGGER_SOFTWARE, EXPOSE = 0x30C, 0xB140
"""Registers that have Aravis send a frame at once; and one of ours, after which the exposure takes its time first."""
CONTROL_PRIVILEGE, PACKET_SIZE = 0xA00, 0xD04
TEMPERATURE, DELAY, LOSS, FREEZE, WRONG_EXPOSURE = 0xB000, 0xB100, 0xB104, 0xB108, 0xB10C
STALE_EXPOSURE, POWER_CYCLE, DROP_CONTROL, CLOCK_DRIFT = 0xB110, 0xB114, 0xB118, 0xB11C
ALL_EXPOSURES, SPEED = 0xB120, 0xB124
REPEAT_FRAME, BLACK, CLOCK_OFFSET = 0xB130, 0xB134, 0xB138
FOREIGN_PACKETS, BAD_AFTER_START = 0xB150, 0xB154
EXPOSURE_AUTO, GAIN_AUTO, BLACK_LEVEL, GAMMA, FRAME_RATE, EXPOSURE_MODE = 0xB200, 0xB204, 0xB208, 0xB20C, 0xB210, 0xB214

PIXEL_FORMATS = {
    "Mono8": 0x01080001,
    "Mono10": 0x01100003,
    "Mono12": 0x01100005,
    "Mono16": 0x01100007,
    "BayerRG8": 0x01080009,
    "BayerRG10": 0x0110000D,
    "BayerRG12": 0x01100011,
    "BayerRG16": 0x0110002F,
    "Mono10Packed": 0x010C0004,
    "Mono12Packed": 0x010C0006,
    "Mono10p": 0x010A0046,
    "Mono12p": 0x010C0047,
}
GAIN_STEPS_PER_DB = 10
TEMPERATURE_STEPS_PER_DEGREE = 10

_HEADER = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="SimulatedSky" VendorName="sunarc" StandardNameSpace="None" SchemaMajorVersion="1"
 SchemaMinorVersion="0" SchemaSubMinorVersion="1" MajorVersion="1" MinorVersion="0" SubMinorVersion="0"
 ToolTip="Simulated all-sky imager" ProductGuid="0" VersionGuid="0"
 xmlns="http://www.genicam.org/GenApi/Version_1_0">"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """A feature and its nodes in XML."""

    name: str
    category: str
    nodes: str


def genicam_xml(*, exposure_min_us: int, exposure_max_us: int, trigger: int = TRIGGER_SOFTWARE) -> str:
    """Return the description of a camera with these exposure bounds; `trigger` is the register of its trigger."""
    acquisition = _make_acquisition_features(exposure_min_us, exposure_max_us, trigger=trigger)
    features = [*_make_identity_features(), *_make_image_features(), *acquisition, *_make_fault_features()]
    categories: dict[str, list[str]] = {}
    for feature in features:
        categories.setdefault(feature.category, []).append(feature.name)
    parts = [_HEADER, _format_category("Root", list(categories))]
    parts += [_format_category(name, members) for name, members in categories.items()]
    parts += [feature.nodes for feature in features]
    return "\n".join([*parts, '<Port Name="Device"/>', "</RegisterDescription>", ""])


def _make_identity_features() -> list[Feature]:
    temperature = _format_scaled("DeviceTemperature", TEMPERATURE, steps=TEMPERATURE_STEPS_PER_DEGREE, low=-99, high=99)
    return [
        _make_string("DeviceVendorName", VENDOR, 32),
        _make_string("DeviceModelName", MODEL, 32),
        _make_string("DeviceSerialNumber", SERIAL, 16),
        Feature(name="DeviceTemperature", category="DeviceControl", nodes=temperature),
    ]


def _make_image_features() -> list[Feature]:
    category = "ImageFormatControl"
    payload = (
        '<IntSwissKnife Name="PayloadSize"><pVariable Name="W">Width</pVariable><pVariable Name="H">Height</pVariable>'
        '<pVariable Name="F">PixelFormat</pVariable><Formula>W * H * ((F&gt;&gt;16)&amp;0xFF) / 8</Formula>'
        "</IntSwissKnife>"
    )
    return [
        _make_integer("SensorWidth", SENSOR_WIDTH, category),
        _make_integer("SensorHeight", SENSOR_HEIGHT, category),
        _make_integer("BinningHorizontal", BINNING_X, category, "<Min>1</Min><Max>4</Max>"),
        _make_integer("BinningVertical", BINNING_Y, category, "<Min>1</Min><Max>4</Max>"),
        _make_quotient("WidthMax", "SensorWidth", "BinningHorizontal", category),
        _make_quotient("HeightMax", "SensorHeight", "BinningVertical", category),
        _make_integer("Width", WIDTH, category, "<Min>1</Min><pMax>WidthMax</pMax>"),
        _make_integer("Height", HEIGHT, category, "<Min>1</Min><pMax>HeightMax</pMax>"),
        _make_integer("OffsetX", OFFSET_X, category, "<Min>0</Min><pMax>WidthMax</pMax>"),
        _make_integer("OffsetY", OFFSET_Y, category, "<Min>0</Min><pMax>HeightMax</pMax>"),
        _make_enumeration("PixelFormat", PIXEL_FORMAT, category, PIXEL_FORMATS),
        Feature(name="PayloadSize", category="TransportLayerControl", nodes=payload),
    ]


def _make_acquisition_features(exposure_min_us: int, exposure_max_us: int, *, trigger: int) -> list[Feature]:
    category = "AcquisitionControl"
    exposure = _format_scaled("ExposureTime", EXPOSURE, steps=1, low=exposure_min_us, high=exposure_max_us)
    selector = (
        '<Enumeration Name="TriggerSelector"><EnumEntry Name="FrameStart"><Value>0</Value></EnumEntry>'
        "<pValue>TriggerSelectorValue</pValue></Enumeration>"
        '<Integer Name="TriggerSelectorValue"><Value>0</Value></Integer>'
    )
    return [
        _make_enumeration("AcquisitionMode", 0x12C, category, {"Continuous": 1, "SingleFrame": 2, "MultiFrame": 3}),
        _make_command("AcquisitionStart", ACQUISITION, category, 1),
        _make_command("AcquisitionStop", ACQUISITION, category, 0),
        Feature(name="TriggerSelector", category=category, nodes=selector),
        _make_enumeration("TriggerMode", TRIGGER_MODE, category, {"Off": 0, "On": 1}),
        _make_enumeration("TriggerSource", TRIGGER_SOURCE, category, {"Line0": 0, "Software": 1}),
        _make_enumeration("TriggerActivation", 0x308, category, {"RisingEdge": 0}),
        _make_command("TriggerSoftware", trigger, category, 1),
        Feature(name="ExposureTime", category=category, nodes=exposure),
        _make_enumeration("ExposureMode", EXPOSURE_MODE, category, {"Timed": 0, "TriggerWidth": 1}),
        _make_enumeration("ExposureAuto", EXPOSURE_AUTO, category, {"Off": 0, "Continuous": 1}),
        _make_boolean("AcquisitionFrameRateEnable", FRAME_RATE, category),
        Feature(
            name="Gain",
            category="AnalogControl",
            nodes=_format_scaled("Gain", GAIN, steps=GAIN_STEPS_PER_DB, low=0, high=24),
        ),
        _make_enumeration("GainAuto", GAIN_AUTO, "AnalogControl", {"Off": 0, "Continuous": 1}),
        _make_integer("BlackLevelRaw", BLACK_LEVEL, "AnalogControl", "<Min>0</Min><Max>255</Max>"),
        _make_boolean("GammaEnable", GAMMA, "AnalogControl"),
    ]


def _make_fault_features() -> list[Feature]:
    category = "SimulationControl"
    return [
        _make_integer("SimDelayMs", DELAY, category),
        _make_integer("SimLossPermille", LOSS, category, "<Min>0</Min><Max>1000</Max>"),
        _make_integer("SimFreezeMs", FREEZE, category),
        _make_integer("SimWrongExposurePercent", WRONG_EXPOSURE, category),
        _make_integer("SimAllExposuresPercent", ALL_EXPOSURES, category),
        _make_integer("SimStaleExposure", STALE_EXPOSURE, category, "<Min>0</Min><Max>1</Max>"),
        _make_integer("SimPowerCycle", POWER_CYCLE, category, "<Min>0</Min><Max>1</Max>"),
        _make_integer("SimDropControl", DROP_CONTROL, category, "<Min>0</Min><Max>1</Max>"),
        _make_integer("SimClockDriftPpm", CLOCK_DRIFT, category),
        _make_integer("SimRepeatFrame", REPEAT_FRAME, category, "<Min>0</Min><Max>1</Max>"),
        _make_integer("SimBlack", BLACK, category, "<Min>0</Min><Max>1</Max>"),
        _make_integer("SimClockOffsetMs", CLOCK_OFFSET, category),
        _make_integer("SimForeignPackets", FOREIGN_PACKETS, category),
        _make_integer("SimBadAfterStart", BAD_AFTER_START, category),
        _make_integer("SimSpeedPermille", SPEED, category, "<Min>1</Min>"),
    ]


def _format_category(name: str, members: list[str]) -> str:
    return f'<Category Name="{name}">' + "".join(f"<pFeature>{m}</pFeature>" for m in members) + "</Category>"


def _format_register(name: str, address: int, access: str = "RW") -> str:
    return (
        f'<IntReg Name="{name}Register"><Address>{address:#x}</Address><Length>4</Length><AccessMode>{access}'
        "</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>"
    )


def _make_integer(name: str, address: int, category: str, bounds: str = "") -> Feature:
    nodes = f'<Integer Name="{name}"><pValue>{name}Register</pValue>{bounds}</Integer>{_format_register(name, address)}'
    return Feature(name=name, category=category, nodes=nodes)


def _make_boolean(name: str, address: int, category: str) -> Feature:
    nodes = f'<Boolean Name="{name}"><pValue>{name}Register</pValue></Boolean>{_format_register(name, address)}'
    return Feature(name=name, category=category, nodes=nodes)


def _make_quotient(name: str, over: str, under: str, category: str) -> Feature:
    nodes = (
        f'<IntSwissKnife Name="{name}"><pVariable Name="A">{over}</pVariable><pVariable Name="B">{under}</pVariable>'
        "<Formula>A / B</Formula></IntSwissKnife>"
    )
    return Feature(name=name, category=category, nodes=nodes)


def _format_scaled(name: str, address: int, *, steps: int, low: int, high: int) -> str:
    """Return a float feature kept as an integer number of steps per unit."""
    return (
        f'<Float Name="{name}"><pValue>{name}Converter</pValue><Min>{low}</Min><Max>{high}</Max>'
        f"<Inc>{1 / steps:g}</Inc></Float>"
        f'<Converter Name="{name}Converter"><FormulaTo>FROM * {steps}</FormulaTo>'
        f"<FormulaFrom>TO / {steps}.0</FormulaFrom><pValue>{name}Register</pValue></Converter>"
        f"{_format_register(name, address)}"
    )


def _make_enumeration(name: str, address: int, category: str, entries: dict[str, int]) -> Feature:
    listed = "".join(f'<EnumEntry Name="{n}"><Value>{v}</Value></EnumEntry>' for n, v in entries.items())
    nodes = f'<Enumeration Name="{name}">{listed}<pValue>{name}Register</pValue></Enumeration>'
    return Feature(name=name, category=category, nodes=nodes + _format_register(name, address))


def _make_command(name: str, address: int, category: str, value: int) -> Feature:
    nodes = f'<Command Name="{name}"><pValue>{name}Register</pValue><CommandValue>{value}</CommandValue></Command>'
    return Feature(name=name, category=category, nodes=nodes + _format_register(name, address, "WO"))


def _make_string(name: str, address: int, length: int) -> Feature:
    nodes = (
        f'<StringReg Name="{name}"><Address>{address:#x}</Address><Length>{length}</Length>'
        "<AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>"
    )
    return Feature(name=name, category="DeviceControl", nodes=nodes)
