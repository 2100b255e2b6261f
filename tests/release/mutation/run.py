"""Report which changes of the core no test detects.

    tests/mutants [--rooms calibration optics …] [--count 200] [--seed 1] [--jobs 2] [--json FILE]

Draws constants and operators of the rooms with a fixed seed, changes one at a time in a copy of the package, and runs
the rooms' own fast tests that reach the line, then test files of other rooms that import the changed module or what
is made of it, the nearest first, until one fails. Prints the share that was detected and names the survivors. What
failed is run once more without a change: a test that fails then has detected nothing. First the rooms' fast tests are
run once, traced, to learn which lines they reach; `--lines FILE` keeps that for the next run. `--files` limits the
changes to files whose name holds one of some texts.

Not drawn are texts, messages of errors, annotations and decorators, and the numbers whose growth is without effect by
their place: guards against zero, conditions of rest, limits of rounds, seeds, finer grids (`idle.py`).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from tests.release.mutation.elsewhere import files_elsewhere
from tests.release.mutation.reach import lines_that_matter
from tests.release.mutation.sites import Site, mutated, sites

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "service" / "sunarc"
ROOMS = ("calibration", "changes", "stars", "optics", "detection")
FAST = "not slow and not gige and not system and not browser and not waits and not release"
_SECONDS_OF_TESTS = 40.0
"""Of processor that each of three groups of tests is given for one mutant, the fastest first: those named as its file,
the others that reach it, those of other rooms."""
_MOST_TESTS = 500
_SECONDS_AT_MOST = 160
"""Of processor for each; one that computes without end is detected."""
_WAITED_AT_MOST_S = 3600.0
"""One that waits without end is detected, too; a loaded host alone makes none of them late."""
_FAILED = "failed.txt"
_PASSED = (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
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
    """Which test failed on a mutant; None where none did, "" where all ended without a word."""

    mutant: Mutant
    failed: str | None
    n_tests: int


def main() -> int:
    """Run and return 0 where enough were detected, else 1."""
    options = _arguments()
    with TemporaryDirectory(prefix="sunarc-mutants-") as folder:
        reach = _reach(options, Path(folder))
        outcomes = _outcomes(_drawn(options), reach, options, Path(folder))
        failing = _failing(Path(folder) / "0" / "service", sorted({one.failed for one in outcomes if one.failed}))
    for outcome in outcomes:
        if outcome.failed in failing:
            print(f"not detected by a test that fails without the change: {outcome.mutant}, {outcome.failed}")
    survivors = [outcome for outcome in outcomes if outcome.failed is None or outcome.failed in failing]
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
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "tests.release.mutation.record",
            "-m",
            FAST,
            "--timeout",
            "900",
        ]
        environment = _environment(ROOT / "service")
        environment |= {"SUNARC_LINES": str(path), "SUNARC_LINES_ROOMS": " ".join(options.rooms)}
        subprocess.run([*command, *rooms], cwd=ROOT, env=environment, check=True)
    reach: dict[str, Any] = json.loads(path.read_text())
    return reach


def _outcomes(mutants: list[Mutant], reach: dict[str, Any], options: argparse.Namespace, folder: Path) -> list[Outcome]:
    copies: SimpleQueue[Path] = SimpleQueue()
    for number in range(options.jobs):
        copies.put(_copy(folder / str(number)))

    def outcome(mutant: Mutant) -> Outcome:
        copy = copies.get()
        try:
            nearest, tests = _tests_for(mutant, reach)
            others = files_elsewhere(mutant.file, _texts(), ROOT, options.rooms)
            found = (_failed(mutant, group, copy) for group in (nearest, tests, others) if group)
            failed = next((one for one in found if one is not None), None)
            if failed is None:
                print(_survivor(mutant, len(nearest) + len(tests), len(others)), flush=True)
            return Outcome(mutant, failed, len(nearest) + len(tests))
        finally:
            copies.put(copy)

    with ThreadPoolExecutor(options.jobs) as pool:
        return list(pool.map(outcome, mutants))


def _copy(root: Path) -> Path:
    """Copy the package to where its sources are in a checkout, all else beside it: it reads the migrations."""
    shutil.copytree(PACKAGE, root / "service" / "sunarc")
    for folder in (ROOT, ROOT / "service"):
        for path in folder.iterdir():
            if not (target := root / path.relative_to(ROOT)).exists():
                target.symlink_to(path)
    return root / "service"


def _tests_for(mutant: Mutant, reach: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Return the tests that reach what a mutant changes: those named as its file or of stored answers, and the others.

    The first are run by themselves: to import all test files takes longer than most mutants live.
    """
    lines, seconds = reach["lines"], reach["seconds"]
    matter = lines_that_matter(mutant.site.line, mutant.file, _texts())
    chosen = [test for test, executed in lines.items() if not matter.isdisjoint(executed)]
    chosen.sort(key=lambda test: float(seconds.get(test, 0.0)))
    named = re.compile(rf"/(test_)?{Path(mutant.file).stem}[./]|/test_stored_")
    nearest = [test for test in chosen if named.search(test)]
    others = [test for test in chosen if not named.search(test)]
    return nearest[:_MOST_TESTS], others[:_MOST_TESTS]


