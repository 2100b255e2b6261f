"""A large made archive with one worker and with two: tests/long archive [--images N] [--broken N].

Prints, for each number of workers, wall and processor seconds and the largest resident memory of the command and of a
worker early and late in the run; whether the tables of both runs are equal; how many images, broken files and epochs
there are.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path
from time import perf_counter
from typing import Any

from sunarc.imager.runtime.clock import SystemClock
from sunarc.lab.simulation.made_archive import FOUR_CAMERAS, MadeArchive, write_archive

TABLES = ("sightings.csv", "epochs.json", "failures.csv")
_PER_DAY = 40
_SAMPLE_S = 1.0


def main() -> None:
    """Make the archive, analyse it twice, and print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=20_000, help="of all four cameras")
    parser.add_argument("--broken", type=int, default=500, help="files among them")
    asked = parser.parse_args()
    cameras = len(FOUR_CAMERAS)
    days = max(asked.images // (cameras * _PER_DAY), 6)
    made = MadeArchive(cameras=FOUR_CAMERAS, days=days, per_day=_PER_DAY, broken=asked.broken // cameras)
    with tempfile.TemporaryDirectory(prefix="archive-") as folder:
        begun = perf_counter()
        path = write_archive(made, Path(folder) / "images")
        print(f"{cameras * days * _PER_DAY} images and {cameras * made.broken} broken files made in "
              f"{perf_counter() - begun:.0f} s", flush=True)  # fmt: skip
        runs = [analysed(path, Path(folder) / f"workers-{workers}", workers) for workers in (1, 2)]
        same = all((runs[0] / name).read_bytes() == (runs[1] / name).read_bytes() for name in TABLES)
        print(f"tables equal: {same}")
        for epoch in json.loads((runs[0] / "epochs.json").read_text()):
            print(" ".join(f"{key} {epoch[key]}" for key in ("camera", "epoch", "start", "end", "cause")))
        print(f"{len((runs[0] / 'failures.csv').read_text().splitlines()) - 1} files in failures.csv")


def analysed(path: Path, target: Path, workers: int) -> Path:
    """Run the command and print what it cost; return the folder of its results."""
    command = [sys.executable, "-m", "sunarc", "reanalyse", "--cameras", str(path), "--workers", str(workers), "--yes",
               "--latitude", "36.604043", "--longitude", "-97.484856", "--altitude", "318", "--json", "--no-exports",
               "-o", str(target)]  # fmt: skip
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        memory = _Memory(process.pid)
        memory.start()
        report = json.loads(process.communicate()[0])
    memory.stop()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"{workers} workers: {perf_counter() - begun:.0f} s, {spent:.0f} s of processor, MiB early and late: "
          f"command {memory.early_and_late(0)}, worker {memory.early_and_late(1)}; "
          f"accepted epochs {_accepted(report)}", flush=True)  # fmt: skip
    return target


def _accepted(report: dict[str, Any]) -> str:
    epochs = [epoch for camera in report["cameras"] for epoch in camera["epochs"]]
    return f"{sum(epoch['accepted'] for epoch in epochs)} of {len(epochs)}"


class _Memory(threading.Thread):
    """Samples the resident memory of a process and the largest of its descendants', MiB."""

    def __init__(self, pid: int) -> None:
        super().__init__(daemon=True)
        self._pid = pid
        self._ended = threading.Event()
        self._samples: list[tuple[float, float]] = []

    def run(self) -> None:
        while not SystemClock().wait(self._ended, _SAMPLE_S):
            children = [_resident(pid) for pid in _descendants(self._pid)]
            self._samples.append((_resident(self._pid), max(children, default=0.0)))

    def stop(self) -> None:
        self._ended.set()
        self.join()

    def early_and_late(self, which: int) -> str:
        """Return the largest of the second quarter and of the last one."""
        quarter = max(len(self._samples) // 4, 1)
        early, late = self._samples[quarter : 2 * quarter], self._samples[-quarter:]
        return "{:.0f}, {:.0f}".format(*(max((one[which] for one in part), default=0.0) for part in (early, late)))


def _descendants(pid: int) -> list[int]:
    children: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):  # a process belongs to the thread that started it
        with suppress(OSError):
            children += [int(child) for child in task.read_text().split()]
    return children + [one for child in children for one in _descendants(child)]


def _resident(pid: int) -> float:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024.0 for line in status.splitlines() if line.startswith("VmRSS")), 0.0)


if __name__ == "__main__":
    main()
