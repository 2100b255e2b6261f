"""Weeks of weather on an archive: what is seen each day, judged and refitted each night, faster than real time.

    python -m tests.imager.workers.long_run --days 60
    python -m tests.imager.workers.long_run --days 12 --then-cloud 7

prints one line a night, and what it came to.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance, sigma_px
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.formats.calibration_document import from_document
from sunarc.imager.archive.archive import Archive, CameraArchive, open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.values import CameraRecord, Refit, SunPoint
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.calibrating.day_judge import DayJudge
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.calibrating.solver_process import SolveProblem
from sunarc.imager.workers.options import RefitOptions
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.days import day_bounds_unix_s
from sunarc.sky.sun import sun_angles, sun_directions

FloatArray = NDArray[np.float64]

FIRST_DAY = date(2013, 5, 13)
LOWEST_ZENITH_DEG = 88.0
SIGMA_PX = 0.05
WITHIN_95 = 5.991
"""95 % point of the chi-square with two degrees of freedom."""


@dataclass(frozen=True)
class Weather:
    """How much of a day shows the sun, how much of what is reported is something else, and what is observed at all."""

    name: str
    seen: float
    false: float
    missed: float = 0.0
    begins: float = 0.0


CLEAR = Weather("clear", 0.98, 0.0)
PARTLY = Weather("partly", 0.6, 0.03)
CLOUDY = Weather("cloudy", 0.12, 0.1)
HEAVY = Weather("heavy cloud", 0.1, 0.3)


@dataclass(frozen=True)
class Night:
    """What a night came to.

    Attributes
    ----------
    refit : how the refit ended; "" where none was asked for.
    error_px, stated_px : root mean square error of the served camera over the sky, and its stated 1-sigma.
    covered : share of the sky whose error lies within the stated 95 %.
    """

    day: date
    weather: str
    verdict: str
    refit: str
    message: str
    calibration: str | None
    error_px: float
    stated_px: float
    covered: float


class LongRun:
    """An archive, its day judge and its refit worker, on simulated sightings of a known camera."""

    def __init__(self, folder: Path, *, cadence_s: float = 120.0, seed: int = 1, camera: Camera | None = None) -> None:
        self.truth = true_camera() if camera is None else camera
        self.cadence_s = cadence_s
        self._rng = np.random.default_rng(seed)
        upgrade(folder / "sunarc.sqlite")
        self.archive: Archive = open_archive(folder / "sunarc.sqlite")
        self.now = datetime(2013, 5, 13, tzinfo=UTC)
        self.archive.cameras.save(CameraRecord.at(SGP, name="roof", width=self.truth.width, height=self.truth.height))
        self._join()

    def _join(self) -> None:
        clock = VirtualClock(self.now)
        self._board = StatusRegistry(version="long run", started_at=self.now, monotonic=clock.monotonic)
        self.judge = DayJudge(
            camera=CameraArchive(self.archive, name="roof", site=SGP),
            cadence_s=lambda: self.cadence_s,
            sun_zenith_deg=LOWEST_ZENITH_DEG,
            now=lambda: self.now,
            request_refit=self.request,
        )
        self.worker = self.with_solve(solve_here)

    def with_solve(self, solve: Callable[..., Calibration | None]) -> RefitWorker:
        """Return a refit worker that solves in its own way."""
        return RefitWorker(
            camera=CameraArchive(self.archive, name="roof", site=SGP),
            options=RefitOptions(),
            calibration=CalibrationOptions(),
            cadence_s=self.cadence_s,
            clock=VirtualClock(self.now),
            now=lambda: self.now,
            board=self._board,
            solve=solve,
        )

    def on(self, archive: Archive) -> LongRun:
        """Return the same run on another archive."""
        other = copy(self)
        other.archive = archive
        other._join()
        return other

    def request(self, reason: str) -> Refit:
        """Ask for a refit."""
        return self.archive.refits.add(Refit(id=uuid.uuid4().hex, camera="roof", requested_at=self.now, reason=reason))

    def day(self, day: date, weather: Weather, *, always_refit: bool = False) -> Night:
        """Live through a day and the night after it."""
        self._see(day, weather)
        self.now = datetime.fromtimestamp(day_bounds_unix_s(day, longitude=SGP.longitude)[1] + 60.0, UTC)
        (judged,) = self.judge.judge_ended_days()
        if always_refit and not self.archive.refits.find("roof", unfinished=True):
            self.request("in spite of the clouds")
        refit: Refit | None = None
        for waiting in self.archive.refits.find("roof", unfinished=True):
            self.worker.carry_out(waiting, threading.Event(), lambda: None)
            refit = self.archive.refits.get(waiting.id)
        served = self.archive.calibrations.current("roof")
        error, stated, covered = (np.nan,) * 3
        if served is not None:
            error, stated, covered = judged_against(self.truth, from_document(served.document))
        return Night(
            day=day,
            weather=weather.name,
            verdict=judged.verdict,
            refit="" if refit is None else refit.state,
            message="" if refit is None else refit.message,
            calibration=None if served is None else served.id,
            error_px=error,
            stated_px=stated,
            covered=covered,
        )

    def _see(self, day: date, weather: Weather) -> None:
        start, end = day_bounds_unix_s(day, longitude=SGP.longitude)
        times = np.arange(start, end, self.cadence_s)
        times = times[sun_angles(times, SGP).apparent_zenith < LOWEST_ZENITH_DEG]
        seen = self._clear_spells(times.size, weather.seen)
        if weather.missed or weather.begins:
            observed = self._rng.random(times.size) >= weather.missed
            observed[: int(weather.begins * times.size)] = False
            times, seen = times[observed], seen[observed]
        self._store_hidden(times[~seen])
        times = times[seen]
        pixels = project(self.truth, sun_directions(times, SGP)) + self._rng.normal(0.0, SIGMA_PX, (times.size, 2))
        false = self._rng.random(times.size) < weather.false
        pixels[false] += self._rng.normal(4.0, 12.0, (int(false.sum()), 2))  # bright edges of clouds, all on one side
        moments = [datetime.fromtimestamp(t, UTC) for t in times.tolist()]
        epoch = self.archive.epochs.at("roof", moments[0], reason="first frame").id if moments else ""
        self.archive.sightings.add(
            SunPoint(
                camera="roof",
                pose_epoch=epoch,
                time=moment,
                method="disc",
                accepted=True,
                verdict="clear",
                x_px=x,
                y_px=y,
                sigma_px=SIGMA_PX,
                clock_error_s=0.001,
            )
            for moment, (x, y) in zip(moments, pixels.tolist(), strict=True)
        )

    def _store_hidden(self, times: NDArray[np.float64]) -> None:
        """Store the sun exposures that showed clouds: without them nobody knows that they were taken."""
        moments = [datetime.fromtimestamp(t, UTC) for t in times.tolist()]
        epoch = self.archive.epochs.at("roof", moments[0], reason="first frame").id if moments else ""
        self.archive.sightings.add(
            SunPoint(
                camera="roof",
                pose_epoch=epoch,
                time=moment,
                method="disc",
                accepted=False,
                verdict="hidden",
            )
            for moment in moments
        )

    def _clear_spells(self, n: int, share: float) -> NDArray[np.bool_]:
        """Return which of n cycles see the sun: spells of clear sky, together about a share of the day."""
        noise = self._rng.normal(size=n + 60)
        smooth = np.convolve(noise, np.ones(20), mode="valid")[:n]
        return np.asarray(smooth <= np.quantile(smooth, share))


def judged_against(truth: Camera, served: Calibration) -> tuple[float, float, float]:
    """Return a calibration's error over the sky, its stated 1-sigma, px, and the share of the sky within 95 %."""
    directions = hemisphere(800)
    pixels, covariance = project_with_covariance(served, directions)
    apart = pixels - project(truth, directions)
    known = np.all(np.isfinite(apart), axis=-1)
    apart, covariance = apart[known], covariance[known]
    square = np.einsum("ni,ni->n", apart, np.linalg.solve(covariance, apart[..., None])[..., 0])
    error = float(np.sqrt(np.mean(np.sum(apart**2, axis=-1))))
    stated = float(np.sqrt(np.mean(2.0 * sigma_px(covariance) ** 2)))
    return error, stated, float(np.mean(square < WITHIN_95))


