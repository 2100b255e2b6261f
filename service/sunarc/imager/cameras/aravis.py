"""GigE Vision and USB3 Vision cameras, through Aravis: the only file that imports the library.

A frame is trusted when the camera was idle, was given one software trigger, and answered with one whole frame whose
count follows the last one's, and whose own note of its exposure (a chunk), where the camera adds one, agrees. Whatever
else happens raises, and the next exposure starts from a stopped camera.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Literal

import numpy as np

from sunarc.common import errors
from sunarc.common.array_types import Image
from sunarc.imager.cameras import features
from sunarc.imager.cameras.frame import CameraCondition, CameraInfo, Frame, exposure_middle, largest_count
from sunarc.imager.cameras.options import AravisOptions, timestamp_to_utc
from sunarc.imager.cameras.packed import packed_bytes, packed_layout, unpack
from sunarc.imager.runtime.clock import Clock
from sunarc.imaging.exposure import ExposureBounds

# The exposure of a GenICam camera: by which feature it is set, in what unit, within what bounds.

_FLOATS = ("ExposureTime", "ExposureTimeAbs")
_SAME = 1.5
"""Factor up to which two exposures may be one to a camera that does not state its step."""
_RAW, _RAW_UNIT = "ExposureTimeRaw", "ExposureTimeBaseAbs"


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureControl:
    """Control of the exposures.

    Attributes
    ----------
    feature, kind : the camera's feature, and whether it holds a float or whole steps.
    unit_us : microseconds in a step of the feature.
    bounds : shortest and longest exposure, and its step.
    """

    feature: str
    kind: Literal["float", "integer"]
    unit_us: float
    bounds: ExposureBounds

    def set(self, camera: Any, exposure_us: float) -> float:  # noqa: ANN401 - a GObject has no types
        """Set the nearest possible exposure, and return the one read back, µs."""
        steps = self.bounds.nearest(exposure_us) / self.unit_us
        pin = features.write(camera, self.feature, self.kind, round(steps) if self.kind == "integer" else steps)
        return float(pin.value) * self.unit_us

    def get(self, camera: Any) -> float:  # noqa: ANN401 - a GObject has no types
        """Return the exposure read back from the camera, µs."""
        return float(features.read(camera, self.feature, self.kind)) * self.unit_us


def require_taken(actual_us: float, asked_us: float, *, before_us: float) -> float:
    """Return an exposure that was read back from the camera; CameraError where the camera kept the former one."""
    if actual_us == before_us and not 1.0 / _SAME <= actual_us / asked_us <= _SAME:
        raise errors.CameraError(f"the camera keeps an exposure of {actual_us:g} µs and does not take {asked_us:g} µs")
    return actual_us


def exposure_control(camera: Any) -> ExposureControl:  # noqa: ANN401 - a GObject has no types
    """Find out how a camera's exposure is set; CameraError when it cannot be."""
    for feature in (*_FLOATS, _RAW):
        if not features.has(camera, feature):
            continue
        unit_us = float(camera.get_float(_RAW_UNIT)) if feature == _RAW and features.has(camera, _RAW_UNIT) else 1.0
        with contextlib.suppress(Exception):  # a few cameras hold whole microseconds: refused as a float
            bounds = camera.get_float_bounds(feature)
            return _control(feature, "float", unit_us, bounds, _read_step(camera.get_float_increment, feature))
        bounds = camera.get_integer_bounds(feature)
        return _control(feature, "integer", unit_us, bounds, _read_step(camera.get_integer_increment, feature))
    raise errors.CameraError(f"the camera's exposure cannot be set: it has none of {', '.join((*_FLOATS, _RAW))}")


def _control(
    feature: str, kind: Literal["float", "integer"], unit_us: float, bounds: tuple[float, float], step: float
) -> ExposureControl:
    return ExposureControl(
        feature=feature,
        kind=kind,
        unit_us=unit_us,
        bounds=ExposureBounds(
            minimum_us=float(bounds[0]) * unit_us, maximum_us=float(bounds[1]) * unit_us, step_us=step * unit_us
        ),
    )


def _read_step(ask: Any, feature: str) -> float:  # noqa: ANN401 - a GObject's method has no types
    with contextlib.suppress(Exception):  # vendors' descriptions disagree on whether there is one
        step = float(ask(feature))
        return step if math.isfinite(step) and 1e-6 < step < 1e6 else 0.0
    return 0.0


