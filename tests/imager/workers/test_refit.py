from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from multiprocessing.context import SpawnProcess
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.archive import new_archive
from tests.fixtures.finding_codes import codes
from tests.imager.workers.conftest import refit_worker

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.values import Refit, SunPoint
from sunarc.imager.runtime.clock import SystemClock, VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.calibrating.solver_process import (
    ChildControl,
    SolveFailedError,
    SolveProblem,
    SolverDiedError,
    solve_in_child,
)
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import PARAMETER_NAMES
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions

NOW = datetime(2013, 5, 14, 6, 30, tzinfo=UTC)
SIZE = (1748, 1748)


def sightings(*, every_s: float = 240.0, sigma_px: float = 0.02) -> Sightings:
    times = datetime(2013, 5, 13, 6, tzinfo=UTC).timestamp() + np.arange(0.0, 86_400.0, every_s)
    times = times[sun_angles(times, SGP).apparent_zenith < 88.0]
    noise = np.random.default_rng(3).normal(0.0, sigma_px, (times.size, 2))
    return Sightings.of(unix_s=times, pixels=project(true_camera(), sun_directions(times, SGP)) + noise)


@pytest.fixture(scope="module")
def good() -> Calibration:
    return calibrate(sightings(), site=SGP, image_size=SIZE)


@pytest.fixture
def archive(tmp_path: Path) -> Archive:
    opened = new_archive(tmp_path, width=SIZE[0], height=SIZE[1])
    points = sightings()
    epoch = opened.epochs.at("roof", datetime.fromtimestamp(points.unix_s[0], UTC), reason="first frame")
    opened.sightings.add(
        SunPoint(
            camera="roof",
            pose_epoch=epoch.id,
            time=datetime.fromtimestamp(time, UTC),
            method="disc",
            accepted=True,
            verdict="clear",
            x_px=x,
            y_px=y,
        )
        for time, (x, y) in zip(points.unix_s.tolist(), points.pixels.tolist(), strict=True)
    )
    return opened


@pytest.fixture
def worker(archive: Archive, board: StatusRegistry, clock: VirtualClock) -> RefitWorker:
    return refit_worker(archive, board, clock, now=NOW, cadence_s=30.0)


Answer = Calibration | SolveFailedError | None
Carry = Callable[[str, Answer], Refit]


@pytest.fixture
def carry_out(worker: RefitWorker, archive: Archive, monkeypatch: pytest.MonkeyPatch) -> Carry:
    """Carry one refit out with a solve that is already known."""

    def carry(name: str, answer: Answer) -> Refit:
        def solved(*_: object, **__: object) -> Calibration | None:
            if isinstance(answer, SolveFailedError):
                raise answer
            return answer

        monkeypatch.setattr(worker, "solve", solved)
        refit = archive.refits.add(Refit(id=name * 6, camera="roof", requested_at=NOW, reason="test"))
        worker.carry_out(refit, threading.Event(), lambda: None)
        return archive.refits.get(refit.id)

    return carry


def test_the_first_accepted_fit_becomes_current_from_the_epochs_beginning(
    carry_out: Carry, archive: Archive, good: Calibration, board: StatusRegistry
) -> None:
    refit = carry_out("a", good)
    current = archive.calibrations.current("roof")
    assert refit.state == "accepted"
    assert current is not None
    assert current.id == refit.calibration
    (epoch,) = archive.epochs.find("roof")
    assert current.valid_from == epoch.started_at
    assert "no_calibration" not in {reason.code for reason in board.snapshot().reasons}


def test_a_worse_fit_is_refused_kept_and_served_to_nobody(
    carry_out: Carry, archive: Archive, good: Calibration
) -> None:
    first = carry_out("a", good)
    worse = replace(good, sky_rms_deg=3.0 * good.sky_rms_deg)
    second = carry_out("b", worse)
    assert second.state == "refused"
    current = archive.calibrations.current("roof")
    assert current is not None
    assert current.id == first.calibration
    assert second.calibration is not None
    kept = archive.calibrations.get(second.calibration)
    assert kept.state == "refused"
    assert kept.parent == first.calibration
    assert kept.findings[0].code == "direction_sigma_increased"
    told = archive.events.find("roof")[0]
    assert told.kind == "refit_refused"
    assert told.findings[0]["data"]["served"] == f"the calibration of {current.created_at:%d %b %Y} is still served"
    assert told.text.startswith("the calibration of ")


def test_a_pinned_calibration_stays_and_the_better_one_waits_as_a_candidate(
    carry_out: Carry, archive: Archive, good: Calibration
) -> None:
    first = carry_out("a", good)
    assert first.calibration is not None
    archive.calibrations.pin(first.calibration, at=NOW, reason="a campaign")
    second = carry_out("b", replace(good, sky_rms_deg=0.9 * good.sky_rms_deg))
    assert second.state == "accepted"
    assert codes(second.findings)[-1] == "active_is_pinned"
    assert second.message.endswith(Finding("active_is_pinned").text)
    current = archive.calibrations.current("roof")
    assert current is not None
    assert current.id == first.calibration
    assert [record.id for record in archive.calibrations.find("roof", state="candidate")] == [second.calibration]


def test_a_fit_that_refuses_itself_is_kept_with_its_reasons(
    carry_out: Carry, archive: Archive, good: Calibration
) -> None:
    refused = replace(good, verdict=Verdict(accepted=False, findings=(Finding("not_evaluated"),)))
    refit = carry_out("a", refused)
    assert refit.state == "refused"
    assert codes(refit.findings) == ["not_evaluated"]
    assert archive.calibrations.current("roof") is None


