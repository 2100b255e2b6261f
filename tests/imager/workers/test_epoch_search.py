"""A turn inside an imported record: found by the refit, with an epoch and a calibration on either side."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.fixtures.archive import new_archive
from tests.imager.workers.conftest import refit_worker

from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration
from sunarc.changes.record import find_pose_steps
from sunarc.common.findings import Finding
from sunarc.formats.calibration_document import from_document
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.values import Event, Refit, SunPoint
from sunarc.imager.commands.calibrate_archive import reproduce_calibration
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.calibrating.refit import SEARCHED, EpochSearch, RefitWorker
from sunarc.imager.workers.calibrating.solver_process import SolveProblem, SolverDiedError, columns_to_sightings
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.sun import sun_angles, sun_directions

FloatArray = NDArray[np.float64]
SIZE = (1748, 1748)
MIDNIGHT = datetime(2013, 5, 13, 6, 30, tzinfo=UTC).timestamp()
TRUTH = replace(true_camera(), max_angle=2.0)
DAYS = 12
NOW = datetime(2013, 5, 26, 7, tzinfo=UTC)


def turned(camera: Camera, degrees: float) -> Camera:
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.8, 0.5, -0.33])).as_matrix()
    return replace(camera, rotation_cam_enu=rotation_vector(turn @ rotation_matrix(camera.rotation_cam_enu)))


def record(degrees: float, *, clouds: bool, days: int = DAYS) -> tuple[FloatArray, FloatArray, int]:
    """Return times, pixels and the row of a turn in the middle; on every other day cloud draws an hour aside."""
    rng = np.random.default_rng(11)
    times = MIDNIGHT + np.arange(0.0, days * 86_400.0, 600.0)
    times = times[sun_angles(times, SGP).apparent_zenith < 86.0]
    row, directions = times.size // 2, sun_directions(times, SGP)
    after = (np.arange(times.size) >= row)[:, None]
    pixels = np.where(after, project(turned(TRUTH, degrees), directions), project(TRUTH, directions))
    pixels = pixels + rng.normal(0.0, 0.03, pixels.shape)
    for day in range(0, days if clouds else 0, 2):
        share = (times - MIDNIGHT - 86_400.0 * day - rng.uniform(30_000.0, 60_000.0)) / 3600.0
        inside = (share > 0.0) & (share < 1.0)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        pixels[inside] += (6.0 * np.sin(np.pi * share[inside]))[:, None] * [np.cos(angle), np.sin(angle)]
    return times, pixels, row


def import_record(archive: Archive, times: FloatArray, pixels: FloatArray) -> None:
    archive.sightings.add(
        SunPoint(
            camera="roof",
            pose_epoch=archive.epochs.at("roof", datetime.fromtimestamp(times[0], UTC), reason="imported").id,
            time=datetime.fromtimestamp(time, UTC),
            method="import",
            accepted=True,
            verdict="clear",
            x_px=x,
            y_px=y,
        )
        for time, (x, y) in zip(times.tolist(), pixels.tolist(), strict=True)
    )


def solve_here(problem: SolveProblem, *_: object) -> Calibration:
    return calibrate(problem.points, site=problem.site, image_size=problem.image_size, options=problem.options)


def search_here(problem: SolveProblem, *_: object) -> tuple[PoseChange, ...]:
    return find_pose_steps(
        problem.points, site=problem.site, image_size=problem.image_size, options=problem.options, lens=problem.lens
    )


@pytest.fixture
def archive(tmp_path: Path) -> Archive:
    return new_archive(tmp_path, width=SIZE[0], height=SIZE[1])


@pytest.fixture
def worker(archive: Archive, board: StatusRegistry, clock: VirtualClock) -> RefitWorker:
    return refit_worker(archive, board, clock, now=NOW, cadence_s=600.0, solve=solve_here, search=search_here)


@pytest.fixture
def refit(archive: Archive, worker: RefitWorker) -> Callable[[str], Refit]:
    def carried(name: str) -> Refit:
        asked = archive.refits.add(Refit(id=name * 6, camera="roof", requested_at=NOW, reason="test"))
        worker.carry_out(asked, threading.Event(), lambda: None)
        return archive.refits.get(asked.id)

    return carried


def error_and_sigma_px(archive: Archive, unix_s: float, truth: Camera) -> tuple[float, float]:
    """Return how far what answers at a moment is from the truth where the sun then is, and the 1-sigma stated there."""
    answering = archive.calibrations.current("roof", at=datetime.fromtimestamp(unix_s, UTC))
    assert answering is not None
    direction = sun_directions(unix_s + np.array([-3600.0, 3600.0]), SGP)
    said, covariance = project_with_covariance(from_document(answering.document), direction)
    error = np.linalg.norm(said - project(truth, direction), axis=-1)
    return float(np.max(error)), float(np.sqrt(np.max(np.linalg.eigvalsh(covariance))))


def test_a_turn_in_an_imported_record_gets_an_epoch_and_a_calibration_on_either_side(
    archive: Archive, refit: Callable[[str], Refit]
) -> None:
    times, pixels, row = record(0.4, clouds=True)
    import_record(archive, times, pixels)
    done = refit("a")
    assert done.state == "accepted", done.message
    first, second = archive.epochs.find("roof")
    assert second.started_at == datetime.fromtimestamp(times[row], UTC)
    assert first.ended_at == second.started_at
    (event,) = archive.events.find("roof", kind="bump")
    assert event.time == second.started_at
    assert [finding["code"] for finding in event.findings] == ["pose_changed"]
    assert float(event.details["turn_deg"]) == pytest.approx(0.4, abs=0.02)
    for moment, truth in ((times[20], TRUTH), (times[row - 20], TRUTH), (times[row + 20], turned(TRUTH, 0.4))):
        error, sigma = error_and_sigma_px(archive, float(moment), truth)
        assert error < max(4.0 * sigma, 0.02)
        assert error < 0.2
    epochs, answers = archive.epochs.find("roof"), archive.calibrations.find("roof")
    assert {answer.pose_epoch for answer in answers} == {"roof-1", "roof-2"}
    past = next(answer for answer in answers if answer.pose_epoch == "roof-1")
    points = columns_to_sightings(archive.calibrations.sightings_given_to(past.id), latest="roof-1")
    again = reproduce_calibration(from_document(past.document), points)
    assert np.allclose(again.camera.to_vector(), from_document(past.document).camera.to_vector(), atol=1e-9)
    refit("b")
    assert archive.epochs.find("roof") == epochs
    assert len(archive.events.find("roof", kind="bump")) == 1
    answering = archive.calibrations.current("roof", at=datetime.fromtimestamp(times[20], UTC))
    assert answering is not None
    assert answering.id == past.id


def test_cloud_in_an_imported_record_opens_no_epoch(archive: Archive, refit: Callable[[str], Refit]) -> None:
    times, pixels, _ = record(0.0, clouds=True)
    import_record(archive, times, pixels)
    assert refit("a").state == "accepted"
    assert len(archive.epochs.find("roof")) == 1
    assert archive.events.find("roof", kind="bump") == ()


def test_what_was_imported_later_from_before_a_turn_leaves_the_current_calibration_its_epoch(
    archive: Archive, refit: Callable[[str], Refit]
) -> None:
    times, pixels, row = record(0.4, clouds=False)
    import_record(archive, times[row:], pixels[row:])
    assert refit("a").state == "accepted"
    current = archive.calibrations.current("roof")
    assert current is not None
    import_record(archive, times[:row], pixels[:row])
    archive.epochs.at("roof", datetime.fromtimestamp(times[0], UTC), reason="imported")
    refit("b")
    earlier, later = archive.epochs.find("roof")
    assert (earlier.id, later.id) == ("roof-2", current.pose_epoch)
    assert later.started_at == datetime.fromtimestamp(times[row], UTC)
    error, _ = error_and_sigma_px(archive, float(times[20]), TRUTH)
    assert error < 0.2
    error, _ = error_and_sigma_px(archive, float(times[-20]), turned(TRUTH, 0.4))
    assert error < 0.2


def search_event(time: datetime, **details: object) -> Event:
    return Event(time=time, kind=SEARCHED, severity="info", text="searched", camera="roof", details=details)


def searching(archive: Archive) -> EpochSearch:
    return EpochSearch(
        camera=CameraArchive(archive, name="roof", site=SGP),
        options=CalibrationOptions(),
        circle=None,
        now=lambda: NOW,
    )


def test_a_damaged_event_of_a_search_does_not_end_the_refits(archive: Archive) -> None:
    times, pixels, _ = record(0.0, clouds=False, days=3)
    import_record(archive, times, pixels)
    archive.events.add(search_event(NOW - timedelta(hours=2), last_id=times.size, divided=["roof-1"]))
    archive.events.add(search_event(NOW - timedelta(hours=1)))  # as the archive reads details with a flipped bit
    search = searching(archive)
    assert search.due() is None  # the search before it is remembered
    assert search.unanswered("roof-1")


def test_a_search_that_a_clock_ahead_dated_is_neither_repeated_nor_answered_for_ever(archive: Archive) -> None:
    times, pixels, _ = record(0.0, clouds=False, days=3)
    import_record(archive, times, pixels)
    ahead = NOW + timedelta(days=365)
    archive.events.add(search_event(ahead, last_id=times.size // 2, divided=["roof-1"]))
    archive.events.add(search_event(NOW - timedelta(hours=1), last_id=times.size, divided=[]))
    search = searching(archive)
    assert search.due() is None
    assert search.unanswered("roof-1")
    archive.calibrations.add({
        "id": "a", "camera": "roof", "method": "robust", "pose_epoch": "roof-1", "valid_from": NOW.isoformat(),
        "created_at": NOW.isoformat(), "verdict": {"accepted": True, "reasons": []},
    })  # fmt: skip
    archive.calibrations.activate("a")
    assert not search.unanswered("roof-1")


def test_a_search_whose_process_was_killed_is_begun_once_more(
    archive: Archive, worker: RefitWorker, refit: Callable[[str], Refit], monkeypatch: pytest.MonkeyPatch
) -> None:
    times, pixels, _ = record(0.4, clouds=False, days=6)
    import_record(archive, times, pixels)
    begun: list[int] = []

    def search_at_the_second_time(problem: SolveProblem, *_: object) -> tuple[PoseChange, ...]:
        begun.append(1)
        if len(begun) == 1:
            raise SolverDiedError(Finding("solver_died", {"end": "signal 9"}))
        return search_here(problem)

    monkeypatch.setattr(worker, "search", search_at_the_second_time)
    refit("a")
    assert len(begun) == 2
    assert len(archive.epochs.find("roof")) == 2
