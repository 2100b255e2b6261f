"""What a small computer needs: start, detection, refit and memory under limits of processor and memory (cgroups).

    python docs/studies/small_computer.py --state FOLDER [--share 0.25] [--memory-mb 2000]

As root: makes a control group, and measures within it. FOLDER gets a database of a year (500,000 sightings) unless it
has one. Share is that of one core. On a host with other work the wall time is longer than processor time over share.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import threading
import uuid
from datetime import timedelta
from functools import partial
from pathlib import Path

import cv2
import five_years
import numpy as np

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.imager.archive.archive import CameraArchive, open_archive
from sunarc.imager.archive.values import Refit
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.options import RefitOptions
from sunarc.lab.simulation.made_archive import encoded, photograph
from sunarc.lab.simulation.truth import SGP
from sunarc.sources.detect_files import detect_in_image
from sunarc.sources.image_files import checked_image

_GROUPS = Path("/sys/fs/cgroup")
_PERIOD_US = 100_000
_DAYS, _SIGHTINGS = 365, 500_000
_TWELVE_MEGAPIXELS = (4056, 3040)
"""Of the Raspberry Pi's high-quality camera."""


def main() -> None:
    """Measure in a control group, or within it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--state", type=Path, required=True)
    parser.add_argument("--share", type=float, default=0.25)
    parser.add_argument("--memory-mb", type=int, default=2000)
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    vars(five_years).update(DAYS=_DAYS, SIGHTINGS=_SIGHTINGS, END=five_years.START + timedelta(days=_DAYS))
    path = options.state / "sunarc.sqlite"
    vars(sys.modules["__main__"]).pop("__file__", None)  # which the process of a solve would read: see five_years.py
    if options.inside:
        measure(path)
        return
    options.state.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        five_years.make(path)
    run_limited(
        [sys.executable, *sys.argv, "--inside"], share=options.share, memory_bytes=options.memory_mb * 1_000_000
    )


def run_limited(command: list[str], *, share: float, memory_bytes: int) -> None:
    """Run a command within a share of a core and an amount of memory, and remove the group again."""
    name = f"small-{os.getpid()}"
    quota = round(share * _PERIOD_US)
    if (_GROUPS / "cgroup.controllers").exists():
        groups = {_GROUPS / name: {"cpu.max": f"{quota} {_PERIOD_US}", "memory.max": str(memory_bytes)}}
    else:
        groups = {
            _GROUPS / "cpu" / name: {"cpu.cfs_period_us": str(_PERIOD_US), "cpu.cfs_quota_us": str(quota)},
            _GROUPS / "memory" / name: {"memory.limit_in_bytes": str(memory_bytes)},
        }
    for group, limits in groups.items():
        group.mkdir()
        for limit, value in limits.items():
            (group / limit).write_text(value)

    def enter() -> None:
        for group in groups:
            (group / "cgroup.procs").write_text(str(os.getpid()))

    try:
        subprocess.run(command, check=True, preexec_fn=enter)  # noqa: S603 - our own command, no threads yet
        for group in groups:
            most = group / "memory.max_usage_in_bytes"
            if most.exists():
                print(f"most memory of the group, cached files too: {int(most.read_text()) / 1e6:.0f} MB")
    finally:
        for group in groups:
            _remove(group)


def _remove(group: Path) -> None:
    """Remove a group once its last process has left it."""
    for _ in range(100):
        try:
            group.rmdir()
        except OSError:
            SystemClock().wait(threading.Event(), 0.1)
        else:
            return


def measure(path: Path) -> None:
    """Print what each takes, and the most memory of this process so far."""
    for _ in range(2):
        five_years.start(path)
    width, height = _TWELVE_MEGAPIXELS
    square = photograph(width // 4, np.array([300.0, 400.0]), np.random.default_rng(3))
    middle = square[(width - height) // 8 : (width + height) // 8]
    jpeg = encoded(np.asarray(cv2.resize(middle, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.uint8))
    for _ in range(3):
        five_years.measured("decode and search a JPEG of 12 MP", partial(look, jpeg))
    show_memory()
    archive = open_archive(path)
    board = StatusRegistry(version="study", started_at=five_years.END, monotonic=SystemClock().monotonic)
    worker = RefitWorker(
        camera=CameraArchive(archive, name="roof", site=SGP),
        options=RefitOptions(),
        calibration=CalibrationOptions(),
        cadence_s=30.0,
        clock=SystemClock(),
        now=lambda: five_years.END,
        board=board,
    )
    for what in ("the first refit of a year", "a nightly refit of a year"):
        new = Refit(id=uuid.uuid4().hex, camera="roof", requested_at=five_years.END, reason="study")
        refit = archive.refits.add(new)
        five_years.measured(what, partial(worker.carry_out, refit, threading.Event(), lambda: None))
        print(archive.refits.get(refit.id).state, flush=True)
    show_memory()


def look(jpeg: bytes) -> None:
    """Decode a picture and find its sun."""
    found = detect_in_image(checked_image(jpeg, "picture.jpg"))
    print(f"{found.verdict} at {found.x_px}, {found.y_px}")


def show_memory() -> None:
    """Print the most memory so far, of this process and of its largest child."""
    own, child = (resource.getrusage(who).ru_maxrss / 1e3 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    print(f"most resident memory: {own:.0f} MB, the largest child's {child:.0f} MB", flush=True)


if __name__ == "__main__":
    main()
