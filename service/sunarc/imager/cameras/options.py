"""Settings of the cameras, with their bounds."""

from __future__ import annotations

import ipaddress
import urllib.parse
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from sunarc.common.bounds import require_bounds
from sunarc.common.errors import InputError
from sunarc.common.utc import EPOCH
from sunarc.imager.cameras.frame import largest_count
from sunarc.sources.time_patterns import checked_pattern

Pixels = Annotated[int, Ge(0), Le(100_000)]


@dataclass(frozen=True, slots=True, kw_only=True)
class AravisOptions:
    """Address and settings of a camera.

    Attributes
    ----------
    address : its IP address; names are refused, for they would be looked for by broadcast. With USB the device's id.
    transport : "gige"; or "usb3" for USB3 Vision, which no one has tried.
    packet_size : bytes per stream packet; unset: negotiated with the camera. Where no frame comes whole, 1500 is used.
    packet_socket : use a packet socket where the process may (CAP_NET_RAW); otherwise UDP with a large buffer.
    pixel_format : a single-channel GenICam format; those of 10 and 12 bits may be packed (Mono12p, Mono12Packed).
    binning : pixels that are joined in either direction by the camera.
    region : x, y, width, height in px after binning; unset: the whole sensor.
    gain_db : pinned gain; cameras that know only raw steps are set to their lowest.
    black_level : pinned black level, in the camera's own unit; unset: as it is in the camera.
    timestamps : "host" dates frames by this machine's clock at the trigger; "camera" by the frame's own timestamp,
        where the camera's clock is disciplined (PTP) and marks the start of the exposure.
    timestamp_scale : "utc"; or "tai" where the camera's clock follows a PTP grandmaster without converting: TAI is
        37 s ahead of UTC.
    timestamp_offset_s : seconds added to the camera's timestamps, for a known constant offset.
    answer_timeout_s : how long after the exposure's end a frame may arrive.
    """

    address: str
    transport: Literal["gige", "usb3"] = "gige"
    packet_size: Annotated[int, Ge(576), Le(65_000)] | None = None
    packet_socket: bool = True
    pixel_format: str = "Mono12"
    binning: Annotated[int, Ge(1), Le(16)] = 1
    region: tuple[Pixels, Pixels, Pixels, Pixels] | None = None
    gain_db: Annotated[float, Ge(-20.0), Le(60.0)] = 0.0
    black_level: Annotated[float, Ge(-1e6), Le(1e6)] | None = None
    timestamps: Literal["host", "camera"] = "host"
    timestamp_scale: Literal["utc", "tai"] = "utc"
    timestamp_offset_s: Annotated[float, Ge(-3600.0), Le(3600.0)] = 0.0
    answer_timeout_s: Annotated[float, Ge(0.05), Le(60.0)] = 1.0

    def __post_init__(self) -> None:
        """Refuse options by which no camera could be opened."""
        require_bounds(self, section_path="camera")
        if self.transport == "gige":
            _require_address(self.address)
        elif not self.address.strip():
            raise InputError(field="camera.address", problem="is empty", remedy="give the id that arv-tool-0.8 lists")
        largest_count(self.pixel_format, field="camera.pixel_format")
        if self.region is not None and min(self.region[2:]) < 1:
            problem = f"{self.region} has no width or height"
            raise InputError(field="camera.region", problem=problem, remedy="give x, y, width, height in px")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """Folder of images that is played again.

    Attributes
    ----------
    folder : where they are, subfolders included.
    pixel_format : their format; unset: Mono8 or Mono16, by depth.
    exposure_us : exposure of images whose name does not state it; unset: those are left out.
    """

    folder: Path
    pixel_format: str | None = None
    exposure_us: Annotated[float, Ge(0.01), Le(1e9)] | None = None

    def __post_init__(self) -> None:
        """Refuse a folder that cannot be played."""
        require_bounds(self, section_path="replay")
        if self.pixel_format is not None:
            largest_count(self.pixel_format, field="replay.pixel_format")


