"""A database whose commits take as long as on a device that stalls, while frames keep coming."""

from __future__ import annotations

import threading
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from sqlalchemy import event
from tests.fixtures.archive import new_archive
from tests.fixtures.calibrations import SITE

from sunarc.detection.values import DiscOptions
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.values import SunPoint
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers import upkeep
from sunarc.imager.workers.detect import DetectWorker, FrozenFrames, SightingWriteBuffer
from sunarc.imager.workers.options import SensorOptions
from sunarc.imager.workers.upkeep import DatabaseWorker

from .conftest import NOON

CYCLES, FRAMES, CADENCE_S = 6, 5, 1.2
STALLS_S = (0.2, 0.5, 0.3)
"""Up to 0.4 of the cadence; 5 s of 30 s are less."""
FRAME = Frame(image=np.zeros((6, 8), np.uint16), time=NOON, exposure_us=20.0, gain_db=0.0, pixel_format="Mono12",
              full_scale=4095, frame_id=1)  # fmt: skip


@pytest.mark.waits
def test_commits_that_stall_cost_no_frame_and_no_heartbeat_and_are_told(
    tmp_path: Path, board: StatusRegistry, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive, clock = new_archive(tmp_path), SystemClock()
    stalls, never = [True], threading.Event()
    commits = list[float]()

    def stall(_: object) -> None:
        if stalls[0]:
            commits.append(STALLS_S[len(commits) % len(STALLS_S)])
            clock.wait(never, commits[-1])  # with the write lock held, as a slow fsync holds it

    event.listen(archive.database.engine, "commit", stall)
    frames: DropOldestQueue[Frame] = DropOldestQueue(capacity=8)
    keeper = SightingWriteBuffer(archive, board=board)
    worker = DetectWorker(
        frames,
        keeper=keeper,
        camera="roof",
        predictor=SimpleNamespace(expectation=lambda _: None, clear_level_per_us=lambda _: 0.0),  # type: ignore[arg-type]
        options=SensorOptions(),
        disc=DiscOptions(),
        clock_error_s=lambda _: 0.01,
        report=lambda *_: None,
        board=board,
        frozen=FrozenFrames(CameraArchive(archive, name="roof", site=SITE), board=board),
        cadence_s=30.0,
    )
    stop, beats = threading.Event(), list[float]()
    thread = threading.Thread(target=worker.run, args=(stop, lambda: beats.append(clock.monotonic())))
    thread.start()
    for number in range(CYCLES * FRAMES):
        frames.put(replace(FRAME, time=NOON + timedelta(seconds=number)))
        clock.wait(never, CADENCE_S if number % FRAMES == FRAMES - 1 else 0.01)
    watch = DatabaseWorker(archive=archive, clock=clock, now=clock.now, board=board, waiting=lambda: 7)
    watch.check()
    told = {reason.code: dict(reason.data) for reason in board.snapshot().reasons}
    stalls[0] = False
    stop.set()
    thread.join(20.0)
    assert len(commits) >= CYCLES
    assert frames.dropped == 0
    assert len(archive.sightings.find("roof")) == CYCLES * FRAMES
    assert set(told) == {"database_slow"}
    assert told["database_slow"]["waiting"] == 7
    assert 0.5 <= float(str(told["database_slow"]["seconds"])) < 5.0
    assert max(np.diff(beats)) < 5.0
    for number in range(CYCLES * FRAMES, CYCLES * FRAMES + 10):
        worker.process(replace(FRAME, time=NOON + timedelta(seconds=number)))
    monkeypatch.setattr(upkeep, "_SLOW_WITHIN_S", 0.0)
    watch.check()
    assert board.snapshot().reasons == ()
    archive.close()


def test_a_commit_that_has_not_ended_is_said_within_seconds(tmp_path: Path, board: StatusRegistry) -> None:
    archive, clock, ended = new_archive(tmp_path), SystemClock(), threading.Event()
    event.listen(archive.database.engine, "commit", lambda _: ended.wait(20.0))
    sighting = SunPoint(camera="roof", pose_epoch="", time=NOON, method="disc", accepted=False, verdict="hidden")
    thread = threading.Thread(target=archive.sightings.add, args=([sighting],), kwargs={"first_epoch": "first frame"})
    thread.start()
    clock.wait(threading.Event(), 1.0)
    DatabaseWorker(archive=archive, clock=clock, now=clock.now, board=board).check()
    assert {reason.code for reason in board.snapshot().reasons} == {"database_slow"}
    ended.set()
    thread.join(20.0)
    archive.close()
