"""Options of the workers."""

from __future__ import annotations

import base64
import binascii
import urllib.parse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Gt, Le, Lt

from sunarc.calibration.model.options import FirstPoseOptions
from sunarc.common.bounds import require_bounds
from sunarc.common.errors import ConfigurationError, InputError
from sunarc.common.foreign_files import MOST_SECRET_BYTES, read_regular
from sunarc.common.utc import DAY_S
from sunarc.detection.values import Sensor, bayer_pattern
from sunarc.imager.cameras.frame import Frame

_MOST_WEBHOOKS = 8
_LEAST_SECRET = 16  # bytes: half of what HMAC-SHA256 makes of it
_SECRET_PREFIX = "whsec_"  # noqa: S105 - of a secret in base64 (Standard Webhooks)


@dataclass(frozen=True, slots=True, kw_only=True)
class PushOptions:
    """Receivers of messages: an MQTT broker, and webhooks.

    Attributes
    ----------
    mqtt : address of a broker, "mqtt://broker.example" (port 1883) or "mqtts://…" (TLS, port 8883); unset: none.
        Needs the extra `mqtt`.
    mqtt_login_file : a file whose one line is USER:PASSWORD for the broker.
    webhooks : addresses that messages are posted to, as "https://example.org/hook"; at most 8.
    webhook_secret_file : a file whose one line is the secret that messages to webhooks are signed with.
    """

    mqtt: str | None = None
    mqtt_login_file: Path | None = None
    webhooks: tuple[str, ...] = ()
    webhook_secret_file: Path | None = None

    def __post_init__(self) -> None:
        """Refuse invalid addresses."""
        if self.mqtt is not None:
            parts = _check_url("push.mqtt", self.mqtt, ("mqtt", "mqtts"))
            if parts.path.strip("/"):
                raise _make_refusal("push.mqtt", self.mqtt, "give one as mqtts://broker.example")
        for url in self.webhooks:
            _check_url("push.webhooks", url, ("http", "https"))
        if len(self.webhooks) > _MOST_WEBHOOKS or len(set(self.webhooks)) < len(self.webhooks):
            remedy = f"give at most {_MOST_WEBHOOKS} different ones"
            raise InputError(field="push.webhooks", problem=f"{len(self.webhooks)} addresses", remedy=remedy)
        if self.webhooks and self.webhook_secret_file is None:
            remedy = "write 32 random bytes in base64 to a file"
            raise InputError(field="push.webhook_secret_file", problem="is missing", remedy=remedy)


def _check_url(field: str, url: str, schemes: tuple[str, ...]) -> urllib.parse.SplitResult:
    remedy = f"give one as {schemes[-1]}://receiver.example"
    try:
        parts = urllib.parse.urlsplit(url)
        port = parts.port
    except ValueError:
        raise _make_refusal(field, url, remedy) from None
    printable = url.isascii() and url.isprintable() and " " not in url
    if parts.scheme not in schemes or not parts.hostname or port == 0 or parts.fragment or not printable:
        raise _make_refusal(field, url, remedy)
    if parts.username is not None:
        raise InputError(field=field, problem="has a password in the address", remedy="put it in a file of its own")
    return parts


def _make_refusal(field: str, value: str, remedy: str) -> InputError:
    return InputError(field=field, problem=f"{value!r} is not an address", remedy=remedy)


def read_login(path: Path | None, *, setting: str) -> tuple[str, str] | None:
    """Return user and password of a file that a setting names; None without a file."""
    if path is None:
        return None
    user, colon, password = _read_line(setting, path).partition(":")
    if not user or not colon or "\n" in password:
        raise ConfigurationError(f"{setting} {path}: is not USER:PASSWORD in one line")
    return user, password


def read_secret(path: Path | None) -> bytes:
    """Return the key that messages to webhooks are signed with."""
    text = "" if path is None else _read_line("push.webhook_secret_file", path)
    key = text.encode()
    if text.startswith(_SECRET_PREFIX):
        try:
            key = base64.b64decode(text.removeprefix(_SECRET_PREFIX), validate=True)
        except binascii.Error as error:
            raise ConfigurationError(f"push.webhook_secret_file {path}: {_SECRET_PREFIX}… is no base64") from error
    if len(key) < _LEAST_SECRET:
        raise ConfigurationError(
            f"push.webhook_secret_file {path}: has {len(key)} bytes; write {_LEAST_SECRET} or more"
        )
    return key


