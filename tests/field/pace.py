"""How punctual cycles are at real time, with the sun exposures and without; not part of the tests.

    tests/field/pace.py [--cycles 20] [--cadence 2]

Frames cross GigE Vision on loopback from a simulated imager whose exposures take their time. Needs port 3956 of
127.0.0.1 (a network namespace of its own is best).
"""

from __future__ import annotations

import argparse
import json
import statistics
import threading
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from soak import ADDRESS, HDR_US, REGION, START, Imager  # type: ignore[import-not-found] # beside this script

from sunarc.board import StatusBoard
from sunarc.cameras import AravisOptions, Frame, open_aravis
from sunarc.clock import SystemClock
from sunarc.imaging import SunExposureOptions
from sunarc.workers import CaptureOptions, CaptureWorker, FrameTime, Handover, SunExposures


def pace(*, cycles: int, cadence_s: float, with_sun: bool) -> dict[str, Any]:
    """Run so many cycles, and return how late each was and how long its normal exposures took, in ms."""
    clock, stop = SystemClock(), threading.Event()
    board = StatusBoard(version="pace", started_at=START, monotonic=clock.monotonic)
    done: Handover[Sequence[Frame]] = Handover(capacity=4)
    options = AravisOptions(address=ADDRESS, region=REGION, packet_size=60_000, packet_socket=False)
    worker = CaptureWorker(
        open_camera=lambda: open_aravis(options, clock),
        clock=clock,
        frame_time=FrameTime(clock, follows_camera=False),
        options=CaptureOptions(cadence_s=cadence_s, hdr_exposures_us=HDR_US),
        name="pace",
        apparent_zenith=lambda: 60.0 if with_sun else 90.0,
        sun_exposures=SunExposures(SunExposureOptions()),
        cycles=done,
        sun_frames=Handover(capacity=4),
        board=board,
    )
    thread = threading.Thread(target=worker.run, args=(stop, lambda: None))
    thread.start()
    late_ms, hdr_ms = [], []
    for _ in range(cycles):
        done.get(timeout_s=10.0 * cadence_s)
        clock.wait(stop, 0.3)
        status = board.snapshot().capture
        if status is not None and status.jitter_s is not None and status.hdr_s is not None:
            late_ms.append(round(status.jitter_s * 1e3, 2))
            hdr_ms.append(round(status.hdr_s * 1e3, 2))
    stop.set()
    thread.join(timeout=20.0)
    return {
        "sun_exposures": with_sun,
        "late_ms": {"median": statistics.median(late_ms), "largest": max(late_ms)},
        "hdr_ms": {"median": statistics.median(hdr_ms), "largest": max(hdr_ms)},
        "cycles": len(late_ms),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=20)
    parser.add_argument("--cadence", type=float, default=2.0)
    arguments = parser.parse_args()
    with TemporaryDirectory(prefix="sunarc-pace-") as folder:
        imager = Imager(Path(folder), SystemClock(), real_exposures=True)
        try:
            imager.start()
            told = [
                pace(cycles=arguments.cycles, cadence_s=arguments.cadence, with_sun=with_sun)
                for with_sun in (False, True)
            ]
        finally:
            imager.kill()
    print(json.dumps(told, indent=1))  # noqa: T201 - a script


if __name__ == "__main__":
    main()
