"""A month of a camera at speed, with all that happens to one, beside the truth that is known here alone.

    python -m tests.release.month folder http gige --days 30 --every 900 --seed 1

Each source sees the same sky through the same lens. Clouds; a picture that is served for an hour; six hours without a
network; two hours with something else in the pictures' place (a web page; a folder that is mounted anew); a clock that
is wrong for a day; 2 % of truncated pictures; the change to winter time; a move.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Protocol
from zoneinfo import ZoneInfo

import numpy as np
from tests.imager.live.followed import Followed
from tests.imager.live.sky_pictures import Lens, jpeg, picture, sun_at
from tests.imager.live.test_snapshots import Asked, Camera, sent

from sunarc.common.array_types import FloatArray
from sunarc.imager.app.service import Service
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.optics.forward import project

START = datetime(2025, 10, 27, 12, 0, tzinfo=UTC)
"""Winter time begins on 2 November, 07:00 UTC: on day 6."""
ZONE = ZoneInfo("America/Chicago")
BEFORE, AFTER = Lens(), Lens(turn_deg=27.0)
HOURS = 13.0
LOWEST_DEG = 84.0
FAR_PX = 2.0


@dataclass(frozen=True)
class Plan:
    """What happens when; times are true."""

    days: int
    every_s: float
    seed: int
    clock_s: float = 420.0

    @property
    def moved_at(self) -> datetime:
        return START + timedelta(days=round(0.6 * self.days), hours=16)

    def lens(self, at: datetime) -> Lens:
        return BEFORE if at < self.moved_at else AFTER

    def happens(self, at: datetime) -> str:
        day, hour = (at - START).days, at.hour
        hours = {2: ("frozen", 16, 17), 3: ("outage", 14, 20), 4: ("away", 15, 17)}
        what, since, until = hours.get(day, ("", 0, 0))
        return what if since <= hour < until else ""

    def clock_is_wrong(self, at: datetime) -> bool:
        return timedelta(days=7, hours=5) <= at - START < timedelta(days=8, hours=6)

    def slots(self) -> list[list[datetime]]:
        """Return the times of the pictures with the sun up, day by day."""
        n = round(HOURS * 3600.0 / self.every_s)
        every = [[START + timedelta(days=d, seconds=k * self.every_s) for k in range(n)] for d in range(self.days)]
        return [[at for at in day if sun_at(at)[0] < 88.0] for day in every]


class Source(Protocol):
    """A service, and how a picture gets to it."""

    service: Service

    def show(self, at: datetime, content: bytes, happens: str) -> datetime:
        """Let the service see a picture, and return the time that it is dated by."""

    def advance_to(self, at: datetime) -> None:
        """Let time pass."""

    def close(self) -> None:
        """Free what it holds."""


class FolderSource:
    """Pictures in a folder, by the camera's clock in local time; what came while there was no network comes later."""

    def __init__(self, base: Path, plan: Plan) -> None:
        self.plan, self.late = plan, list[tuple[str, bytes]]()
        self.followed = Followed(base, START, utc_offset="America/Chicago")
        self.followed.turn()
        self.service = self.followed.service
        self.away = self.followed.root.with_name("away")
        self.rng = np.random.default_rng(plan.seed)

    def show(self, at: datetime, content: bytes, happens: str) -> datetime:
        dated = at + timedelta(seconds=self.plan.clock_s * self.plan.clock_is_wrong(at))
        name = f"{dated.astimezone(ZONE):%Y%m%d}/image-{dated.astimezone(ZONE):%Y%m%d%H%M%S}.jpg"
        root = self.followed.root
        if happens == "away" and root.exists():
            root.rename(self.away)
        if happens != "away" and self.away.exists():
            shutil.copytree(self.away, root)  # another inode, as of a mount
            shutil.rmtree(self.away)
        if happens in {"outage", "away"}:
            self.late.append((name, content))
        else:
            order = self.rng.permutation(len(self.late))
            for one in [(name, content), *(self.late[number] for number in order)]:
                self.followed.write(*one)
            self.late.clear()
        self.followed.turn()
        return dated

    def advance_to(self, at: datetime) -> None:
        self.followed.clock.advance(max((at - self.followed.clock.now()).total_seconds(), 0.0))
        self.followed.turn()
        behind = self.service.folder_archive
        assert behind is not None
        behind.step(threading.Event(), lambda: None)

    def close(self) -> None:
        self.followed.close()


