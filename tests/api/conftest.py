"""One clear day of a made camera, in an archive, served."""

from __future__ import annotations

import asyncio
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
from fastapi import FastAPI
from tests.fixtures.calibrations import SITE, chosen_calibration, refused

from sunarc.calibration.model.result import Calibration
from sunarc.common.findings import Finding
from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.archive.move_pictures import MovePictures
from sunarc.imager.archive.obstructions import ObstructionLearner
from sunarc.imager.archive.values import CameraRecord, Day, Event, Housekeeping, Refit, SunPoint
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import CameraStatus, ClockStatus, DiskStatus, StatusRegistry, WorkerStatus
from sunarc.imager.web.app import create_app
from sunarc.imager.web.context import PictureList
from sunarc.imager.web.options import ApiOptions
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

TOKEN = "a token that is long enough"  # noqa: S105 - of the test alone
NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
LENS = Camera(
    width=1748,
    height=1748,
    projection="equisolid",
    focal_length_px=(601.32, 601.32),
    principal_point_px=(871.96, 883.0),
    rotation_cam_enu=(0.02, -0.015, 2.1),
    radial=(0.004, -0.009, 0.003, 0.0, 0.0, 0.0, 0.0, 0.0),
    decentering=(1e-4, -5e-5, 0.0, 0.0),
)
SMALL = replace(LENS, width=120, height=116, focal_length_px=(41.0, 41.0), principal_point_px=(59.8, 58.1))
"""A map of it is made in a moment."""


def calibration(camera: Camera = LENS) -> Calibration:
    """Return a calibration whose every number is chosen, none fitted."""
    names = ("principal_point_x_px", "principal_point_y_px", "rotation_x", "rotation_y", "rotation_z")
    covariance, orders = np.diag([1e-4, 1e-4, 1e-10, 1e-10, 1e-10]), np.array([[1, 1], [2, 1]])
    return chosen_calibration(camera, names=names, covariance=covariance, orders=orders)


REFUSED = Finding("cross_validation_rmse", {"rmse_px": 0.4, "expected_px": 0.1})
"""Why the refused calibration was refused."""
NOT_ACCEPTED = Finding(
    "refit_refused",
    {"refit": "7", "message": REFUSED.text, "served": "the calibration of 13 May 2013 is still served"},
)
"""Event of its refit."""


def document(
    name: str,
    *,
    accepted: bool = True,
    valid_from: datetime = NOON - timedelta(days=1),
    camera: Camera = LENS,
    solved: Calibration | None = None,
) -> dict[str, Any]:
    """Return a calibration document."""
    solved = solved or calibration(camera)
    if not accepted:
        solved = refused(solved, REFUSED)
    return to_document(
        solved,
        id=name,
        camera="roof",
        state="candidate",
        created_at=valid_from + timedelta(hours=8),
        valid_from=valid_from,
        valid_until=None,
        pose_epoch="roof-1",
        software_version="0.1.0",
    )


def sightings(until: datetime, *, every_s: float = 300.0, camera: Camera = LENS) -> Iterator[SunPoint]:
    """Return a day of looks at the sun: seen with 0.03 px of noise, hidden by a cloud for a while."""
    first, last = datetime(2013, 5, 13, 11, 30, tzinfo=UTC).timestamp(), until.timestamp()
    unix_s = np.arange(first, last + 1.0, every_s)
    unix_s = unix_s[sun_angles(unix_s, SITE).apparent_zenith < 88.0]
    noise = np.random.default_rng(7).normal(0.0, 0.03, (len(unix_s), 2))
    pixels = project(camera, sun_directions(unix_s, SITE)) + noise
    for moment, (x, y) in zip(unix_s.tolist(), pixels.tolist(), strict=True):
        time = datetime.fromtimestamp(moment, UTC)
        cloud = datetime(2013, 5, 13, 15, tzinfo=UTC) <= time < datetime(2013, 5, 13, 16, tzinfo=UTC)
        yield SunPoint(
            camera="roof",
            pose_epoch="roof-1",
            time=time,
            method="disc",
            accepted=not cloud,
            verdict="hidden" if cloud else "clear",
            findings=(Finding("disc_too_few_pixels") if cloud else Finding("disc_found", {"chi2": 1.1}),),
            exposure_us=47.0,
            x_px=None if cloud else x,
            y_px=None if cloud else y,
            sigma_px=None if cloud else 0.03,
            clock_error_s=0.01,
        )


