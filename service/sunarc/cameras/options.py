"""Settings of the cameras, with their bounds."""

from __future__ import annotations

import ipaddress
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sunarc.cameras.frame import full_scale_of
from sunarc.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class AravisOptions:
    """How a camera is reached and set up.

    Attributes
    ----------
    address : its IP address; names are refused, for they would be looked for by broadcast. With USB the device's id.
    transport : "gige"; or "usb3" for USB3 Vision, which no one has tried.
    packet_size : bytes per stream packet; None negotiates it with the camera.
    packet_socket : use a packet socket where the process may (CAP_NET_RAW); otherwise UDP with a large buffer.
    pixel_format : a single-channel GenICam format; those of 10 and 12 bits may be packed (Mono12p, Mono12Packed).
    binning : pixels that are joined in either direction by the camera.
    region : x, y, width, height in px after binning; None is the whole sensor.
    gain_db : pinned gain; cameras that know only raw steps are set to their lowest.
    black_level : pinned black level, in the camera's own unit; None keeps the camera's.
    timestamps : "host" dates frames by this machine's clock at the trigger; "camera" by the frame's own timestamp,
        where the camera's clock is disciplined (PTP) and marks the start of the exposure.
    timestamp_scale : "utc"; or "tai" where the camera's clock follows a PTP grandmaster without converting: TAI is
        37 s ahead of UTC.
    timestamp_offset_s : seconds added to the camera's timestamps, for a known constant offset.
    answer_timeout_s : how long after the exposure's end a frame may arrive.
    """

    address: str
    transport: Literal["gige", "usb3"] = "gige"
    packet_size: int | None = None
    packet_socket: bool = True
    pixel_format: str = "Mono12"
    binning: int = 1
    region: tuple[int, int, int, int] | None = None
    gain_db: float = 0.0
    black_level: float | None = None
    timestamps: Literal["host", "camera"] = "host"
    timestamp_scale: Literal["utc", "tai"] = "utc"
    timestamp_offset_s: float = 0.0
    answer_timeout_s: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what no camera could be opened with."""
        _require_one_of("transport", self.transport, ("gige", "usb3"))
        if self.transport == "gige":
            _require_address(self.address)
        elif not self.address.strip():
            raise InputError(field="address", problem="is empty", remedy="give the id that arv-tool-0.8 lists")
        full_scale_of(self.pixel_format)
        _require_one_of("timestamps", self.timestamps, ("host", "camera"))
        _require_one_of("timestamp_scale", self.timestamp_scale, ("utc", "tai"))
        _require_within("timestamp_offset_s", self.timestamp_offset_s, -3600.0, 3600.0, "give seconds")
        if self.packet_size is not None:
            _require_within("packet_size", self.packet_size, 576, 65_000, "give bytes, at most the network's MTU")
        _require_within("binning", self.binning, 1, 16, "give a whole number of pixels")
        _require_within("gain_db", self.gain_db, -20.0, 60.0, "give decibels")
        _require_within("answer_timeout_s", self.answer_timeout_s, 0.05, 60.0, "give seconds")
        if self.region is not None and (min(self.region[:2]) < 0 or min(self.region[2:]) < 1):
            raise InputError(
                field="region", problem=f"{self.region} is no rectangle", remedy="give x, y, width, height in px"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """Which images are played again.

    Attributes
    ----------
    folder : where they are, subfolders included.
    pixel_format : their format; None takes Mono8 or Mono16, by depth.
    exposure_us : exposure of images whose name does not tell it; None leaves those out.
    """

    folder: Path
    pixel_format: str | None = None
    exposure_us: float | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be played."""
        if self.pixel_format is not None:
            full_scale_of(self.pixel_format)
        if self.exposure_us is not None:
            _require_within("exposure_us", self.exposure_us, 0.01, 1e9, "give microseconds")


def _require_address(address: str) -> None:
    try:
        ipaddress.ip_address(address)
    except ValueError:
        raise InputError(
            field="address", problem=f"{address!r} is no IP address", remedy="give the camera's fixed address"
        ) from None


def _require_one_of(field: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        known = " or ".join(repr(choice) for choice in choices)
        raise InputError(field=field, problem=f"{value!r} is unknown", remedy=f"use {known}")


def _require_within(field: str, value: float, low: float, high: float, remedy: str) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise InputError(field=field, problem=f"{value} is not within {low:g} to {high:g}", remedy=remedy)
