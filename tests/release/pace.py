"""How punctual cycles are at real time, with the sun exposures and without, by turns; not part of the tests.

    tests/release/pace.py [--cycles 20] [--cadence 2] [--turn 1]

Frames cross GigE Vision on loopback from a simulated imager whose exposures take their time. One worker takes all
cycles; for so many of them (`--turn`) the sun is up, for so many it is not, so that both meet the same machine. Needs
port 3956 of 127.0.0.1 (a network namespace of its own is best).
"""

from __future__ import annotations

import argparse
import json
import statistics
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from soak import ADDRESS, HDR_US, REGION, START, Imager  # type: ignore[import-not-found] # beside this script

from sunarc.imager.cameras.aravis import open_aravis
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.capture import CaptureWorker
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.imager.workers.exposures import SunExposures
from sunarc.imager.workers.options import CaptureOptions
from sunarc.imaging.exposure import SunExposureOptions

_SETTLING = 4
_UP_DEG, _DOWN_DEG = 60.0, 92.0  # apparent zenith angles: in daylight both


@dataclass(kw_only=True)
class Kind:
    """Cycles of one kind: how late each was, and how long its normal exposures took, ms."""

    late_ms: list[float] = field(default_factory=list)
    hdr_ms: list[float] = field(default_factory=list)
    sun_frames: int = 0

    def told(self) -> dict[str, Any]:
        """Return medians and extremes."""
        return {
            "cycles": len(self.late_ms),
            "sun_frames": self.sun_frames,
            "late_ms": {"median": round(statistics.median(self.late_ms), 2), "largest": max(self.late_ms)},
            "hdr_ms": {"median": round(statistics.median(self.hdr_ms), 2), "largest": max(self.hdr_ms)},
        }


class Pace:
    """One worker, and the sun that is switched on and off beneath it."""

    def __init__(self, *, cadence_s: float) -> None:
        self.clock, self.stop = SystemClock(), threading.Event()
        self.board = StatusRegistry(version="pace", started_at=START, monotonic=self.clock.monotonic)
        self.done: DropOldestQueue[Sequence[Frame]] = DropOldestQueue(capacity=4)
        self.sun_frames: DropOldestQueue[Frame] = DropOldestQueue(capacity=10)
        self.zenith_deg = _DOWN_DEG
        self.cadence_s = cadence_s

    def worker(self) -> CaptureWorker:
        options = AravisOptions(address=ADDRESS, region=REGION, packet_size=60_000, packet_socket=False)
        return CaptureWorker(
            open_camera=lambda: open_aravis(options, self.clock),
            clock=self.clock,
            frame_time=FrameTime(self.clock, follows_camera=False),
            options=CaptureOptions(cadence_s=self.cadence_s, hdr_exposures_us=HDR_US),
            name="pace",
            apparent_zenith=lambda: self.zenith_deg,
            sun_exposures=SunExposures(SunExposureOptions()),
            cycles=self.done,
            sun_frames=self.sun_frames,
            board=self.board,
        )

    def run(self, *, cycles: int, turn: int) -> dict[bool, Kind]:
        """Take so many cycles of either kind, after some to settle; the sun changes between two slots."""
        kinds = {True: Kind(), False: Kind()}
        for number in range(_SETTLING + 2 * cycles):
            with_sun = number // turn % 2 == 0
            self.zenith_deg = _UP_DEG if with_sun else _DOWN_DEG
            before, until = self._served(), self.clock.monotonic() + 10.0 * self.cadence_s + 10.0
            while self._served() == before and self.clock.monotonic() < until:
                self.clock.wait(self.stop, 0.02)
            self._take(kinds[with_sun], counting=number >= _SETTLING)
        return kinds

    def _served(self) -> int:
        status = self.board.snapshot().capture
        return 0 if status is None else status.cycles

    def _take(self, kind: Kind, *, counting: bool) -> None:
        while self.done.get(timeout_s=0.0) is not None:
            pass
        taken = 0
        while self.sun_frames.get(timeout_s=0.0) is not None:
            taken += 1
        status = self.board.snapshot().capture
        if counting and status is not None and status.jitter_s is not None and status.hdr_s is not None:
            kind.late_ms.append(round(status.jitter_s * 1e3, 2))
            kind.hdr_ms.append(round(status.hdr_s * 1e3, 2))
            kind.sun_frames += taken


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=20, help="of either kind")
    parser.add_argument("--cadence", type=float, default=2.0, help="seconds from slot to slot")
    parser.add_argument("--turn", type=int, default=1, help="cycles of one kind in a row")
    arguments = parser.parse_args()
    with TemporaryDirectory(prefix="sunarc-pace-") as folder:
        imager, pace = Imager(Path(folder), SystemClock(), real_exposures=True), Pace(cadence_s=arguments.cadence)
        thread = threading.Thread(target=pace.worker().run, args=(pace.stop, lambda: None))
        try:
            imager.start()
            thread.start()
            kinds = pace.run(cycles=arguments.cycles, turn=arguments.turn)
        finally:
            pace.stop.set()
            if thread.is_alive():
                thread.join(timeout=20.0)
            imager.kill()
    told = {("with sun exposures" if with_sun else "without"): kind.told() for with_sun, kind in kinds.items()}
    told["difference_of_medians_ms"] = round(
        told["with sun exposures"]["hdr_ms"]["median"] - told["without"]["hdr_ms"]["median"], 2
    )
    print(json.dumps(told, indent=1))


if __name__ == "__main__":
    main()
