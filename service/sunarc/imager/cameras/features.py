"""Configuration of a GenICam camera, and the check that it is still configured so.

Features go by the names of the SFNC (EMVA, "GenICam Standard Features Naming Convention"), then by those that vendors
use instead. Everything here takes the library's camera object as it is (untyped): only `cameras.aravis` knows the
library.
"""

from __future__ import annotations

import contextlib
import logging
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from sunarc.common.errors import CameraError, ConfigurationError, InputError
from sunarc.imager.cameras.frame import largest_count
from sunarc.imager.cameras.options import AravisOptions

_log = logging.getLogger(__name__)

Kind = Literal["string", "boolean", "float", "integer"]
Value: TypeAlias = str | bool | float | int

GAIN = ("Gain", "GainRaw", "GainAbs")
BLACK_LEVEL = ("BlackLevel", "BlackLevelRaw")
TEMPERATURE = "DeviceTemperature"
SIMULATED_SPEED = "SimSpeedPermille"
"""Of the simulated imager alone: seconds of its clock in 1000 real seconds."""
_GAIN_STEP_DB, _SAME_GAIN_DB = 1.0, 0.01
"""Steps that cameras round a gain to, and the least that tells two gains apart."""
_SERIAL = ("DeviceSerialNumber", "DeviceID", "DeviceSerialNumberText")
_BINNING = ("BinningHorizontal", "BinningVertical")
_REQUIRED: tuple[tuple[str, str], ...] = (
    ("ExposureMode", "Timed"),
    ("ExposureAuto", "Off"),
    ("GainAuto", "Off"),
    ("AcquisitionMode", "Continuous"),
)
"""Without these a frame does not have the exposure that was set."""
_CHOICES: tuple[tuple[str, str], ...] = (
    ("GainSelector", "All"),
    ("BlackLevelSelector", "All"),
    ("BalanceWhiteAuto", "Off"),
    ("BlackLevelAuto", "Off"),
    ("AcquisitionFrameRateAuto", "Off"),
    ("AcquisitionFrameRateMode", "Off"),
    ("BinningHorizontalMode", "Average"),
    ("BinningVerticalMode", "Average"),
    ("TestPattern", "Off"),
    ("TestImageSelector", "Off"),
    ("SharpeningMode", "Off"),
    ("SharpnessAuto", "Off"),
)
_GAMMA_SWITCHES = ("GammaEnable", "GammaEnabled")
_SWITCHED_OFF = (
    *_GAMMA_SWITCHES,
    "AcquisitionFrameRateEnable",
    "AcquisitionFrameRateEnabled",
    "ReverseX",
    "ReverseY",
    "LUTEnable",
    "SharpeningEnable",
    "SharpnessEnable",
)
_AS_THEY_ARE: tuple[tuple[str, Kind], ...] = (
    ("PixelFormat", "string"),
    ("Width", "integer"),
    ("Height", "integer"),
    ("OffsetX", "integer"),
    ("OffsetY", "integer"),
    ("TriggerMode", "string"),
    ("TriggerSource", "string"),
)
_NEUTRAL_UNKNOWN = ("Sharpness", "SharpnessEnhancement", "BslSharpnessEnhancement", "SharpeningFactor")
"""Their neutral value differs from maker to maker: kept as they are, and compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pin:
    """A feature and the value that it has to keep."""

    name: str
    kind: Kind
    value: Value


def pin_settings(camera: Any, options: AravisOptions) -> tuple[Pin, ...]:  # noqa: ANN401 - a GObject has no types
    """Switch everything automatic off, set format, region and gain (before a stream is made); return the settings.

    A feature that already has its value is not written. An optional one that refuses is kept as it is; its value is
    returned like the others, so that a later change of it is noticed.

    Raises
    ------
    ConfigurationError
        The camera lacks the pixel format, or the region does not fit.
    """
    _stop_acquisition(camera)
    pins = [
        *_write_required(camera),
        *_write_preferred(camera),
        *_switch_off_processing(camera),
        *_set_binning(camera, options.binning),
    ]
    _set_pixel_format(camera, options.pixel_format)
    _set_region(camera, options.region)
    pins += _set_levels(camera, options)
    camera.set_trigger("Software")  # after everything that deals with the frame rate, which would undo it
    pins += [read_pin(camera, name) for name in _NEUTRAL_UNKNOWN if has(camera, name)]
    return (*pins, *(_read_as_pin(camera, name, kind) for name, kind in _AS_THEY_ARE if has(camera, name)))


def changed_pins(camera: Any, pins: tuple[Pin, ...]) -> Iterator[str]:  # noqa: ANN401 - a GObject has no types
    """Yield the features of a camera that changed since they were set, one sentence each."""
    for pin in pins:
        value = read(camera, pin.name, pin.kind)
        close = isinstance(value, float) and abs(value - float(pin.value)) <= 1e-3 * max(1.0, abs(value))
        if value != pin.value and not close:
            yield f"{pin.name} is {value}, not {pin.value}"


def has(camera: Any, name: str) -> bool:  # noqa: ANN401 - a GObject has no types
    """Return whether a camera offers a feature now."""
    return bool(camera.is_feature_available(name))


def first(camera: Any, names: tuple[str, ...]) -> str | None:  # noqa: ANN401 - a GObject has no types
    """Return the first of the names that a camera has."""
    return next((name for name in names if has(camera, name)), None)


def read_pin(camera: Any, name: str) -> Pin:  # noqa: ANN401 - a GObject has no types
    """Return a feature with the value that it has, of whichever kind it is."""
    kinds: tuple[Kind, ...] = ("float", "integer", "boolean", "string")
    for kind in kinds[:-1]:
        with contextlib.suppress(Exception):  # asked as another kind than it is, a feature is refused
            return _read_as_pin(camera, name, kind)
    return _read_as_pin(camera, name, "string")


def read(camera: Any, name: str, kind: Kind) -> Value:  # noqa: ANN401 - a GObject has no types
    """Return the value of a feature as read from the camera."""
    value: Value = getattr(camera, f"get_{kind}")(name)
    return value


def write(camera: Any, name: str, kind: Kind, value: Value) -> Pin:  # noqa: ANN401 - a GObject has no types
    """Write a feature and return the camera's value of it."""
    getattr(camera, f"set_{kind}")(name, value)
    return _read_as_pin(camera, name, kind)