def solve_here(problem: SolveProblem, *_: object) -> Calibration:
    """Solve in this process: a year of nights need not start a process each."""
    return calibrate(
        problem.points,
        site=problem.site,
        image_size=problem.image_size,
        options=problem.options,
        circle=problem.circle,
    )


def mixed(days: int, *, seed: int = 2) -> Iterator[Weather]:
    """Give half clear or partly clear days and half cloudy ones, in spells, the first one clear."""
    rng = np.random.default_rng(seed)
    weather = CLEAR
    for _ in range(days):
        yield weather
        if rng.random() < 0.5:
            weather = (CLEAR, PARTLY, CLOUDY, CLOUDY)[int(rng.integers(4))]


def worst_rise(nights: list[Night]) -> float:
    """Return the largest rise of the true error at a refit, in units of the stated 1-sigma after it."""
    pairs = [(a, b) for a, b in pairwise(nights) if a.calibration not in (None, b.calibration)]
    return max(((b.error_px - a.error_px) / b.stated_px for a, b in pairs), default=0.0)


def main() -> None:
    """Run, print a line a night, and what it came to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--days", type=int, default=60)
    parser.add_argument("--then-cloud", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lens", type=int, default=0, help="of which true lens; 0 is the paper's")
    parser.add_argument("--cadence", type=float, default=120.0)
    chosen = parser.parse_args()
    nights: list[Night] = []
    with tempfile.TemporaryDirectory() as folder:
        camera = true_camera(chosen.lens)
        run = LongRun(Path(folder), cadence_s=chosen.cadence, seed=chosen.seed, camera=camera)
        weather = [*mixed(chosen.days, seed=chosen.seed + 1), *[HEAVY] * chosen.then_cloud]
        for number, of_day in enumerate(weather):
            night = run.day(FIRST_DAY + timedelta(days=number), of_day, always_refit=of_day is HEAVY)
            nights.append(night)
            print(  # noqa: T201 - a script that tells what it measured
                f"{night.day} {night.weather:11} {night.verdict:8} {night.refit:9} error {night.error_px:.4f} px,"
                f" stated {night.stated_px:.4f}, covered {night.covered:.3f}  {night.message[:90]}",
                flush=True,
            )
    served = [night for night in nights if night.calibration is not None]
    told = replace(served[-1], message="")
    print(told)  # noqa: T201
    print(  # noqa: T201
        f"largest rise {worst_rise(served):.2f} stated sigma; last error {told.error_px:.4f} px; mean coverage "
        f"{np.mean([night.covered for night in served]):.3f}; refits "
        f"{ {state: sum(n.refit == state for n in nights) for state in ('accepted', 'marginal', 'refused', 'failed')} }"
    )


if __name__ == "__main__":
    main()
