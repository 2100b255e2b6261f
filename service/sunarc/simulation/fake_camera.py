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
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.errors import ConfigurationError, OutsideError
from sunarc.simulation import genicam

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
        return Request(
            self.read(genicam.EXPOSURE), self.read(genicam.GAIN), self.read(genicam.PIXEL_FORMAT), self._region()
        )

    def _region(self) -> tuple[int, int, int, int]:
        """Return x, y, width and height."""
        x, y, width, height = map(self.read, (genicam.OFFSET_X, genicam.OFFSET_Y, genicam.WIDTH, genicam.HEIGHT))
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

        def called(buffer: int, _: object, exposure_us: int, gain_steps: int, pixel_format: int) -> None:
            with self._lock:
                if not self._closed:
                    answer(buffer, exposure_us, gain_steps, pixel_format)

        def answer(buffer: int, exposure_us: int, gain_steps: int, pixel_format: int) -> None:
            try:
                request = Request(exposure_us, gain_steps, pixel_format, self._region())
                self._write_frame(buffer, *fill(request))
            except Exception:  # noqa: BLE001 - nothing may pass through the C frames above
                _log.exception("a frame could not be rendered")

        self._callback = _FILL(called)  # kept for as long as the library may call it
        self._library.arv_fake_camera_set_fill_pattern(self._camera, self._callback, None, None)

    def close(self) -> None:
        """Let a frame that is being filled be the last one.

        A call that held the camera while it is let go would end it in its own thread, which then waits for itself.
        """
        with self._lock:
            self._closed = True

    def _write_frame(self, buffer: int, image: NDArray[np.uint8], timestamp_ns: int) -> None:
        # the library has compared the buffer with what the registers say; a larger image would end the process
        bits = self.read(genicam.PIXEL_FORMAT) >> 16 & 0xFF
        expected = self.read(genicam.WIDTH) * self.read(genicam.HEIGHT) * bits // 8
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
    library = _load()
    _require_free_port(address)
    with TemporaryDirectory(prefix="sunarc-imager-") as folder:
        path = Path(folder) / "genicam.xml"
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


def _load() -> ctypes.CDLL:
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
