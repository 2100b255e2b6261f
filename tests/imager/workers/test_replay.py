from __future__ import annotations

import threading
from datetime import timedelta
from pathlib import Path

import cv2
import numpy as np

from sunarc.imager.cameras.frame import Frame
from sunarc.imager.cameras.options import ReplayOptions
from sunarc.imager.cameras.replay import open_replay
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.imager.workers.replay import ReplayWorker

from .conftest import NOON


def test_the_sun_exposures_of_a_folder_are_handed_on_in_their_order_and_none_is_dropped(
    tmp_path: Path, clock: VirtualClock, board: StatusRegistry
) -> None:
    for number in range(5):
        for exposure_us in (20, 3000):
            stamp = NOON + timedelta(minutes=number)
            name = f"{stamp:%Y%m%dT%H%M%SZ}_{exposure_us}us.png"
            cv2.imwrite(str(tmp_path / name), np.full((6, 8), number, dtype=np.uint8))
    frames: DropOldestQueue[Frame] = DropOldestQueue(capacity=2)
    frame_time = FrameTime(clock, follows_camera=True)
    worker = ReplayWorker(
        open_camera=lambda: open_replay(ReplayOptions(folder=tmp_path)),
        clock=clock,
        frame_time=frame_time,
        name="roof",
        sun_frames=frames,
        board=board,
    )
    stop, seen = threading.Event(), []

    def heartbeat() -> None:
        if frames.full or clock.monotonic() > 10.0:
            while (frame := frames.get(timeout_s=0.0)) is not None:
                seen.append(int(frame.image[0, 0]))
        if clock.monotonic() > 20.0:
            stop.set()

    worker.run(stop, heartbeat)
    assert seen == [0, 1, 2, 3, 4]
    assert frames.dropped == 0
    assert frame_time.now() >= NOON + timedelta(minutes=4)