def write_if_other(camera: Any, name: str, kind: Kind, value: Value) -> Pin:  # noqa: ANN401 - as above
    """Write a feature that has another value, and return the camera's value of it.

    Many features are locked while others have a certain value: one that need not be written is not.
    """
    present = _read_as_pin(camera, name, kind)
    if present.value == value:
        return present
    _log.info("setting %s from %s to %s", name, present.value, value)
    return write(camera, name, kind, value)


def write_or_keep(camera: Any, name: str, kind: Kind, value: Value) -> Pin:  # noqa: ANN401 - as above
    """Set an optional feature; where the camera refuses, keep the value that it has."""
    with contextlib.suppress(Exception):  # read-only, or locked; a lost camera fails again at the reading
        return write_if_other(camera, name, kind, value)
    present = _read_as_pin(camera, name, kind)
    _log.warning("the camera refuses %s = %s and keeps %s; frames are taken with that", name, value, present.value)
    return present


def read_serial(camera: Any) -> str:  # noqa: ANN401 - a GObject has no types
    """Return the serial number, empty where the camera does not state it."""
    name = first(camera, _SERIAL)
    return "" if name is None else str(camera.get_string(name))


def temperature_c(camera: Any) -> float | None:  # noqa: ANN401 - a GObject has no types
    """Return the camera's own temperature in degrees Celsius, None where it cannot be read."""
    with contextlib.suppress(Exception):  # some sensors are busy or asleep; a lost camera fails at its next command
        return float(camera.get_float(TEMPERATURE)) if has(camera, TEMPERATURE) else None
    return None


def simulated_speed(camera: Any) -> float:  # noqa: ANN401 - a GObject has no types
    """Return the seconds of a simulated camera's clock in a real second."""
    return float(camera.get_integer(SIMULATED_SPEED)) / 1000.0


def gain_db(pins: tuple[Pin, ...]) -> float:
    """Return the pinned gain in decibels, 0 where the camera has only a raw one."""
    return next((float(pin.value) for pin in pins if pin.name == "Gain" and pin.kind == "float"), 0.0)


def gain_raise_db(camera: Any, pins: tuple[Pin, ...]) -> float:  # noqa: ANN401 - a GObject has no types
    """Return by how many decibels the pinned gain can be raised; 0 where the camera has only a raw one, or none."""
    if not any(pin.name == "Gain" and pin.kind == "float" for pin in pins):
        return 0.0
    return max(float(camera.get_float_bounds("Gain")[1]) - gain_db(pins), 0.0)


def raise_gain_by(
    camera: Any,  # noqa: ANN401 - a GObject has no types
    pins: tuple[Pin, ...],
    from_db: float,
    *,
    by_db: float,
) -> tuple[Pin, ...]:
    """Set the gain, and return the settings that have to hold from now on.

    Raises
    ------
    CameraError
        The camera has another gain than was set.
    """
    pin = write(camera, "Gain", "float", from_db + by_db)
    read_db = float(pin.value)
    if abs(read_db - from_db - by_db) > _GAIN_STEP_DB or (by_db == 0.0 and abs(read_db - from_db) > _SAME_GAIN_DB):
        raise CameraError(f"Gain is {read_db:g} dB, not {from_db + by_db:g}")
    return tuple(pin if one.name == "Gain" else one for one in pins)


