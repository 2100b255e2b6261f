"""Faults of a window overlap where they can; one that fails is found wrong, and does not end the campaign."""

from __future__ import annotations

import json
import signal
import threading
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, cast

import pytest
from tests.release.campaign_faults import FAULTS, Faults
from tests.release.campaign_judge import Findings
from tests.release.campaign_processes import Setting, pause
from tests.release.campaign_windows import Windows

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from tests.release.campaign_judge import Judge


class WithoutProcesses(Faults):
    """Faults that are done to nothing; what would be started and stopped is listed."""

    def __init__(self, folder: Path, error: Exception | None) -> None:
        self.folder = self.state = folder
        self.clock_file = folder / "clock"
        self.setting = Setting()
        self.service = self.imager = self.judge = self.hub = None
        self.seed, self.faults_of, self.left_out, self.failed = 1, "gige", ["disk_full"], False
        self.drawn, self.locks, self.hinders_until = threading.local(), defaultdict(threading.RLock), {}
        self.pool = ThreadPoolExecutor(12)
        self.counts: dict[str, int] = {}
        self.exits: list[str] = []
        self.done: list[str] = []
        self.error = error

    def _kill(self) -> None:
        if self.error is not None:
            raise self.error

    def note(self, text: str) -> None:
        assert text

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
    faults.disturb(["kill"])
    assert faults.exits == ["kill failed: did not start"]
    done = [one for one in faults.done if one != "wait"]
    assert done == ["stop service by SIGKILL", "kill imager", "start imager", "start service"]
    assert faults.clock_file.read_text() == "0 synchronised"


def test_a_fault_that_ends_as_it_should_starts_nothing(tmp_path: Path) -> None:
    faults = WithoutProcesses(tmp_path, None)
    faults.disturb(["kill"])
    assert (faults.exits, set(faults.done), faults.counts) == ([], {"wait"}, {"kill": 1})


class Overlapping(WithoutProcesses):
    """Counts how many faults of the service are done at once; two others go on only where both are being done."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, None)
        self.both = threading.Barrier(2, timeout=10.0)
        self.at_once: list[int] = []
        self.now_done = 0

    def _kill(self) -> None:
        self.now_done += 1
        self.at_once.append(self.now_done)
        pause(0.02)
        self.now_done -= 1

    _stop = _pause = _kill

    def _hub_away(self) -> None:
        self.both.wait()

    _receiver_drips = _hub_away


def test_faults_of_one_thing_follow_each_other_and_others_overlap(tmp_path: Path) -> None:
    faults = Overlapping(tmp_path)
    names = ["kill", "stop", "pause", "hub_away", "receiver_drips"]
    faults.disturb(names)
    assert faults.at_once == [1, 1, 1]
    assert (faults.exits, faults.counts) == ([], dict.fromkeys(names, 1))


def test_windows_have_each_kind_once_before_any_comes_again(tmp_path: Path) -> None:
    kinds = set(FAULTS["gige"]) - {"disk_full"}
    drawn: list[str] = []
    for window in WithoutProcesses(tmp_path, None).windows():
        assert len(set(window)) == len(window) <= 12
        drawn += window
        if len(drawn) >= 3 * len(kinds):
            break
    assert all(set(drawn[n * len(kinds) :][: len(kinds)]) == kinds for n in range(3))


class Judged(WithoutProcesses):
    """A chain in which one kind of fault loses a sighting each time."""

    def __init__(self, folder: Path, bad: str) -> None:
        super().__init__(folder, None)
        self.left_out, self.flipped, self.n_starts, self.n_starts_again = [], set(), 1, 0
        self.bad, self.judge = bad, cast("Judge", self)
        self.found = Findings(n_sightings=1, integrity="ok")

    def disturb(self, faults: Sequence[str]) -> None:
        for fault in faults:
            self.counts[fault] = self.counts.get(fault, 0) + 1
        if self.bad in faults:
            self.found.lost.append(f"{len(self.found.lost)}")

    def recover(self) -> list[str]:
        return []

    def check(self) -> Findings:
        return self.found


def test_faults_of_a_window_with_a_finding_are_named_and_done_singly(tmp_path: Path) -> None:
    run = Judged(tmp_path, "locked")
    windows = Windows(run, {"source": "gige", "seed": 1})
    while "locked" not in run.counts:
        windows.one()
    report = json.loads((tmp_path / "report.json").read_text())
    (failed,) = report["failed"]
    assert "locked" in failed["faults"]
    assert failed["found"] == ["lost 0"]
    assert failed["singly"] == {fault: ["lost 1"] if fault == "locked" else [] for fault in failed["faults"]}
    assert report["singly"] == dict.fromkeys(failed["faults"], 1)
    assert report["faults"] == dict.fromkeys((fault for one in windows.done for fault in one.faults), 1)
    assert (report["good"], report["windows"]) == (False, len(windows.done))


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
        WithoutProcesses(tmp_path, KeyError("defect")).disturb(["kill"])
