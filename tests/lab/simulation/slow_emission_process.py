"""Closes a camera while the library's signal that it is lost is being emitted; "closed" is its last line."""

from __future__ import annotations

import threading
import time

from sunarc.imager.cameras.aravis import open_aravis
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import SystemClock
from sunarc.lab.simulation import fake_camera as genicam

emitting = threading.Event()


def slow(*_: object) -> None:
    emitting.set()
    time.sleep(0.5)  # noqa: TID251 - the library's thread is held up for real


options = AravisOptions(address="127.0.0.1", packet_size=60_000, packet_socket=False)
camera = open_aravis(options, SystemClock())
camera._device.connect("control-lost", slow)
camera._device.write_register(genicam.CONTROL_PRIVILEGE, 0)
assert emitting.wait(30.0)
camera.close()
time.sleep(1.0)  # noqa: TID251 - the library's thread goes on
print("closed", flush=True)  # noqa: T201 - the test reads it
