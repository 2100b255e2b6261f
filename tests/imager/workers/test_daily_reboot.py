"""A host, or a camera, that is rebooted once a day at a time that wanders through solar noon over days.

The sun is pvlib's, the lens a formula of this file, so that nothing but the service is judged.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, date, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from pvlib.solarposition import get_solarposition
from scipy.spatial.transform import Rotation
from tests.fixtures.archive import make_empty

from sunarc.calibration.answers.covariance import project_with_covariance, sigma_px
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.formats.calibration_document import from_document
from sunarc.imager.app.service import Service
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.values import CameraRecord
from sunarc.imager.cameras.frame import SkyCamera
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import ClockState, VirtualClock
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.options import CaptureOptions
from sunarc.sky.site import Site

from .clock_faults import hand_on
from .long_run import solve_here

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

FloatArray = NDArray[np.float64]

SITE = Site(latitude=47.0, longitude=11.0, altitude=600.0)
FIRST_DAY = date(2021, 6, 14)
DAYS = 9
SIZE = 1200
SIGMA_PX = 0.03
LOWEST_DEG = 85.0
CADENCE_S = 1200.0
DOWN_S = 45.0
OFF_FOR_S = {"host": 90.0, "camera": 600.0}
"""From the end of a reboot to a right clock: a time service asks soon, the camera's PTP takes ten minutes."""
SYNCHRONISED = ClockState(synchronised=True, error_bound_s=0.01)
UNSYNCHRONISED = ClockState(synchronised=False, error_bound_s=16.0)
POSE = Rotation.from_euler("zyx", [33.0, 2.5, -1.5], degrees=True).as_matrix() @ np.diag([-1.0, -1.0, 1.0])


