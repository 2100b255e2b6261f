"""A pytest plugin: which lines of some rooms each test runs, written to the file that SUNARC_LINES names.

SUNARC_LINES_ROOMS names the rooms. The compiled kernels (service/kernels) leave no lines, and are not mutated.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType

import pytest

Line = tuple[str, int]
TraceFunction = Callable[[FrameType, str, object], "TraceFunction | None"]
_FILE = Path(os.environ["SUNARC_LINES"])
_PACKAGE = f"{os.sep}sunarc{os.sep}"
_ROOMS = tuple(f"{room}/" for room in os.environ["SUNARC_LINES_ROOMS"].split())
_lines: dict[str, set[Line]] = {}
_seconds: dict[str, float] = {}
_ours: dict[CodeType, str] = {}
_executed: set[Line] = set()
_fixtures: dict[int, set[Line]] = {}


def _name(code: CodeType) -> str:
    """Return a code's file from the package on; empty where it is of no such room."""
    if code not in _ours:
        name = code.co_filename.rpartition(_PACKAGE)[2]
        _ours[code] = name if name.startswith(_ROOMS) else ""
    return _ours[code]


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Note the lines that a test and its fixtures run, a shared fixture's for every test that asks for it."""
    _executed.clear()

    def local(frame: FrameType, event: str, _: object) -> TraceFunction:
        if event == "line":
            _executed.add((_ours[frame.f_code], frame.f_lineno))
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
    lines = {test: sorted(f"{file}:{line}" for file, line in executed) for test, executed in _lines.items()}
    _FILE.write_text(json.dumps({"lines": lines, "seconds": _seconds}))
