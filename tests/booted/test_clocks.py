"""The host's clock 400 days ahead at a start, and right again after a minute."""

from __future__ import annotations

import time
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import pytest

from sunarc.sky.site import Site

from .conditions import findings, wait_for_reason
from .conftest import AS_SUNARC
from .machine import wait_for

if TYPE_CHECKING:
    from pathlib import Path

    from .conftest import Field, Fields

pytestmark = [pytest.mark.booted, pytest.mark.timeout(1200)]

DAYS = 400
AHEAD_S = 60.0
CADENCE_S = 2.0
DROP_IN = "/etc/systemd/system/sunarc.service.d/test.conf"
CLOCK = "/etc/sunarc/clock"
CLOCKED = """
import runpy, sys
from datetime import UTC, datetime, timedelta
sys.path.insert(0, "/usr/lib/sunarc/site")
if __name__ == "__main__":
    from sunarc.imager.runtime import clock
    from sunarc.imager.workers import clock_watch
    clock_watch.SETTLE_S = 150.0  # ten minutes otherwise
    def setting():
        seconds, state = open("/etc/sunarc/clock").read().split()
        return float(seconds), state == "synchronised"
    clock.SystemClock.now = lambda self: datetime.now(UTC) + timedelta(seconds=setting()[0])
    clock.SystemClock.state = lambda self: clock.ClockState(synchronised=setting()[1], error_bound_s=0.01)
    runpy.run_path("/usr/lib/sunarc/launch.py", run_name="__main__")
"""
START = "/usr/bin/python3 -I -X faulthandler /etc/sunarc/clocked.py serve --config /etc/sunarc/sunarc.toml"


def set_clock(field: Field, seconds: float, state: str) -> None:
    """Let the service's host be ahead by so many seconds, and the kernel call its clock so."""
    field.write(f"{CLOCK}.new", f"{seconds} {state}")
    field.path(f"{CLOCK}.new").rename(field.path(CLOCK))


def imager_offset_s(field: Field) -> float:
    """Return the imager's time less the host's, seconds: it begins to count when the first frame is asked for."""
    wait_for_reason(field, "camera_clock_offset")
    time.sleep(20.0 * CADENCE_S)  # the smallest of many is meant, not that of a cycle that was late
    return float(findings(field)["camera_clock_offset"]["offset_s"])


@pytest.fixture
def dated_by_the_host(new_field: Fields, installed: Path) -> tuple[Field, float]:
    """Return a field computer at noon, calibrated, whose clock is the imager's; and what makes it so, seconds."""
    now = datetime.now(UTC)
    field = new_field(installed)
    field.site = Site(latitude=20.0, longitude=(12.0 - now.hour - now.minute / 60.0) * 15.0, altitude=300.0)
    field.start, field.speed = now, 1
    field.write("/etc/sunarc/clocked.py", CLOCKED)
    field.write(DROP_IN, f"[Service]\nExecStart=\nExecStart={START}\n")
    set_clock(field, 0.0, "synchronised")
    field.configure(cadence_s=CADENCE_S)
    field.begin()
    offset_s = imager_offset_s(field)
    set_clock(field, offset_s, "synchronised")
    field.do("systemctl", "stop", "sunarc")
    field.do("sh", "-c", "rm /var/lib/sunarc/sunarc.sqlite*")
    field.configure(cadence_s=CADENCE_S, timestamps="host")
    field.do("systemctl", "start", "sunarc")
    field.wait_until_ready()
    field.remember(days=3)
    assert field.ask("/v1/refits", method="POST") is not None
    # a second one, of the same days, may change nothing and be refused
    wait_for(lambda: not {"requested", "running"} & refit_states(field), within_s=300.0, what="the refit", every_s=0.5)
    assert "accepted" in refit_states(field)
    return field, offset_s


def refit_states(field: Field) -> set[str]:
    return set(field.sql("SELECT state FROM refit").split())


def trusted(field: Field) -> int:
    return int(field.sql("SELECT count(*) FROM sun_point WHERE accepted AND clock_error_s < 2.0"))


@pytest.mark.parametrize("state", ["unsynchronised", "synchronised"])
def test_a_start_with_the_clock_400_days_ahead_costs_neither_calibration_nor_images(
    dated_by_the_host: tuple[Field, float], state: str
) -> None:
    field, right_s = dated_by_the_host
    calibration = field.ask("/v1/calibration")["id"]
    field.wait_for_sightings(3)
    yesterday = f"/var/lib/sunarc/images/{field.start - timedelta(days=1):%Y/%m/%d}"
    field.do(*AS_SUNARC, "sh", "-c", f"mkdir -p {yesterday} && touch {yesterday}/120000.hdr.png")
    field.do("systemctl", "stop", "sunarc")
    set_clock(field, DAYS * 86_400.0, state)
    field.do("systemctl", "start", "sunarc")
    field.wait_until_ready()
    time.sleep(AHEAD_S)
    set_clock(field, right_s, "synchronised")
    time.sleep(40.0)
    field.do("systemctl", "restart", "sunarc")
    field.wait_until_ready()
    before = trusted(field)
    wait_for(lambda: trusted(field) >= before + 10, within_s=400.0, what="trusted sightings", every_s=1.0)
    assert field.ask("/v1/calibration")["id"] == calibration
    assert field.sql("SELECT count(*) FROM pose_epoch") == "1"
    assert field.sql("SELECT kind FROM event WHERE kind IN ('bump', 'lens', 'clock')") == ""
    assert field.path(f"{yesterday}/120000.hdr.png").exists()
    assert field.ask("/v1/refits", method="POST") is not None
    wait_for(lambda: not {"requested", "running"} & refit_states(field), within_s=300.0, what="the refit's end")
    assert "failed" not in refit_states(field)
    field.compare_with_truth()
