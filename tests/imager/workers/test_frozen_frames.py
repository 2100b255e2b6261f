"""A camera that delivers an image again: nothing is accepted from it, and it is reported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.archive import new_archive, store_sun_point

from sunarc.common.findings import Finding
from sunarc.detection.values import Detection, DiscOptions
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.sightings import FROZEN
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.detect import DetectWorker, FrozenFrames, SightingWriteBuffer
from sunarc.imager.workers.options import SensorOptions
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.lab.simulation.options import SensorModel
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions

START = datetime(2013, 5, 13, 18, 0, tzinfo=UTC)
SIDE = 240
TRUTH = true_camera()
CORNER = (np.round(project(TRUTH, sun_directions(START.timestamp(), SGP))) - SIDE / 2).astype(int).tolist()


@cache
def scene() -> Scene:
    return Scene(TRUTH, SGP, sensor=SensorModel(black_level=0.0))


def frame_at(seconds: float, *, shown_s: float | None = None) -> Frame:
    """Return the frame of a moment; `shown_s`: with the image of another moment."""
    of = START + timedelta(seconds=seconds if shown_s is None else shown_s)
    image = scene().render(round(of.timestamp() * 1e6), exposure_us=20.0, region=(*CORNER, SIDE, SIDE))
    return Frame(
        image=image,
        time=START + timedelta(seconds=seconds),
        exposure_us=20.0,
        gain_db=0.0,
        pixel_format="Mono12",
        full_scale=4095,
        frame_id=1,
    )


@pytest.fixture
def archive(tmp_path: Path) -> Archive:
    return new_archive(tmp_path, width=SIDE, height=SIDE)


@pytest.fixture
def new_worker(archive: Archive, board: StatusRegistry) -> Callable[[], DetectWorker]:
    return lambda: DetectWorker(
        DropOldestQueue(capacity=4),
        keeper=SightingWriteBuffer(archive, board=board),
        camera="roof",
        predictor=SunPredictor(CameraArchive(archive, name="roof", site=SGP)),
        options=SensorOptions(),
        disc=DiscOptions(),
        clock_error_s=lambda _: 0.01,
        report=lambda _frame, _detection: None,
        board=board,
        frozen=FrozenFrames(CameraArchive(archive, name="roof", site=SGP), board=board),
        cadence_s=30.0,
    )


def codes(board: StatusRegistry) -> set[str]:
    return {reason.code for reason in board.snapshot().reasons}


def test_a_frozen_camera_gives_no_sighting_is_shown_and_is_welcome_when_it_lives_again(
    new_worker: Callable[[], DetectWorker], archive: Archive, board: StatusRegistry
) -> None:
    worker = new_worker()
    assert all(worker.process(frame_at(seconds)).accepted for seconds in (0.0, 30.0, 60.0))
    frozen = [worker.process(frame_at(seconds, shown_s=60.0)) for seconds in np.arange(90.0, 240.0, 30.0)]
    assert [(one.accepted, one.verdict) for one in frozen] == [(False, FROZEN)] * 5
    assert frozen[0].findings == (Finding("frame_repeated", {"time": "2013-05-13T18:01:00+00:00"}),)
    assert codes(board) == {"camera_frozen"}
    assert [event.kind for event in archive.events.find("roof", severity="alarm")] == ["camera_frozen"]
    assert len(archive.sightings.find("roof", accepted=True)) == 3
    assert worker.process(frame_at(240.0)).accepted
    assert codes(board) == set()


def test_a_restart_does_not_accept_the_frozen_image_once_more(
    new_worker: Callable[[], DetectWorker], archive: Archive
) -> None:
    assert new_worker().process(frame_at(0.0)).accepted
    for seconds in (30.0, 60.0):
        assert new_worker().process(frame_at(seconds, shown_s=0.0)).verdict == FROZEN
    assert len(archive.sightings.find("roof", accepted=True)) == 1


def test_a_camera_that_alternates_between_two_images_is_frozen_too(new_worker: Callable[[], DetectWorker]) -> None:
    worker = new_worker()
    shown = [worker.process(frame_at(30.0 * n, shown_s=30.0 * (n % 2))).accepted for n in range(6)]
    assert shown == [True, True, False, False, False, False]


def test_a_single_repeated_image_is_rejected_and_is_no_condition(
    new_worker: Callable[[], DetectWorker], board: StatusRegistry
) -> None:
    worker = new_worker()
    assert worker.process(frame_at(0.0)).accepted
    assert not worker.process(frame_at(30.0, shown_s=0.0)).accepted
    assert worker.process(frame_at(60.0)).accepted
    assert codes(board) == set()


def test_a_sun_that_hardly_moves_between_frames_is_not_taken_for_frozen(
    new_worker: Callable[[], DetectWorker], board: StatusRegistry
) -> None:
    worker = new_worker()
    assert all(worker.process(frame_at(0.1 * n)).accepted for n in range(10))
    assert codes(board) == set()


def seen(x_px: float, *, accepted: bool = True) -> Detection:
    return Detection(
        method="disc", accepted=accepted, verdict="clear" if accepted else "hidden", findings=(), x_px=x_px, y_px=50.0
    )


@pytest.mark.parametrize(("apart_s", "frozen"), [(3.0, False), (30.0, True)])
def test_exactly_the_same_place_is_frozen_only_once_the_sun_has_moved(
    archive: Archive, board: StatusRegistry, *, apart_s: float, frozen: bool
) -> None:
    checker = FrozenFrames(CameraArchive(archive, name="roof", site=SGP), board=board)
    blank = np.zeros((6, 8), dtype=np.uint16)
    first = replace(frame_at(0.0), image=blank)
    second = replace(first, time=first.time + timedelta(seconds=apart_s))
    assert checker.checked(first, seen(50.0)).accepted
    assert checker.checked(second, seen(50.0)).accepted != frozen
    assert checker.checked(replace(second, time=second.time + timedelta(seconds=30)), seen(50.0001)).accepted


def test_a_night_without_noise_is_black_again_and_again(archive: Archive, board: StatusRegistry) -> None:
    checker = FrozenFrames(CameraArchive(archive, name="roof", site=SGP), board=board)
    black = np.zeros((600, 600), dtype=np.uint8)
    black[3, :90] = 255  # hot pixels
    hidden = Detection(method="disc", accepted=False, verdict="hidden", findings=())
    for number in range(5):
        frame = replace(frame_at(0.0), image=black, time=START + timedelta(seconds=30 * number))
        assert checker.checked(frame, hidden) == hidden
    assert codes(board) == set()


def test_places_are_compared_with_those_stored_before_a_start(archive: Archive, board: StatusRegistry) -> None:
    store_sun_point(archive, START, x_px=50.0, y_px=50.0)
    checker = FrozenFrames(CameraArchive(archive, name="roof", site=SGP), board=board)
    later = replace(frame_at(600.0), image=np.zeros((6, 8), dtype=np.uint16))
    assert checker.checked(later, seen(50.0)).verdict == FROZEN


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock(START)


def test_slots_with_a_frozen_image_are_not_observed_whatever_it_shows(
    new_worker: Callable[[], DetectWorker], archive: Archive
) -> None:
    worker = new_worker()
    clouds = replace(frame_at(0.0), image=np.random.default_rng(1).integers(90, 110, (SIDE, SIDE), dtype=np.uint16))
    assert worker.process(clouds).verdict == "hidden"
    assert worker.process(replace(clouds, time=START + timedelta(seconds=30))).verdict == FROZEN
    assert worker.process(frame_at(60.0)).accepted
    assert worker.process(frame_at(90.0, shown_s=60.0)).verdict == FROZEN
    observed = archive.sightings.exposure_times("roof", since=START, until=START + timedelta(hours=1))
    assert observed is not None
    assert (observed - START.timestamp()).tolist() == [0.0, 60.0]


def test_a_copy_of_a_frame_that_was_never_searched_for_the_sun_is_rejected(
    archive: Archive, board: StatusRegistry
) -> None:
    frozen = FrozenFrames(CameraArchive(archive, name="roof", site=SGP), board=board)
    probe, first = frame_at(0.0), frame_at(30.0)
    for frame in (probe, first):
        frozen.remember(frame)
    assert frozen.checked(first, seen(40.0)).accepted
    assert frozen.checked(frame_at(60.0, shown_s=0.0), seen(39.0)).verdict == FROZEN


@pytest.mark.parametrize("sun", [True, False])
def test_a_camera_that_is_frozen_under_a_clock_that_runs_is_frozen(
    new_worker: Callable[[], DetectWorker], board: StatusRegistry, *, sun: bool
) -> None:
    clouds = np.random.default_rng(1).integers(1000, 1400, (SIDE, SIDE), dtype=np.uint16)
    worker = new_worker()
    verdicts = []
    for n in range(5):
        frame = frame_at(30.0 * n, shown_s=0.0)
        image = frame.image.copy() if sun else clouds.copy()
        image[:12, :60] = np.random.default_rng(n).choice([0, 300], (12, 60))
        verdicts.append(worker.process(replace(frame, image=image)).verdict)
    assert verdicts[1:] == 4 * [FROZEN]
    assert codes(board) == {"camera_frozen"}