def _read_as_pin(camera: Any, name: str, kind: Kind) -> Pin:  # noqa: ANN401 - a GObject has no types
    return Pin(name=name, kind=kind, value=read(camera, name, kind))


def _stop_acquisition(camera: Any) -> None:  # noqa: ANN401 - a GObject has no types
    """Leave the state of an earlier run: acquisition and triggers lock other features, also after a kill."""
    for command in (camera.stop_acquisition, camera.clear_triggers):
        try:
            command()
        except Exception as error:  # noqa: BLE001 - refused where there is nothing to stop; a lost camera fails next
            _log.debug("stopping the camera: %s", error)


def _write_required(camera: Any) -> Iterator[Pin]:  # noqa: ANN401 - a GObject has no types
    for name, choice in _REQUIRED:
        if _offers_choice(camera, name, choice):
            yield write_if_other(camera, name, "string", choice)


def _write_preferred(camera: Any) -> Iterator[Pin]:  # noqa: ANN401 - a GObject has no types
    for name, choice in _CHOICES:
        if _offers_choice(camera, name, choice):
            yield write_or_keep(camera, name, "string", choice)


def _offers_choice(camera: Any, name: str, choice: str) -> bool:  # noqa: ANN401 - a GObject has no types
    return has(camera, name) and bool(camera.is_enumeration_entry_available(name, choice))


def _switch_off_processing(camera: Any) -> Iterator[Pin]:  # noqa: ANN401 - a GObject has no types
    for name in _SWITCHED_OFF:
        if has(camera, name):
            yield write_or_keep(camera, name, "boolean", value=False)
    if first(camera, _GAMMA_SWITCHES) is None and has(camera, "Gamma"):
        yield write_or_keep(camera, "Gamma", "float", 1.0)
    if has(camera, "DigitalShift"):
        yield write_or_keep(camera, "DigitalShift", "integer", 0)


def _set_binning(camera: Any, binning: int) -> Iterator[Pin]:  # noqa: ANN401 - a GObject has no types
    for name in _BINNING:
        if has(camera, name):
            pin = write_or_keep(camera, name, "integer", binning)
            if pin.value != binning:
                raise ConfigurationError(f"the camera does not bin by {binning}: {name} stays {pin.value}")
            yield pin
        elif binning != 1:
            raise ConfigurationError(f"the camera cannot bin: it has no {name}; set camera.binning = 1")


def _set_pixel_format(camera: Any, pixel_format: str) -> None:  # noqa: ANN401 - a GObject has no types
    offered = [str(name) for name in camera.dup_available_pixel_formats_as_strings()]
    if pixel_format not in offered:
        usable = [name for name in offered if is_usable(name)]
        raise InputError(
            field="camera.pixel_format",
            problem=f"the camera has no pixel format {pixel_format}; it offers {', '.join(offered)}",
            remedy=f"set one of {', '.join(usable)}"
            if usable
            else "none of these is a single-channel format that can be decoded",
        )
    if str(camera.get_pixel_format_as_string()) != pixel_format:
        camera.set_pixel_format_from_string(pixel_format)


def is_usable(pixel_format: str) -> bool:
    """Return whether a format is a single-channel one that can be decoded."""
    try:
        largest_count(pixel_format)
    except InputError:
        return False
    return True


def _set_region(camera: Any, region: tuple[int, int, int, int] | None) -> None:  # noqa: ANN401 - a GObject has no types
    widest, highest = _largest_region(camera)
    x, y, width, height = region or (0, 0, widest, highest)
    if x + width > widest or y + height > highest:
        raise InputError(
            field="camera.region",
            problem=f"{region} does not fit the sensor of {widest}×{highest} px",
            remedy="give x, y, width, height within it (in px after binning)",
        )
    camera.set_region(0, 0, width, height)  # a smaller region first: an offset may be refused beside a full width
    camera.set_region(x, y, width, height)


def _largest_region(camera: Any) -> tuple[int, int]:  # noqa: ANN401 - a GObject has no types
    """Return the largest width and height, px after binning."""
    if has(camera, "WidthMax") and has(camera, "HeightMax"):
        return int(camera.get_integer("WidthMax")), int(camera.get_integer("HeightMax"))
    width, height = camera.get_sensor_size()
    return int(width), int(height)


