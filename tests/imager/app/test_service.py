"""The parts of a running imager, as they are joined."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.finding_codes import codes

from sunarc.imager.app.service import Service
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.values import CameraRecord, SunPoint
from sunarc.imager.cameras.frame import SkyCamera
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import ClockState, VirtualClock
from sunarc.imager.settings.model import Settings
from sunarc.sky.site import Site

NOON = datetime(2026, 5, 1, 18, 30, tzinfo=UTC)
CAMERA = CameraRecord(name="imager", latitude=36.6, longitude=-97.5, altitude=318.0, width=8, height=6)


def no_camera() -> SkyCamera:
    raise AssertionError("no camera is asked for")


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock(NOON)


@pytest.fixture
def service(tmp_path: Path, clock: VirtualClock) -> Service:
    make_empty(tmp_path / "sunarc.sqlite")
    settings = Settings(
        site=Site(latitude=36.6, longitude=-97.5, altitude=318.0),
        state=tmp_path,
        camera=AravisOptions(address="127.0.0.9", timestamps="host"),
    )
    made = Service(settings, archive=open_archive(settings.database), clock=clock, open_camera=no_camera)
    made.archive.cameras.save(CAMERA)
    return made


def test_days_wait_for_a_synchronised_clock_and_are_then_judged(service: Service, clock: VirtualClock) -> None:
    epoch = service.archive.epochs.at("imager", NOON, reason="first frame")
    rejected = SunPoint(
        camera="imager", pose_epoch=epoch.id, time=NOON, method="disc", accepted=False, verdict="hidden"
    )
    service.archive.sightings.add([rejected])
    clock.advance(timedelta(days=1).total_seconds())
    clock.set_state(ClockState(synchronised=False, error_bound_s=16.0))
    service.judge_completed_days()
    assert service.archive.days.find("imager") == ()
    clock.set_state(ClockState(synchronised=True, error_bound_s=0.01))
    service.judge_completed_days()
    assert [day.verdict for day in service.archive.days.find("imager")] == ["unusable"]


def test_sixty_three_requests_at_once_are_solved_once_or_twice(service: Service) -> None:
    with ThreadPoolExecutor(8) as pool:
        asked = list(pool.map(service.request_refit, [f"request {number}" for number in range(63)]))
    assert len({refit.id for refit in asked}) == 1
    assert [refit.reason for refit in service.archive.refits.find("imager")] == [asked[0].reason]


def test_a_refit_waits_for_a_synchronised_clock(service: Service, clock: VirtualClock) -> None:
    service.request_refit("by hand")
    worker = service.refit_worker()
    stop = threading.Event()
    clock.set_state(ClockState(synchronised=False, error_bound_s=16.0))
    worker.run(stop, lambda: stop.set() if clock.monotonic() > 5.0 else None)
    assert [refit.state for refit in service.archive.refits.find("imager")] == ["requested"]
    clock.set_state(ClockState(synchronised=True, error_bound_s=0.01))
    stop.clear()
    worker.run(stop, lambda: stop.set() if clock.monotonic() > 10.0 else None)
    assert [codes(refit.findings) for refit in service.archive.refits.find("imager")] == [["no_accepted_sightings"]]


def test_a_refit_left_over_by_a_kill_waits_until_the_camera_has_told_its_time(
    service: Service, clock: VirtualClock
) -> None:
    assert service.settings.camera is not None
    settings = replace(service.settings.camera, timestamps="camera")
    dated_by_camera = Service(
        service.settings.model_copy(update={"camera": settings}),
        archive=service.archive,
        clock=clock,
        open_camera=no_camera,
    )
    refit = service.request_refit("by hand")
    service.archive.refits.start(refit.id, started_at=NOON)
    worker, stop = dated_by_camera.refit_worker(), threading.Event()
    worker.run(stop, lambda: stop.set() if clock.monotonic() > 5.0 else None)
    assert service.archive.refits.get(refit.id).state == "running"
    dated_by_camera.frame_time.note(NOON - timedelta(days=1000))
    stop.clear()
    worker.run(stop, lambda: stop.set() if clock.monotonic() > 10.0 else None)
    done = service.archive.refits.get(refit.id)
    assert done.finished_at is not None
    assert done.finished_at < NOON - timedelta(days=999)  # dated by the camera


@pytest.mark.parametrize(("stores", "expected"), [(False, ["no_sightings"]), (True, [])])
def test_ten_slots_of_sun_without_a_stored_sighting_are_shown(
    service: Service, clock: VirtualClock, *, stores: bool, expected: list[str]
) -> None:
    for _ in range(11):  # near noon
        service.check_sightings()
        if stores:
            service.keeper.keep(
                SunPoint(
                    camera="imager", pose_epoch="", time=clock.now(), method="disc", accepted=False, verdict="hidden"
                )
            )
        clock.advance(service.settings.capture.cadence_s)
    service.check_sightings()
    assert [reason.code for reason in service.board.snapshot().reasons] == expected
