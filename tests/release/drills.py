"""Drills of the dashboard: states of a camera, each looked at in a browser at three widths.

    .venv/bin/python -m tests.release.drills --into DIR [NAME…]

serves each state from an archive of its own, writes DIR/NAME-WIDTH.png at 1440, 768 and 390 px, and prints the first
screen in words, what axe-core finds, what is wider than the window, and the console; exit 1 where there is any of it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser
from tests.fixtures.calibrations import SITE, chosen_calibration
from tests.fixtures.nights import judged
from tests.fixtures.served import LENS, NOON, calibration, document, fill, new_archive, sightings
from tests.imager.web.test_dashboard import browser, opened, serving_app

from sunarc.calibration.model.result import Verdict
from sunarc.common.findings import Finding
from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.images import DiskOptions, ImageStore
from sunarc.imager.archive.move_pictures import MovePictures
from sunarc.imager.archive.values import TO_ACKNOWLEDGE, CameraRecord, Event, Refit
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import (
    CameraStatus,
    ClockStatus,
    DiskStatus,
    StatusRegistry,
    WorkerStatus,
    condition,
)
from sunarc.imager.web.app import create_app
from sunarc.imager.web.options import ApiOptions
from sunarc.imager.workers.calibrating.moves import MoveConditions
from sunarc.imager.workers.calibrating.refit import CalibrationIntegrityCheck
from sunarc.imager.workers.clock_watch import clock_cost_text
from sunarc.imager.workers.night.images import night_picture, store_picture
from sunarc.lab.simulation.made_archive import encoded, photograph
from sunarc.lab.simulation.options import Bump
from sunarc.lab.simulation.scene import bumped_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

WIDTHS = {1440: 1000, 768: 1024, 390: 844}
"""Widths and heights of the windows, px."""
HOURS = timedelta(hours=9)
"""That a camera has run, but for a fresh one."""
AUCKLAND = Site(latitude=-36.85, longitude=174.76, altitude=40.0)
MOVED_AT = NOON - timedelta(minutes=25)
MOVED = bumped_camera(LENS, Bump(at=MOVED_AT, turn_deg=(2.5, 0.0, 0.0)))
WIDER = """() => [...document.querySelectorAll("main *, header *, aside *, #moves *")]
  .filter((one) => one.getBoundingClientRect().right > innerWidth + 1 && !one.closest(".wide, .picture, svg"))
  .map((one) => `${one.tagName} ${one.id} ${one.textContent.slice(0, 60)}`)"""


@dataclass
class Stage:
    """A camera in a state: its archive, its board and what is served of them."""

    folder: Path
    archive: Archive
    board: StatusRegistry
    site: Site = SITE
    camera: Camera = LENS
    timezone: str = "America/Chicago"
    now: datetime = NOON
    image: Path | None = None
    images: ImageStore | None = None
    others: dict[str, Any] = field(default_factory=dict)

    def app(self) -> Any:
        """Return the application that serves it."""

        def refit(reason: str) -> Refit:
            return Refit(id="r", camera="roof", requested_at=self.now, reason=reason)

        return create_app(
            archive=self.archive, camera="roof", site=self.site, status=self.board.snapshot, request_refit=refit,
            frame_clock=lambda: self.now, latest_image=lambda: self.image, images=self.images,
            options=ApiOptions(), timezone=self.timezone, **self.others,
        )  # fmt: skip

    def photograph(self, time: datetime) -> Path:
        """Take a picture of the sky at a time."""
        sun = project(self.camera, sun_directions(time.timestamp(), self.site))
        self.image = self.folder / f"{time:%Y%m%dT%H%M%S}.000Z_hdr.jpg"
        self.image.write_bytes(encoded(photograph(LENS.width, np.asarray(sun), np.random.default_rng(3))))
        self.board.note(last_frame_at=time)
        return self.image

    def running(self) -> None:
        """Let the camera answer, the clock be right and all workers run, with a picture and a sighting of now."""
        self.board.note(
            camera=CameraStatus(name="roof", connected=True, model="Test", serial="1"),
            clock=ClockStatus(synchronised=True, max_error_s=0.01),
            disk=DiskStatus(free_bytes=82 * 10**9, images_bytes=12 * 10**9),
            last_sighting_at=self.now,
        )
        for name in ("capture", "detect", "refit", "watch"):
            self.board.set_worker(WorkerStatus(name=name, state="running", heartbeat_age_s=0.5))
        self.photograph(self.now)


def fresh(stage: Stage) -> None:
    """Show a service that started a moment ago."""
    stage.board.set_condition("no_frame_yet", condition("no_frame_yet"))
    stage.board.set_condition("no_calibration", condition("no_calibration", n=0))


def first_hours(stage: Stage) -> None:
    """Show the first morning, before the first fit."""
    stage.running()
    stage.archive.sightings.add(one for one in sightings(NOON, every_s=60.0) if one.accepted)
    n = stage.archive.sightings.count_accepted_suns("roof")
    stage.board.set_condition("no_calibration", condition("no_calibration", n=n))


def ready(stage: Stage) -> None:
    """Show a calibrated camera."""
    fill(stage.archive)
    stage.running()


def clock(stage: Stage) -> None:
    """Show a calibrated camera whose host has lost its time service."""
    ready(stage)
    stage.board.note(clock=ClockStatus(synchronised=False, max_error_s=16.0))
    cost = clock_cost_text(0.006, error_s=16.0)
    stage.board.set_condition(
        "clock_unsynchronised",
        condition("clock_unsynchronised", clock="host", cost=cost),
    )


def bump(stage: Stage) -> None:
    """Show a mast that was bumped by 2.5 degrees some minutes ago."""
    ready(stage)
    stage.others["moves"] = pictures = MovePictures(stage.folder / "moves")
    pictures.remember(stage.photograph(MOVED_AT - timedelta(minutes=5)), sighted_at=MOVED_AT)
    event = _changed(stage, "bump", "the camera was moved by 2.5° ± 0.3°", size=2.5, sigma=0.3)
    stage.camera = MOVED
    since = (replace(one, pose_epoch="roof-2") for one in sightings(NOON, camera=MOVED) if one.time >= MOVED_AT)
    stage.archive.sightings.replace(since)
    pictures.keep(event, stage.photograph(NOON), sighted_at=NOON)


def lens(stage: Stage) -> None:
    """Show a lens whose focus changed."""
    ready(stage)
    _changed(stage, "refocus", "the focus changed by 0.8 %", size=0.8, sigma=0.1)


def gone(stage: Stage) -> None:
    """Show a camera that does not answer any more."""
    ready(stage)
    stage.now += timedelta(hours=3)
    stage.board.note(camera=CameraStatus(name="roof", connected=False, address="192.168.0.2"))
    stage.board.set_condition(
        "camera_lost", condition("camera_lost", severity="not_ready", error="the camera at 192.168.0.2 does not answer")
    )


def full_disk(stage: Stage) -> None:
    """Show a disk that another program has filled."""
    ready(stage)
    stage.board.note(disk=DiskStatus(free_bytes=31 * 10**6, images_bytes=10**6))
    lacking = condition("disk_full", folder="/var/lib/sunarc/images", free_mb=31.0, lacking_mb=1169.0, images_mb=1.0)
    stage.board.set_condition("disk_full", lacking)


def photographs_map(stage: Stage) -> None:
    """Show a camera calibrated from few photographs: uncertain far from the sun's path."""
    names = ("principal_point_x_px", "principal_point_y_px", "rotation_x", "rotation_y", "rotation_z", "k2", "k5")
    wide = np.diag([4.0, 4.0, 1e-5, 1e-5, 1e-5, 1e-5, 8e-2])
    known = chosen_calibration(LENS, names=names, covariance=wide, orders=np.array([[1, 1], [2, 1]]))
    known = replace(known, sky_rms_deg=5.8, sky_max_deg=17.2)
    stage.archive.sightings.add(sightings(NOON, every_s=1800.0))
    written = to_document(
        known, id="few", camera="roof", state="candidate", created_at=NOON - timedelta(hours=1),
        valid_from=NOON - timedelta(days=1), valid_until=None, pose_epoch="roof-1", software_version="0.1.0",
    )  # fmt: skip
    stage.archive.calibrations.activate(stage.archive.calibrations.add(written).id)
    stage.running()


