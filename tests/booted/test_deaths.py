"""The service killed, hung, and kept from starting."""

from __future__ import annotations

import errno
import os
import random
import time
from typing import TYPE_CHECKING

import pytest

from .machine import wait_for

if TYPE_CHECKING:
    from .conftest import Field

pytestmark = [pytest.mark.booted, pytest.mark.timeout(1200)]

KILLS = 20
START_PROCESSOR_S = 4.0
"""Of a start until ready; 1.8 to 2.3 s in 20 kills beside a load of 12 on 2 cores."""
DROP_IN = "/etc/systemd/system/sunarc.service.d/test.conf"
OCCUPYING = """
import pathlib, socket, time
occupied = socket.create_server(("127.0.0.1", 8080))
pathlib.Path("/run/occupied").touch()
time.sleep(9e6)
"""
HANGING = """
import runpy, sys, threading
sys.path.insert(0, "/usr/lib/sunarc/site")
if __name__ == "__main__":
    import sunarc.imager.app.service as service
    def hang(self, stop, heartbeat):
        threading.Event().wait()
    service.{worker}.run = hang
    runpy.run_path("/usr/lib/sunarc/launch.py", run_name="__main__")
"""


def test_twenty_kills_at_random_moments_lose_nothing_and_each_start_is_quick(field_computer: Field) -> None:
    field, moments = field_computer, random.Random(20)
    waits: list[float] = []
    used: list[float] = []
    for _ in range(KILLS):
        field.wait_for_sightings(1)
        time.sleep(moments.uniform(0.0, 3.0))
        stored = int(field.sql("SELECT max(id) FROM sun_point"))
        restarts, killed = field.restarts(), time.monotonic()
        field.do("systemctl", "kill", "-s", "KILL", "--kill-whom=main", "sunarc")
        wait_for(lambda before=restarts: field.restarts() > before, within_s=30.0, what="the restart")  # type: ignore[misc]
        field.wait_until_ready()
        used.append(field.processor_s())
        waits.append(time.monotonic() - killed)
        assert int(field.sql(f"SELECT count(*) FROM sun_point WHERE id <= {stored}")) == stored
        field.do("systemctl", "reset-failed", "sunarc")  # twenty in a row would be called hopeless
    assert field.sql("PRAGMA integrity_check") == "ok"
    print("seconds from kill to ready:", *(f"{wait:.1f}" for wait in waits))  # noqa: T201 - the figure that is asked for
    print("seconds of processor:", *(f"{one:.1f}" for one in used))  # noqa: T201 - same
    assert max(used) <= START_PROCESSOR_S  # the wait itself is the host's matter, where others use it too


@pytest.mark.parametrize("worker", ["CaptureWorker", "DetectWorker", "ComposeWorker", "RefitWorker"])
def test_a_hung_worker_is_ended_by_the_watchdog_with_its_stack_in_the_journal(
    field_computer: Field, worker: str
) -> None:
    field = field_computer
    field.configure(more="[supervisor]\nstale_after_s = 5.0\n")
    field.write("/etc/sunarc/hanging.py", HANGING.format(worker=worker))
    start = "/usr/bin/python3 -I -X faulthandler /etc/sunarc/hanging.py serve --config /etc/sunarc/sunarc.toml"
    field.write(DROP_IN, f"[Service]\nWatchdogSec=8\nExecStart=\nExecStart={start}\n")
    field.do("systemctl", "daemon-reload")
    field.do("systemctl", "restart", "sunarc")
    before = field.restarts()
    wait_for(lambda: field.restarts() > before, within_s=90.0, what="the watchdog", every_s=0.5)
    told = field.journal()
    assert f"condition worker_stuck_{worker.removesuffix('Worker').lower()}" in told
    assert "Watchdog timeout" in told
    assert 'File "/etc/sunarc/hanging.py", line 7 in hang' in told
    field.path(DROP_IN).unlink()
    field.configure()
    field.do("systemctl", "daemon-reload")
    field.do("systemctl", "restart", "sunarc")
    field.wait_until_ready()
    field.wait_for_sightings(1)


def test_a_service_that_cannot_stay_up_is_told_of_and_tried_again(field_computer: Field) -> None:
    field = field_computer
    field.write("/etc/sunarc/on-failure.d/tell", "#!/bin/sh\ntouch /run/told\n", mode=0o755)
    field.write(DROP_IN, "[Unit]\nStartLimitBurst=3\n")
    field.do("systemctl", "daemon-reload")
    field.do("systemctl", "stop", "sunarc")
    field.do("systemd-run", "--unit=occupier", "python3", "-c", OCCUPYING)
    wait_for(lambda: field.call("test", "-e", "/run/occupied").returncode == 0, within_s=60.0, what="the occupier")
    field.call("systemctl", "start", "sunarc")

    def failed() -> bool:
        return field.call("systemctl", "is-failed", "sunarc").stdout.strip() == "failed"

    wait_for(failed, within_s=120.0, what="the start limit", every_s=0.5)
    assert os.strerror(errno.EADDRINUSE) in field.journal()
    wait_for(lambda: field.call("test", "-e", "/run/told").returncode == 0, within_s=20.0, what="the hook")
    assert field.do("systemctl", "is-active", "sunarc-retry.timer").strip() == "active"
    field.do("systemctl", "stop", "occupier")
    field.do("systemctl", "reset-failed", "sunarc")  # what five minutes do
    field.write("/etc/systemd/system/sunarc-retry.timer.d/soon.conf", "[Timer]\nOnActiveSec=\nOnActiveSec=2\n")
    field.do("systemctl", "daemon-reload")
    field.do("systemctl", "restart", "sunarc-retry.timer")
    field.wait_until_ready()