def sun(unix_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the sun's apparent zenith angles, degrees, and its directions (n, 3), east-north-up."""
    found = get_solarposition(
        pd.to_datetime(np.atleast_1d(unix_s), unit="s", utc=True),
        SITE.latitude,
        SITE.longitude,
        altitude=SITE.altitude,
        pressure=SITE.pressure_pa,
        temperature=SITE.temperature,
        method="nrel_numpy",
    )
    zenith, azimuth = np.radians(found["apparent_zenith"].to_numpy()), np.radians(found["azimuth"].to_numpy())
    across = np.sin(zenith)
    return np.degrees(zenith), np.stack([across * np.sin(azimuth), across * np.cos(azimuth), np.cos(zenith)], axis=-1)


def seen_at(directions: FloatArray) -> FloatArray:
    """Return pixels (n, 2): an equisolid lens that is longer to its edge by 0.3 %."""
    x, y, z = (directions @ POSE.T).T
    angle = np.arctan2(np.hypot(x, y), z)
    radius = 800.0 * np.sin(angle / 2.0) * (1.0 + 0.0012 * angle**2) / np.maximum(np.hypot(x, y), 1e-12)
    return np.stack([603.0 + radius * x, 598.0 + radius * y], axis=-1)


def no_camera() -> SkyCamera:
    raise AssertionError("frames are made here")


class Mast:
    """The joined service, shown the true sun; either the host is rebooted each day, or the camera."""

    def __init__(self, folder: Path, rebooted: Literal["host", "camera"]) -> None:
        make_empty(folder / "sunarc.sqlite")
        self.rebooted = rebooted
        self._settings = Settings(
            name="roof",
            site=SITE,
            state=folder,
            camera=AravisOptions(address="127.0.0.9", timestamps=rebooted),
            capture=CaptureOptions(cadence_s=CADENCE_S, sun_zenith_deg=LOWEST_DEG),
        )
        self.archive = open_archive(self._settings.database)
        self._start = datetime(FIRST_DAY.year, FIRST_DAY.month, FIRST_DAY.day, 1, tzinfo=UTC)
        self.clock = VirtualClock(self._start)
        self.clock.set_state(SYNCHRONISED)
        self._rng = np.random.default_rng(20)
        self._camera_off_s = 0.0
        self.true_times: dict[datetime, datetime] = {}
        self.archive.cameras.save(CameraRecord.at(SITE, name="roof", width=SIZE, height=SIZE))
        self.start_service()

    def start_service(self) -> None:
        """Start the service (anew) with what its archive and the clocks say."""
        self.service = Service(self._settings, archive=self.archive, clock=self.clock, open_camera=no_camera)
        self.note_frame()
        self.service.clock_watch.check()
        self.service.watch.remember()

    @property
    def true_time(self) -> datetime:
        return self._start + timedelta(seconds=self.clock.monotonic())

    def note_frame(self) -> datetime:
        """Let a frame come, and return how it is dated."""
        if self.rebooted == "camera":
            dated = self.true_time + timedelta(seconds=self._camera_off_s)
            self.service.frame_time.note(dated, host_offset_s=self._camera_off_s)
            return dated
        return self.clock.now()

    def run_until(self, moment: datetime, *, every_s: float) -> None:
        """Let time pass; the clock is looked at, and a frame comes, so often."""
        while (left_s := (moment - self.true_time).total_seconds()) > 0.0:
            self.clock.advance(min(left_s, every_s))
            self.note_frame()
            self.service.clock_watch.check()

    def reboot(self, behind_s: float, *, restart: bool) -> None:
        """Switch off and on what is rebooted: its clock resumes at a time that it stored, `behind_s` ago."""
        self.clock.advance(DOWN_S)
        if self.rebooted == "host":
            self.clock.set_state(UNSYNCHRONISED)
            self.clock.step(-behind_s)
        else:
            self._camera_off_s = -behind_s
        if restart:
            self.start_service()

    def set_right(self, behind_s: float) -> None:
        """Set the clock right, by the time service or by PTP."""
        if self.rebooted == "host":
            self.clock.step(behind_s)
            self.clock.set_state(SYNCHRONISED)
        self._camera_off_s = 0.0

    def see(self, pixel: FloatArray) -> None:
        """Take a sun exposure and hand on what was detected."""
        moment = self.note_frame()
        self.true_times.setdefault(moment, self.true_time)
        x, y = (float(v) for v in pixel + self._rng.normal(0.0, SIGMA_PX, 2))
        hand_on(self.service, x, y, moment=moment, sigma_px=SIGMA_PX)

    def live(self, day: date, *, reboot_at: datetime, behind_s: float, restart: bool) -> None:
        """Live through a cloudless day with its reboot, and the midnight after it."""
        noon = solar_noon(day)
        slots = noon.timestamp() + np.arange(-10.0 * 3600.0, 10.0 * 3600.0, CADENCE_S)
        zenith_deg, directions = sun(slots)
        up_at = reboot_at + timedelta(seconds=DOWN_S)
        right_at = up_at + timedelta(seconds=OFF_FOR_S[self.rebooted])
        off = (slots >= reboot_at.timestamp()) & (slots < up_at.timestamp())
        seen = np.flatnonzero((zenith_deg < LOWEST_DEG) & ~off)
        doings: list[tuple[datetime, Callable[[], None]]] = [
            (datetime.fromtimestamp(slot, UTC), partial(self.see, pixel))
            for slot, pixel in zip(slots[seen].tolist(), seen_at(directions[seen]), strict=True)
        ]
        doings.append((reboot_at, partial(self.reboot, behind_s, restart=restart)))
        doings.append((right_at, partial(self.set_right, behind_s)))
        for moment, do in sorted(doings, key=lambda doing: doing[0]):
            soon = reboot_at <= self.true_time < right_at + timedelta(minutes=15)
            self.run_until(moment, every_s=2.0 if soon else 600.0)
            do()
        self.run_until(noon + timedelta(hours=12, minutes=2), every_s=600.0)
        self.service.judge_completed_days()

    def refit(self) -> None:
        """Carry out the refit that waits."""
        service = self.service
        worker = RefitWorker(
            camera=service.camera,
            options=self._settings.refit,
            calibration=self._settings.calibration,
            cadence_s=CADENCE_S,
            clock=self.clock,
            now=service.frame_time.now,
            board=service.board,
            may_solve=service.clock_watch.trusted,
            solve=solve_here,
        )
        for waiting in self.archive.refits.find("roof", unfinished=True):
            worker.carry_out(waiting, threading.Event(), lambda: None)


def solar_noon(day: date) -> datetime:
    """Return noon of local mean solar time."""
    return datetime(day.year, day.month, day.day, 12, tzinfo=UTC) - timedelta(seconds=240.0 * SITE.longitude)


@pytest.fixture(scope="module", params=["host", "camera"])
def mast(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Mast:
    """Return a mast after 9 days: reboots 68 minutes before noon to 68 after it, and a refit every fourth night."""
    made = Mast(tmp_path_factory.mktemp(request.param), request.param)
    rng = np.random.default_rng(21)
    for number in range(DAYS):
        day = FIRST_DAY + timedelta(days=number)
        reboot_at = solar_noon(day) + timedelta(
            minutes=17.0 * (number - DAYS // 2), seconds=float(rng.uniform(0.0, 60.0))
        )
        restart = made.rebooted == "host" or number % 2 == 0
        made.live(day, reboot_at=reboot_at, behind_s=float(rng.uniform(90.0, 3600.0)), restart=restart)
        if number % 4 == 0:
            made.refit()
    return made


def test_every_day_is_judged_and_clear(mast: Mast) -> None:
    days = {day.date: day for day in mast.archive.days.find("roof")}
    assert sorted(days) == [FIRST_DAY + timedelta(days=number) for number in range(DAYS)]
    assert {day.verdict for day in days.values()} == {"clear"}


def test_every_night_that_was_asked_makes_a_calibration_as_good_as_it_says(mast: Mast) -> None:
    done = mast.archive.refits.find("roof")
    assert {refit.state for refit in done if refit.finished_at is not None} == {"accepted"}
    served = mast.archive.calibrations.current("roof")
    assert served is not None
    zenith, azimuth = (
        part.ravel() for part in np.radians(np.meshgrid(np.arange(1.0, 85.0, 4.0), np.arange(0.0, 360.0, 12.0)))
    )
    across = np.sin(zenith)
    sky = np.stack([across * np.sin(azimuth), across * np.cos(azimuth), np.cos(zenith)], axis=-1)
    pixels, covariance = project_with_covariance(from_document(served.document), sky)
    weight = across / across.sum()
    error_px = np.sqrt(np.sum(weight * np.sum((pixels - seen_at(sky)) ** 2, axis=-1)))
    stated_px = np.sqrt(np.sum(weight * 2.0 * sigma_px(covariance) ** 2))
    assert error_px < 2.0 * stated_px
    assert error_px < 0.3


def test_no_reboot_is_taken_for_a_move(mast: Mast) -> None:
    assert len(mast.archive.epochs.find("roof")) == 1
    alarms = {event.kind for event in mast.archive.events.find("roof") if event.severity == "alarm"}
    assert alarms <= {"camera_clock_offset"}


def test_no_sighting_is_dated_worse_than_it_says_and_few_are_lost(mast: Mast) -> None:
    points = mast.archive.sightings.find("roof", limit=100_000)
    stated = {point.time: np.inf if point.clock_error_s is None else point.clock_error_s for point in points}
    assert all(abs((time - mast.true_times[time]).total_seconds()) <= bound + 1e-3 for time, bound in stated.items())
    surely = sum(point.accepted and stated[point.time] <= MAX_CLOCK_ERROR_S for point in points)
    assert (
        surely >= len(mast.true_times) - 6 * DAYS
    )  # of some 200 a day: 90 s or 10 minutes, and 10 until it is trusted