def _set_levels(camera: Any, options: AravisOptions) -> Iterator[Pin]:  # noqa: ANN401 - a GObject has no types
    """Pin gain and black level: decibels where the camera supports them, otherwise its lowest gain."""
    for names, requested in ((GAIN, options.gain_db), (BLACK_LEVEL, options.black_level)):
        name = first(camera, names)
        if name is None:
            continue
        present = read_pin(camera, name)
        is_float = present.kind == "float"
        low, high = camera.get_float_bounds(name) if is_float else camera.get_integer_bounds(name)
        if names is GAIN and name != "Gain":
            requested = float(low)  # noqa: PLW2901 - raw steps are not decibels
        if requested is None:
            yield present
        else:
            value = min(max(requested, low), high)
            yield write_or_keep(camera, name, present.kind, value if is_float else round(value))


PREFERRED_BUFFER_BYTES = 32 << 20
PASSED_EVERYWHERE_BYTES = 1500
"""Ethernet's MTU without jumbo frames (IEEE 802.3, 3.2.7)."""

_IP_MTU = 14  # linux/in.h
_CAP_NET_RAW = 13  # linux/capability.h
_MORE_THAN_ANY_BYTES = 1 << 30
_SELF = Path("/proc/self/status")


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """Reception of a stream.

    Attributes
    ----------
    packet_bytes : of a stream packet, IP and UDP headers included.
    frame_bytes : of one frame.
    mtu : of the route to the camera, bytes; None where the kernel does not state it.
    packet_socket : a ring that the kernel fills without a socket's buffer (needs CAP_NET_RAW).
    buffer_limit_bytes : `net.core.rmem_max`, up to which the kernel grants a UDP socket's buffer.
    """

    packet_bytes: int
    frame_bytes: int
    mtu: int | None
    packet_socket: bool
    buffer_limit_bytes: int

    @property
    def text(self) -> str:
        """The chosen settings and their reason, for one line of the log."""
        way = (
            "a packet socket (CAP_NET_RAW)"
            if self.packet_socket
            else f"UDP with a socket buffer of up to {_format_mb(self.buffer_limit_bytes)}"
        )
        route = "" if self.mtu is None else f" (the route takes {self.mtu})"
        return f"packets of {self.packet_bytes} bytes{route}, frames of {_format_mb(self.frame_bytes)} through {way}"

    @property
    def complaints(self) -> tuple[str, ...]:
        """Causes of lost packets, each with its remedy."""
        complaints = []
        if self.mtu is not None and self.packet_bytes > self.mtu:
            complaints.append(
                f"packets of {self.packet_bytes} bytes do not fit the network's MTU of {self.mtu}; set "
                f"camera.packet_size = {self.mtu - self.mtu % 4}, or a larger MTU all the way from the camera"
            )
        limit = self.buffer_limit_bytes
        if not self.packet_socket and limit < 2 * self.frame_bytes:
            preferred = max(PREFERRED_BUFFER_BYTES, 1 << (2 * self.frame_bytes - 1).bit_length())
            complaints.append(
                f"a socket may buffer {_format_mb(limit)} and a frame has "
                f"{_format_mb(self.frame_bytes)}: packets are lost when the "
                f"host is busy; run: sysctl -w net.core.rmem_max={preferred}, or give the service CAP_NET_RAW"
            )
        return tuple(complaints)


def link_to(address: str, *, packet_bytes: int, frame_bytes: int, packet_socket: bool) -> Link:
    """Return how a stream from an address will be received; `packet_socket`: whether to use one."""
    return Link(
        packet_bytes=packet_bytes,
        frame_bytes=frame_bytes,
        mtu=route_mtu(address),
        packet_socket=packet_socket and may_open_packet_sockets(),
        buffer_limit_bytes=buffer_limit(),
    )


def route_mtu(address: str) -> int | None:
    """Return the MTU of the route to an address, by the kernel's routing table; nothing is sent."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((address, 9))
        return probe.getsockopt(socket.IPPROTO_IP, _IP_MTU)
    return None


def may_open_packet_sockets() -> bool:
    """Return whether this process has CAP_NET_RAW."""
    with contextlib.suppress(OSError):
        for line in _SELF.read_text(encoding="ascii").splitlines():
            if line.startswith("CapEff:"):
                return bool(int(line.split()[1], 16) >> _CAP_NET_RAW & 1)
    return False


def buffer_limit() -> int:
    """Return the largest receive buffer that the kernel grants a socket, bytes: `net.core.rmem_max`.

    A socket of our own is asked, for the unit hides the file that has it; the kernel answers with twice the number.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _MORE_THAN_ANY_BYTES)
        return probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def _format_mb(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:.3g} MB"
