"""The simulated imager as a process of its own: a GigE Vision camera on loopback whose frames are the scene's."""

from __future__ import annotations

import ctypes
import json
import logging
import math
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.result import NO_METRICS, Calibration, Provenance, Verdict
from sunarc.common.array_types import Image
from sunarc.common.bounds import require_bounds
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.findings import Finding
from sunarc.common.utc import DAY_S, to_microseconds
from sunarc.detection.values import bayer_pattern
from sunarc.formats.calibration_document import to_document
from sunarc.imager.cameras.frame import largest_count
from sunarc.imager.cameras.packed import pack, packed_layout
from sunarc.imager.runtime.clock import Clock, SystemClock
from sunarc.lab.simulation import fake_camera as genicam
from sunarc.lab.simulation.fake_camera import FakeCamera, Request, fake_camera
from sunarc.lab.simulation.options import WEATHERS, SceneOptions, SensorModel, Weather
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.backward import fit_backward
from sunarc.optics.camera import Camera
from sunarc.optics.displacement import WaveBasis
from sunarc.optics.pose import pose_angles
from sunarc.sky.days import solar_date
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

_log = logging.getLogger(__name__)

_PR_SET_PDEATHSIG = 1
_TEMPERATURE_C = 21.5
_ORDERS_POLL_S = 0.05
_TRIGGER_POLL_S = 0.005
"""By so much at most a real exposure begins after its trigger."""
MAX_IMAGES = 8
"""Images that can be repeated: those of a cycle."""
DARK_US = 1e-6
"""Exposure, µs, in which even the sun leaves no count: a closed dome."""
SLOWEST = 10.0
"""Speed that an overloaded host is not slowed below."""
Badness = Literal["black", "half_filled", "old_exposure"]
_BADNESSES: tuple[Badness, ...] = get_args(Badness)
ExposureUs = Annotated[int, Ge(1), Lt(2**32)]
_HEADERS_BYTES = 36
"""Of a stream packet: IPv4, UDP and GVSP (AIA, "GigE Vision", version 1.2, chapter 24)."""
_START, _NOTED_START = 1, 3
"""A start of acquisition, and the number written over one that was noticed: any number but 0 goes on as well."""
_FORMAT_NAMES = {number: name for name, number in genicam.PIXEL_FORMATS.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class ImagerOptions:
    """A simulated imager.

    Attributes
    ----------
    address : an address of this machine.
    start : first simulated time, aware.
    speed : simulated seconds per real second.
    skip_nights : jump from dusk to dawn.
    site : where the imager stands.
    lens_seed : which true camera.
    camera : the true camera; None takes the one of `lens_seed`.
    clouds : the weather, or several separated by commas: one per solar day, in turn.
    scene : the rest of the scene; its weather and first day are replaced by `clouds` and `start`.
    sensor : how light becomes counts.
    exposure_min_us, exposure_max_us : bounds of the exposure.
    real_exposures : let an exposure take its time.
    serial : what the camera calls itself.
    name : of the camera in the truth's document.
    truth : file that the true camera is written to once the imager runs; None writes none.
    die_with_parent : end when the process that started this one ends.
    """

    address: str = "127.0.0.1"
    start: datetime = datetime(2013, 5, 13, 12, tzinfo=UTC)
    speed: Annotated[float, Gt(0.0), Le(100_000.0)] = 1.0
    skip_nights: bool = True
    site: Site = SGP
    lens_seed: int = 0
    camera: Camera | None = None
    clouds: str = "clear"
    scene: SceneOptions = field(default_factory=SceneOptions)
    sensor: SensorModel = field(default_factory=SensorModel)
    exposure_min_us: ExposureUs = 1
    exposure_max_us: ExposureUs = 10_000_000
    real_exposures: bool = False
    serial: str = "SIM-0001"
    name: str = "simulated"
    truth: Path | None = None
    die_with_parent: bool = True

    def __post_init__(self) -> None:
        """Refuse options that cannot be simulated."""
        if self.start.tzinfo is None:
            raise InputError(field="start", problem="has no time zone", remedy="give UTC, as 2013-05-13T12:00:00Z")
        require_bounds(self, section_path="")
        if self.exposure_min_us >= self.exposure_max_us:
            raise InputError(field="exposure_min_us", problem="not below exposure_max_us", remedy="lower it")
        _parse_weathers(self.clouds)


def run_imager(
    options: ImagerOptions,
    stop: threading.Event,
    *,
    clock: Clock | None = None,
    running: Callable[[FakeCamera], None] = lambda _: None,
) -> None:
    """Serve frames until `stop` is set; see `ImagerOptions`.

    `running` is given the camera once it serves: whoever writes its registers can bring about faults from outside.

    Raises
    ------
    ConfigurationError
        Aravis is not installed.
    OutsideError
        The port is taken, no interface has the address, or the truth cannot be written.
    """
    if options.die_with_parent:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    description = genicam.genicam_xml(
        exposure_min_us=options.exposure_min_us,
        exposure_max_us=options.exposure_max_us,
        trigger=genicam.EXPOSE if options.real_exposures else genicam.TRIGGER_SOFTWARE,
    )
    scene = make_scene(options)
    scene.render(to_microseconds(options.start), exposure_us=10.0)  # compiles, before anyone can ask for a frame
    with fake_camera(address=options.address, serial=options.serial, description=description) as camera:
        clock = clock or SystemClock()
        imager = _Imager(options, scene, camera, stop=stop, clock=clock)
        camera.fill_with(imager.fill)
        if options.truth is not None:
            write_truth(options.truth, imager.scene, name=options.name, created_at=options.start)
        _log.info("simulated imager at %s, %s, speed %g", options.address, options.start.isoformat(), options.speed)
        running(camera)
        while not clock.wait(stop, _TRIGGER_POLL_S if options.real_exposures else _ORDERS_POLL_S):
            imager.obey()
            if options.real_exposures:
                imager.expose()


def halve_speed(camera: FakeCamera) -> None:
    """Let simulated time pass half as fast, but not slower than `SLOWEST`."""
    speed, slowest = camera.read(genicam.SPEED), round(1000 * SLOWEST)
    camera.write(genicam.SPEED, min(speed, max(speed // 2, slowest)))


def make_scene(options: ImagerOptions) -> Scene:
    """Return the very scene that an imager with these options shows."""
    first_day = solar_date(options.start.timestamp(), longitude=options.site.longitude)
    scene = replace(options.scene, weather=_parse_weathers(options.clouds), first_day=first_day)
    camera = true_camera(options.lens_seed) if options.camera is None else options.camera
    return Scene(camera, options.site, options=scene, sensor=options.sensor)


class _Exposure(NamedTuple):
    """A frame that was triggered: its bytes, its timestamp, and the monotonic time at which it may be sent."""

    data: NDArray[np.uint8]
    timestamp_ns: int
    ends_at: float


class _Imager:
    """Renders the frames that the registers request, at the simulated time."""

    def __init__(
        self, options: ImagerOptions, scene: Scene, camera: FakeCamera, *, stop: threading.Event, clock: Clock
    ) -> None:
        self.scene = scene
        self._options = options
        self._camera = camera
        self._stop = stop
        self._clock = clock
        self._previous_exposure_us = 0.0
        self._last_images: dict[Request, Image] = {}
        self._exposure: _Exposure | None = None
        self._last_sent: NDArray[np.uint8] = np.empty(0, np.uint8)
        self._bad_left = self._bad_sent = 0
        self._set_up_registers()
        start_unix_s = options.start.timestamp()
        self._timeline = SceneTimeline(
            options.site, start_unix_s=start_unix_s, speed=options.speed, skip_nights=options.skip_nights
        )
        self._camera.write(genicam.SPEED, round(1000.0 * options.speed))
        self._started_at: float | None = None

    def expose(self) -> None:
        """Begin a real exposure once the client has triggered it, and have its frame sent when it is over.

        It takes its time here: in the thread that fills frames it would leave the control channel without an answer.
        A trigger during an exposure is ignored, and an exposure that acquisition does not outlast is dropped.
        """
        triggered = bool(self._camera.read(genicam.EXPOSE))
        if triggered:
            self._camera.write(genicam.EXPOSE, 0)
        if not self._camera.read(genicam.ACQUISITION):
            self._exposure = None
            self._camera.write(genicam.TRIGGER_SOFTWARE, 0)
        elif self._exposure is None and triggered:
            request = self._camera.request()
            begun = self._clock.monotonic()
            data, timestamp_ns = self._expose_frame(request)
            self._exposure = _Exposure(data, timestamp_ns, begun + request.exposure_us * 1e-6)
        elif self._exposure is not None and self._clock.monotonic() >= self._exposure.ends_at:
            self._exposure = self._exposure._replace(ends_at=math.inf)  # is sent once
            self._camera.write(genicam.TRIGGER_SOFTWARE, 1)

    def fill(self, request: Request) -> tuple[NDArray[np.uint8], int]:
        """Return a frame's bytes and its timestamp in nanoseconds: the simulated start of the exposure."""
        exposure, self._exposure = self._exposure, None
        if exposure is not None:
            self._delay_sending(0.0)
            return exposure.data, exposure.timestamp_ns
        begun = self._clock.monotonic()
        taken = self._expose_frame(request)
        self._delay_sending(request.exposure_us * 1e-6 - (self._clock.monotonic() - begun))
        return taken

    def _expose_frame(self, request: Request) -> tuple[NDArray[np.uint8], int]:
        """Return the bytes and the timestamp of a frame whose exposure begins now."""
        begun = self._clock.monotonic()
        name = _FORMAT_NAMES[request.pixel_format]
        if self._started_at is None:
            self._started_at = begun  # nothing of the day is lost while a busy host starts who asks for frames
        elapsed_s = begun - self._started_at
        self._follow_speed(elapsed_s)
        start_us = round(self._timeline.at(elapsed_s) * 1e6)
        drift_us = self._camera.read(genicam.CLOCK_DRIFT) * elapsed_s * self._options.speed
        offset_us = self._camera.read(genicam.CLOCK_OFFSET) * 1000
        image = self._repeat_image(request) if self._camera.read(genicam.REPEAT_FRAME) else None
        bad = self._find_restart_fault()
        if image is None:
            image = self._render_binned(
                partial(
                    self.scene.render,
                    start_us,
                    exposure_us=self._true_exposure_us(request.exposure_us, bad),
                    gain_db=request.gain_steps / genicam.GAIN_STEPS_PER_DB,
                    full_scale=largest_count(name),
                    bayer=bayer_pattern(name),
                ),
                request.region,
            )
            self._keep_image(request, image)
        if bad == "half_filled":
            image = image.copy()  # the one that is kept to be repeated stays whole
            image[image.shape[0] // 2 :] = 0
        sent = self._mix_packets(_encode_image(image, name), request, start_us * 1e-6)
        return sent, (start_us + round(drift_us) + offset_us) * 1000

    def _keep_image(self, request: Request, image: Image) -> None:
        """Keep an image to be repeated; of the oldest requests none is kept."""
        self._last_images.pop(request, None)
        self._last_images[request] = image
        while len(self._last_images) > MAX_IMAGES:
            del self._last_images[next(iter(self._last_images))]

    def _repeat_image(self, request: Request) -> Image | None:
        """Return the image that was last sent for the same request; None without one."""
        return self._last_images.get(request)

    def _follow_speed(self, elapsed_s: float) -> None:
        """Go on at the speed that the register asks for."""
        speed = self._camera.read(genicam.SPEED) / 1000.0
        if speed > 0.0 and abs(speed - self._timeline.speed) > 1e-3:
            self._timeline.set_speed(speed, elapsed_s=elapsed_s)

    def obey(self) -> None:
        """Carry out register orders that are valid at any time: power cycle, or drop the controlling client."""
        if self._camera.read(genicam.POWER_CYCLE):
            self._reset_registers()
        if self._camera.read(genicam.DROP_CONTROL):
            self._camera.write(genicam.DROP_CONTROL, 0)
            self._camera.write(genicam.CONTROL_PRIVILEGE, 0)

    def _find_restart_fault(self) -> Badness | None:
        """Return the fault of a frame that follows a start of acquisition too soon, each kind in turn."""
        if self._camera.read(genicam.ACQUISITION) == _START:
            self._camera.write(genicam.ACQUISITION, _NOTED_START)
            self._bad_left = self._camera.read(genicam.BAD_AFTER_START)
        if self._bad_left == 0:
            return None
        self._bad_left -= 1
        self._bad_sent += 1
        return _BADNESSES[self._bad_sent % len(_BADNESSES)]

    def _mix_packets(self, sent: NDArray[np.uint8], request: Request, unix_s: float) -> NDArray[np.uint8]:
        """Return a frame's bytes; where that is asked for with the frame before's in the packets about the sun."""
        before, self._last_sent = self._last_sent, sent
        count = self._camera.read(genicam.FOREIGN_PACKETS)
        packet = (self._camera.read(genicam.PACKET_SIZE) & 0xFFFF) - _HEADERS_BYTES
        if count == 0 or packet <= 0 or before.size != sent.size:
            return sent
        at = self.scene.sun_pixel(unix_s) - request.region[:2]
        if not np.all(np.isfinite(at)):
            return sent
        pixel_bytes = sent.size / (request.region[2] * request.region[3])
        sun = round(at[1]) * request.region[2] + at[0]
        first = max(int(sun * pixel_bytes) // packet * packet, 0)
        changed = slice(first, first + count * packet)
        mixed = sent.copy()
        mixed[changed] = before[changed]
        return mixed

    def _true_exposure_us(self, exposure_us: float, bad: Badness | None) -> float:
        """Return the true exposure of the frame, µs: the stated one, unless a fault is set."""
        percent = self._camera.read(genicam.WRONG_EXPOSURE) or self._camera.read(genicam.ALL_EXPOSURES) or 100
        self._camera.write(genicam.WRONG_EXPOSURE, 0)
        if self._camera.read(genicam.BLACK) or bad == "black":
            return DARK_US
        stale = (
            bad == "old_exposure" or bool(self._camera.read(genicam.STALE_EXPOSURE))
        ) and self._previous_exposure_us > 0.0
        light_us = self._previous_exposure_us if stale else exposure_us * percent / 100.0
        self._previous_exposure_us = exposure_us
        return light_us

    def _render_binned(self, render: Callable[..., Image], region: tuple[int, int, int, int]) -> Image:
        """Return a region's counts, each the mean of the pixels that the registers join."""
        across, down = self._camera.read(genicam.BINNING_X), self._camera.read(genicam.BINNING_Y)
        x, y, width, height = region
        image = render(region=(x * across, y * down, width * across, height * down))
        if across == down == 1:
            return image
        joined: Image = image.reshape(height, down, width, across).mean(axis=(1, 3)).astype(image.dtype)
        return joined

    def _delay_sending(self, rest_of_exposure_s: float) -> None:
        """Wait as long as the exposure and the faults want, and let packets be lost."""
        delay_s = self._camera.read(genicam.DELAY) * 1e-3 + self._camera.read(genicam.FREEZE) * 1e-3
        self._camera.write(genicam.FREEZE, 0)
        if self._options.real_exposures:
            delay_s += rest_of_exposure_s
        if delay_s > 0.0:
            self._clock.wait(self._stop, delay_s)
        self._camera.lose_packets(self._camera.read(genicam.LOSS) / 1000.0)

    def _set_up_registers(self) -> None:
        width, height = self.scene.camera.width, self.scene.camera.height
        registers = {
            genicam.SENSOR_WIDTH: width,
            genicam.SENSOR_HEIGHT: height,
            genicam.WIDTH: width,
            genicam.HEIGHT: height,
            genicam.BINNING_X: 1,
            genicam.BINNING_Y: 1,
            genicam.PIXEL_FORMAT: genicam.PIXEL_FORMATS["Mono12"],
            genicam.EXPOSURE: 3000,
            genicam.GAIN: 0,
            genicam.TEMPERATURE: round(_TEMPERATURE_C * genicam.TEMPERATURE_STEPS_PER_DEGREE),
        }
        for address, value in registers.items():
            self._camera.write(address, value)
        self._camera.write_text(genicam.VENDOR, "sunarc", length=32)
        self._camera.write_text(genicam.MODEL, "simulated sky", length=32)

    def _reset_registers(self) -> None:
        """Reset to the state after switching on: free-running, everything automatic, no application in control."""
        self._set_up_registers()
        registers = {
            genicam.POWER_CYCLE: 0,
            genicam.ACQUISITION: 0,
            genicam.TRIGGER_MODE: 0,
            genicam.TRIGGER_SOURCE: 0,
            genicam.EXPOSURE_AUTO: 1,
            genicam.GAIN_AUTO: 1,
            genicam.GAMMA: 1,
            genicam.GAIN: 6 * genicam.GAIN_STEPS_PER_DB,
            genicam.CONTROL_PRIVILEGE: 0,
        }
        for address, value in registers.items():
            self._camera.write(address, value)


def _encode_image(image: Image, pixel_format: str) -> NDArray[np.uint8]:
    packing = packed_layout(pixel_format)
    if packing is None:
        return np.ascontiguousarray(image).view(np.uint8).ravel()
    return np.frombuffer(pack(image.astype(np.uint16), packing), np.uint8)


def _parse_weathers(clouds: str) -> tuple[Weather, ...]:
    names = [name.strip() for name in clouds.split(",")]
    known: dict[str, Weather] = {weather: weather for weather in WEATHERS}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(field="clouds", problem=f"{unknown[0]!r} is unknown", remedy=f"use {', '.join(WEATHERS)}")
    return tuple(known[name] for name in names)


def write_truth(path: Path, scene: Scene, *, name: str, created_at: datetime) -> None:
    """Write the document of the simulated camera's true parameters."""
    document = truth_document(scene.camera, scene.site, name=name, created_at=created_at)
    partial = path.with_name(path.name + ".part")
    with disk_errors(path):
        partial.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        partial.replace(path)


# Simulated time: faster than real, with the nights left out.

_TWILIGHT_ZENITH_DEG = 92.0
_STEP_S = 60.0
_LONGEST_NIGHT_DAYS = 200


class SceneTimeline:
    """Simulated time as a function of elapsed real time.

    Parameters
    ----------
    site : whose nights are skipped.
    start_unix_s : simulated time at 0.
    speed : simulated seconds per real second.
    skip_nights : jump from the end of a day's twilight to the beginning of the next one's.
    """

    def __init__(self, site: Site, *, start_unix_s: float, speed: float, skip_nights: bool = True) -> None:
        self._site = site
        self._start_unix_s = start_unix_s
        self._speed = speed
        self._skip_nights = skip_nights
        self._skipped_s = 0.0
        self._since_s = 0.0

    @property
    def speed(self) -> float:
        """Simulated seconds per real second."""
        return self._speed

    def set_speed(self, speed: float, *, elapsed_s: float) -> None:
        """Go on at another speed from an elapsed real time on, without a step."""
        self._start_unix_s += (elapsed_s - self._since_s) * self._speed
        self._since_s, self._speed = elapsed_s, speed

    def at(self, elapsed_s: float) -> float:
        """Return the simulated time in seconds since 1970-01-01 UTC; must not be called for earlier times again."""
        now = self._start_unix_s + (elapsed_s - self._since_s) * self._speed + self._skipped_s
        if self._skip_nights and _is_night(now, self._site):
            dawn = next_dawn(now, self._site)
            self._skipped_s += dawn - now
            return dawn
        return now


def next_dawn(unix_s: float, site: Site) -> float:
    """Return the next minute at which the sun is at most 92° from the zenith; `unix_s` itself without one."""
    minutes = np.arange(0.0, DAY_S, _STEP_S)
    for day in range(_LONGEST_NIGHT_DAYS):
        times = unix_s + day * DAY_S + minutes
        light = np.flatnonzero(sun_angles(times, site).apparent_zenith <= _TWILIGHT_ZENITH_DEG)
        if light.size:
            return float(times[light[0]])
    return unix_s


def _is_night(unix_s: float, site: Site) -> bool:
    return float(sun_angles(unix_s, site).apparent_zenith) > _TWILIGHT_ZENITH_DEG


# The truth as a calibration document, so that everything that reads one can be held against it.


def truth_document(camera: Camera, site: Site, *, name: str, created_at: datetime) -> dict[str, Any]:
    """Return a camera as a calibration document ("sunarc.calibration/2"): without uncertainty, and without evidence."""
    truth = Calibration(
        camera=camera,
        poses=(camera.rotation_cam_enu,),
        parameter_names=(),
        covariance=np.zeros((0, 0)),
        field=_make_zero_field(camera),
        sky_rms_deg=0.0,
        sky_max_deg=0.0,
        metrics=NO_METRICS,
        pose=pose_angles(camera.rotation_cam_enu),
        backward=fit_backward(camera),
        evidence=_make_empty_provenance(),
        verdict=Verdict(accepted=True, findings=(Finding("simulated_camera"),)),
        method="robust",
        site=site,
    )
    return to_document(
        truth,
        id="truth",
        camera=name,
        state="current",
        created_at=created_at,
        valid_from=created_at,
        valid_until=None,
        pose_epoch="truth",
        software_version=version("sunarc"),
    )


def _make_zero_field(camera: Camera) -> Field:
    center = (camera.width / 2.0, camera.height / 2.0)
    basis = WaveBasis(center_px=center, half_px=center, orders=np.zeros((0, 2), dtype=np.int64))
    return Field(amplitude_px=0.0, length_px=1.0, basis=basis, cross=np.zeros((2, 0, 0)))


def _make_empty_provenance() -> Provenance:
    return Provenance(
        days=(),
        n_supplied=0,
        n_used=0,
        n_rejected=0,
        options={},
        sigma_px=math.nan,
        inflation=math.nan,
        radial_px=math.nan,
        clock_error_s=math.nan,
    )
