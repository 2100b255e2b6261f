"""Exposures of seconds that take their time: the camera goes on answering, and a night is worked in real time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from tests.lab.simulation.conftest import Imager, require_aravis
from tests.lab.simulation.test_over_the_wire import ADDRESS, opened, rendered

from sunarc.detection.stars.detect import detect_stars
from sunarc.imager.cameras.aravis import AravisCamera, open_aravis
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.capture import CaptureWorker
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.imager.workers.exposures import SunExposures
from sunarc.imager.workers.night.exposures import NightCapture, NightExposures
from sunarc.imager.workers.options import CaptureOptions
from sunarc.imaging.exposure import SunExposureOptions
from sunarc.lab.simulation import fake_camera as genicam
from sunarc.lab.simulation.truth import SGP
from sunarc.sky.sun import sun_angles

__all__ = ["opened"]
pytestmark = [pytest.mark.gige, pytest.mark.slow, pytest.mark.timeout(240)]

NIGHT = datetime(2013, 5, 13, 6, 0, tzinfo=UTC)
REGION = (500, 500, 700, 600)


@pytest.fixture(scope="module")
def imager(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Imager]:
    require_aravis()
    folder: Path = tmp_path_factory.mktemp("imager")
    running = Imager(
        folder,
        start=NIGHT,
        night={"star_e_per_s": 50_000.0, "faintest": 6.0, "moon": False},
        speed=1.0,
        clouds="clear",
        real_exposures=True,
        skip_nights=False,
    )
    try:
        running.start()
        yield running
    finally:
        running.kill()


def test_real_exposures_of_five_seconds_arrive_while_the_camera_goes_on_answering(
    imager: Imager, opened: Callable[..., AravisCamera]
) -> None:
    camera, clock, done = opened(packet_size=8000, region=REGION), SystemClock(), threading.Event()
    answered_s: list[float] = []

    def ask() -> None:
        while not done.is_set():
            asked = clock.monotonic()
            camera._device.read_register(genicam.TEMPERATURE)
            answered_s.append(clock.monotonic() - asked)
            clock.wait(done, 0.1)

    asking = threading.Thread(target=ask)
    asking.start()
    try:
        for exposure_us in (5e6, 5e6, 3000.0, 6e6):
            began = clock.monotonic()
            frame = camera.expose(exposure_us)
            took_s = clock.monotonic() - began
            assert exposure_us * 1e-6 <= took_s < exposure_us * 1e-6 + 1.0
            assert frame.exposure_us == exposure_us
            assert np.array_equal(frame.image, rendered(imager.scene, frame, REGION))
    finally:
        done.set()
        asking.join()
    assert len(answered_s) > 100
    assert max(answered_s) < 2.0  # of the 2.5 s after which the library gives a camera up


def test_a_night_is_captured_in_real_time(imager: Imager) -> None:
    assert imager.truth.exists()
    clock, stop, frames = SystemClock(), threading.Event(), list[Frame]()
    frame_time = FrameTime(clock, follows_camera=True)
    board = StatusRegistry(version="0", started_at=NIGHT, monotonic=clock.monotonic)
    night = NightCapture(NightExposures(), DropOldestQueue(capacity=9))

    def zenith() -> float:
        return float(sun_angles(frame_time.now().timestamp(), SGP).apparent_zenith)

    def heartbeat() -> None:
        if (frame := night.frames.get(timeout_s=0.0)) is not None:
            frames.append(frame)
            if len(frames) == 2:
                stop.set()

    options = AravisOptions(address=ADDRESS, region=REGION, timestamps="camera", packet_size=8000, packet_socket=False)
    CaptureWorker(
        open_camera=lambda: open_aravis(options, clock),
        clock=clock,
        frame_time=frame_time,
        options=CaptureOptions(night_cadence_s=10.0),
        name="roof",
        apparent_zenith=zenith,
        sun_exposures=SunExposures(SunExposureOptions()),
        cycles=DropOldestQueue(capacity=9),
        sun_frames=DropOldestQueue(capacity=9),
        board=board,
        night=night,
    ).run(stop, heartbeat)
    assert [frame.exposure_us for frame in frames] == [5e6, 5e6]
    assert (frames[1].time - frames[0].time).total_seconds() == pytest.approx(10.0, abs=1.0)
    assert "camera_lost" not in {reason.code for reason in board.snapshot().reasons}
    for frame in frames:
        assert len(detect_stars(frame.image, full_scale=frame.full_scale)) > 20
