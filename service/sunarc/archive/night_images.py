"""What was measured in the images of the present night, so that a restart does not lose it."""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Literal

from sqlalchemy import delete, func, select, update

from sunarc.archive.days_and_events import insert_event
from sunarc.archive.rows import upsert
from sunarc.archive.store import Store
from sunarc.archive.tables import night_image
from sunarc.archive.values import Event

_log = logging.getLogger(__name__)

NightImageKind = Literal["stars", "moon"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NightImage:
    """An image of the night without its pixels.

    Attributes
    ----------
    time, kind : middle of the exposure; whether its stars or its moon were looked for.
    exposure_us, gain_db, pixel_format, full_scale, binning : of the frame.
    width, height : of the frame, px.
    serial : of the camera.
    clock_error_s : bound of the error of `time` when the image was taken, seconds.
    halo : light about the bright stars; None without.
    digest : checksum of the frame's counts.
    n_repeated : frames of the night until then that were the one before once more.
    measured : arrays in NumPy's npz.
    picture : JPEG of the best image until then; None where a former one is better.
    """

    time: datetime
    kind: NightImageKind
    exposure_us: float
    gain_db: float
    pixel_format: str
    full_scale: int
    width: int
    height: int
    binning: int
    serial: str
    clock_error_s: float
    measured: bytes
    halo: float | None = None
    digest: int = 0
    n_repeated: int = 0
    picture: bytes | None = None


_COLUMNS = [column for column in night_image.c if column.name not in {"camera", "n_tries"}]


class NightImages(Store):
    """The part of the archive with the images of nights that have no verdict yet."""

    def add_night_image(self, camera: str, image: NightImage, *, keep_since: datetime) -> None:
        """Store an image of the night, and remove those of its kind from before `keep_since`."""
        c = night_image.c
        row = {"camera": camera, "n_tries": 0, **asdict(image)}
        with self._writing(camera=camera) as connection:
            upsert(connection, night_image, row, key=["camera", "time", "kind"])
            connection.execute(delete(night_image).where(c.camera == camera, c.kind == image.kind, c.time < keep_since))

    def night_images(self, camera: str) -> tuple[NightImage, ...]:
        """Return the images of a camera's nights without a verdict, the oldest first."""
        c = night_image.c
        return self._values(select(*_COLUMNS).where(c.camera == camera).order_by(c.time, c.kind), NightImage)

    def begin_night_verdict(self, camera: str) -> int:
        """Count that the verdict of the stored images is begun, and return how often it was, this time included."""
        c = night_image.c
        with self._writing(camera=camera) as connection:
            connection.execute(update(night_image).where(c.camera == camera).values(n_tries=c.n_tries + 1))
            tries = select(func.max(c.n_tries)).where(c.camera == camera)
            return int(connection.scalar(tries) or 0)

    def finish_night(self, camera: str, event: Event | None) -> None:
        """Store the event of a night's verdict and remove the night's images: both are done, or neither is."""
        with self._writing() as connection:
            stored = None if event is None else insert_event(connection, event)
            connection.execute(delete(night_image).where(night_image.c.camera == camera))
        if stored is not None:
            _log.info("%s: %s", stored.kind, stored.text, extra={"event_id": stored.id, "event_kind": stored.kind})
