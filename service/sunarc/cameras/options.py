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
    """How a GigE Vision camera is reached and set up.

    Attributes
    ----------
    address : its IP address; names are refused, for they would be looked for by broadcast.
    packet_size : bytes per stream packet; None negotiates it with the camera.
    packet_socket : use a packet socket where the process may (CAP_NET_RAW); otherwise UDP with a large buffer.
    pixel_format : an unpacked single-channel GenICam format.
    region : x, y, width, height in px of the sensor; None is the whole sensor.
    gain_db : pinned gain; cameras with raw gain only keep theirs.
    timestamps : "host" dates frames by this machine's clock at the trigger; "camera" by the frame's own timestamp,
        where the camera's clock is disciplined to UTC and marks the start of the exposure.
    answer_timeout_s : how long after the exposure's end a frame may arrive.
    """

    address: str
    packet_size: int | None = None
    packet_socket: bool = True
    pixel_format: str = "Mono12"
    region: tuple[int, int, int, int] | None = None
    gain_db: float = 0.0
    timestamps: Literal["host", "camera"] = "host"
    answer_timeout_s: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what no camera could be opened with."""
        _require_address(self.address)
        full_scale_of(self.pixel_format)
        if self.timestamps not in {"host", "camera"}:
            raise InputError(
                field="timestamps", problem=f"{self.timestamps!r} is unknown", remedy="use 'host' or 'camera'"
            )
        if self.packet_size is not None:
            _require_within("packet_size", self.packet_size, 576, 65_000, "give bytes, at most the network's MTU")
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


def _require_within(field: str, value: float, low: float, high: float, remedy: str) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise InputError(field=field, problem=f"{value} is not within {low:g} to {high:g}", remedy=remedy)
