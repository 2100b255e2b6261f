"""Capture over GigE Vision for hours, with a fault every now and then; not part of the tests (test_soak.py is).

    tests/release/soak.py --cycles 3000 [--seed 1] [--cadence 0.6] [--fault-every 60] [--json FILE]

A simulated imager in a process of its own serves frames, the very worker of the service takes them. Every frame that
is handed on is rendered again from the scene, for the time and exposure that it states, and compared pixel by pixel:
the comparison knows nothing of the adapter. Needs port 3956 of 127.0.0.1 (a network namespace of its own is best).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import random
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

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
from sunarc.lab.simulation.imager import ImagerOptions, make_scene

ADDRESS = "127.0.0.1"
START = datetime(2013, 5, 13, 22, 40, tzinfo=UTC)
REGION = (300, 1250, 420, 400)  # holds the sun from the start on for two hours, and a corner beyond the lens's field
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
IMAGER = Path(__file__).parents[1] / "lab" / "simulation" / "imager_process.py"
THIEF = Path(__file__).with_name("thief.py")
FAULTS = (
    "kill",
    "freeze",
    "power_cycle",
    "loss",
    "wrong_exposure",
    "wrong_exposures",
    "stale_exposure",
    "stolen",
    "changed",
)
_SETTLING = 8  # slots
HDR_US = (3_000.0, 12_000.0, 48_000.0)
_log = logging.getLogger("soak")


@dataclass(kw_only=True)
class Outcome:
    """What a soak found; `recoveries_s` run from the end of each fault to the next complete cycle."""

    cycles: int = 0
    complete: int = 0
    frames: int = 0
    wrong: list[str] = field(default_factory=list)
    faults: dict[str, int] = field(default_factory=dict)
    recoveries_s: dict[str, list[float]] = field(default_factory=dict)
    undisturbed: int = 0
    incomplete_undisturbed: list[str] = field(default_factory=list)
    before: dict[str, float] = field(default_factory=dict)
    after: dict[str, float] = field(default_factory=dict)
    capture: dict[str, Any] = field(default_factory=dict)


class Imager:
    """The simulated camera's process; its time goes on when it is started again."""

    def __init__(self, folder: Path, clock: SystemClock, *, real_exposures: bool = False) -> None:
        self._folder = folder
        self._settings = imager_settings() | {"real_exposures": real_exposures}
        self._clock = clock
        self._began = clock.monotonic()
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        truth = self._folder / "truth.json"
        truth.unlink(missing_ok=True)
        start = START + timedelta(seconds=self._clock.monotonic() - self._began)
        arguments = [json.dumps(self._settings), start.isoformat(), str(truth), "orders"]
        self._process = subprocess.Popen([sys.executable, str(IMAGER), *arguments], stdin=subprocess.PIPE, text=True)
        until = self._clock.monotonic() + 90.0
        while not truth.exists() and self._clock.monotonic() < until:
            self._clock.wait(threading.Event(), 0.05)

    def order(self, name: str, value: int) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(f"{name} {value}\n")
        self._process.stdin.flush()

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait(timeout=10)
            if self._process.stdin is not None:
                with contextlib.suppress(BrokenPipeError):
                    self._process.stdin.close()
            self._process = None


def imager_settings() -> dict[str, Any]:
    return {"address": ADDRESS, "clouds": "clear", "skip_nights": False}