def night(stage: Stage) -> None:
    """Show a calibrated camera at night, after a clear night."""
    fill(stage.archive)
    midnight = datetime(2013, 5, 14, 6, 0, tzinfo=UTC)
    stage.images = ImageStore(stage.folder / "images", options=DiskOptions(keep_free_mb=64.0))
    sky = np.random.default_rng(1).poisson(150.0, (LENS.height, LENS.width)).astype(np.uint16)
    bodies = [{"body": "star:HIP91262", "title": "Vega", "pixel": [1200.0, 700.0], "magnitude": 0.2, "found": True}]
    picture = night_picture(sky, midnight, 5)
    store_picture(stage.images, picture, bodies, calibration="second", image_size=(LENS.width, LENS.height))
    numbers: dict[str, Any] = {
        "verdict": "clear",
        "limiting_magnitude": 4.9,
        "cloud_fraction": 0.1,
        "n_images": 48,
        "n_accepted": 46,
        "n_matched": 210,
        "n_stars": 240,
        "n_stored": 900,
    }
    why = (Finding("night_images", {"n": 46, "images": 48, "cloud_fraction": 0.1}),)
    stage.archive.nights.save(judged("2013-05-13", at=midnight + timedelta(hours=6), findings=why, **numbers))
    stage.running()
    stage.now = midnight + timedelta(hours=1)
    stage.board.note(last_frame_at=stage.now - timedelta(minutes=8))
    stage.others["observes_stars"] = True


