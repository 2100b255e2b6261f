"""The camera in the process behaves as one on a wire would."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from tests.fixtures.scene_camera import SceneCamera

from sunarc.common.errors import CameraError, CameraLostError, CameraTimeoutError
from sunarc.imager.cameras.frame import SkyCamera
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.lab.simulation.scene import Scene

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
REGION = (700, 500, 100, 80)


@pytest.fixture
def camera(scene: Scene) -> SceneCamera:
    return SceneCamera(scene, VirtualClock(NOON), region=REGION)


def test_it_is_a_sky_camera(camera: SkyCamera) -> None:
    frame = camera.expose(3000.0)
    assert frame.image.shape == (camera.info.height, camera.info.width) == (80, 100)
    assert frame.full_scale == camera.info.full_scale == 4095
    assert not frame.image.flags.writeable


def test_a_frame_is_the_scene_at_the_middle_of_its_exposure(camera: SceneCamera, scene: Scene) -> None:
    frame = camera.expose(48_000.0)
    assert frame.time == NOON + timedelta(milliseconds=24)
    expected = scene.render(round(NOON.timestamp() * 1e6), exposure_us=48_000.0, region=REGION)
    assert np.array_equal(frame.image, expected)


def test_an_exposure_takes_its_time(scene: Scene) -> None:
    clock = VirtualClock(NOON)
    SceneCamera(scene, clock, region=REGION).expose(48_000.0)
    assert clock.now() == NOON + timedelta(milliseconds=48)


def test_exposures_are_whole_microseconds_within_the_bounds(scene: Scene) -> None:
    camera = SceneCamera(scene, VirtualClock(NOON), region=REGION, exposure_bounds_us=(20.0, 50_000.0))
    assert [camera.expose(e).exposure_us for e in (1.0, 33.4, 1e9)] == [20.0, 33.0, 50_000.0]


def test_faults_come_when_they_are_asked_for(camera: SceneCamera) -> None:
    camera.fail_next("timeout", None, "error")
    with pytest.raises(CameraTimeoutError):
        camera.expose(10.0)
    assert camera.expose(10.0).frame_id == 1
    with pytest.raises(CameraError, match="not usable"):
        camera.expose(10.0)
    assert camera.expose(10.0).frame_id == 2


def test_a_lost_camera_stays_lost(camera: SceneCamera) -> None:
    camera.fail_next("lost")
    for _ in range(2):
        with pytest.raises(CameraLostError):
            camera.expose(10.0)


def test_a_wrong_exposure_is_four_times_as_bright_and_does_not_say_so(camera: SceneCamera) -> None:
    right = camera.expose(3000.0)
    camera.fail_next("wrong_exposure")
    wrong = camera.expose(3000.0)
    assert wrong.exposure_us == right.exposure_us == 3000.0
    assert np.median(wrong.image) - 32 == pytest.approx(4.0 * (np.median(right.image) - 32), rel=0.1)


def test_a_closed_camera_gives_nothing(camera: SceneCamera) -> None:
    camera.close()
    camera.close()
    with pytest.raises(CameraLostError):
        camera.expose(10.0)
