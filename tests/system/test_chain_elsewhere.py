"""The same chain in one process, at places where days, azimuths and nights are not what one is used to."""

from __future__ import annotations

import threading
from datetime import UTC, date, datetime, timedelta
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from tests.fixtures.scene_camera import SceneCamera
from tests.imager.workers.long_run import solve_here

from sunarc.formats.calibration_document import from_document
from sunarc.imager.app.service import Service
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.cameras.frame import SkyCamera
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.options import CaptureOptions, SensorOptions
from sunarc.lab.simulation.options import SensorModel
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.days import day_bounds_unix_s
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

CADENCE_S = 1800.0

LIMA = Site(latitude=-12.05, longitude=-77.04, altitude=150.0)
WELLINGTON = Site(latitude=-41.29, longitude=174.78, altitude=10.0)
SVALBARD = Site(latitude=78.92, longitude=11.93, altitude=10.0)
SGP = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)


class Imager:
    """A service in this process, stepped slot by slot in simulated time."""

    def __init__(self, state: Path, site: Site, *, lens_seed: int, start: datetime) -> None:
        self.site = site
        self.truth = true_camera(lens_seed)
        self.clock = VirtualClock(start)
        self.scene_camera = SceneCamera(Scene(self.truth, site, sensor=SensorModel(black_level=0.0)), self.clock)
        settings = Settings(
            state=state,
            site=site,
            camera=AravisOptions(address="127.0.0.1", timestamps="camera"),
            sensor=SensorOptions(),
            capture=CaptureOptions(cadence_s=CADENCE_S, hdr_exposures_us=(10.0,)),
        )
        upgrade(settings.database)
        self.archive = open_archive(settings.database)
        self.service = Service(settings, archive=self.archive, clock=self.clock, open_camera=lambda: self.scene_camera)

    def run_until(self, end: datetime) -> None:
        camera: SkyCamera = self.service.open_and_remember()
        capture, detect = self.service.capture_worker(), self.service.detect_worker()
        while self.clock.now() < end:
            self.clock.advance(CADENCE_S - self.clock.now().timestamp() % CADENCE_S)
            if self.service.predictor.apparent_zenith(self.clock.now()) < 89.6:
                capture.cycle(camera, self.clock.now(), within_s=CADENCE_S / 2)
                while (frame := self.service.sun_frames.get(timeout_s=0.0)) is not None:
                    detect.process(frame)
            else:
                self.service.frame_time.note(self.clock.now())

    def judge_and_refit(self) -> None:
        """End the day; the fit is made here, for a process of its own is another test's matter."""
        self.service.judge_completed_days()
        with patch("sunarc.imager.app.service.RefitWorker", partial(RefitWorker, solve=solve_here)):
            worker = self.service.refit_worker()
        for refit in self.archive.refits.find(self.service.settings.name, unfinished=True):
            worker.carry_out(refit, threading.Event(), lambda: None)

    def served(self) -> Camera:
        record = self.archive.calibrations.current(self.service.settings.name)
        assert record is not None, [event.text for event in self.archive.events.find()]
        return from_document(record.document).camera


@pytest.fixture
def state(tmp_path: Path) -> Path:
    return tmp_path / "state"


def rms_px(apart: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=-1))))


def off_truth_px(imager: Imager, day: date) -> tuple[float, float]:
    """Return the served calibration's error on the day's track and over the sky."""
    begin, end = day_bounds_unix_s(day, longitude=imager.site.longitude)
    times = np.arange(begin, end, 60.0)
    track = sun_directions(times[sun_angles(times, imager.site).apparent_zenith < 89.5], imager.site)
    rng = np.random.default_rng(0)
    zenith = np.degrees(np.arccos(rng.uniform(np.cos(np.radians(89.9)), 1.0, 2000)))
    sky = direction_from_angles(zenith_deg=zenith, azimuth_deg=rng.uniform(0.0, 360.0, 2000))
    served = imager.served()
    return tuple(rms_px(project(served, ways) - project(imager.truth, ways)) for ways in (track, sky))  # type: ignore[return-value]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("site", "day"),
    [
        pytest.param(LIMA, date(2013, 10, 25), id="12-south-sun-through-the-zenith"),
        pytest.param(WELLINGTON, date(2013, 12, 10), id="41-south-at-the-date-line"),
        pytest.param(SVALBARD, date(2013, 5, 13), id="79-north-midnight-sun"),
    ],
)
def test_a_clear_day_is_calibrated_wherever_the_camera_stands(state: Path, site: Site, day: date) -> None:
    begin, end = (datetime.fromtimestamp(t, UTC) for t in day_bounds_unix_s(day, longitude=site.longitude))
    imager = Imager(state, site, lens_seed=0, start=begin)
    imager.run_until(end + timedelta(minutes=20))
    imager.judge_and_refit()
    (verdict,) = imager.archive.days.find("imager")
    assert (verdict.date, verdict.verdict) == (day, "clear")
    assert verdict.n >= 0.95 * verdict.n_possible
    on_track, over_sky = off_truth_px(imager, day)
    assert on_track <= 0.05
    assert over_sky <= 0.6


@pytest.mark.slow
@pytest.mark.parametrize("lens_seed", [1, 2, 3])
def test_other_lenses_are_found_from_one_day_too(state: Path, lens_seed: int) -> None:
    day = date(2013, 5, 13)
    begin, end = (datetime.fromtimestamp(t, UTC) for t in day_bounds_unix_s(day, longitude=SGP.longitude))
    imager = Imager(state, SGP, lens_seed=lens_seed, start=begin)
    imager.run_until(end + timedelta(minutes=20))
    imager.judge_and_refit()
    on_track, over_sky = off_truth_px(imager, day)
    assert on_track <= 0.05
    assert over_sky <= 0.75  # no day of a lens that differs by 7 px from its projection determines all of the sky


def test_a_day_is_judged_once_however_often_one_asks(state: Path) -> None:
    imager = Imager(state, SGP, lens_seed=0, start=datetime(2013, 5, 13, 17, tzinfo=UTC))
    imager.run_until(datetime(2013, 5, 13, 18, tzinfo=UTC))
    imager.clock.advance(86_400.0)
    imager.service.frame_time.note(imager.clock.now())
    for _ in range(3):
        imager.service.judge_completed_days()
    (verdict,) = imager.archive.days.find("imager")
    assert verdict.verdict == "unusable"
    assert imager.archive.refits.find("imager") == ()
    assert [event.kind for event in imager.archive.events.find("imager")] == ["day"]
