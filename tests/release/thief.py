"""Takes control of a camera as soon as it is to be had, holds it, and lets go. Arguments: address, seconds."""

from __future__ import annotations

import sys
import threading

from sunarc.common.errors import CameraError
from sunarc.imager.cameras.aravis import open_aravis
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import SystemClock

address, hold_s = sys.argv[1], float(sys.argv[2])
clock = SystemClock()
print("trying", flush=True)
until = clock.monotonic() + 15.0
while clock.monotonic() < until:
    try:
        camera = open_aravis(AravisOptions(address=address), clock)
    except CameraError:
        continue
    camera.expose(777.0)
    clock.wait(threading.Event(), hold_s)
    camera.close()
    break
