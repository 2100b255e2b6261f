"""When a hub's jobs run, and what is shown of those that failed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import pytest
from tests.fixtures.archive import new_archive
from tests.fixtures.board import status_registry

from sunarc.common.errors import InputError
from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.hub.nightly import NightlyWork, nightly_jobs
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.options import NightlyOptions

NIGHT = datetime(2026, 5, 2, 8, 29, 59, tzinfo=UTC)
"""A second before 2 h after midnight at 97.5 degrees west."""
HOUR = 3600.0


@dataclass
class Bench:
    archive: HubArchive
    clock: VirtualClock
    board: StatusRegistry
    calls: list[str] = field(default_factory=list)
    broken: set[str] = field(default_factory=set)

    def job(self, name: str) -> dict[str, int]:
        self.calls.append(name)
        if name in self.broken:
            raise ValueError(f"{name} is broken")
        return {"n": len(self.calls)}

    def work(self) -> NightlyWork:
        """Return the work of a process that has just started."""
        self.board = status_registry(self.clock)
        jobs = {name: lambda _now, name=name: self.job(name) for name in ("first", "second")}
        return NightlyWork(archive=self.archive, jobs=jobs, clock=self.clock, board=self.board)

    def reasons(self) -> list[str]:
        return [reason.code for reason in self.board.snapshot().reasons]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    clock = VirtualClock(NIGHT)
    new_archive(tmp_path).close()
    with open_hub_archive(tmp_path / "sunarc.sqlite") as archive:
        yield Bench(archive, clock, status_registry(clock))


def test_jobs_run_once_a_night_two_hours_after_midnight(bench: Bench) -> None:
    work = bench.work()
    work.run_due()  # of the night before, which nobody did
    bench.calls.clear()
    work.run_due()
    assert bench.calls == []
    bench.clock.advance(1.0)
    for _ in range(24 * 60):
        work.run_due()
        bench.clock.advance(60.0)
    assert bench.calls == ["first", "second"]
    nights = bench.archive.nightly.runs(limit=9)
    assert [run.night.isoformat() for run in nights] == ["2026-05-02", "2026-05-01"]
    assert all(run.finished_at is not None and set(run.results) == {"first", "second"} for run in nights)


def test_nights_that_were_missed_are_made_up_by_one(bench: Bench) -> None:
    work = bench.work()
    work.run_due()
    bench.clock.advance(5 * 24 * HOUR)
    work.run_due()
    work.run_due()
    assert bench.calls == ["first", "second"] * 2


def test_a_job_that_fails_is_shown_and_tried_again_alone_each_hour_also_by_another_process(bench: Bench) -> None:
    bench.broken = {"first"}
    bench.clock.advance(1.0)
    bench.work().run_due()
    assert (bench.calls, bench.reasons()) == (["first", "second"], ["nightly_failed"])
    work = bench.work()
    assert bench.reasons() == []
    work.run_due()  # shown from the store, not run again
    assert (bench.calls, bench.reasons()) == (["first", "second"], ["nightly_failed"])
    (reason,) = bench.board.snapshot().reasons
    assert (reason.data["jobs"], reason.data["error"]) == ("first", "ValueError: first is broken")
    bench.clock.advance(HOUR)
    bench.broken = set()
    work.run_due()
    assert (bench.calls[2:], bench.reasons()) == (["first"], [])


def test_a_run_that_was_cut_off_is_made_again_after_an_hour(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(_name: str) -> dict[str, int]:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(bench, "job", killed)
        with pytest.raises(KeyboardInterrupt):
            bench.work().run_due()
    bench.work().run_due()
    assert bench.calls == []
    bench.clock.advance(HOUR)
    bench.work().run_due()
    assert bench.calls == ["first", "second"]


def test_a_clock_that_was_ahead_does_not_end_the_nights(bench: Bench) -> None:
    work = bench.work()
    bench.clock.step(365 * 24 * HOUR)
    work.run_due()
    bench.clock.step(-365 * 24 * HOUR)
    work.run_due()
    assert bench.calls == ["first", "second"] * 2


def test_the_jobs_of_a_hub(bench: Bench) -> None:
    jobs = nightly_jobs(bench.archive, NightlyOptions())
    assert {name: job(bench.clock.now()) for name, job in jobs.items()} == {
        "summaries": {"days": 0},
        "cross_checks": {"checks": []},
        "retention": {"removed": 0},
        "quarantine": {"removed": 0},
    }


@pytest.mark.parametrize("days", [89.9, 36_501.0])
def test_what_is_needed_is_kept(days: float) -> None:
    with pytest.raises(InputError):
        NightlyOptions(keep_sightings_days=days)