# The exposure that a frame notes of itself (a GenICam chunk), or the register's where there is none to be read.

_CHUNK = "ExposureTime"


class NotedExposure:
    """Reader of the exposure that a frame states in its chunk data.

    Parameters
    ----------
    camera : the library's, before its stream is made: chunks change the payload.
    control : by which the exposure is set, and read back.
    error : the library's error.
    """

    def __init__(self, camera: Any, control: ExposureControl, *, error: type[Exception]) -> None:  # noqa: ANN401 - a GObject has no types
        self._camera = camera
        self._control = control
        self._error = error
        self._parser: Any = None
        try:
            if camera.are_chunks_available():
                camera.set_chunks(_CHUNK)
                self._parser = camera.create_chunk_parser()
        except error as refused:  # a camera may have chunks and none of the exposure
            _log.info("the camera does not note its exposures: %s", refused)

    @property
    def from_frame(self) -> bool:
        """True where frames state their exposure themselves."""
        return self._parser is not None

    def of(self, buffer: Any) -> float:  # noqa: ANN401 - a GObject
        """Return a frame's exposure in microseconds; chunks that cannot be parsed are not tried again."""
        if self._parser is not None:
            try:
                return float(self._parser.get_float_value(buffer, f"Chunk{_CHUNK}"))
            except self._error as unreadable:
                self._parser = None
                _log.warning(
                    "chunk data of the camera cannot be parsed (%s): exposures are checked by reading %s back instead",
                    unreadable,
                    self._control.feature,
                )
        return self._control.get(self._camera)


# The library's signal that a camera no longer answers, and the end of the device that sends it.

_POLL_S = 0.002
_POLLS = 250
"""0.5 s in all: a signal's emission takes less than a millisecond of a thread that runs."""


def event_setter(event: threading.Event) -> Callable[..., None]:
    """Return a signal handler that refers to nothing but the event: a reference to the camera would keep it open."""

    def set_event(*_: object) -> None:
        event.set()

    return set_event


def wait_for_last_reference(device: Any, clock: Clock) -> bool:  # noqa: ANN401 - a GObject has no types
    """Wait until the caller's reference to a device is the only one, at most 0.5 s; return whether it is.

    The signal is emitted in the device's own heartbeat thread, and the emission has a reference to the device until
    all handlers have returned. Were that the last one, the device would be finalized in that thread, which would then
    join itself: GLib ends the process ("Resource deadlock avoided"). An exception that is being handled may hold
    another reference, which is dropped later in the caller's thread: that wait ends in vain.
    """
    for _ in range(_POLLS):
        if getattr(device, "__grefcount__", 1) <= 1:
            return True
        clock.wait(threading.Event(), _POLL_S)
    _log.debug("the camera's device is still referred to %g s after it was closed", _POLLS * _POLL_S)
    return False


_log = logging.getLogger(__name__)

_BUFFERS = 6
_DISCARDED = 3
"""Frames after each start of acquisition that are taken and left. The library enlarges the socket's buffer only when
the first one arrives, and some cameras begin with one or two that are dark, half filled or of the exposure before."""
_INTERFACE_OF = {"gige": "GigEVision", "usb3": "USB3Vision"}
_INTERFACES = {*_INTERFACE_OF.values(), "Fake"}


def open_aravis(options: AravisOptions, clock: Clock) -> AravisCamera:
    """Open a camera by its address and bring it into the state that exposures need.

    Raises
    ------
    CameraLostError
        Nothing answers at the address, or another program controls the camera.
    ConfigurationError, InputError
        Aravis is not installed, or the camera cannot be set up as asked.
    """
    camera = AravisCamera(options, clock, library=_import_aravis())
    try:
        camera.connect()
    except errors.SunarcError as error:
        camera.close()
        error.__context__ = error.__cause__ = None  # a traceback would keep the device, and with it the control of it
        raise error.with_traceback(None)  # noqa: B904 - the cause was cut off on purpose
    except BaseException:
        camera.close()
        raise
    return camera


