"""Signals, stops, killed children, a hung web server and a full cache, done to the installed package."""

from __future__ import annotations

import random
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from .machine import wait_for

if TYPE_CHECKING:
    from .conftest import Field

pytestmark = [pytest.mark.booted, pytest.mark.timeout(1200)]

STOPS = 12
LOAD = 4  # busy processes beside the service
DROP_IN = "/etc/systemd/system/sunarc.service.d/test.conf"
HUNG_LOOP = """
import runpy, sys, time
sys.path.insert(0, "/usr/lib/sunarc/site")
if __name__ == "__main__":
    import sunarc.imager.app.serving as serving
    on_tick = serving.Server.on_tick
    async def hang(self, counter):
        if counter == 50:
            time.sleep(9e6)
        return await on_tick(self, counter)
    serving.Server.on_tick = hang
    runpy.run_path("/usr/lib/sunarc/launch.py", run_name="__main__")
"""


def shown(field: Field, name: str) -> str:
    return field.do("systemctl", "show", "-P", name, "sunarc").strip()


@contextmanager
def busy_host(n: int) -> Iterator[None]:
    """Keep `n` processes of the host busy."""
    burners = [subprocess.Popen(["sh", "-c", "while :; do :; done"]) for _ in range(n)]
    try:
        yield
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


@pytest.mark.parametrize("signal", ["TERM", "INT"])
def test_a_signal_to_the_process_ends_it_and_it_is_started_again(field_computer: Field, signal: str) -> None:
    field = field_computer
    before, pid = field.restarts(), field.main_pid()
    stored = field.wait_for_sightings(1)
    field.do("systemctl", "kill", "-s", signal, "--kill-whom=main", "sunarc")
    wait_for(lambda: field.restarts() > before, within_s=60.0, what="the restart", every_s=0.5)
    field.wait_until_ready()
    assert field.main_pid() != pid
    assert field.wait_for_sightings(1) > stored


def test_sighup_changes_nothing(field_computer: Field) -> None:
    field = field_computer
    pid = field.main_pid()
    field.do("systemctl", "kill", "-s", "HUP", "--kill-whom=main", "sunarc")
    field.wait_for_sightings(1)
    assert field.main_pid() == pid


def test_refused_settings_are_not_tried_again_by_themselves(field_computer: Field) -> None:
    field = field_computer
    field.configure(more="[api]\nprot = 8080\n")
    field.call("systemctl", "restart", "sunarc")
    wait_for(lambda: not field.active(), within_s=30.0, what="the refusal")

    def reported() -> bool:
        return "/etc/sunarc/sunarc.toml" in field.do("journalctl", "-u", "sunarc-failed", "-o", "cat", "--no-pager")

    wait_for(reported, within_s=30.0, what="the report")
    assert field.call("systemctl", "is-active", "sunarc-retry.timer").stdout.strip() == "inactive"
    assert field.restarts() == 0
    field.configure()
    field.wait_until_ready()


def test_orderly_stops_on_a_busy_host_end_with_code_0_and_no_abort(field_computer: Field) -> None:
    field, moments = field_computer, random.Random(8)
    with busy_host(LOAD):
        for _ in range(STOPS):
            time.sleep(moments.uniform(0.5, 6.0))
            stored = int(field.sql("SELECT max(id) FROM sun_point") or 0)
            field.do("systemctl", "stop", "sunarc")
            assert (shown(field, "Result"), shown(field, "ExecMainStatus")) == ("success", "0")
            field.do("systemctl", "reset-failed", "sunarc")
            field.do("systemctl", "start", "sunarc")
            field.wait_until_ready()
            assert int(field.sql(f"SELECT count(*) FROM sun_point WHERE id <= {stored}") or 0) == stored
        field.wait_for_sightings(1)
    told = field.journal()
    assert "terminate called" not in told
    assert "SIGABRT" not in told


def refit_states(field: Field) -> list[str]:
    return field.sql("SELECT state FROM refit ORDER BY requested_at").split()


def begin_refit(field: Field) -> None:
    assert field.ask("/v1/refits", method="POST") is not None
    wait_for(lambda: "running" in refit_states(field), within_s=60.0, what="the refit to run", every_s=0.05)


def solver(field: Field) -> str:
    return field.call("pgrep", "-P", str(field.main_pid()), "-f", "multiprocessing-fork").stdout.strip()


def test_a_refit_outlives_a_stop_and_the_death_of_its_process(field_computer: Field) -> None:
    field = field_computer
    field.remember(days=3)
    begin_refit(field)
    wait_for(lambda: solver(field) != "", within_s=120.0, what="the solving process", every_s=0.05)
    field.do("systemctl", "stop", "sunarc")
    assert "running" in refit_states(field)  # it is begun again
    assert "failed" not in refit_states(field)
    field.do("systemctl", "start", "sunarc")
    field.wait_until_ready()
    wait_for(lambda: solver(field) != "", within_s=240.0, what="the solving process", every_s=0.05)
    field.do("kill", "-KILL", *solver(field).split())
    wait_for(lambda: "running" not in refit_states(field), within_s=300.0, what="the refit's end", every_s=0.5)
    assert set(refit_states(field)) <= {"requested", "accepted", "marginal", "refused"}
    assert "signal 9" in field.journal()
    field.compare_with_truth()


def test_a_hung_web_server_is_ended_by_the_watchdog(field_computer: Field) -> None:
    field = field_computer
    field.configure(more="[supervisor]\nstale_after_s = 5.0\n")
    field.write("/etc/sunarc/hanging.py", HUNG_LOOP)
    start = "/usr/bin/python3 -I -X faulthandler /etc/sunarc/hanging.py serve --config /etc/sunarc/sunarc.toml"
    field.write(DROP_IN, f"[Service]\nWatchdogSec=8\nExecStart=\nExecStart={start}\n")
    field.do("systemctl", "daemon-reload")
    field.do("systemctl", "restart", "sunarc")
    before = field.restarts()
    wait_for(lambda: field.restarts() > before, within_s=120.0, what="the watchdog", every_s=0.5)
    told = field.journal()
    assert "condition worker_stuck_web" in told
    assert "Watchdog timeout" in told
    assert "in hang" in told


def test_systemctl_shows_how_the_service_is(field_computer: Field) -> None:
    field = field_computer
    field.wait_for_sightings(1)
    wait_for(lambda: f"{field.start:%Y}-" in shown(field, "StatusText"), within_s=60.0, what="the line", every_s=1.0)
