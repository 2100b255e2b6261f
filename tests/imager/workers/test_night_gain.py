"""The gain of the night: raised for one exposure, restored after it, and the camera let go where that fails."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from tests.fixtures.scene_camera import SceneCamera
from tests.imager.workers.test_night import CAMERA

from sunarc.common.errors import CameraError, CameraLostError
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.night.exposures import GAIN_NOT_RESTORED, NightGain
from sunarc.imager.workers.options import SensorOptions, frame_sensor
from sunarc.lab.simulation.options import SceneOptions, SimulatedNight
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP

NIGHT = datetime(2013, 5, 13, 5, 0, tzinfo=UTC)


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock(NIGHT)


def camera(clock: VirtualClock, **options: Any) -> SceneCamera:  # noqa: ANN401 - of the camera
    sky = SceneOptions(night=SimulatedNight(moon=False, warm_spots=0))
    return SceneCamera(Scene(CAMERA, SGP, options=sky), clock, region=(400, 400, 64, 64), **options)


def codes(board: StatusRegistry) -> set[str]:
    return {reason.code for reason in board.snapshot().reasons}


@pytest.mark.parametrize("pixel_format", ["Mono12", "BayerRG12"])
def test_one_exposure_has_the_raised_gain_and_the_next_has_not(
    clock: VirtualClock, board: StatusRegistry, pixel_format: str
) -> None:
    taken, gain = camera(clock, pixel_format=pixel_format), NightGain(board)
    raised = gain.take(taken, 12.0, lambda: taken.expose(5e6))
    usual = taken.expose(5e6)
    assert raised is not None
    assert (raised.gain_db, raised.raised_db) == (12.0, 12.0)
    assert (usual.gain_db, usual.raised_db) == (0.0, 0.0)
    black = 32.0
    ratio = (float(np.median(raised.image)) - black) / (float(np.median(usual.image)) - black)
    assert 3.0 < ratio < 5.0
    options = SensorOptions()
    assert frame_sensor(raised, options).gain_e_per_count == pytest.approx(
        frame_sensor(usual, options).gain_e_per_count / 10.0 ** (12.0 / 20.0)
    )
    assert codes(board) == set()


def test_a_camera_without_a_gain_stands_aside(clock: VirtualClock, board: StatusRegistry) -> None:
    taken = camera(clock, has_gain=False)
    frame = NightGain(board).take(taken, 12.0, lambda: taken.expose(5e6))
    assert frame is not None
    assert (frame.gain_db, frame.raised_db) == (0.0, 0.0)


def test_a_raise_beyond_the_camera_s_gain_ends_at_it(clock: VirtualClock, board: StatusRegistry) -> None:
    taken = camera(clock, gain_db=30.0)
    frame = NightGain(board).take(taken, 18.0, lambda: taken.expose(5e6))
    assert frame is not None
    assert (frame.gain_db, frame.raised_db) == (36.0, 6.0)


def test_a_gain_that_stays_raised_blocks_until_it_is_restored(clock: VirtualClock, board: StatusRegistry) -> None:
    taken, gain = camera(clock), NightGain(board)
    taken.gain_stuck = True
    with pytest.raises(CameraLostError):
        gain.take(taken, 12.0, lambda: taken.expose(5e6))
    assert codes(board) == {GAIN_NOT_RESTORED}
    with pytest.raises(CameraLostError):
        gain.restore(taken)
    taken.gain_stuck = False
    gain.restore(taken)
    assert codes(board) == set()
    assert taken.expose(3_000.0).gain_db == 0.0


def test_an_exposure_that_fails_leaves_the_gain_as_it_was(clock: VirtualClock, board: StatusRegistry) -> None:
    taken, gain = camera(clock), NightGain(board)

    def fails() -> Frame | None:
        raise CameraError("no frame")

    assert gain.take(taken, 12.0, fails) is None
    assert taken.expose(5e6).gain_db == 0.0
    assert clock.now() - NIGHT < timedelta(minutes=1)
