"""A camera whose clock is wrong, over the wire: its sightings carry the difference, and /readyz names it."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from tests.fixtures.ports import free_port
from tests.release.campaign_processes import Processes, Setting, pause

from sunarc.sky.site import Site

LATE_S = 100.0
TAI_S = 37.0
CADENCE_S = 2.0


def findings(run: Processes) -> dict[str, dict[str, Any]]:
    """Return the data of the conditions in /readyz by their codes."""
    answer = run.get("/readyz") or {"findings": []}
    return {finding["code"]: finding["data"] for finding in answer["findings"]}


def offset_s(run: Processes) -> float:
    """Return the difference that /readyz names, seconds; 0 where it names none."""
    return float(findings(run).get("camera_clock_offset", {"offset_s": 0.0})["offset_s"])


def bounds(run: Processes, *, after: float) -> list[float]:
    """Return the clock bounds of the sightings with a later time, seconds; NaN is none."""
    with closing(sqlite3.connect(f"file:{run.database}?mode=ro", uri=True, timeout=5.0)) as connection:
        rows = connection.execute("SELECT clock_error_s FROM sun_point WHERE time > ?", (after * 1e6,)).fetchall()
    return [row[0] for row in rows]


def newest(run: Processes) -> float:
    with closing(sqlite3.connect(f"file:{run.database}?mode=ro", uri=True, timeout=5.0)) as connection:
        return float(connection.execute("SELECT coalesce(max(time), 0) FROM sun_point").fetchone()[0]) / 1e6


def wait_for_sightings(run: Processes, *, after: float, fewest: int) -> list[float]:
    run.wait_for(lambda: len(bounds(run, after=after)) >= fewest, what="sightings", within_s=60.0)
    return bounds(run, after=after)


@pytest.mark.gige
@pytest.mark.system
@pytest.mark.release  # in real time; tests/imager/workers/test_clock_watch.py has the cases
@pytest.mark.timeout(300)
def test_a_camera_that_tells_tai_states_the_difference_with_each_sighting(tmp_path: Path) -> None:
    host = datetime.now(UTC)  # noqa: TID251 - the imager's time is compared with the machine's
    noon = Site(latitude=20.0, longitude=(12.0 - host.hour - host.minute / 60.0) * 15.0, altitude=300.0)
    start = host - timedelta(seconds=LATE_S)
    setting = Setting(site=noon, start=start, speed=1.0, cadence_s=CADENCE_S)
    with Processes(tmp_path, port=free_port(), setting=setting) as run:
        assert min(wait_for_sightings(run, after=0.0, fewest=3)) >= LATE_S - 1.0  # late by its own start, too
        run.wait_for(lambda: offset_s(run) < -LATE_S, what="the notice", within_s=30.0)
        late_s = -offset_s(run)
        run.order("CLOCK_OFFSET", round(1000.0 * late_s))
        run.wait_for(lambda: "camera_clock_offset" not in findings(run), what="the end of the notice", within_s=60.0)
        pause(4.0 * CADENCE_S)
        right = newest(run)
        assert max(wait_for_sightings(run, after=right, fewest=2)) < 1.0
        run.order("CLOCK_OFFSET", round(1000.0 * (late_s + TAI_S)))
        wrong = newest(run) + TAI_S / 2.0  # later than all that were dated rightly
        assert min(wait_for_sightings(run, after=wrong, fewest=3)) >= TAI_S - 1.0
        run.wait_for(lambda: abs(offset_s(run) - TAI_S) < 1.0, what="the notice", within_s=30.0)
        assert 'timestamp_scale = "tai"' in findings(run)["camera_clock_offset"]["remedy"]
