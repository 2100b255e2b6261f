"""A site with a wrong sign is said within the first ten sightings, and a right one never doubted."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.archive import new_archive
from tests.imager.workers.test_watch import SIZE, TRUTH

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.changes.values import WatchOptions
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.values import CameraRecord
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imager.workers.calibrating.provisional_pose import ProvisionalPoseEstimator
from sunarc.imager.workers.calibrating.watch import WatchWorker
from sunarc.imager.workers.capture_status import CaptureReport
from sunarc.lab.simulation.truth import SGP
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

EVENING = datetime(2013, 5, 13, 23, 30, tzinfo=UTC)
MORNING = datetime(2013, 5, 13, 14, 30, tzinfo=UTC)
NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
EAST = replace(SGP, longitude=-SGP.longitude)
SOUTH = replace(SGP, latitude=-SGP.latitude)


def seen_from(begin: datetime) -> tuple[np.ndarray, np.ndarray]:
    times = begin.timestamp() + 30.0 * np.arange(10)
    noise = np.random.default_rng(4).normal(0.0, 0.3, (10, 2))
    return times, project(TRUTH, sun_directions(times, SGP)) + noise


@pytest.mark.parametrize(("site", "said"), [(EAST, True), (SGP, False)])
def test_a_first_start_with_the_wrong_sign_of_the_longitude_is_said(
    tmp_path: Path, board: StatusRegistry, *, site: Site, said: bool
) -> None:
    with watched(tmp_path, board, site) as watch:
        after = [show(watch, *one) for one in zip(*seen_from(EVENING), strict=True)][-1]
    assert ("sun_contradicts_site" in after) == said
    if said:
        assert "site.longitude" in after["sun_contradicts_site"].remedy


@pytest.mark.parametrize("site", [SGP, EAST])
def test_what_an_evening_shows_holds_until_the_next_morning_shows_something(
    tmp_path: Path, board: StatusRegistry, site: Site
) -> None:
    codes = []
    with watched(tmp_path, board, site) as watch:
        for begin in (EVENING, MORNING + timedelta(days=1)):
            codes += [set(show(watch, *one)) for one in zip(*seen_from(begin), strict=True)]
    if site == SGP:
        assert codes == [set()] * 20
    else:
        assert codes[9:13] == [{"sun_contradicts_site"}] * 4
        assert codes[13:] == [{"sun_seen_below_horizon"}] * 7


@contextmanager
def watched(base: Path, board: StatusRegistry, site: Site) -> Iterator[WatchWorker]:
    archive = new_archive(base)
    archive.cameras.save(CameraRecord.at(site, name="roof", width=SIZE[0], height=SIZE[1]))
    camera = CameraArchive(archive, name="roof", site=site)

    def now() -> datetime:
        return EVENING + timedelta(days=2)

    reposer = ProvisionalPoseEstimator(camera, options=CalibrationOptions(), wander_deg=0.0, now=now)
    yield WatchWorker(camera=camera, options=WatchOptions(), reposer=reposer, now=now, board=board)
    archive.close()


def show(watch: WatchWorker, unix_s: float, pixel: np.ndarray) -> dict[str, Reason]:
    """Show the watch a sighting; return the conditions after it."""
    watch.notice(datetime.fromtimestamp(unix_s, UTC), x_px=float(pixel[0]), y_px=float(pixel[1]), sigma_px=0.3)
    assert watch.process_next()
    return {reason.code: reason for reason in watch.board.snapshot().reasons}


def lit(level: float, exposure_us: float) -> Frame:
    return Frame(
        image=np.full((64, 64), round(4095 * level), dtype=np.uint16), time=NOON, exposure_us=exposure_us, gain_db=0.0,
        pixel_format="Mono12", full_scale=4095, frame_id=1,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        ([(0.64, 48_000.0)] * 2, True),  # the simulated day
        ([(1.0, 5e6), (0.64, 48_000.0)] * 2, True),
        ([(0.64, 48_000.0)], False),
        ([(0.01, 48_000.0)] * 5, False),
        ([(0.6, 5e6)] * 5, False),  # a bright town
        ([(1.0, 10e6)] * 5, False),
    ],
)
def test_daylight_while_the_sun_should_be_far_below_the_horizon_is_said(
    board: StatusRegistry, frames: list[tuple[float, float]], *, said: bool
) -> None:
    report = CaptureReport(board, name="roof")
    zenith = float(sun_angles(NOON.timestamp(), EAST).apparent_zenith)
    assert zenith > 102.0
    for level, exposure_us in frames:
        report.night_level(lit(level, exposure_us), apparent_zenith=zenith)
    assert ("daylight_at_night" in {reason.code for reason in board.snapshot().reasons}) == said
    report.night_level(lit(0.01, 48_000.0), apparent_zenith=zenith)
    assert "daylight_at_night" not in {reason.code for reason in board.snapshot().reasons}