def auckland(stage: Stage) -> None:
    """Show a calibrated camera in New Zealand."""
    stage.site, stage.timezone = AUCKLAND, "Pacific/Auckland"
    stage.now = datetime(2013, 5, 13, 23, 30, tzinfo=UTC)
    stage.archive.cameras.save(CameraRecord.at(AUCKLAND, name="roof", width=LENS.width, height=LENS.height))
    since = stage.now - timedelta(hours=4)
    stage.archive.sightings.add(sightings(stage.now, site=AUCKLAND, first=since))
    stage.archive.calibrations.add(document("first"))
    stage.archive.calibrations.activate("first")
    stage.running()


def _changed(stage: Stage, kind: str, text: str, **sizes: float) -> Event:
    """Write an event of a change, serve a provisional pose, and set the conditions as the service does."""
    camera = CameraArchive(stage.archive, name="roof", site=SITE)
    details = {**sizes, TO_ACKNOWLEDGE: True}
    stage.archive.epochs.open("roof", at=MOVED_AT, reason=text)
    event = Event(time=MOVED_AT, kind=kind, severity="alarm", text=text, camera="roof", details=details)
    event = stage.archive.events.add(event)
    if kind == "bump":
        known = replace(calibration(MOVED), sky_rms_deg=0.3, sky_max_deg=0.4)
        of_pose = replace(known.evidence, options={"free": "pose"})
        verdict = Verdict(accepted=True, findings=(Finding("provisional"),))
        posed = replace(known, evidence=of_pose, verdict=verdict)
        written = to_document(
            posed, id="provisional", camera="roof", state="candidate", created_at=MOVED_AT, valid_from=MOVED_AT,
            valid_until=None, pose_epoch="roof-2", software_version="0.1.0",
        )  # fmt: skip
        stage.archive.calibrations.activate(stage.archive.calibrations.add(written).id)
        stage.board.set_condition(
            "provisional_pose", condition("provisional_pose", severity="note", n=6, sigma_deg=0.3)
        )
    else:
        stage.archive.calibrations.retire("second", at=MOVED_AT)
        CalibrationIntegrityCheck(camera, now=lambda: NOON, board=stage.board).check()
    MoveConditions(camera=camera, board=stage.board).follow()
    return event


DRILLS: dict[str, Callable[[Stage], None]] = {
    one.__name__: one
    for one in (fresh, first_hours, ready, clock, bump, lens, gone, full_disk, photographs_map, night, auckland)
}


class Seen(NamedTuple):
    """The first screen in words, and what is wrong with the page."""

    words: str
    wrong: list[str]


@contextmanager
def served(name: str) -> Iterator[str]:
    """Serve a drill; give its address."""
    with TemporaryDirectory() as folder:
        archive = new_archive(Path(folder) / "drill.sqlite")
        running = timedelta(minutes=1) if name == fresh.__name__ else HOURS
        clock_of_host = VirtualClock(NOON - running)
        board = StatusRegistry(version="drill", started_at=NOON - running, monotonic=clock_of_host.monotonic)
        stage = Stage(Path(folder), archive, board)
        clock_of_host.advance(running.total_seconds())
        DRILLS[name](stage)
        with serving_app(stage.app()) as address:
            yield address
        archive.close()


def look(chromium: Browser, name: str, into: Path) -> list[Seen]:
    """Return what a drill shows at each width, and take its pictures."""
    with served(name) as address:
        return [_page(chromium, address, width, into / f"{name}-{width}.png") for width in WIDTHS]


def _page(chromium: Browser, address: str, width: int, target: Path) -> Seen:
    found = opened(chromium, address, width=width, height=WIDTHS[width])
    page = found.page
    page.wait_for_selector("#health:not([data-health=unknown])", timeout=30_000)
    page.wait_for_load_state("load")
    page.wait_for_timeout(4000)
    page.screenshot(path=target, full_page=True)
    page.screenshot(path=target.with_name(f"{target.stem}-first.png"))
    wrong = [f"axe: {one['id']} {one['nodes'][0]['html']}" for one in Axe().run(page).response["violations"]]
    wrong += [f"wider than {width}: {one}" for one in page.evaluate(WIDER)]
    wrong += [one for one in found.complaints if "404" not in one]  # there is no picture yet
    lines = [page.inner_text(one) for one in ("#health", "#moves", "#reasons") if page.is_visible(one)]
    page.context.close()
    return Seen("\n".join(lines), wrong)


def main() -> int:
    """Run the drills that are named, or all; return 1 where a page is at fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[[], *DRILLS])
    parser.add_argument("--into", type=Path, required=True)
    options = parser.parse_args()
    options.into.mkdir(parents=True, exist_ok=True)
    faults = 0
    with browser() as chromium:
        for name in options.names or DRILLS:
            seen = look(chromium, name, options.into)
            print(f"== {name}\n{seen[0].words}")
            for width, one in zip(WIDTHS, seen, strict=True):
                faults += len(one.wrong)
                print(f"-- {width}: {one.wrong or 'nothing wrong'}")
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
