"""A pytest plugin: which lines of the package each test runs, written to the file that SUNARC_LINES names.

A compiled kernel runs outside the interpreter and leaves no lines: a call of one counts for every line of its source
and of the kernels that it calls.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher

TraceFunction = Callable[[FrameType, str, object], "TraceFunction | None"]
_FILE = Path(os.environ["SUNARC_LINES"])
_PACKAGE = f"{os.sep}sunarc{os.sep}"
_lines: dict[str, set[str]] = {}
_seconds: dict[str, float] = {}
_ours: dict[CodeType, str | None] = {}
_executed: set[str] = set()
_fixtures: dict[int, set[str]] = {}
_kernels: dict[int, frozenset[str]] = {}


def _name(code: CodeType) -> str | None:
    if code not in _ours:
        place = code.co_filename.rpartition(_PACKAGE)
        _ours[code] = place[2] if place[1] else None
    return _ours[code]


def _kernel_lines(kernel: Any, known: frozenset[int] = frozenset()) -> frozenset[str]:  # noqa: ANN401 - numba is untyped
    """Return the lines of a kernel's source and of the kernels that it names."""
    function = kernel.py_func
    name = _name(function.__code__)
    found = {f"{name}:{line}" for *_, line in function.__code__.co_lines() if line} if name else set()
    for other in (function.__globals__.get(each) for each in function.__code__.co_names):
        if isinstance(other, Dispatcher) and id(other) not in known:
            found |= _kernel_lines(other, known | {id(kernel)})
    return frozenset(found)


def pytest_configure() -> None:
    """Note the lines of every kernel that Python calls."""
    plain = Dispatcher.__call__

    def noted(kernel: Any, *values: object, **named: object) -> object:  # noqa: ANN401 - numba is untyped
        if id(kernel) not in _kernels:
            _kernels[id(kernel)] = _kernel_lines(kernel)
        _executed.update(_kernels[id(kernel)])
        return plain(kernel, *values, **named)

    Dispatcher.__call__ = noted  # type: ignore[assignment,method-assign]


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
