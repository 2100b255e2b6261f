"""A pytest plugin: which lines of the package each test runs, written to the file that SUNARC_LINES names.

Compiled kernels run outside the interpreter and leave no lines; `run.py` falls back on what imports their module.
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


def _name(code: CodeType) -> str | None:
    if code not in _ours:
        place = code.co_filename.rpartition(_PACKAGE)
        _ours[code] = place[2] if place[1] else None
    return _ours[code]


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Note the lines that a test and its fixtures run; what a shared fixture runs counts for its first test."""
    executed: set[str] = set()

    def local(frame: FrameType, event: str, _: object) -> TraceFunction:
        if event == "line":
            executed.add(f"{_name(frame.f_code)}:{frame.f_lineno}")
        return local

    def every(frame: FrameType, _event: str, _: object) -> TraceFunction | None:
        return local if _name(frame.f_code) else None

    sys.settrace(every)
    try:
        yield
    finally:
        sys.settrace(None)
        _lines[item.nodeid] = executed


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up how long each test takes."""
    _seconds[report.nodeid] = _seconds.get(report.nodeid, 0.0) + report.duration


def pytest_sessionfinish() -> None:
    """Write what was noted."""
    lines = {test: sorted(executed) for test, executed in _lines.items()}
    _FILE.write_text(json.dumps({"lines": lines, "seconds": _seconds}))
