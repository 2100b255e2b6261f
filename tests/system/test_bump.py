"""A camera that is bumped under a running service, frame by frame: noticed, followed, and told."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.scene_camera import SceneCamera

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.imager.app.service import Service
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers.options import CaptureOptions
from sunarc.lab.simulation.options import Bump, SceneOptions, SensorModel
from sunarc.lab.simulation.scene import Scene, bumped_camera
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions

CADENCE_S = 60.0
BUMPED_AT = datetime(2013, 5, 14, 18, 30, 30, tzinfo=UTC)


@pytest.fixture(scope="module")
def of_the_day_before() -> Calibration:
    """Solve the day before the bump."""
    times = datetime(2013, 5, 13, 6, tzinfo=UTC).timestamp() + np.arange(0.0, 86_400.0, 240.0)
    times = times[sun_angles(times, SGP).apparent_zenith < 88.0]
    noise = np.random.default_rng(3).normal(0.0, 0.02, (times.size, 2))
    points = Sightings.of(unix_s=times, pixels=project(true_camera(), sun_directions(times, SGP)) + noise)
    return calibrate(points, site=SGP, image_size=(1748, 1748))


def known(archive: Archive, calibration: Calibration) -> None:
    """Leave the calibration of the day before, as a nightly refit would."""
    begun = datetime(2013, 5, 13, 12, tzinfo=UTC)
    document = to_document(
        calibration,
        id="known",
        camera="imager",
        state="candidate",
        created_at=begun,
        valid_from=begun,
        valid_until=None,
        pose_epoch=archive.epochs.at("imager", begun, reason="first frame").id,
        software_version="1",
    )
    archive.calibrations.activate(archive.calibrations.add(document).id)


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [(0.12, -0.1, 0.12), (9.0, 5.0, -14.0)])
def test_a_bumped_camera_is_followed_frame_by_frame(
    tmp_path: Path, of_the_day_before: Calibration, turn_deg: tuple[float, float, float]
) -> None:
    bump = Bump(at=BUMPED_AT, turn_deg=turn_deg)
    clock = VirtualClock(datetime(2013, 5, 14, 18, 22, 10, tzinfo=UTC))
    scene = Scene(true_camera(), SGP, options=SceneOptions(bump=bump), sensor=SensorModel(black_level=0.0))
    camera = SceneCamera(scene, clock)
    settings = Settings(
        state=tmp_path,
        site=SGP,
        camera=AravisOptions(address="127.0.0.1", timestamps="camera"),
        capture=CaptureOptions(cadence_s=CADENCE_S, hdr_exposures_us=(10.0,)),
        calibration={"level_within_deg": 20.0},
    )
    upgrade(settings.database)
    archive = open_archive(settings.database)
    service = Service(settings, archive=archive, clock=clock, open_camera=lambda: camera)
    service.open_and_remember()
    known(archive, of_the_day_before)
    capture, detect = service.capture_worker(), service.detect_worker()
    for _ in range(20):
        clock.advance(CADENCE_S - clock.now().timestamp() % CADENCE_S)
        capture.cycle(camera, clock.now(), within_s=CADENCE_S)
        while (frame := service.sun_frames.get(timeout_s=0.0)) is not None:
            detect.process(frame)
        while service.watch.process_next():
            pass
    (event,) = [event for event in archive.events.find("imager") if event.severity == "alarm"]
    assert event.kind == "bump"
    assert abs((event.time - BUMPED_AT).total_seconds()) <= 2.0 * CADENCE_S
    served = archive.calibrations.current("imager")
    assert served is not None
    assert served.pose_epoch == "imager-2"
    assert service.board.snapshot().health == "degraded"
    sky = hemisphere(300)
    pixels, covariance = project_with_covariance(from_document(served.document), sky)
    error = pixels - project(bumped_camera(true_camera(), bump), sky)
    stated = np.nanmean(np.trace(covariance, axis1=1, axis2=2))
    assert np.nanmean(np.sum(error**2, axis=-1)) < 4.0 * stated