class HttpSource:
    """A camera on loopback that is asked; the clock that goes wrong is the host's."""

    def __init__(self, base: Path, plan: Plan) -> None:
        self.plan, self.camera, self.passed_s = plan, Camera(), 0.0
        url = f"http://127.0.0.1:{self.camera.port}/record/current.jpg"
        self.asked = Asked(base, url, start=START, cadence_s=plan.every_s)
        self.service = self.asked.service
        self.is_off = False

    def show(self, at: datetime, content: bytes, happens: str) -> datetime:
        self.advance_to(at)
        answers = {
            "outage": lambda request: request.connection.close(),
            "away": sent(b"<html>log in</html>", "text/html"),
        }
        self.camera.answer = answers.get(happens, sent(content))
        dated = self.asked.clock.now()
        assert self.service.snapshots is not None
        self.service.snapshots.take()
        return dated

    def advance_to(self, at: datetime) -> None:
        clock = self.asked.clock
        clock.advance(max((at - START).total_seconds() - clock.monotonic(), 0.0))
        if self.plan.clock_is_wrong(at) != self.is_off:
            self.is_off = not self.is_off
            clock.step(self.plan.clock_s if self.is_off else -self.plan.clock_s)
        self.service.clock_watch.check()

    def close(self) -> None:
        self.service.archive.close()
        self.camera.close()


@dataclass
class Shown:
    """What was shown: the true time of each picture by the time it is dated by, and which could not be used."""

    true_of: dict[datetime, datetime] = field(default_factory=dict)
    spoilt: set[datetime] = field(default_factory=set)
    codes: dict[str, datetime] = field(default_factory=dict)
    seconds: float = 0.0


