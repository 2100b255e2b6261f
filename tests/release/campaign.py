"""A random campaign of faults on the whole chain, judged against the simulator's truth; a short form is a test.

    tests/campaign --seed 1 --faults 1000 --side-by-side 4 [--sources gige night folder http] [--keep FOLDER]

A simulated camera, the service, a receiver of its messages and a hub with PostgreSQL run as processes, faster than real
time, for each source (`night` is the GigE camera with its nights). Faults are drawn with a seed, some of different
kinds into a window, where they overlap: kills, stops (also while a refit is solved), camera faults, wrong clocks,
frozen and black frames, a locked, a deleted and a full database, a damaged row, flipped bits in every kind of file that
the service writes, backups, a second service, receivers that drip; a hub that is killed, away, that fails or drips,
PostgreSQL killed or its disk full; of a folder uploads that are late, cut off, damaged or doubled, a folder that
vanishes; of an address pages, drips, bodies without end, redirects. After each window all has to go on by itself within
minutes; nothing may be lost or doubled, the hub has every row of the imager and no other, no accepted sighting is
farther from the truth than it states, no star elsewhere, no calibration served worse than stated, and in two days or
more one has to be served; the service must not have ended by itself, nor reported "ready" while no sighting was stored
for 10 slots of clear sun, faults or not. The faults of a window after which something is wrong are done once more, each
by itself. Sources side by side need root, for a network of each; the full disk needs it, too.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from tests.fixtures.ports import free_port

from .campaign_faults import FAULTS, Faults, Source
from .campaign_judge import Findings
from .campaign_pictures import PictureFaults
from .campaign_processes import SPEED, Setting, now
from .campaign_windows import Windows

SOURCES: tuple[Source, ...] = tuple(FAULTS)
_IN_A_NETWORK = ("unshare", "-n", "sh", "-c", 'ip link set lo up; exec "$@"', "sh")


def campaign(
    *,
    seed: int,
    faults: int,
    folder: Path,
    most_s: float = float("inf"),
    source: Source = "gige",
    speed: float = SPEED,
    kinds: Sequence[str] = (),
    patience: float = 1.0,
) -> tuple[Findings, dict[str, int]]:
    """Run a campaign of one source; return what was found wrong and how often each fault was done.

    Parameters
    ----------
    seed : of the faults and their durations.
    faults : how many.
    folder : empty; keeps state, logs and, after each window, `report.json`.
    most_s : real seconds after the start of both processes from which no further window is begun, but one always is.
    source : one of `SOURCES`.
    speed : of the camera's time.
    kinds : of faults; all of the source unless given.
    patience : factor of the real seconds within which all has to go on after faults.
    """
    setting = Setting(nights=source == "night", speed=speed)
    with run_of(source, folder, seed=seed, setting=setting) as run:
        run.only, run.patience = kinds, patience
        began = now()
        run.wait(15.0 * run.slot_s)
        windows = Windows(
            run,
            {"source": source, "seed": seed, "speed": speed, "cadence_s": run.setting.cadence_s, "patience": patience},
        )
        while sum(run.counts.values()) < faults and (not run.counts or now() - began < most_s):
            windows.one()
        run.wait(15.0 * run.slot_s)
        found = windows.check(forgotten=run.end())
        windows.report(ended=True)
    return found, run.counts


def run_of(source: Source, folder: Path, *, seed: int, setting: Setting) -> Faults:
    """Return the chain of a source, not started."""
    if source in {"folder", "http"}:
        return PictureFaults(folder, port=free_port(), seed=seed, setting=setting, source=source)
    return Faults(folder, port=free_port(), seed=seed, setting=setting, source=source)


def _in_a_process(source: Source, options: argparse.Namespace, kept: Path) -> dict[str, Any]:
    """Run one source in a process and, where that is allowed, a network of its own; return its report."""
    network = _IN_A_NETWORK if os.geteuid() == 0 else ()
    share = -(-options.faults // len(options.sources))
    numbers = {"--seed": options.seed, "--faults": share, "--most-s": options.most_s, "--speed": options.speed}
    numbers |= {"--patience": options.patience}
    arguments = [part for name, value in numbers.items() for part in (name, str(value))]
    command = [sys.executable, "-m", "tests.release.campaign", "--sources", source, "--keep", str(kept), *arguments]
    command += ["--kinds", *options.kinds] if options.kinds else []
    with (kept / f"{source}.log").open("wb") as log:
        subprocess.run([*network, *command], stdout=log, stderr=log, check=False)
    report = kept / source / "report.json"
    found: dict[str, Any] = {"source": source, "seed": options.seed, "faults": {}, "ended": False}
    if report.exists():
        found = json.loads(report.read_text())
    if not found["ended"]:
        found |= {"good": False, "broke_off": (kept / f"{source}.log").read_text()[-1000:]}
    return found


def main() -> int:
    """Run; exit 0 where nothing was found wrong, else 1."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--faults", type=int, default=300)
    parser.add_argument("--most-s", type=float, default=float("inf"), help="begin no fault after so many real seconds")
    parser.add_argument("--sources", nargs="+", choices=SOURCES, default=SOURCES)
    parser.add_argument("--side-by-side", type=int, default=1, help="sources that run at once")
    parser.add_argument("--speed", type=float, default=SPEED, help="of the cameras' time; less on a busy host")
    parser.add_argument("--kinds", nargs="+", default=(), help="of faults; those that a source has not are left out")
    parser.add_argument(
        "--patience", type=float, default=1.0, help="factor of the time to recover; more on a busy host"
    )
    parser.add_argument("--json", type=Path)
    parser.add_argument("--keep", type=Path, help="an empty folder for state and logs (default: a temporary one)")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # what was started ends with it
    with contextlib.ExitStack() as stack:
        kept = options.keep or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sunarc-campaign-")))
        kept.mkdir(parents=True, exist_ok=True)
        kept.chmod(0o755)  # PostgreSQL's user comes there
        if len(options.sources) == 1:
            (source,) = options.sources
            folder = kept / source
            folder.mkdir()
            numbers = {"seed": options.seed, "faults": options.faults, "most_s": options.most_s}
            limits = {"speed": options.speed, "kinds": options.kinds, "patience": options.patience}
            campaign(**numbers, **limits, folder=folder, source=source)
            reports = [json.loads((folder / "report.json").read_text())]
        else:
            with ThreadPoolExecutor(options.side_by_side) as pool:
                reports = list(pool.map(lambda source: _in_a_process(source, options, kept), options.sources))
    print(json.dumps(reports, indent=1))
    if options.json:
        options.json.write_text(json.dumps(reports, indent=1) + "\n")
    return 0 if all(report["good"] for report in reports) else 1


if __name__ == "__main__":
    sys.exit(main())
