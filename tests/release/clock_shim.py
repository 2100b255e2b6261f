"""Runs `sunarc` with a host clock that can be set while it runs. Arguments: a file, then the command line's own.

The file holds the seconds by which the wall clock is ahead, and "synchronised" or "unsynchronised": what the kernel
reports. Monotonic time is the machine's.
"""

from __future__ import annotations

import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sunarc.cli.main import main
from sunarc.imager.runtime import clock


def _setting(file: Path) -> tuple[float, bool]:
    try:
        seconds, _, state = file.read_text().partition(" ")
    except OSError:
        return 0.0, True
    return float(seconds or 0.0), state.strip() != "unsynchronised"


def _install(file: Path) -> None:
    """Let the system's clock tell what the file says."""

    def now(self: clock.SystemClock) -> datetime:  # noqa: ARG001 - a method
        return datetime.now(UTC) + timedelta(seconds=_setting(file)[0])

    def state(self: clock.SystemClock) -> clock.ClockState:  # noqa: ARG001 - same
        return clock.ClockState(synchronised=_setting(file)[1], error_bound_s=0.01)

    clock.SystemClock.now = now  # type: ignore[method-assign]
    clock.SystemClock.state = state  # type: ignore[method-assign]


if __name__ == "__main__":  # a solving process imports this file again
    _install(Path(sys.argv.pop(1)))
    main()
