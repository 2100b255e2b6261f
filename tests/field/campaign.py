"""A random campaign of faults on the whole chain, judged against the simulator's truth; a short form is a test.

    tests/campaign --seed 1 --faults 300 [--sources gige night folder http] [--json FILE] [--keep FOLDER]

A simulated camera, the service, a receiver of its messages and a hub with PostgreSQL run as processes, faster than real
time; the faults are divided among the sources (`night` is the GigE camera with its nights). They are drawn with a seed:
kills, stops (also while a refit is solved), camera faults, wrong clocks, frozen and black frames, a locked, a deleted
and a full database, a damaged row, flipped bits in every kind of file that the service writes, backups, a second
service, receivers that drip; a hub that is killed, away, that fails or drips, PostgreSQL killed or its disk full; of a
folder uploads that are late, cut off, damaged or doubled, a folder that vanishes; of an address pages, drips, bodies
without end, redirects. In the end nothing may be lost or doubled, the hub has every row of the imager and no other, no
accepted sighting farther from the truth than it states, no calibration served worse than stated, and in 100 faults
or more one has to be served; the service must not have ended by itself, nor reported "ready" while no sighting was
stored for 10 slots of clear sun. Needs port 3956 of 127.0.0.1 (a network namespace of its own is best); the full disk
needs root.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from tests.fixtures.ports import free_port

from .campaign_faults import FAULTS, Faults, Source
from .campaign_judge import Findings
from .campaign_pictures import PictureFaults
from .campaign_processes import SPEED, Setting, now

SOURCES: tuple[Source, ...] = tuple(FAULTS)


def campaign(
    *,
    seed: int,
    faults: int,
    folder: Path,
    most_s: float = float("inf"),
    source: Source = "gige",
    speed: float = SPEED,
) -> tuple[Findings, dict[str, int]]:
    """Run a campaign; return what was found wrong and how often each fault was done.

    Parameters
    ----------
    seed : of the faults and their durations.
    faults : how many.
    folder : empty; keeps state and logs.
    most_s : real seconds after the start of both processes from which no further fault is begun, but one always is.
    source : one of `SOURCES`.
    speed : of the GigE camera's time, which a busy host cannot follow at 200; pictures come at 60.
    """
    with _run_of(source, folder, seed, speed) as run:
        began = now()
        run.wait(15.0 * run.slot_s)
        kinds = run.drawn()
        while sum(run.counts.values()) < faults and (not run.counts or now() - began < most_s):
            run.disturb(next(kinds))
        run.wait(15.0 * run.slot_s)
        forgotten = run.end()
        n_of_hub = 0 if run.hub is None else run.hub.n_rows
    assert run.judge is not None
    found = run.judge.end(n_faults=sum(run.counts.values()))
    found.own_exits, found.left_out, found.forgotten = run.exits, run.left_out, forgotten
    found.flipped = sorted(run.flipped)
    if run.hub is not None:
        found.n_of_hub, found.installations = n_of_hub, len(run.hub.installations)
    return found, run.counts


def _run_of(source: Source, folder: Path, seed: int, speed: float) -> Faults:
    if source in {"folder", "http"}:
        return PictureFaults(folder, port=free_port(), seed=seed, source=source)
    setting = Setting(nights=source == "night", speed=speed)
    return Faults(folder, port=free_port(), seed=seed, setting=setting, source=source)


def main() -> int:
    """Run; exit 0 where nothing was found wrong, else 1."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--faults", type=int, default=300)
    parser.add_argument("--most-s", type=float, default=float("inf"), help="begin no fault after so many real seconds")
    parser.add_argument("--sources", nargs="+", choices=SOURCES, default=SOURCES)
    parser.add_argument("--speed", type=float, default=SPEED, help="of a GigE camera's time; less on a busy host")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--keep", type=Path, help="an empty folder for state and logs (default: a temporary one)")
    options = parser.parse_args()
    reports = []
    n = len(options.sources)
    with contextlib.ExitStack() as stack:
        kept = options.keep or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sunarc-campaign-")))
        kept.chmod(0o755)  # PostgreSQL's user comes there
        for source in options.sources:
            folder = kept / source
            folder.mkdir(parents=True)
            found, counts = campaign(
                seed=options.seed,
                faults=-(-options.faults // n),
                folder=folder,
                most_s=options.most_s / n,
                source=source,
                speed=options.speed,
            )
            report = {"source": source, "seed": options.seed, "faults": counts, **asdict(found), "good": found.good}
            reports.append(report)
            print(json.dumps(report, indent=1), flush=True)  # noqa: T201 - a script that prints what it found
    if options.json:
        options.json.write_text(json.dumps(reports, indent=1) + "\n")
    return 0 if all(report["good"] for report in reports) else 1


if __name__ == "__main__":
    sys.exit(main())