def run_month(source: Source, plan: Plan, *, lost_in: frozenset[str]) -> dict[str, Any]:
    """Show a month to a service, and return what it made of it.

    Parameters
    ----------
    lost_in : happenings whose pictures the source never gets.
    """
    rng, shown, frozen = np.random.default_rng(plan.seed), Shown(), b""
    refits, stop = source.service.refit_worker(), threading.Event()
    source.service.watch.remember()
    for day, slots in enumerate(plan.slots()):
        cloudy = bool(rng.random() < 0.25)
        for at in slots:
            cloud = bool(rng.random() < (0.8 if cloudy else 0.05))
            happens, content = plan.happens(at), jpeg(picture(at, plan.lens(at), rng, cloud=cloud))
            frozen = frozen or content if happens == "frozen" else b""
            content = frozen or content
            truncated = bool(rng.random() < 0.02)
            began_s = time.process_time()
            dated = source.show(at, content[: len(content) // 2] if truncated else content, happens)
            shown.seconds += time.process_time() - began_s
            while source.service.watch.process_next():
                pass
            shown.true_of[dated] = at
            if truncated or happens in lost_in:
                shown.spoilt.add(dated)
            for reason in source.service.board.snapshot().reasons:
                shown.codes.setdefault(reason.code, at)
        _end_day(source, refits, START + timedelta(days=day, hours=23, minutes=40), stop)
    return {**_rows(source.service, plan, shown), **_calibrations(source.service, plan, shown)}


def _end_day(source: Source, refits: RefitWorker, at: datetime, stop: threading.Event) -> None:
    source.advance_to(at)
    source.advance_to(at + timedelta(minutes=12))
    source.service.judge_completed_days()
    for waiting in source.service.archive.refits.find("roof", unfinished=True)[-1:]:
        refits.carry_out(waiting, stop, lambda: None)
    source.advance_to(at + timedelta(minutes=13))


def _rows(service: Service, plan: Plan, shown: Shown) -> dict[str, Any]:
    """Return what became of the pictures."""
    points = service.archive.sightings.find("roof")
    times = Counter(point.time for point in points)
    wanted = {dated for dated, at in shown.true_of.items() if dated not in shown.spoilt and sun_at(at)[0] < LOWEST_DEG}
    used = [point for point in points if point.accepted]
    true = [shown.true_of.get(point.time, point.time) for point in used]
    off = [_off_px(plan.lens(at), at, point.x_px, point.y_px) for point, at in zip(used, true, strict=True)]
    return {
        "shown": len(shown.true_of),
        "spoilt": len(shown.spoilt),
        "rows": len(points),
        "doubled": sum(times.values()) - len(times),
        "lost": len(wanted - set(times)),
        "of_no_picture": len(set(times) - set(shown.true_of)),
        "verdicts": dict(Counter(point.verdict for point in points)),
        "accepted": len(used),
        "accepted_far_off": int(np.sum(np.array(off) > FAR_PX)),
        "median_off_px": round(float(np.median(off)), 4) if off else None,
        "accepted_of_a_wrong_clock": sum(
            shown.true_of.get(point.time) != point.time and (point.clock_error_s or 0.0) < 2.0 for point in used
        ),
        "milliseconds_a_picture": round(1e3 * shown.seconds / max(len(shown.true_of), 1), 1),
        "codes": {code: f"{at:%m-%d %H:%M}" for code, at in shown.codes.items()},
    }


def _off_px(lens: Lens, at: datetime, x_px: float | None, y_px: float | None) -> float:
    x, y = lens.pixel(*sun_at(at))
    return float(np.hypot((x_px or 0.0) - x, (y_px or 0.0) - y))


def _calibrations(service: Service, plan: Plan, shown: Shown) -> dict[str, Any]:
    """Return how far each calibration was from the lens of its time, beside what it states."""
    errors = []
    for record in service.archive.calibrations.find("roof"):
        # nobody knows of a move in the night before the next picture
        lens = plan.lens(max(at for at in shown.true_of.values() if at <= record.created_at))
        model = service.archive.calibrations.model(record.id)
        off = [
            np.hypot(*(project(model.camera, _direction(z, a)) - np.array(lens.pixel(z, a))))
            for z in (20.0, 40.0, 60.0, 75.0)
            for a in range(0, 360, 45)
        ]
        true_deg = float(np.degrees(np.sqrt(np.mean(np.square(off))) / lens.focal_px))
        stated_deg = float(record.document["uncertainty"]["sky_rms_deg"])
        errors.append((record.valid_from, true_deg, stated_deg))
    errors.sort()
    ratios = [true / stated for _, true, stated in errors]
    changes = ("bump", "clock", "lens", "image", "site", "clock_step")
    return {
        "days": dict(Counter(day.verdict for day in service.archive.days.find("roof"))),
        "calibrations": len(errors),
        "worst_true_over_stated": round(max(ratios, default=0.0), 2),
        "beyond_two_stated": sum(ratio > 2.0 for ratio in ratios),
        "last": [round(one, 4) for one in errors[-1][1:]] if errors else None,
        "moved_at": f"{plan.moved_at:%m-%d %H:%M}",
        "epochs": [(f"{one.started_at:%m-%d %H:%M}", one.reason) for one in service.archive.epochs.find("roof")],
        "events": [
            (one.kind, f"{one.time:%m-%d %H:%M}", one.text[:70])
            for one in service.archive.events.find("roof")
            if one.kind in changes
        ],
    }


def _direction(zenith_deg: float, azimuth_deg: float) -> FloatArray:
    zenith, azimuth = np.radians([zenith_deg, azimuth_deg])
    return np.array([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)])


SOURCES: dict[str, tuple[Callable[[Path, Plan], Source], frozenset[str]]] = {
    "folder": (FolderSource, frozenset[str]()),
    "http": (HttpSource, frozenset({"outage", "away"})),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run months and print what came of each."""
    parser = argparse.ArgumentParser(prog="tests.release.month", description=__doc__)
    parser.add_argument("sources", nargs="+", choices=SOURCES)
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--every", type=float, default=900.0, help="seconds between pictures")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    plan = Plan(options.days, options.every, options.seed)
    for name in options.sources:
        make, lost_in = SOURCES[name]
        with tempfile.TemporaryDirectory(prefix="month-") as base:
            source = make(Path(base), plan)
            found = run_month(source, plan, lost_in=lost_in)
            source.close()
        print(name)
        for what, value in found.items():
            print(f"  {what}: {value}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
