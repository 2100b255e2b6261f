"""A pytest plugin: which lines of the package each test runs, written to the file that SUNARC_LINES names.

The compiled kernels (service/kernels) leave no lines, and are not mutated.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType

import pytest

TraceFunction = Callable[[FrameType, str, object], "TraceFunction | None"]
_FILE = Path(os.environ["SUNARC_LINES"])
_PACKAGE = f"{os.sep}sunarc{os.sep}"
_lines: dict[str, set[str]] = {}
_seconds: dict[str, float] = {}
_ours: dict[CodeType, str | None] = {}
_executed: set[str] = set()
_fixtures: dict[int, set[str]] = {}


def _name(code: CodeType) -> str | None:
    if code not in _ours:
        place = code.co_filename.rpartition(_PACKAGE)
        _ours[code] = place[2] if place[1] else None
    return _ours[code]


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Note the lines that a test and its fixtures run, a shared fixture's for every test that asks for it."""
    _executed.clear()

    def local(frame: FrameType, event: str, _: object) -> TraceFunction:
        if event == "line":
            _executed.add(f"{_name(frame.f_code)}:{frame.f_lineno}")
        return local

    def every(frame: FrameType, _event: str, _: object) -> TraceFunction | None:
        return local if _name(frame.f_code) else None

    sys.settrace(every)
    try:
        yield
    finally:
        sys.settrace(None)
        asked = getattr(item, "_fixtureinfo").name2fixturedefs.values()  # noqa: B009 - not among pytest.Item's names
        shared = (_fixtures.get(id(each[-1]), set()) for each in asked)
        _lines[item.nodeid] = _executed.union(*shared)


@pytest.hookimpl(hookwrapper=True)
def pytest_fixture_setup(fixturedef: object) -> Iterator[None]:
    """Note the lines that a fixture runs, once for all tests that share it."""
    before = set(_executed)
    _executed.clear()
    yield
    _fixtures[id(fixturedef)] = set(_executed)
    _executed.update(before)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up how long each test takes."""
    _seconds[report.nodeid] = _seconds.get(report.nodeid, 0.0) + report.duration


def pytest_sessionfinish() -> None:
    """Write what was noted."""
    lines = {test: sorted(executed) for test, executed in _lines.items()}
    _FILE.write_text(json.dumps({"lines": lines, "seconds": _seconds}))