class Client:
    """Asks an application without a network; a failure of the application is an answer too."""

    def __init__(self, app: FastAPI, address: str = "127.0.0.1") -> None:
        self._transport = httpx.ASGITransport(app, raise_app_exceptions=False, client=(address, 1))

    def get(self, path: str, **how: Any) -> httpx.Response:  # noqa: ANN401 - of httpx
        return self.request("GET", path, **how)

    def post(self, path: str, **how: Any) -> httpx.Response:  # noqa: ANN401 - of httpx
        return self.request("POST", path, **how)

    def request(self, method: str, path: str, **how: Any) -> httpx.Response:  # noqa: ANN401 - of httpx
        async def asking() -> httpx.Response:
            async with httpx.AsyncClient(transport=self._transport, base_url="http://imager") as client:
                return await client.request(method, path, **how)

        return asyncio.run(asking())


@dataclass
class Made:
    """An application and all that stands behind it."""

    archive: Archive
    board: StatusRegistry
    app: FastAPI
    client: Client
    asked: list[str] = field(default_factory=list)
    noon: datetime = NOON
    site: Site = SITE
    lens: Camera = LENS
    bearer: dict[str, str] = field(default_factory=lambda: {"authorization": f"Bearer {TOKEN}"})

    def client_at(self, address: str) -> Client:
        """Return a client that asks from another host."""
        return Client(self.app, address)


Make = Callable[..., Made]


def write_image(folder: Path, name: str = "20130513T183000.000Z_hdr.jpg") -> Path:
    """Write a small picture of a sky."""
    y, x = np.mgrid[0:200, 0:200]
    sky = np.clip(200.0 - np.hypot(x - 100.0, y - 100.0), 0, 255).astype(np.uint8)
    path = folder / name
    cv2.imwrite(str(path), sky)
    return path