class Soak:
    """Joins worker, judge and faults."""

    def __init__(self, imager: Imager, *, cadence_s: float, seed: int) -> None:
        self.clock = SystemClock()
        self.imager = imager
        self.cadence_s = cadence_s
        self.random = random.Random(seed)
        self.stop = threading.Event()
        self.outcome = Outcome()
        self.scene = make_scene(ImagerOptions(**imager_settings(), start=START))
        self.cycles: DropOldestQueue[Sequence[Frame]] = DropOldestQueue(capacity=50)
        self.sun_frames: DropOldestQueue[Frame] = DropOldestQueue(capacity=200)
        self.board = StatusRegistry(version="soak", started_at=START, monotonic=self.clock.monotonic)
        self.frame_time = FrameTime(self.clock, follows_camera=True)
        self.completed: dict[int, float] = {}
        self.disturbed: list[tuple[float, float]] = []
        self.slots: list[tuple[float, int]] = []
        self.settled_at = 0.0

    def worker(self) -> CaptureWorker:
        options = AravisOptions(
            address=ADDRESS,
            region=REGION,
            timestamps="camera",
            packet_size=60_000,
            packet_socket=False,
            answer_timeout_s=0.25,
        )
        return CaptureWorker(
            open_camera=lambda: open_aravis(options, self.clock),
            clock=self.clock,
            frame_time=self.frame_time,
            options=CaptureOptions(
                cadence_s=self.cadence_s, hdr_exposures_us=HDR_US, reopen_after_s=0.2, reopen_at_most_s=1.0
            ),
            name="soak",
            apparent_zenith=lambda: 60.0,
            sun_exposures=SunExposures(SunExposureOptions()),
            cycles=self.cycles,
            sun_frames=self.sun_frames,
            board=self.board,
        )

    def judge(self) -> None:
        """Compare what was handed on with the truth."""
        while not self.stop.is_set():
            cycle = self.cycles.get(timeout_s=0.05)
            sun = self.sun_frames.get(timeout_s=0.0)
            for frame in [*(cycle or ()), *([sun] if sun else ())]:
                self.outcome.frames += 1
                if not np.array_equal(frame.image, self._truth(frame)):
                    self.outcome.wrong.append(f"{frame.time.isoformat()} {frame.exposure_us:g} us")
            if cycle:
                began = (cycle[0].time - EPOCH).total_seconds()
                self.completed[int(began // self.cadence_s)] = self.clock.monotonic()

    def _truth(self, frame: Frame) -> np.ndarray[Any, Any]:
        start_us = (frame.time - EPOCH) // timedelta(microseconds=1) - round(frame.exposure_us / 2)
        return self.scene.render(start_us, exposure_us=frame.exposure_us, full_scale=4095, region=REGION)

    def wait(self, seconds: float) -> None:
        """Wait, and note which slot it is when."""
        until = self.clock.monotonic() + seconds
        while (now := self.clock.monotonic()) < until:
            if self.frame_time.is_known:
                self.slots.append((now, int(self.frame_time.now().timestamp() // self.cadence_s)))
            self.clock.wait(self.stop, min(0.2, until - now))

    def faults(self) -> Iterator[str]:
        """Return faults without end, each kind once before any comes again."""
        while True:
            yield from self.random.sample(FAULTS, len(FAULTS))

    def disturb(self, fault: str) -> None:
        """Do a fault, and wait until a cycle is complete again."""
        began = self.clock.monotonic()
        _log.warning("fault: %s", fault)
        getattr(self, f"_{fault}")()
        ended = self.clock.monotonic()
        while not any(at > ended for at in self.completed.values()) and self.clock.monotonic() < ended + 60.0:
            self.wait(0.05)
        recovered = self.clock.monotonic()
        self.wait(2.0 * self.cadence_s)
        self.disturbed.append((began, recovered))
        _log.warning("from %.1f s to %.1f s", began - self.slots[0][0], recovered - self.slots[0][0])
        self.outcome.faults[fault] = self.outcome.faults.get(fault, 0) + 1
        self.outcome.recoveries_s.setdefault(fault, []).append(round(recovered - ended, 2))

    def _kill(self) -> None:
        self.imager.kill()
        self.wait(self.random.uniform(0.0, 6.0))
        self.imager.start()

    def _freeze(self) -> None:
        freeze_ms = self.random.choice([700, 3000])
        self.imager.order("FREEZE", freeze_ms)
        self.wait(freeze_ms / 1000.0 + self.cadence_s)

    def _power_cycle(self) -> None:
        self.imager.order("POWER_CYCLE", 1)
        self.wait(0.1)

    def _loss(self) -> None:
        self.imager.order("LOSS", self.random.choice([100, 500, 1000]))
        self.wait(2.0)
        self.imager.order("LOSS", 0)

    def _wrong_exposure(self) -> None:
        for _ in range(8):
            self.imager.order("WRONG_EXPOSURE", self.random.choice([25, 400, 1600]))
            self.wait(self.random.uniform(0.3, 0.7))
        self.imager.order("WRONG_EXPOSURE", 0)

    def _wrong_exposures(self) -> None:
        """All frames alike, as their ratios cannot tell: for several cycles, or beginning or ending within one."""
        self.imager.order("ALL_EXPOSURES", self.random.choice([25, 400, 1600]))
        self.wait(self.random.uniform(0.2, 5.0))
        self.imager.order("ALL_EXPOSURES", 0)

    def _stale_exposure(self) -> None:
        self.imager.order("STALE_EXPOSURE", 1)
        self.wait(2.0)
        self.imager.order("STALE_EXPOSURE", 0)

    def _stolen(self) -> None:
        with subprocess.Popen([sys.executable, str(THIEF), ADDRESS, "3"], stdout=subprocess.PIPE, text=True) as thief:
            assert thief.stdout is not None
            thief.stdout.readline()  # it is trying
            self.imager.order("DROP_CONTROL", 1)
            while thief.poll() is None:
                self.wait(0.1)

    def _changed(self) -> None:
        self.imager.order(self.random.choice(["GAIN_AUTO", "EXPOSURE_AUTO", "GAMMA", "GAIN"]), 1)
        self.wait(0.1)

    def footing(self) -> dict[str, float]:
        status = Path("/proc/self/status").read_text()
        found = dict(line.split(":", 1) for line in status.splitlines())
        return {
            "resident_mb": round(int(found["VmRSS"].split()[0]) / 1024.0, 1),
            "threads": float(found["Threads"]),
            "files": float(len(list(Path("/proc/self/fd").iterdir()))),
        }

    def tell(self) -> Outcome:
        """Count what was complete."""
        outcome = self.outcome
        slots: dict[int, float] = {}
        for at, slot in self.slots:
            slots.setdefault(slot, at)
        quiet = [
            slot
            for slot, at in sorted(slots.items())[:-3]
            if at >= self.settled_at
            and not any(began - self.cadence_s <= at <= ended + 2.0 * self.cadence_s for began, ended in self.disturbed)
        ]
        missing = [slot for slot in quiet if slot not in self.completed]
        status = self.board.snapshot().capture
        outcome.cycles, outcome.complete = len(slots), len(self.completed)
        outcome.undisturbed = len(quiet)
        outcome.incomplete_undisturbed = [f"{slots[slot] - self.slots[0][0]:.1f} s" for slot in missing]
        outcome.capture = {} if status is None else asdict(status)
        return outcome

    @contextmanager
    def running(self) -> Iterator[None]:
        worker = self.worker()
        threads = [
            threading.Thread(target=worker.run, args=(self.stop, lambda: None)),
            threading.Thread(target=self.judge),
        ]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            self.stop.set()
            for thread in threads:
                thread.join(timeout=20.0)


def soak(
    *, cycles: int, seed: int, cadence_s: float, fault_every: int, progress: Callable[[str], None] = lambda _: None
) -> Outcome:
    """Run for so many slots, and not less than one fault of each kind; return what was found."""
    with TemporaryDirectory(prefix="sunarc-soak-") as folder:
        clock = SystemClock()
        imager = Imager(Path(folder), clock)
        try:
            imager.start()
            run = Soak(imager, cadence_s=cadence_s, seed=seed)
            with run.running():
                run.wait(_SETTLING * cadence_s)
                run.settled_at, run.outcome.before = clock.monotonic(), run.footing()
                until = clock.monotonic() + (cycles - _SETTLING) * cadence_s
                for fault in run.faults():
                    run.wait(cadence_s * run.random.uniform(0.5, 1.5) * fault_every)
                    run.disturb(fault)
                    progress(f"{len(run.completed)} complete, {len(run.outcome.wrong)} wrong, {run.footing()}")
                    if clock.monotonic() > until and len(run.outcome.faults) == len(FAULTS):
                        break
                run.wait(5.0 * cadence_s)
                run.outcome.after = run.footing()
            return run.tell()
        finally:
            imager.kill()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cadence", type=float, default=0.6, help="seconds from slot to slot")
    parser.add_argument("--fault-every", type=int, default=60, help="cycles from fault to fault, on average")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(name)s: %(message)s")
    outcome = soak(
        cycles=arguments.cycles,
        seed=arguments.seed,
        cadence_s=arguments.cadence,
        fault_every=arguments.fault_every,
        progress=lambda text: print(text, flush=True),
    )
    text = json.dumps(asdict(outcome), indent=1)
    print(text)
    if arguments.json is not None:
        arguments.json.write_text(text)
    return 1 if outcome.wrong or outcome.incomplete_undisturbed else 0


if __name__ == "__main__":
    sys.exit(main())
