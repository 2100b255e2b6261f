"""Another camera under the same name: its serial number says so, and nothing of the old lens is served for it."""

from __future__ import annotations

import threading
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from tests.fixtures.cameras import INFO
from tests.fixtures.finding_codes import codes
from tests.imager.workers.clock_faults import START, Imager

from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.epochs import LENS_CHANGED
from sunarc.imager.cameras.frame import CameraInfo
from sunarc.imager.runtime.clock import ClockState

from .test_same_camera import Camera


@pytest.fixture
def imager(tmp_path: Path) -> Imager:
    made = Imager(tmp_path)
    open_camera(made, serial="1")
    made.run(2.0)
    return made


def open_camera(imager: Imager, *, serial: str) -> None:
    info: CameraInfo = replace(INFO, width=imager.camera.width, height=imager.camera.height, serial=serial)
    imager.open_camera = lambda: Camera(info)
    imager.boot()
    imager.service.open_and_remember()


def stored_serial(archive: Archive) -> str:
    (camera,) = archive.cameras.all()
    return camera.serial


def test_the_same_serial_changes_nothing(imager: Imager) -> None:
    open_camera(imager, serial="1")
    assert imager.served() == "full"
    assert len(imager.archive.epochs.find("roof")) == 1
    assert imager.alarms() == []


def test_another_serial_retires_the_calibration_begins_an_epoch_and_is_an_event(imager: Imager) -> None:
    at = imager.clock.now()
    open_camera(imager, serial="2")
    assert imager.served() is None
    retired = imager.archive.calibrations.get("full")
    assert (retired.state, retired.valid_until) == ("retired", at)
    first, second = imager.archive.epochs.find("roof")
    assert (first.ended_at, second.started_at, second.reason) == (at, at, LENS_CHANGED)
    (event,) = imager.alarms()
    assert event.kind == "camera_replaced"
    assert (event.details["serial"], event.details["serial_before"]) == ("2", "1")
    assert event.details["calibration"] == "full"
    assert stored_serial(imager.archive) == "2"
    imager.run(10.0)
    assert imager.served() is None  # no pose is found with the other camera's lens
    assert {p.pose_epoch for p in imager.archive.sightings.find("roof", since=at)} == {second.id}
    open_camera(imager, serial="2")
    assert len(imager.alarms()) == 1


def test_a_pinned_calibration_is_retired_too(imager: Imager) -> None:
    imager.archive.calibrations.pin("full", at=START, reason="good")
    open_camera(imager, serial="2")
    assert imager.served() is None


@pytest.mark.parametrize("step", [timedelta(days=400), timedelta(days=-400)])
def test_the_epoch_begins_after_the_last_sighting_where_the_clock_cannot_be_trusted(
    imager: Imager, step: timedelta
) -> None:
    last = imager.archive.sightings.find("roof", newest_first=True, limit=1)[0].time
    imager.clock.set_state(ClockState(synchronised=False, error_bound_s=16.0))
    imager.clock.step(step.total_seconds())
    open_camera(imager, serial="2")
    assert imager.archive.epochs.find("roof")[-1].started_at == last + timedelta(microseconds=1)
    assert imager.archive.calibrations.get("full").valid_until == last + timedelta(microseconds=1)


def test_a_camera_that_tells_no_serial_is_the_one_of_before(imager: Imager) -> None:
    open_camera(imager, serial="")
    assert imager.served() == "full"
    assert stored_serial(imager.archive) == "1"


def test_a_refit_takes_the_new_camera_s_sightings_alone(imager: Imager) -> None:
    open_camera(imager, serial="2")
    refit = imager.service.request_refit("by hand")
    worker = imager.service.refit_worker()
    worker.carry_out(refit, threading.Event(), lambda: None)
    assert codes(imager.archive.refits.get(refit.id).findings) == ["no_accepted_sightings"]


def test_a_camera_is_replaced_though_an_epoch_of_the_future_stands_in_the_way(imager: Imager) -> None:
    future = imager.clock.now() + timedelta(days=400)
    imager.archive.epochs.open("roof", at=future, reason="bump")
    at = imager.clock.now()
    open_camera(imager, serial="2")
    present = imager.archive.epochs.current("roof", at=at)
    assert present is not None
    assert (present.started_at, present.ended_at, present.reason) == (at, future, LENS_CHANGED)
    before = imager.archive.sightings.columns("roof", until=at).epoch_ids
    assert before == ("roof-1",)


def test_a_calibration_that_was_retired_is_missed_at_once(imager: Imager) -> None:
    worker = imager.service.refit_worker()
    stop, codes = threading.Event(), list[set[str]]()

    def beat() -> None:
        codes.append(set(imager.codes()))
        if len(codes) == 2:
            imager.archive.calibrations.retire("full", at=imager.clock.now())
        if "no_calibration" in codes[-1] or len(codes) == 10:
            stop.set()

    worker.run(stop, beat)
    assert all("no_calibration" not in held for held in codes[:2])
    assert "no_calibration" in codes[-1]
    assert len(codes) <= 5
