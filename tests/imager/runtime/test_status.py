from __future__ import annotations

import threading
from dataclasses import replace
from datetime import timedelta

from tests.fixtures.board import START

from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import CameraStatus, ClockStatus, DiskStatus, Reason, StatusRegistry, WorkerStatus

DISK = DiskStatus(free_bytes=5, images_bytes=3)
LOST = Reason(code="camera_lost", severity="not_ready", text="the camera is gone", remedy="check its cable")
DRIFT = Reason(code="drift", severity="degraded", text="the camera moved", remedy="wait for a clear day")


def test_an_empty_board_is_ready_and_knows_nothing(board: StatusRegistry) -> None:
    snapshot = board.snapshot()
    assert snapshot.health == "ready"
    assert not snapshot.workers
    assert not snapshot.reasons
    assert snapshot.camera is None
    assert snapshot.last_frame_at is None


def test_health_is_the_worst_reason(board: StatusRegistry) -> None:
    board.set_condition(DRIFT.code, DRIFT)
    assert board.snapshot().health == "degraded"
    board.set_condition(LOST.code, LOST)
    assert board.snapshot().health == "not_ready"
    board.set_condition(LOST.code, None)
    board.set_condition(LOST.code, None)
    assert board.snapshot().reasons == (replace(DRIFT, since=START),)


def test_a_reason_replaces_the_one_of_its_code(board: StatusRegistry) -> None:
    board.set_condition(DRIFT.code, DRIFT)
    worse = Reason(code=DRIFT.code, severity="not_ready", text="it moved again", remedy="tighten the screws")
    board.set_condition(worse.code, worse)
    assert board.snapshot().reasons == (replace(worse, since=START),)


def test_a_condition_is_dated_when_it_begins_and_anew_after_it_ended(
    board: StatusRegistry, clock: VirtualClock
) -> None:
    since = []
    for reason in (DRIFT, replace(DRIFT, text="it moved on"), None, DRIFT):
        clock.advance(10.0)
        board.set_condition(DRIFT.code, reason)
        since += [one.since for one in board.snapshot().reasons]
    assert since == [START + timedelta(seconds=seconds) for seconds in (10.0, 10.0, 40.0)]


def test_heartbeats_age_between_writing_and_reading(board: StatusRegistry, clock: VirtualClock) -> None:
    board.set_worker(WorkerStatus(name="capture", state="running", heartbeat_age_s=1.5))
    board.set_worker(WorkerStatus(name="archive", state="starting"))
    clock.advance(10.0)
    archive, capture = board.snapshot().workers
    assert (archive.name, archive.heartbeat_age_s) == ("archive", None)
    assert (capture.name, capture.heartbeat_age_s) == ("capture", 11.5)


def test_notes_keep_what_was_noted_before(board: StatusRegistry) -> None:
    camera = CameraStatus(name="roof", connected=True)
    board.note(camera=camera, disk=DISK)
    board.note(clock=ClockStatus(synchronised=True, max_error_s=0.01), last_frame_at=START)
    snapshot = board.snapshot()
    assert (snapshot.camera, snapshot.disk, snapshot.last_frame_at) == (camera, DISK, START)


def test_a_snapshot_does_not_change_afterwards(board: StatusRegistry) -> None:
    before = board.snapshot()
    board.set_condition(LOST.code, LOST)
    board.note(disk=DISK)
    assert before.health == "ready"
    assert before.disk is None


def test_many_threads_may_write_at_once(board: StatusRegistry) -> None:
    def write(name: str) -> None:
        for restarts in range(200):
            board.set_worker(WorkerStatus(name=name, state="running", restarts=restarts))
            board.note(disk=DiskStatus(free_bytes=restarts, images_bytes=0))
            board.snapshot()

    threads = [threading.Thread(target=write, args=(f"worker {i}",)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [worker.restarts for worker in board.snapshot().workers] == [199] * 4