def _read_line(setting: str, path: Path) -> str:
    try:
        return read_regular(path, most_bytes=MOST_SECRET_BYTES).decode("utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{setting} {path}: {error}") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class NightOptions:
    """Whether stars are observed at night.

    Attributes
    ----------
    enabled : observe the stars: every `capture.night_cadence_s` while the sun is below -12 degrees an exposure of
        seconds is taken, and its stars are used with the sun's sightings.
    """

    enabled: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorOptions:
    """The sensor's noise.

    Attributes
    ----------
    full_well_e : electrons at full scale.
    read_noise_e : electrons.
    black_level_fraction : level of an unlit pixel, of full scale.
    blooming : a saturated pixel spills into its neighbours.
    """

    full_well_e: Annotated[float, Gt(0.0), Le(1e7)] = 20_000.0
    read_noise_e: Annotated[float, Ge(0.0), Le(1e6)] = 12.0
    black_level_fraction: Annotated[float, Ge(0.0), Lt(1.0)] = 0.0
    blooming: bool = False

    def __post_init__(self) -> None:
        """Refuse values that no sensor has."""
        require_bounds(self, section_path="sensor")


def frame_sensor(frame: Frame, options: SensorOptions) -> Sensor:
    """Return the sensor's properties for the detector and the merge, by a frame's pixel format and binning.

    The mean of n² pixels has the noise of n² times the electrons per count; a raised gain has fewer.
    """
    raised = 10.0 ** (frame.raised_db / 20.0)
    return Sensor(
        full_scale=frame.full_scale,
        gain_e_per_count=frame.binning**2 * options.full_well_e / frame.full_scale / raised,
        read_noise_e=frame.binning * options.read_noise_e,
        black_level=options.black_level_fraction * frame.full_scale,
        bayer=bayer_pattern(frame.pixel_format),
        blooming=options.blooming,
        binning=frame.binning,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPriorOptions(FirstPoseOptions):
    """Prior of lens and pose before the first full fit.

    Attributes
    ----------
    lens_prior : file of the type of lens (`sunarc calibrate --write-lens-prior`); unset: no pose before the first fit.
    """

    lens_prior: Path | None = None

    def __post_init__(self) -> None:
        """Refuse an invalid pose."""
        require_bounds(self, section_path="first_pose")


CirclePx = Annotated[float, Ge(-1e5), Le(1e5)]


@dataclass(frozen=True, slots=True, kw_only=True)
class RefitOptions:
    """When and how a refit runs.

    Attributes
    ----------
    check_every_s : how often ended days are looked for, real seconds.
    time_limit_s : longest duration of a solve, real seconds.
    image_circle_px : x, y and radius of the circle that the lens draws at 90 degrees, where they are known.
    """

    check_every_s: Annotated[float, Gt(0.0), Le(3600.0)] = 60.0
    time_limit_s: Annotated[float, Gt(0.0), Le(DAY_S)] = 900.0
    image_circle_px: tuple[CirclePx, CirclePx, CirclePx] | None = None

    def __post_init__(self) -> None:
        """Refuse invalid durations, and a circle without a radius."""
        require_bounds(self, section_path="refit")
        if self.image_circle_px is not None and self.image_circle_px[2] <= 0.0:
            problem = f"the radius {self.image_circle_px[2]:g} is not positive"
            raise InputError(field="refit.image_circle_px", problem=problem, remedy="give x, y and radius in px")


@dataclass(frozen=True, slots=True, kw_only=True)
class HubOptions:
    """The hub that an imager sends its archive's rows to.

    Attributes
    ----------
    url : its address, as "https://fleet.example"; unset: nothing is sent.
    token_file : a file whose one line is the camera's token, made on the hub by `sunarc hub token`.
    """

    url: str | None = None
    token_file: Path | None = None

    def __post_init__(self) -> None:
        """Refuse an invalid address."""
        parts = urllib.parse.urlsplit("https://none" if self.url is None else self.url)
        if parts.scheme not in {"http", "https"} or not parts.hostname or parts.query or parts.username:
            remedy = "give one as https://fleet.example"
            raise InputError(field="hub.url", problem=f"{self.url!r} is not an address", remedy=remedy)
        if self.url is not None and self.token_file is None:
            raise InputError(field="hub.token_file", problem="is missing", remedy="sunarc hub token makes a token")


@dataclass(frozen=True, slots=True, kw_only=True)
class NightlyOptions:
    """Work of a hub once a night.

    Attributes
    ----------
    keep_sightings_days : sightings of months that ended longer ago are removed from a hub's archive.
    """

    keep_sightings_days: Annotated[float, Ge(90.0), Le(36_500.0)] = 36_500.0

    def __post_init__(self) -> None:
        """Refuse limits that would remove needed rows."""
        require_bounds(self, section_path="nightly")


Duration = Annotated[float, Gt(0.0), Le(DAY_S)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockOptions:
    """Options of the watch over the time of the frames.

    Attributes
    ----------
    step_s : wall time that moves against monotonic time by more than this was set; slewing moves both alike.
    assumed_error_s : bound of the host's clock where it is kept right by something that does not inform the kernel.
    """

    step_s: Duration = 0.1
    assumed_error_s: Duration | None = None

    def __post_init__(self) -> None:
        """Refuse an invalid duration."""
        require_bounds(self, section_path="clock")


_SHORTEST_NORMAL_US, _SHORTEST_BRACKET_US = 10.0, 100.0  # no lens shows the sky in less; the sun's are not set


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureOptions:
    """The cadence.

    Attributes
    ----------
    cadence_s : seconds from slot to slot; slots are whole multiples of it since 1970-01-01 UTC.
    hdr_exposures_us : the normal exposures, in the order taken.
    sun_zenith_deg : sun exposures are taken while the sun's apparent zenith angle is below this.
    night_cadence_s : seconds between the exposures of the night, which are not kept: a sign of life, or of its stars.
    reopen_after_s, reopen_at_most_s : seconds before a lost camera is tried again: the first pause, doubled up to the
        longest one.
    camera_clock_error_s : bound of the camera's clock's error, where frames are dated by it (PTP).
    speed : seconds of the camera's clock in a real second; other than 1 only for a simulated camera.
    """

    cadence_s: Annotated[float, Gt(0.0), Le(3600.0)] = 30.0
    hdr_exposures_us: tuple[Annotated[float, Gt(0.0), Le(1e8)], ...] = (3_000.0, 12_000.0, 48_000.0)
    sun_zenith_deg: Annotated[float, Gt(0.0), Le(92.0)] = 89.6
    night_cadence_s: Annotated[float, Gt(0.0), Le(DAY_S)] = 600.0
    reopen_after_s: Annotated[float, Gt(0.0), Le(3600.0)] = 1.0
    reopen_at_most_s: Annotated[float, Gt(0.0), Le(3600.0)] = 30.0
    camera_clock_error_s: Annotated[float, Ge(0.0), Le(3600.0)] = 0.001
    speed: Annotated[float, Gt(0.0), Le(100_000.0)] = 1.0

    def __post_init__(self) -> None:
        """Refuse a cycle that cannot be kept."""
        require_bounds(self, section_path="capture")
        if not self.hdr_exposures_us:
            raise InputError(field="capture.hdr_exposures_us", problem="is empty", remedy="give exposures in µs")
        _require_microseconds(self.hdr_exposures_us)


def _require_microseconds(exposures_us: Sequence[float]) -> None:
    """Refuse normal exposures that only milliseconds explain."""
    bracket_is_short = len(exposures_us) > 1 and max(exposures_us) < _SHORTEST_BRACKET_US
    if min(exposures_us) < _SHORTEST_NORMAL_US or bracket_is_short:
        listed = ", ".join(f"{exposure:g}" for exposure in exposures_us)
        raise InputError(
            field="capture.hdr_exposures_us",
            problem=f"{listed} us are too short for the sky, and look like milliseconds",
            remedy=f"give microseconds: {', '.join(f'{1000.0 * exposure:g}' for exposure in exposures_us)}",
        )