WHOLE_SECONDS_S = 1.0
"""Bound of the error of times that names have in whole seconds, s: sightings carry it, whatever is stated of the clock.
A clock's constant error is not theirs: it turns the camera, see `answers.covariance.pose_error`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderOptions:
    """A folder that another program fills with images, one after the other.

    Attributes
    ----------
    path : where they are, subfolders included; it is read, never written.
    files : which files are this camera's, as "ccd1_*.jpg"; by their names, without folders.
    utc_offset : how far times without a zone are ahead of UTC: hours as "-6", or a zone as "Europe/Berlin" where names
        follow summer time; unset: such images are left out.
    time_pattern : pattern of the names without suffix, where no known one fits, as "%d-%m-%Y_%H-%M-%S"; with the last
        folders as "%Y/%m/%d/%H%M%S".
    follow_exif : turn pictures as their EXIF orientation states; they are read as they are stored otherwise.
    method : how the sun is found: "paper" in ordinary images, "disc" in raw microsecond exposures, "auto" by the image.
    clock_error_s : bound of the error of the images' times, which the uncertainty of calibrations then holds; unset:
        not stated, the names' whole seconds are assumed to be right.
    cadence_s : seconds between images by day; unset: learned from them.
    polling : list the folder every `poll_s` though its file system reports changes.
    poll_s : seconds between two listings, where the file system reports no changes (NFS, SMB) or `polling` is set.
    settle_s : a file is read once it has not changed for so long.
    """

    path: Path
    files: str = "*"
    utc_offset: str | None = None
    time_pattern: str | None = None
    follow_exif: bool = False
    method: Literal["auto", "disc", "paper"] = "auto"
    clock_error_s: Annotated[float, Ge(0.0), Le(3600.0)] | None = None
    cadence_s: Annotated[float, Ge(1.0), Le(3600.0)] | None = None
    polling: bool = False
    poll_s: Annotated[float, Ge(0.2), Le(3600.0)] = 10.0
    settle_s: Annotated[float, Ge(0.0), Le(600.0)] = 2.0

    def __post_init__(self) -> None:
        """Refuse a folder that cannot be followed."""
        require_bounds(self, section_path="folder")
        if self.time_pattern is not None:
            checked_pattern(self.time_pattern, field="folder.time_pattern")
        if not self.files.strip() or "/" in self.files:
            problem, remedy = f"{self.files!r} is no pattern of names", 'give one as "ccd1_*.jpg"'
            raise InputError(field="folder.files", problem=problem, remedy=remedy)


@dataclass(frozen=True, slots=True, kw_only=True)
class SnapshotOptions:
    """A camera that answers with its present picture (JPEG or PNG) at an address.

    Attributes
    ----------
    url : of the picture, as "https://camera.example/snapshot.jpg"; without user and password.
    token_file : a file whose one line is USER:PASSWORD (Basic or Digest, as the camera asks).
    ca_file : certificate that verifies the camera's, in addition to those of the system; read anew where it changes.
    clock_error_s : bound of how far a picture's time is from the request, beyond the time that the answer takes.
    timeout_s : of a request as a whole, s.
    keep_images : keep the pictures as they came, in `state`/images; see [disk].
    """

    url: str
    token_file: Path | None = None
    ca_file: Path | None = None
    clock_error_s: Annotated[float, Ge(0.0), Le(3600.0)] = 1.0
    timeout_s: Annotated[float, Gt(0.0), Le(300.0)] = 10.0
    keep_images: bool = False

    def __post_init__(self) -> None:
        """Refuse an invalid address."""
        require_bounds(self, section_path="http")
        _require_url("http.url", self.url, ("http", "https"))


@dataclass(frozen=True, slots=True, kw_only=True)
class RtspOptions:
    """A camera that streams by RTSP.

    Attributes
    ----------
    url : of the stream, as "rtsp://camera.example/stream1"; without user and password.
    token_file : a file whose one line is USER:PASSWORD (Basic or Digest, as the camera asks).
    clock_error_s : bound of the time from a frame's exposure to its arrival, which no stream states; sightings whose
        whole bound is above 2 s are not calibrated with.
    timeout_s : of connecting, of opening the stream and of waiting for a key frame, s each.
    """

    url: str
    token_file: Path | None = None
    clock_error_s: Annotated[float, Ge(0.0), Le(3600.0)] = 1.5
    timeout_s: Annotated[float, Gt(0.0), Le(30.0)] = 15.0

    def __post_init__(self) -> None:
        """Refuse an invalid address."""
        require_bounds(self, section_path="rtsp")
        _require_url("rtsp.url", self.url, ("rtsp",))


def _require_url(field: str, url: str, schemes: tuple[str, ...]) -> None:
    remedy = f"give one as {schemes[0]}://camera.example/…"
    try:
        parts = urllib.parse.urlsplit(url)
        known = parts.scheme in schemes and parts.hostname and parts.port != 0 and not parts.fragment
    except ValueError:
        known = None
    if not known or not url.isascii() or not url.isprintable() or " " in url:
        raise InputError(field=field, problem=f"{url!r} is not an address", remedy=remedy)
    if parts.username is not None:
        section = field.partition(".")[0]
        remedy = f"put USER:PASSWORD in a file and name it as {section}.token_file"
        raise InputError(field=field, problem="has a user in the address", remedy=remedy)


def _require_address(address: str) -> None:
    try:
        ipaddress.ip_address(address)
    except ValueError:
        raise InputError(
            field="camera.address",
            problem=f"{address!r} is not an IP address",
            remedy="give the camera's fixed address",
        ) from None


TAI_MINUS_UTC_S = 37.0
"""Seconds by which TAI is ahead of UTC since 2017-01-01 (IERS Bulletin C 52). Should a leap second change it,
the comparison with the host's clock shows a difference of 1 s."""


def timestamp_to_utc(timestamp_ns: int, options: AravisOptions) -> datetime:
    """Return the UTC time of a camera's timestamp.

    Parameters
    ----------
    timestamp_ns : nanoseconds since 1970-01-01 on the camera's time scale.
    options : which scale that is, and what is to be added.
    """
    added_s = options.timestamp_offset_s - (TAI_MINUS_UTC_S if options.timestamp_scale == "tai" else 0.0)
    return EPOCH + timedelta(microseconds=timestamp_ns // 1000, seconds=added_s)
