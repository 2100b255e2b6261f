"""Report which changes of the core no test detects.

    tests/mutants [--rooms calibration optics detection] [--count 200] [--seed 1] [--jobs 2] [--json FILE]

Draws constants and operators of the rooms with a fixed seed, changes one at a time in a copy of the package, and runs
the room's own fast tests that reach the line, the fastest first, until one fails. Prints the share that was detected
and names the survivors. First every fast test is run once, traced, to learn which lines it reaches; `--lines FILE`
keeps that for the next run. `--files` limits the changes to files whose name holds one of some texts.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import resource
import shutil
import subprocess
import sys
from bisect import bisect_right
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from functools import cache
from itertools import accumulate
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from tests.mutation.reach import lines_that_matter
from tests.mutation.sites import Site, mutated, sites

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "service" / "sunarc"
ROOMS = ("calibration", "optics", "detection")
FAST = "not slow and not gige and not system and not browser"
_TESTS_AT_LEAST = 25
_SECONDS_OF_TESTS = 20.0
"""Tests that are asked for one mutant: of those that reach it the file's own first, then the fastest; as many as take
this long together, but never fewer than 25."""
_SECONDS_AT_MOST = 120
"""Of processor for one mutant; one that computes without end is detected."""
_WAITED_AT_MOST_S = 3600.0
"""One that waits without end is detected, too; a loaded host alone makes none of them late."""
_NOTHING_RAN = (pytest.ExitCode.USAGE_ERROR, pytest.ExitCode.NO_TESTS_COLLECTED)
_WARM = multiprocessing.get_context("forkserver")
_WARM.set_forkserver_preload(
    ["cv2", "pytest", "scipy.integrate", "scipy.ndimage", "scipy.optimize", "scipy.signal", "scipy.stats"]
)


@dataclass(frozen=True)
class Mutant:
    """A change of a file, named from the package on."""

    file: str
    site: Site


@dataclass(frozen=True)
class Outcome:
    """Whether a test failed on a mutant."""

    mutant: Mutant
    detected: bool
    n_tests: int


def main() -> int:
    """Run and return 0 where enough were detected, else 1."""
    options = _arguments()
    with TemporaryDirectory(prefix="sunarc-mutants-") as folder:
        reach = _reach(options, Path(folder))
        outcomes = _outcomes(_drawn(options), reach, options, Path(folder))
    survivors = [outcome for outcome in outcomes if not outcome.detected]
    share = 1.0 - len(survivors) / max(len(outcomes), 1)
    print(f"{len(outcomes) - len(survivors)} of {len(outcomes)} detected: {100.0 * share:.1f} %")
    if options.json:
        options.json.write_text(
            json.dumps({"share": share, "outcomes": [asdict(outcome) for outcome in outcomes]}, indent=1)
        )
    return 0 if share >= options.at_least else 1


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS))
    parser.add_argument("--files", nargs="+", default=[""], help="only files whose path holds one of these")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--at-least", type=float, default=0.85, help="share for exit code 0")
    parser.add_argument("--lines", type=Path, help="which test reaches which line; made where it is absent")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def _drawn(options: argparse.Namespace) -> list[Mutant]:
    files = sorted(path for room in options.rooms for path in (PACKAGE / room).rglob("*.py"))
    files = [path for path in files if any(part in path.as_posix() for part in options.files)]
    every = [
        Mutant(path.relative_to(PACKAGE).as_posix(), site) for path in files for site in sites(path.read_text("utf-8"))
    ]
    return random.Random(options.seed).sample(every, min(options.count, len(every)))


def _reach(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Return the lines that every fast test of the rooms reaches, and its seconds."""
    path = options.lines or folder / "lines.json"
    if not path.exists():
        rooms = [str(ROOT / "tests" / room) for room in options.rooms]
        command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.mutation.record", "-m", FAST, "--timeout", "900"]
        environment = _environment(ROOT / "service") | {"SUNARC_LINES": str(path)}
        subprocess.run([*command, *rooms], cwd=ROOT, env=environment, check=True)
    reach: dict[str, Any] = json.loads(path.read_text())
    return reach