def _survivor(mutant: Mutant, n_tests: int, n_files: int) -> str:
    site = mutant.site
    return f"survived: {mutant.file}:{site.line}: {site.old} became {site.new} ({n_tests} tests, {n_files} files)"


@cache
def _texts() -> dict[str, str]:
    return {path.relative_to(PACKAGE).as_posix(): path.read_text("utf-8") for path in PACKAGE.rglob("*.py")}


def _failed(mutant: Mutant, tests: list[str], copy: Path) -> str | None:
    """Return which test fails on the changed copy, None where none does; "" where the tests did not come to an end.

    A change that a test module cannot be imported with leaves no test to be found, and so is detected.
    """
    target = copy / "sunarc" / mutant.file
    original = target.read_text("utf-8")
    target.write_text(mutated(original, mutant.site), "utf-8")
    try:
        code = _exit_code(copy, tests, ["-x"])
    finally:
        target.write_text(original, "utf-8")
    if code == pytest.ExitCode.USAGE_ERROR and _exit_code(copy, tests, ["-x"]) == code:
        raise RuntimeError(f"{mutant.file}:{mutant.site.line}: none of {tests} ran; make the file of --lines anew")
    failures = _failures(copy)
    broke_off = code == pytest.ExitCode.TESTS_FAILED and not failures  # pytest itself, not a test
    return None if code in _PASSED or broke_off else "".join(failures[:1])


def _failing(copy: Path, tests: list[str]) -> list[str]:
    """Return which of some tests fail without any change."""
    if tests:
        _exit_code(copy, tests, [])
    return _failures(copy) if tests else []


def _failures(copy: Path) -> list[str]:
    return (copy / _FAILED).read_text("utf-8").split("\n")[:-1]


def _exit_code(copy: Path, tests: list[str], arguments: list[str]) -> int | None:
    """Return pytest's exit code of tests on the package in a folder; negative where it took too long."""
    (copy / _FAILED).write_text("")
    process = _WARM.Process(target=_run_tests, args=(str(copy), [*arguments, *tests]))
    process.start()
    process.join(_WAITED_AT_MOST_S)
    if process.exitcode is None:
        process.kill()
        process.join()
    return process.exitcode


def _run_tests(copy: str, arguments: list[str]) -> None:
    """Run tests on the package in a folder, silently, and exit with their result; called in a process of its own.

    Nothing of it hangs on the host's load: no test has a time limit but that of the processor.
    """
    once = "-x" in arguments
    if once:
        resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS_AT_MOST, _SECONDS_AT_MOST))
    os.chdir(ROOT)
    sys.path[:0] = [copy, str(ROOT)]
    sys.dont_write_bytecode = True
    with Path(os.devnull).open("w", encoding="utf-8") as nothing, redirect_stdout(nothing), redirect_stderr(nothing):
        watch = _Watch(Path(copy) / _FAILED, _SECONDS_OF_TESTS if once else float("inf"))
        of_its_own = ["-p", "no:cacheprovider", "--basetemp", str(Path(copy).parent / "temporary"), "--timeout", "0"]
        code = pytest.main(["-q", *of_its_own, "-m", FAST, *arguments], plugins=[watch])
        sys.exit(0 if watch.stopped and code == pytest.ExitCode.INTERRUPTED else int(code))


class _Watch:
    """A pytest plugin: writes down which tests fail, and begins none after so many seconds of processor."""

    def __init__(self, file: Path, seconds: float) -> None:
        self.file, self.seconds, self.stopped = file, seconds, False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            with self.file.open("a", encoding="utf-8") as file:
                file.write(f"{report.nodeid}\n")

    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        if time.process_time() > self.seconds:
            self.stopped = True
            item.session.shouldstop = "no time is left"
            pytest.skip("no time is left")


def _environment(source: Path) -> dict[str, str]:
    """Return an environment in which the package is imported from `source`."""
    return os.environ | {"PYTHONPATH": f"{source}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}


if __name__ == "__main__":
    sys.exit(main())
