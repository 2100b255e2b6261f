"""A camera that no longer answers may be closed while the library still says so."""

from __future__ import annotations

import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest

from sunarc.imager.cameras.aravis import wait_for_last_reference
from sunarc.imager.runtime.clock import VirtualClock


@pytest.mark.gige
@pytest.mark.usefixtures("imager")
@pytest.mark.timeout(120)
def test_closing_during_the_signal_does_not_end_the_process() -> None:
    script = Path(__file__).with_name("slow_emission_process.py")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("closed\n")


class Device:
    """Counts how often its number of references is asked for."""

    def __init__(self, counts: list[int]) -> None:
        self.counts = counts

    @property
    def __grefcount__(self) -> int:
        return self.counts.pop(0) if len(self.counts) > 1 else self.counts[0]


@pytest.mark.parametrize(
    ("counts", "alone", "least_s", "most_s"),
    [([1], True, 0.0, 0.0), ([2, 2, 2, 1], True, 0.005, 0.007), ([2], False, 0.49, 0.51)],
)
def test_the_wait_ends_with_the_emission_or_after_half_a_second(
    counts: list[int],
    alone: bool,  # noqa: FBT001 - a parameter of the test
    least_s: float,
    most_s: float,
) -> None:
    clock = VirtualClock(datetime(2013, 5, 13, tzinfo=UTC))
    began = clock.monotonic()
    assert wait_for_last_reference(Device(counts), clock) is alone
    assert least_s <= clock.monotonic() - began <= most_s