def _outcomes(mutants: list[Mutant], reach: dict[str, Any], options: argparse.Namespace, folder: Path) -> list[Outcome]:
    copies: SimpleQueue[Path] = SimpleQueue()
    for number in range(options.jobs):
        copies.put(Path(shutil.copytree(PACKAGE, folder / str(number) / "sunarc")).parent)

    def outcome(mutant: Mutant) -> Outcome:
        copy = copies.get()
        try:
            tests = _tests_for(mutant, reach)
            detected = _detected(mutant, tests, copy)
            if not detected:
                site = mutant.site
                print(
                    f"survived: {mutant.file}:{site.line}: {site.old} became {site.new} ({len(tests)} tests)",
                    flush=True,
                )
            return Outcome(mutant, detected, len(tests))
        finally:
            copies.put(copy)

    with ThreadPoolExecutor(options.jobs) as pool:
        return list(pool.map(outcome, mutants))


def _tests_for(mutant: Mutant, reach: dict[str, Any]) -> list[str]:
    """Return the tests that reach what a mutant changes, those of the file's own test file first."""
    lines, seconds = reach["lines"], reach["seconds"]
    matter = lines_that_matter(mutant.site.line, mutant.file, _texts())
    exact = [test for test, executed in lines.items() if not matter.isdisjoint(executed)]
    room = mutant.file.partition("/")[0]
    chosen = exact or [test for test in lines if test.startswith(f"tests/{room}/")]
    own = f"test_{Path(mutant.file).name}::"
    chosen.sort(key=lambda test: (own not in test, float(seconds.get(test, 0.0))))
    total = list(accumulate(float(seconds.get(test, 0.0)) for test in chosen))
    return chosen[: max(_TESTS_AT_LEAST, bisect_right(total, _SECONDS_OF_TESTS))]


@cache
def _texts() -> dict[str, str]:
    return {path.relative_to(PACKAGE).as_posix(): path.read_text("utf-8") for path in PACKAGE.rglob("*.py")}


def _detected(mutant: Mutant, tests: list[str], copy: Path) -> bool:
    """Return whether a test fails on the changed copy; it runs in a process that has numpy and scipy already."""
    if not tests:
        return False
    target = copy / "sunarc" / mutant.file
    original = target.read_text("utf-8")
    target.write_text(mutated(original, mutant.site), "utf-8")
    try:
        code = _exit_code(copy, tests)
    finally:
        target.write_text(original, "utf-8")
    # A change that a test module cannot be imported with leaves no test to be found, and so is detected.
    if code in _NOTHING_RAN and _exit_code(copy, tests) in _NOTHING_RAN:
        raise RuntimeError(f"{mutant.file}:{mutant.site.line}: none of {tests} ran; make the file of --lines anew")
    return code != 0


def _exit_code(copy: Path, tests: list[str]) -> int | None:
    """Return pytest's exit code of tests on the package in a folder; negative where it took too long."""
    process = _WARM.Process(target=_run_tests, args=(str(copy), tests))
    process.start()
    process.join(_WAITED_AT_MOST_S)
    if process.exitcode is None:
        process.kill()
        process.join()
    return process.exitcode


def _run_tests(copy: str, tests: list[str]) -> None:
    """Run tests on the package in a folder, silently, and exit with their result; called in a process of its own."""
    resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS_AT_MOST, _SECONDS_AT_MOST))
    os.chdir(ROOT)
    sys.path[:0] = [copy, str(ROOT)]
    sys.dont_write_bytecode = True
    with Path(os.devnull).open("w", encoding="utf-8") as nothing, redirect_stdout(nothing), redirect_stderr(nothing):
        sys.exit(int(pytest.main(["-q", "-x", "-p", "no:cacheprovider", *tests])))


def _environment(source: Path) -> dict[str, str]:
    """Return an environment in which the package is imported from `source`."""
    return os.environ | {"PYTHONPATH": f"{source}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}


if __name__ == "__main__":
    sys.exit(main())