class AravisCamera:
    """A camera under our control (a `SkyCamera`); made by `open_aravis`."""

    def __init__(self, options: AravisOptions, clock: Clock, *, library: tuple[Any, Any]) -> None:
        self._options = options
        self._clock = clock
        self._aravis, self._glib = library
        self._lost = threading.Event()
        self._camera: Any = None
        self._device: Any = None
        self._stream: Any = None
        self._noted: NotedExposure | None = None
        self._handler = 0
        self._info: CameraInfo | None = None
        self._exposure: ExposureControl | None = None
        self._exposure_us = 0.0
        self._pins: tuple[features.Pin, ...] = ()
        self._day_gain_db, self._simulated = 0.0, False
        self.link: features.Link | None = None
        self._previous_id: int | None = None
        self._is_suspect = False

    @property
    def info(self) -> CameraInfo:
        """Record of the camera."""
        if self._info is None:
            raise errors.CameraLostError(f"the camera at {self._options.address} is not open")
        return self._info

    def connect(self) -> None:
        """Take control, pin the settings and start acquisition; `close` afterwards, also if this fails."""
        address = self._options.address
        with self._translate_errors(f"opening the camera at {address}"):
            for unused in _INTERFACES - {_INTERFACE_OF[self._options.transport]}:
                self._aravis.disable_interface(unused)  # a GigE camera that is not found is not looked for elsewhere
            self._camera = self._aravis.Camera.new(address)
            self._device = self._camera.get_device()
            self._handler = self._device.connect("control-lost", event_setter(self._lost))
            if self._camera.is_gv_device() and not self._device.is_controller():
                raise errors.CameraLostError(
                    f"the camera at {address} is controlled by another program; close that one"
                )
            self._pins = features.pin_settings(self._camera, self._options)
            self._day_gain_db = features.gain_db(self._pins)
            self._simulated = features.has(self._camera, features.SIMULATED_SPEED)
            self._exposure = exposure_control(self._camera)
            self._noted = NotedExposure(self._camera, self._exposure, error=self._glib.Error)
            self._open_stream(self._options.packet_size)
            self._info = self._read_camera_info(self._exposure)
            self._start_with_fitting_packets(self._exposure)
        _log.info("opened %s", self._info)

    def expose(self, exposure_us: float) -> Frame:
        """Expose once, within the camera's bounds, and return the frame (see `SkyCamera`)."""
        info = self.info
        self._require_control()
        with self._translate_errors("exposing"):
            if self._is_suspect:
                self._resynchronise()
            self._is_suspect = True
            before_us, self._exposure_us = self._exposure_us, self._control.set(self._camera, exposure_us)
            actual_us = require_taken(self._exposure_us, self._control.bounds.nearest(exposure_us), before_us=before_us)
            self._return_stale_frames()
            triggered_at = self._clock.now()
            self._camera.software_trigger()
            frame = self._wait_for_frame(info, actual_us, triggered_at)
            self._is_suspect = False
        return frame

    def raise_gain(self, by_db: float) -> None:
        """Raise the gain by decibels, and read it back (see `GainCamera`)."""
        self._require_control()
        with self._translate_errors("setting the gain"):
            self._pins = features.raise_gain_by(self._camera, self._pins, self._day_gain_db, by_db=by_db)

    def restore_gain(self) -> None:
        """Restore the gain of the settings, and read it back (see `GainCamera`)."""
        self.raise_gain(0.0)

    def distrust(self) -> None:
        """Begin the next exposure with acquisition stopped and the stream emptied."""
        self._is_suspect = True

    def check(self) -> CameraCondition:
        """Read every pinned setting from the camera (see `SkyCamera`)."""
        self._require_control()
        with self._translate_errors("asking for the settings"):
            changed = list(features.changed_pins(self._camera, self._pins))
            if changed:
                raise errors.CameraLostError(
                    f"the camera was restarted or set by another program: {'; '.join(changed)}"
                )
            return CameraCondition(
                temperature_c=features.temperature_c(self._camera),
                speed=features.simulated_speed(self._camera) if self._simulated else None,
            )

    def abilities(self) -> tuple[tuple[str, str], ...]:
        """Return the camera's abilities: name and description of each."""
        with self._translate_errors("asking what the camera can do"):
            noted = self._noted is not None and self._noted.from_frame
            return tuple(list_abilities(self._camera, exposure=self._control, pins=self._pins, notes_exposures=noted))

    def close(self) -> None:
        """Release the camera, so that it can be opened again; harmless when done twice."""
        if self._info is not None and not self._lost.is_set():  # else it was never started, or hears nothing
            try:
                self._camera.stop_acquisition()
            except self._glib.Error as error:
                _log.debug("stopping the camera: %s", error.message)
        if self._device is not None and self._handler:
            self._device.disconnect(self._handler)
        self._handler = 0
        self._stream = self._noted = self._camera = None
        if self._device is not None:
            wait_for_last_reference(self._device, self._clock)
        self._device = None
        self._info = None

    @property
    def _control(self) -> ExposureControl:
        if self._exposure is None:
            raise errors.CameraLostError(f"the camera at {self._options.address} is not open")
        return self._exposure

    def _require_control(self) -> None:
        if self._lost.is_set():
            raise errors.CameraLostError(f"the camera at {self.info.address} no longer answers")

    def _read_camera_info(self, exposure: ExposureControl) -> CameraInfo:
        camera = self._camera
        pixel_format = str(camera.get_pixel_format_as_string())
        _, _, width, height = camera.get_region()
        return CameraInfo(
            address=self._options.address,
            vendor=str(camera.get_vendor_name() or ""),
            model=str(camera.get_model_name() or ""),
            serial=features.read_serial(camera),
            width=int(width),
            height=int(height),
            pixel_format=pixel_format,
            full_scale=largest_count(pixel_format),
            exposure_min_us=exposure.bounds.minimum_us,
            exposure_max_us=exposure.bounds.maximum_us,
            exposure_step_us=exposure.bounds.step_us,
            gain_raise_db=features.gain_raise_db(camera, self._pins),
        )

    def _open_stream(self, packet_size: int | None) -> None:
        aravis, options = self._aravis, self._options
        if self._camera.is_gv_device():
            if not options.packet_socket:
                self._camera.gv_set_stream_options(aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
            if packet_size is None:
                self._camera.gv_auto_packet_size()
            else:
                self._camera.gv_set_packet_size(packet_size)
        payload = self._camera.get_payload()
        self._stream = self._camera.create_stream(None, None)
        if self._stream is None:
            raise errors.CameraLostError(f"the camera at {options.address} gives no stream")
        if self._camera.is_gv_device():
            # granted up to net.core.rmem_max
            self._stream.set_property("socket-buffer-size", features.PREFERRED_BUFFER_BYTES)
            self._stream.set_property("socket-buffer", aravis.GvStreamSocketBuffer.FIXED)
            self._log_link(payload)
        for _ in range(_BUFFERS):
            self._stream.push_buffer(aravis.Buffer.new_allocate(payload))

    def _log_link(self, payload: int) -> None:
        """Log how the stream is received, and the causes of lost packets."""
        self.link = features.link_to(
            self._options.address,
            packet_bytes=int(self._camera.gv_get_packet_size()),
            frame_bytes=payload,
            packet_socket=self._options.packet_socket,
        )
        _log.info("stream: %s", self.link.text)
        for complaint in self.link.complaints:
            _log.warning("stream: %s", complaint)

    def _start_with_fitting_packets(self, exposure: ExposureControl) -> None:
        """Start acquisition; where frames come incomplete, with smaller packets that pass every network."""
        if self._start_and_discard_frames(exposure) != "incomplete":
            return
        large = self.link.packet_bytes if self.link is not None else 0
        if large <= features.PASSED_EVERYWHERE_BYTES:
            return
        self._restart_stream(features.PASSED_EVERYWHERE_BYTES)
        if self._start_and_discard_frames(exposure) == "whole":
            self._info = replace(self.info, packet_bytes=features.PASSED_EVERYWHERE_BYTES, packet_bytes_lost=large)
            _log.warning("stream: no frame came whole with packets of %d bytes; smaller ones are used", large)
        else:
            self._restart_stream(large)
            self._start_and_discard_frames(exposure)

    def _restart_stream(self, packet_size: int) -> None:
        self._camera.stop_acquisition()
        self._stream = None  # the camera sends to one at a time
        self._open_stream(packet_size)

    def _start_and_discard_frames(self, exposure: ExposureControl) -> Literal["whole", "incomplete", "silent"]:
        """Start acquisition, and take and discard the first frames; return whether any of them came, and came whole."""
        self._camera.start_acquisition()
        self._exposure_us = exposure.set(self._camera, exposure.bounds.minimum_us)
        self._previous_id, self._is_suspect, whole = None, False, False
        for _ in range(_DISCARDED):
            self._camera.software_trigger()
            buffer = self._stream.timeout_pop_buffer(int(self._options.answer_timeout_s * 1e6))
            if buffer is None:
                self._is_suspect = True
                return "silent"
            whole |= buffer.get_status() == self._aravis.BufferStatus.SUCCESS
            self._stream.push_buffer(buffer)
        return "whole" if whole else "incomplete"

    def _return_stale_frames(self) -> None:
        """Return unclaimed frames to the stream."""
        while (buffer := self._stream.try_pop_buffer()) is not None:
            self._stream.push_buffer(buffer)

    def _resynchronise(self) -> None:
        """Wait for a late frame, stop, and start anew: no frame is under way afterwards."""
        late = self._stream.timeout_pop_buffer(int(self._options.answer_timeout_s * 1e6))
        if late is not None:
            self._stream.push_buffer(late)
        self._camera.stop_acquisition()
        self._return_stale_frames()
        if self._start_and_discard_frames(self._control) == "silent":
            raise self._silence_error()

    def _wait_for_frame(self, info: CameraInfo, exposure_us: float, triggered_at: datetime) -> Frame:
        buffer = self._stream.timeout_pop_buffer(int(exposure_us + self._options.answer_timeout_s * 1e6))
        if buffer is None:
            if self._lost.is_set():
                raise errors.CameraLostError("the camera no longer answers")
            raise self._silence_error()
        try:
            return self._check_frame(buffer, info, exposure_us, triggered_at)
        finally:
            self._stream.push_buffer(buffer)

    def _silence_error(self) -> errors.CameraSilentError:
        return errors.CameraSilentError(
            f"no frame came within {self._options.answer_timeout_s:g} s of the exposure's end"
        )

    def _check_frame(
        self,
        buffer: Any,  # noqa: ANN401 - a GObject
        info: CameraInfo,
        exposure_us: float,
        triggered_at: datetime,
    ) -> Frame:
        status = buffer.get_status()
        if status != self._aravis.BufferStatus.SUCCESS:  # nothing else of such a buffer may be touched
            raise incomplete(status.value_nick)
        if (buffer.get_image_width(), buffer.get_image_height()) != (info.width, info.height):
            raise errors.CameraError(f"a frame of {buffer.get_image_width()}×{buffer.get_image_height()} px came")
        image = decode_frame(buffer.get_image_data(), info)
        frame_id = int(buffer.get_frame_id())
        if self._previous_id is not None and not follows(self._previous_id, frame_id):
            raise errors.CameraError(f"frame {frame_id} came after frame {self._previous_id}")
        self._previous_id = frame_id
        if self._noted is not None:
            require_exposure(self._noted.of(buffer), exposure_us)
        started_at, offset_s = triggered_at, None
        if self._options.timestamps == "camera":
            started_at = timestamp_to_utc(int(buffer.get_timestamp()), self._options)
            offset_s = (started_at - triggered_at).total_seconds()
        return Frame(
            image=image,
            time=exposure_middle(started_at, exposure_us),
            exposure_us=exposure_us,
            gain_db=features.gain_db(self._pins),
            pixel_format=info.pixel_format,
            full_scale=info.full_scale,
            frame_id=frame_id,
            host_offset_s=offset_s,
            binning=self._options.binning,
            raised_db=features.gain_db(self._pins) - self._day_gain_db,
        )

    @contextmanager
    def _translate_errors(self, doing: str) -> Iterator[None]:
        """Turn the library's errors into ours: a command that stays unanswered means that the camera is gone."""
        missing = self._aravis.DeviceError
        try:
            yield
        except self._glib.Error as error:
            quark = self._aravis.device_error_quark()
            codes = (missing.TIMEOUT, missing.NOT_CONNECTED, missing.NOT_CONTROLLER, missing.NOT_FOUND)
            if self._lost.is_set() or any(error.matches(quark, code) for code in codes):
                raise errors.CameraLostError(
                    f"{doing}: no answer ({error.message}); check power and network"
                ) from error
            raise errors.CameraError(f"{doing}: {error.message}") from error


def _import_aravis() -> tuple[Any, Any]:
    """Return Aravis and GLib as their introspection gives them, untyped."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ImportWarning)  # gi's importer is of an older protocol
            import gi  # noqa: PLC0415 - a machine without a GigE camera needs none of this

            gi.require_version("Aravis", "0.8")
            from gi.repository import Aravis, GLib  # noqa: PLC0415 - only after the version was required
    except (ImportError, ValueError) as error:
        raise errors.ConfigurationError(
            f"Aravis is missing ({error}); run: apt-get install python3-gi gir1.2-aravis-0.8, "
            "and use a virtual environment on /usr/bin/python3"
        ) from None
    return Aravis, GLib


# The abilities of a GenICam camera, in words for its installation.


def list_abilities(
    camera: Any,  # noqa: ANN401 - a GObject has no types
    *,
    exposure: ExposureControl,
    pins: tuple[features.Pin, ...],
    notes_exposures: bool,
) -> Iterator[tuple[str, str]]:
    """Yield the abilities of the camera, and which of them are used."""
    width, height = camera.get_sensor_size()
    binning = "bins" if features.has(camera, "BinningHorizontal") else "does not bin"
    yield "sensor", f"{width}x{height} px, {binning}"
    offered = [str(name) for name in camera.dup_available_pixel_formats_as_strings()]
    left_out = [name for name in offered if not features.is_usable(name)]
    not_used = f" (of no use here: {', '.join(left_out)})" if left_out else ""
    yield "pixel formats", ", ".join(name for name in offered if features.is_usable(name)) + not_used
    for what, names in (("gain", features.GAIN), ("black level", features.BLACK_LEVEL)):
        name = features.first(camera, names)
        pinned = next((pin.value for pin in pins if pin.name == name), None)
        yield what, "cannot be set" if name is None else f"{name}, held at {pinned}"
    noted = (
        "noted by the camera beside each frame"
        if notes_exposures
        else "read back from the camera, and judged by brightness"
    )
    yield "exposure", f"by {exposure.feature}; {noted}"
    degrees = features.temperature_c(camera)
    yield "temperature", "not reported" if degrees is None else f"{degrees:.1f} °C"
    yield "held settings", ", ".join(f"{pin.name} {pin.value}" for pin in pins)


# Checks of a received frame: complete, next in number, of the exposure that was set.

_CHUNK_TOLERANCE = 0.01


def follows(previous_id: int, frame_id: int) -> bool:
    """Return whether a frame count follows the previous one; GigE Vision 1 counts 1 … 65535 and leaves out 0."""
    return frame_id == previous_id + 1 or (previous_id == 65_535 and frame_id == 1)


def require_exposure(noted_us: float, exposure_us: float) -> None:
    """Raise `CameraError` when the exposure that a frame notes of itself is not the one that was read back."""
    if not abs(noted_us - exposure_us) <= max(1.0, _CHUNK_TOLERANCE * exposure_us):
        raise errors.CameraError(f"a frame notes an exposure of {noted_us:g} µs, not {exposure_us:g} µs")


def decode_frame(data: bytes, info: CameraInfo) -> Image:
    """Return the counts of a frame's bytes, which may have been cut short."""
    count, packing = info.width * info.height, packed_layout(info.pixel_format)
    depth = 1 if info.full_scale == 255 else 2
    expected = count * depth if packing is None else packed_bytes(packing, count)
    if len(data) < expected:
        raise errors.CameraError(
            f"a frame of {len(data)} bytes came, {expected} bytes in {info.pixel_format} are expected"
        )
    if packing is not None:
        return _make_read_only(unpack(data, packing, count)).reshape(info.height, info.width)
    flat = np.frombuffer(data, np.uint8, count) if depth == 1 else np.frombuffer(data, np.uint16, count)
    return flat.reshape(info.height, info.width)


def _make_read_only(image: Image) -> Image:
    image.flags.writeable = False
    return image


def incomplete(status: str) -> errors.CameraError:
    """Return the error for the status of an unusable buffer."""
    if status in {"timeout", "missing-packets"}:
        return errors.CameraTimeoutError(
            f"packets of the frame were lost ({status}); see the network's buffer settings"
        )
    return errors.CameraError(f"the frame is not usable ({status})")
