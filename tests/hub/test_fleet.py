"""Imagers, a hub and PostgreSQL as processes: whatever fails, every row arrives once and in its order."""

from __future__ import annotations

import os
from typing import Any, cast

import pytest
from tests.fixtures.links import FAULTS
from tests.release.simulated_fleet import fleet_of, quick_retries, run_with_faults

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(300)]
of_root = [pytest.mark.release, pytest.mark.skipif(os.geteuid() != 0, reason="a network of its own needs root")]


@pytest.mark.parametrize("apart", [False, pytest.param(True, marks=of_root)], ids=["loopback", "pulled cable"])
def test_cuts_repetitions_a_killed_hub_and_a_crashed_database_lose_and_double_nothing(apart: bool) -> None:  # noqa: FBT001
    with quick_retries(), fleet_of(3, apart=apart) as fleet:
        counts = run_with_faults(fleet, steps=18, rows=5, pause_s=0.2, seed=4)
        assert {*FAULTS, *(["cable"] if apart else [])} <= set(+counts)  # all of it happened
        fleet.wait_until_caught_up(120.0)
        assert fleet.differences() == []
        listed = cast("dict[str, Any]", fleet.hub.ask("/v1/fleet"))["cameras"]
        assert [one["camera"] for one in sorted(listed, key=lambda one: one["camera"])] == [
            imager.name for imager in fleet.imagers
        ]
        assert {one["n_quarantined"] for one in listed} == {0}
        assert fleet.hub.stop() == 0