def test_a_solve_that_fails_is_told_and_changes_nothing(carry_out: Carry, archive: Archive) -> None:
    too_long = Finding("solve_too_long", {"limit_s": 1.0})
    refit = carry_out("a", SolveFailedError(too_long))
    assert (refit.state, refit.findings, refit.message) == ("failed", (too_long,), too_long.text)
    assert archive.calibrations.find("roof") == ()


def test_a_refit_that_was_cut_short_waits_to_be_begun_again(carry_out: Carry, archive: Archive) -> None:
    refit = carry_out("a", None)
    assert refit.state == "running"
    assert [waiting.id for waiting in archive.refits.find("roof", unfinished=True)] == [refit.id]


@pytest.mark.parametrize("outcome", [(0, "accepted", 1), (1, "accepted", 2), (2, "failed", 2)])
def test_a_solve_whose_process_was_killed_is_begun_once_more(
    worker: RefitWorker,
    archive: Archive,
    good: Calibration,
    monkeypatch: pytest.MonkeyPatch,
    outcome: tuple[int, str, int],
) -> None:
    deaths, state, tries = outcome
    begun: list[int] = []

    def solved(*_: object, **__: object) -> Calibration:
        begun.append(1)
        if len(begun) <= deaths:
            raise SolverDiedError(Finding("solver_died", {"end": "signal 9"}))
        return good

    monkeypatch.setattr(worker, "solve", solved)
    refit = archive.refits.add(Refit(id="abcdef", camera="roof", requested_at=NOW, reason="test"))
    worker.carry_out(refit, threading.Event(), lambda: None)
    assert (archive.refits.get(refit.id).state, len(begun)) == (state, tries)


def solve_and_kill(stop: threading.Event) -> Calibration | None:
    """Solve, and end the child as a stop of the whole control group does, at the parent's first turn."""

    def kill() -> None:
        for child in multiprocessing.active_children():
            child.terminate()

    problem = SolveProblem(points=sightings(every_s=1200.0), site=SGP, image_size=SIZE, options=CalibrationOptions())
    return solve_in_child(problem, ChildControl(SystemClock(), 60.0, stop, kill))


def test_a_child_that_was_killed_is_told_from_one_that_failed() -> None:
    with pytest.raises(SolverDiedError, match="signal 15"):
        solve_and_kill(threading.Event())


def test_a_child_that_dies_before_it_has_read_its_problem_is_one_that_was_killed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    start = SpawnProcess.start

    def start_and_kill(self: SpawnProcess) -> None:
        start(self)
        self.kill()

    monkeypatch.setattr(SpawnProcess, "start", start_and_kill)
    points = sightings(every_s=4.0)  # more than a pipe takes
    problem = SolveProblem(points=points, site=SGP, image_size=SIZE, options=CalibrationOptions())
    with pytest.raises(SolverDiedError):
        solve_in_child(problem, ChildControl(SystemClock(), 60.0, threading.Event(), lambda: None))


def test_a_child_that_is_ended_a_moment_before_the_stop_leaves_the_refit_unfinished() -> None:
    stop = threading.Event()
    later = threading.Timer(0.8, stop.set)
    later.start()
    assert solve_and_kill(stop) is None
    later.join()


def solve(*, time_limit_s: float = 120.0, stop: threading.Event | None = None) -> Calibration | None:
    problem = SolveProblem(points=sightings(every_s=1200.0), site=SGP, image_size=SIZE, options=CalibrationOptions())
    return solve_in_child(problem, ChildControl(SystemClock(), time_limit_s, stop or threading.Event(), lambda: None))


@pytest.mark.slow
def test_the_child_process_answers_what_the_function_answers() -> None:
    answer = solve()
    assert answer is not None
    here = calibrate(sightings(every_s=1200.0), site=SGP, image_size=SIZE)
    # where arrays lie in memory decides in which order vector registers add; a fit stops short of its minimum
    free = [PARAMETER_NAMES.index(name) for name in here.parameter_names]
    apart = (answer.camera.to_vector() - here.camera.to_vector())[free]
    assert np.max(np.abs(apart) / np.sqrt(np.diag(here.covariance))) < 0.05


def test_a_solve_beyond_its_time_limit_is_ended() -> None:
    with pytest.raises(SolveFailedError, match=r"0\.1 s"):
        solve(time_limit_s=0.1)


def test_a_solve_ends_when_the_service_stops() -> None:
    stop = threading.Event()
    stop.set()
    assert solve(stop=stop) is None


def test_a_refit_that_cannot_begin_says_so_and_fails_after_a_day(
    archive: Archive, board: StatusRegistry, worker: RefitWorker, clock: VirtualClock
) -> None:
    refit = archive.refits.add(Refit(id="waits", camera="roof", requested_at=NOW, reason="test"))
    worker.let_wait([refit])
    (reason,) = [one for one in board.snapshot().reasons if one.code == "refit_waiting"]
    assert reason.remedy
    clock.wait(threading.Event(), 80_000.0)
    worker.let_wait([refit])
    assert archive.refits.get(refit.id).state == "requested"
    clock.wait(threading.Event(), 10_000.0)
    worker.let_wait([refit])
    ended = archive.refits.get(refit.id)
    assert (ended.state, [one.code for one in ended.findings]) == ("failed", ["refit_not_begun"])
    assert "refit_waiting" not in {one.code for one in board.snapshot().reasons}
    worker.let_wait([])
    assert "refit_waiting" not in {one.code for one in board.snapshot().reasons}