@pytest.fixture(scope="session")
def archives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make archives to copy: one that has seen nothing, one with a history, and one of a small camera with it."""
    folder = tmp_path_factory.mktemp("archives")
    new_archive(folder / "empty.sqlite").close()
    for name, camera in (("filled", LENS), ("small", SMALL)):
        filled = new_archive(folder / f"{name}.sqlite", camera)
        fill(filled, camera)
        filled.close()
    return folder


@pytest.fixture
def make(tmp_path: Path, archives: Path) -> Iterator[Make]:
    """Return what builds an application on an archive of its own; `image` is what it finds as the latest one."""
    opened: list[Archive] = []

    def build(
        *,
        image: Path | None = None,
        images: ImageStore | None = None,
        moves: MovePictures | None = None,
        pictures: PictureList | None = None,
        obstructions: ObstructionLearner | None = None,
        token: bool = True,
        history: str = "empty",
        archive: Archive | None = None,
        timezone: str = "UTC",
        is_replay: bool = False,
        **options: Any,  # noqa: ANN401 - of ApiOptions
    ) -> Made:
        if archive is None:
            shutil.copy(archives / f"{history}.sqlite", tmp_path / f"{len(opened)}.sqlite")
            opened.append(open_archive(tmp_path / f"{len(opened)}.sqlite"))
        kept = archive or opened[-1]
        started_at, clock = NOON - timedelta(hours=9), VirtualClock(NOON)
        board = StatusRegistry(version="0.1.0", started_at=started_at, monotonic=clock.monotonic)
        asked: list[str] = []

        def request_refit(reason: str) -> Refit:
            asked.append(reason)
            return kept.refits.request(Refit(id=f"r{len(asked)}", camera="roof", requested_at=NOON, reason=reason))

        if token:
            (tmp_path / "token").write_text(TOKEN + "\n")
            options["token_file"] = tmp_path / "token"
        options.setdefault("allowed_hosts", ("imager",))
        app = create_app(
            archive=kept,
            camera="roof",
            site=SITE,
            status=board.snapshot,
            request_refit=request_refit,
            frame_clock=lambda: NOON,
            latest_image=lambda: image,
            options=ApiOptions(**options),
            images=images,
            timezone=timezone,
            is_replay=is_replay,
            moves=moves,
            pictures=pictures,
            obstructions=obstructions,
        )
        return Made(kept, board, app, Client(app), asked)

    yield build
    for archive in opened:
        archive.close()


def new_archive(path: Path, camera: Camera = LENS) -> Archive:
    """Return an archive that knows the camera and has seen nothing."""
    upgrade(path)
    archive = open_archive(path)
    archive.cameras.save(CameraRecord.at(SITE, name="roof", width=camera.width, height=camera.height))
    archive.epochs.open("roof", at=datetime(2013, 5, 1, tzinfo=UTC), reason="installed")
    return archive


@pytest.fixture
def write_openapi() -> bool:
    """Whether the committed OpenAPI document is to be written anew."""
    return os.environ.get("SUNARC_WRITE_OPENAPI") == "1"


@pytest.fixture
def empty(make: Make) -> Made:
    """Make an application on an archive that has seen nothing."""
    return make()


@pytest.fixture
def made(make: Make, tmp_path: Path) -> Made:
    """Make an application in the middle of a clear day, with a calibration."""
    made = make(image=write_image(tmp_path), history="filled")
    made.board.set_worker(WorkerStatus(name="capture", state="running", heartbeat_age_s=1.0))
    made.board.set_worker(WorkerStatus(name="detect", state="running", heartbeat_age_s=0.5, restarts=1))
    made.board.note(
        camera=CameraStatus(name="roof", connected=True, address="127.0.0.9", model="Test", serial="1"),
        clock=ClockStatus(
            synchronised=True, max_error_s=0.01, last_step_s=-2.5, last_step_at=datetime(2013, 5, 13, 18, tzinfo=UTC)
        ),
        disk=DiskStatus(free_bytes=10**10, images_bytes=10**9, oldest_image_at=datetime(2013, 4, 13, 18, tzinfo=UTC)),
        last_frame_at=NOON,
        last_sighting_at=NOON,
    )
    return made


def fill(archive: Archive, camera: Camera = LENS) -> None:
    """Write a history into an archive."""
    archive.sightings.add(sightings(NOON, camera=camera))
    archive.calibrations.add(document("first", valid_from=NOON - timedelta(days=9), camera=camera))
    archive.calibrations.activate("first")
    refused = document("refused", accepted=False, valid_from=NOON - timedelta(days=2), camera=camera)
    archive.calibrations.add(refused, parent="first")
    archive.calibrations.add(document("second", camera=camera), parent="first")
    archive.calibrations.activate("second")
    for n, degrees in enumerate((40.0, 43.0, None)):
        hour = Housekeeping(
            time=NOON - timedelta(hours=2, minutes=30) + timedelta(hours=n),
            disk_free_bytes=10**10 - n * 10**9,
            images_bytes=10**9,
            temperature_c=degrees,
            temperature_min_c=degrees,
            temperature_max_c=degrees,
            n_temperatures=int(degrees is not None),
        )
        archive.housekeeping.add("roof", [hour])
    for day, verdict in ((11, "cloudy"), (12, "clear")):
        archive.days.save(
            Day(
                camera="roof",
                date=date(2013, 5, day),
                verdict="clear" if verdict == "clear" else "cloudy",
                findings=(Finding("day_share_on_arc", {"share": 0.9, "n_observed": 800}),),
                n=700,
                n_possible=800,
                arc_deg=130.0,
                sd_px=0.05,
                rmsd_px=0.07,
                decided_at=NOON,
            )
        )
    archive.events.add(
        Event(time=NOON, kind="refit_refused", severity="warning", text=NOT_ACCEPTED.text, camera="roof")
    )
    archive.events.add(Event(time=NOON - timedelta(days=1), kind="start", severity="info", text="started"))
