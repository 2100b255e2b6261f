"""The interface of a camera: one exposure after the other."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Protocol, runtime_checkable

from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.imaging.exposure import ExposureBounds

_SINGLE_CHANNEL = re.compile(r"(?:Mono|Bayer(?:RG|BG|GR|GB))(?:(8|14|16)|(10|12)(?:p|Packed)?)")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One exposure.

    Attributes
    ----------
    image : (height, width) uint8 or uint16 counts, read-only.
    time : middle of the exposure, aware, UTC.
    exposure_us : as read back from the camera.
    gain_db : as read back from the camera.
    pixel_format : GenICam's name, as "Mono12" or "BayerRG8".
    full_scale : the largest count of that format.
    frame_id : the camera's own count.
    host_offset_s : `time` less the same moment by the host's clock, seconds; None where the host's clock dated it.
    binning : pixels of the sensor that each of these is the mean of, in either direction.
    raised_db : by how much `gain_db` was raised for this exposure over the one of the settings.
    """

    image: Image
    time: datetime
    exposure_us: float
    gain_db: float
    pixel_format: str
    full_scale: int
    frame_id: int
    host_offset_s: float | None = None
    binning: int = 1
    raised_db: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraInfo:
    """Record of an open camera.

    Attributes
    ----------
    address : where it was found.
    vendor, model, serial : as the camera says, empty where it says nothing.
    width, height : px of the frames that it delivers (its region of interest).
    pixel_format, full_scale : as in `Frame`.
    exposure_min_us, exposure_max_us : bounds of what may be asked for.
    exposure_step_us : increment of the exposure; 0 where the camera does not state it.
    gain_raise_db : by how much the gain can be raised over that of the settings; 0 where it cannot be set in decibels.
    packet_bytes, packet_bytes_lost : size of stream packets where it is not the one that was set or negotiated, and
        that one, with which no frame came whole.
    """

    address: str
    vendor: str
    model: str
    serial: str
    width: int
    height: int
    pixel_format: str
    full_scale: int
    exposure_min_us: float
    exposure_max_us: float
    exposure_step_us: float
    gain_raise_db: float = 0.0
    packet_bytes: int | None = None
    packet_bytes_lost: int | None = None

    @property
    def exposure_bounds(self) -> ExposureBounds:
        """Bounds and step of the exposure."""
        return ExposureBounds(
            minimum_us=self.exposure_min_us, maximum_us=self.exposure_max_us, step_us=self.exposure_step_us
        )

    def unreachable(self, exposures_us: Sequence[float]) -> str | None:
        """Return the exposures that the camera cannot take, as one sentence; None where it can take all."""
        beyond = [e for e in exposures_us if not self.exposure_min_us <= e <= self.exposure_max_us]
        if not beyond:
            return None
        listed = ", ".join(f"{e:.8g}" for e in beyond)
        return f"{listed} µs is beyond the camera's {self.exposure_min_us:.8g} to {self.exposure_max_us:.8g} µs"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCondition:
    """The state that a camera reports.

    Attributes
    ----------
    temperature_c : the camera's own, degrees Celsius; None where it cannot be read.
    speed : seconds of its clock in a real second, by a simulated camera; None: a real one.
    """

    temperature_c: float | None = None
    speed: float | None = None


class SkyCamera(Protocol):
    """A camera that takes one exposure after the other; used from one thread at a time."""

    @property
    def info(self) -> CameraInfo:
        """Record of the camera."""

    def expose(self, exposure_us: float) -> Frame:
        """Expose once, within the camera's bounds, and return the frame.

        Raises
        ------
        CameraTimeoutError
            No frame came in time.
        CameraLostError
            The connection is gone: close, wait, open anew.
        CameraError
            A frame came that cannot be trusted.
        """

    def distrust(self) -> None:
        """Treat the last frames as wrong: the next exposure begins with acquisition stopped and the stream emptied."""

    def check(self) -> CameraCondition:
        """Return whether every pinned setting is as it was set, and the camera's condition.

        Raises
        ------
        CameraLostError
            It does not answer, or a setting was changed: it was restarted, or someone else set it. Frames taken since
            the last check are in doubt; open it anew.
        """

    def close(self) -> None:
        """Release the camera; harmless when done twice."""


@runtime_checkable
class GainCamera(SkyCamera, Protocol):
    """A camera whose gain can be raised for a while."""

    def raise_gain(self, by_db: float) -> None:
        """Raise the gain for the next exposures, at most by `info.gain_raise_db`, and read it back.

        Raises
        ------
        CameraError
            The camera has another gain than was set.
        """

    def restore_gain(self) -> None:
        """Set the gain of the settings and read it back; CameraError where it is another one."""


def largest_count(pixel_format: str, *, field: str = "pixel_format") -> int:
    """Return the largest count of a single-channel pixel format (GenICam's names); `field` names it in the error."""
    match = _SINGLE_CHANNEL.fullmatch(pixel_format)
    if match is None:
        raise InputError(
            field=field,
            problem=f"{pixel_format!r} is not a single-channel format that can be decoded",
            remedy="use Mono8, Mono10, Mono12, Mono14, Mono16, Mono10p, Mono12p, Mono10Packed, Mono12Packed, or a "
            "Bayer format of the same depths",
        )
    return int(2 ** int(match.group(1) or match.group(2)) - 1)


def exposure_middle(start: datetime, exposure_us: float) -> datetime:
    """Return the middle of an exposure that began at `start`."""
    return start + timedelta(microseconds=exposure_us / 2.0)
