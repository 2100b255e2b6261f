"""Imagers, a hub and PostgreSQL as processes: whatever fails, every row arrives once and in its order."""

from __future__ import annotations

from typing import Any, cast

import pytest
from tests.fleet.simulated_fleet import FAULTS, fleet_of, quick_retries, run_with_faults

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(300)]


def test_cuts_repetitions_a_killed_hub_and_a_crashed_database_lose_and_double_nothing() -> None:
    with quick_retries(), fleet_of(3) as fleet:
        counts = run_with_faults(fleet, steps=18, rows=5, pause_s=0.2)
        assert set(FAULTS) <= set(counts)  # all of it happened
        fleet.wait_until_caught_up(120.0)
        assert fleet.differences() == []
        listed = cast("dict[str, Any]", fleet.hub.ask("/v1/fleet"))["cameras"]
        assert [one["camera"] for one in sorted(listed, key=lambda one: one["camera"])] == [
            imager.name for imager in fleet.imagers
        ]
        assert {one["state"] for one in listed} == {"uncalibrated"}  # nothing is in quarantine
        assert fleet.hub.stop() == 0
