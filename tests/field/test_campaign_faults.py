"""A fault that does not end as it should is found wrong, and does not end the campaign."""

from __future__ import annotations

import random
import signal
from typing import TYPE_CHECKING

import pytest

from .campaign_faults import Faults
from .campaign_processes import Setting

if TYPE_CHECKING:
    from pathlib import Path


class WithoutProcesses(Faults):
    """Faults that are done to nothing; what would be started and stopped is listed."""

    def __init__(self, folder: Path, error: Exception | None) -> None:
        self.folder = self.state = folder
        self.clock_file = folder / "clock"
        self.setting = Setting()
        self.service = self.imager = self.judge = self.hub = None
        self.random = random.Random(1)
        self.counts: dict[str, int] = {}
        self.exits: list[str] = []
        self.done: list[str] = []
        self.error = error

    def _kill(self) -> None:
        if self.error is not None:
            raise self.error

    def frame_time(self) -> float | None:
        return None

    def wait(self, seconds: float) -> None:
        assert seconds > 0.0
        self.done.append("wait")

    def start_imager(self) -> None:
        self.done.append("start imager")

    def start_service(self) -> None:
        self.done.append("start service")

    def stop_service(self, number: signal.Signals) -> None:
        self.done.append(f"stop service by {number.name}")

    def kill_imager(self) -> None:
        self.done.append("kill imager")


def test_a_fault_that_fails_is_found_wrong_and_both_processes_are_started_anew(tmp_path: Path) -> None:
    faults = WithoutProcesses(tmp_path, RuntimeError("did not start"))
    faults.disturb("kill")
    assert faults.exits == ["kill failed: did not start"]
    assert faults.done == ["stop service by SIGKILL", "kill imager", "start imager", "start service", "wait"]
    assert faults.clock_file.read_text() == "0 synchronised"


def test_a_fault_that_ends_as_it_should_starts_nothing(tmp_path: Path) -> None:
    faults = WithoutProcesses(tmp_path, None)
    faults.disturb("kill")
    assert (faults.exits, faults.done, faults.counts) == ([], ["wait"], {"kill": 1})


def test_what_was_started_is_ended_where_the_service_does_not_start(tmp_path: Path) -> None:
    class Unstarted(WithoutProcesses):
        has_own_disk, port = False, 1

        def write_settings(self, name: str, *, port: int) -> Path:
            return self.folder / f"{name}{port}"

        def start_service(self) -> None:
            raise RuntimeError("did not start")

        def __exit__(self, *_: object) -> None:
            self.done.append("ended")

    faults = Unstarted(tmp_path, None)
    with pytest.raises(RuntimeError), faults:
        pass
    assert faults.done == ["start imager", "ended"]


def test_a_defect_of_the_campaign_itself_ends_it(tmp_path: Path) -> None:
    with pytest.raises(KeyError):
        WithoutProcesses(tmp_path, KeyError("defect")).disturb("kill")
