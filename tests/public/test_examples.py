"""The examples of the public names do what they say, and every name has one."""

from __future__ import annotations

import doctest
import inspect
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import sunarc

FOLDER = Path(__file__).parents[2] / "docs" / "examples" / "front_door"
MOST_NAMES = 30
NEED_NONE = {
    "Comparison",
    "CloudPositions",
    "Directions",
    "StarDetections",
    "SunDetection",
    "InputError",
    "PixelPositions",
    "SunPosition",
}
"""Answers, which the examples of the functions show."""


def examples() -> Iterator[doctest.DocTest]:
    finder = doctest.DocTestFinder(exclude_empty=True)
    for name in sunarc.__all__:
        yield from finder.find(getattr(sunarc, name), name, globs={})


@pytest.mark.parametrize("example", [one for one in examples() if one.examples], ids=lambda one: one.name)
def test_the_example_does_what_it_says(example: doctest.DocTest, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib").use("Agg")
    monkeypatch.chdir(FOLDER)
    runner = doctest.DocTestRunner()
    said: list[str] = []
    assert runner.run(example, out=said.append).failed == 0, "".join(said)


def test_there_are_at_most_thirty_names_each_with_a_docstring_and_an_example() -> None:
    assert len(sunarc.__all__) <= MOST_NAMES
    with_examples = {one.name.partition(".")[0] for one in examples() if one.examples}
    assert set(sunarc.__all__) - with_examples == NEED_NONE
    assert all(inspect.getdoc(getattr(sunarc, name)) for name in sunarc.__all__)
    functions = {
        f"{name}.{method}"
        for name in ("Calibration", "Draws")
        for method, found in vars(getattr(sunarc, name)).items()
        if inspect.isfunction(found) and not method.startswith("_") and "; internal" not in str(found.__doc__)
    }
    assert functions - {one.name for one in examples() if one.examples} == set()


IMPORTED = r"""
import re, sys, time
before = time.process_time()
import sunarc
used = time.process_time() - before
memory_mb = int(re.search(r"VmHWM:\s*(\d+)", open("/proc/self/status").read())[1]) / 1024
print(used, memory_mb, *(name for name in ("numpy", "cv2") if name in sys.modules))
sunarc.Site
print("numpy" in sys.modules)
"""


def test_the_import_loads_nothing_until_a_name_is_used() -> None:
    first, second = subprocess.run(
        [sys.executable, "-c", IMPORTED], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    _, memory_mb, *loaded = first.split()
    assert (loaded, second) == ([], "True")
    assert float(memory_mb) <= 40.0


def test_what_is_no_name_is_refused_as_python_does() -> None:
    with pytest.raises(AttributeError):
        sunarc.calibrat  # type: ignore[attr-defined] # noqa: B018 - to ask is the test
    assert set(dir(sunarc)) >= set(sunarc.__all__)
