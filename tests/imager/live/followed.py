"""A service that follows a folder, in virtual time: its worker is turned by hand. A calibration for such a service."""

from __future__ import annotations

import os
from datetime import datetime
from pathlib import Path

import numpy as np
from tests.fixtures.settings import new_settings
from tests.imager.live.sky_pictures import Lens, sun_at

from sunarc.archives.ingest import ingest_followed
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.sightings import Sightings
from sunarc.formats.calibration_document import to_document
from sunarc.imager.app.service import Service
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.values import SunPoint
from sunarc.imager.live.folder_worker import FolderWorker
from sunarc.imager.runtime.clock import VirtualClock


def never() -> object:
    raise AssertionError("no camera is opened")


class Followed:
    """The service of a folder below `base`, from a moment on; another one of the same base is its next start."""

    def __init__(self, base: Path, start: datetime, **options: object) -> None:
        self.root = base / "images"
        self.root.mkdir(exist_ok=True)
        chosen = {"path": self.root, "utc_offset": "0", "polling": True, "settle_s": 1.0, **options}
        speed = chosen.pop("speed", 1.0)
        settings = new_settings(base, source="folder", folder=chosen, capture={"speed": speed})
        upgrade(settings.database)
        self.clock = VirtualClock(start)
        self.service = Service(
            settings,
            archive=open_archive(settings.archive),
            clock=self.clock,
            open_camera=never,  # type: ignore[arg-type]
            folder_analysis=ingest_followed,
        )

    @property
    def worker(self) -> FolderWorker:
        assert self.service.folder is not None
        return self.service.folder

    def write(self, name: str, content: bytes) -> Path:
        """Write a file as another program does, at this moment."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        now = self.clock.now().timestamp()
        os.utime(path, (now, now))
        return path

    def turn(self) -> None:
        """List, let settle, and look at all that came."""
        self.worker.list_new()
        for _ in range(2):
            self.clock.advance(1.5)
            while self.worker.work():
                pass

    def points(self) -> tuple[SunPoint, ...]:
        return self.service.archive.sightings.find("roof")

    def verdicts(self) -> list[str]:
        return [point.verdict for point in self.points()]

    def codes(self) -> set[str]:
        return {reason.code for reason in self.service.board.snapshot().reasons}

    def close(self) -> None:
        self.service.archive.close()


def serve_calibration_of(service: Service, lens: Lens, day: datetime) -> None:
    """Have a service serve what a day's sightings say of a lens, in the present pose epoch.

    Parameters
    ----------
    day : its morning.
    """
    suns = {day.timestamp() + 300.0 * n: sun_at(datetime.fromtimestamp(day.timestamp() + 300.0 * n, day.tzinfo))
            for n in range(100)}  # fmt: skip
    up = {at: sun for at, sun in suns.items() if sun[0] < 82.0}
    noise = np.random.default_rng(1).normal(0.0, 0.1, (len(up), 2))
    points = Sightings.of(unix_s=np.array(list(up)), pixels=np.array([lens.pixel(*sun) for sun in up.values()]) + noise)
    (epoch,) = service.archive.epochs.find("roof")
    document = to_document(
        calibrate(points, site=service.settings.site, image_size=(lens.size, lens.size)),
        id="full",
        camera="roof",
        state="candidate",
        created_at=service.clock.now(),
        valid_from=epoch.started_at,
        valid_until=None,
        pose_epoch=epoch.id,
        software_version="1",
    )
    service.archive.calibrations.activate(service.archive.calibrations.add(document).id)
