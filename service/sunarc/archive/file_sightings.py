"""Sightings of image files: which files are known, and answers that take the place of former ones."""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import asdict
from datetime import datetime
from typing import NamedTuple

from sqlalchemy import BigInteger, Connection, and_, func, select, type_coerce, update

from sunarc.archive.calibration_inputs import keep_sigma
from sunarc.archive.days_and_events import insert_event
from sunarc.archive.rows import upsert
from sunarc.archive.store import Store
from sunarc.archive.tables import sun_point
from sunarc.archive.values import Event, SunPoint
from sunarc.utc import to_microseconds

SUPERSEDED = "another method's sighting of the same image is accepted"
"""Reason of a sighting that was set aside: an image counts once."""
NOT_NAMED_AGAIN = "not named when its image was looked at again"
"""Reason of a star's sighting that was set aside."""
_STAR = "star"
ImageKey = tuple[int, float, str]
"""Time (microseconds since 1970-01-01 UTC), exposure (us, 0 where not known) and file name of an image."""
_KEY = ("camera", "time", "body", "exposure_us", "method", "file")


class FileSighting(NamedTuple):
    """What the archive holds of an image file by one method; `file` is empty where it is not known (version 0.2)."""

    time_us: int
    exposure_us: float
    file: str
    method: str
    accepted: bool
    verdict: str
    ingest_pass: int | None
    x_px: float | None = None
    y_px: float | None = None
    sigma_px: float | None = None
    radius_px: float | None = None

    @property
    def key(self) -> ImageKey:
        """What tells the image from others."""
        return self.time_us, self.exposure_us, self.file


class FileSightings(Store):
    """The part of the archive with the sightings of image files."""

    def file_sightings(self, camera: str, *, times_us: Container[int]) -> list[FileSighting]:
        """Return what is stored of the sun at the given times, microseconds since 1970-01-01 UTC."""
        c = sun_point.c
        names = [name for name in FileSighting._fields if name != "time_us"]
        rows = select(type_coerce(c.time, BigInteger), *(c[name] for name in names)).where(
            c.camera == camera, c.body == "sun"
        )
        with self._reading() as connection:
            return [FileSighting(*row) for row in connection.execute(rows.order_by(c.id)) if row[0] in times_us]

    def name_files(self, camera: str, keys: Iterable[ImageKey]) -> None:
        """Give sightings that have no file name, of the keys' times and exposures, the names in the keys."""
        c = sun_point.c
        with self._writing() as connection:
            for time_us, exposure_us, file in keys:
                unnamed = (c.camera == camera, type_coerce(c.time, BigInteger) == time_us, c.file == "")
                change = update(sun_point).where(*unnamed, c.exposure_us == exposure_us, c.body == "sun")
                connection.execute(change.values(file=file))

    def replace_sun_points(self, points: Iterable[SunPoint]) -> None:
        """Store sightings of image files; one that is there already (see the key) is replaced, and keeps its id.

        Where one is accepted, sightings of the same image by other methods are set aside: an image counts once. So are
        those of the other images of its stack, which are among the points.
        """
        kept = tuple(points)
        stacked = {point.time for point in kept if point.accepted}
        self._prepare_months([point.time for point in kept])
        with self._writing() as connection:
            for point in kept:
                upsert(connection, sun_point, asdict(point), key=_KEY)
                if point.accepted or (point.verdict == "in_stack" and point.time in stacked):
                    _set_others_aside(connection, point)

    def replace_stars(self, camera: str, points: Iterable[SunPoint]) -> int:
        """Store the stars of images that were looked at again, and return how many sightings are new.

        Former sightings of stars in these images that are not among them are set aside; those of other images stay.
        """
        named = tuple(points)
        self._prepare_months([point.time for point in named])
        c = sun_point.c
        of_images = (c.camera == camera, c.method == _STAR, c.time.in_({point.time for point in named}))
        count = select(func.count()).where(*of_images)
        aside = update(sun_point).where(*of_images, c.accepted.is_(True))
        with self._writing() as connection:
            before = int(connection.scalar(count) or 0)
            connection.execute(aside.values(accepted=False, verdict="set_aside", reason=NOT_NAMED_AGAIN))
            for point in named:
                upsert(connection, sun_point, asdict(point), key=_KEY)
            return int(connection.scalar(count) or 0) - before

    def mark_predicted(self, camera: str, keys: Iterable[ImageKey], *, ingest_pass: int) -> None:
        """Set the `ingest_pass` of the sightings of image files."""
        c = sun_point.c
        with self._writing() as connection:
            for time_us, exposure_us, file in keys:
                same = (c.camera == camera, type_coerce(c.time, BigInteger) == time_us, c.file == file, c.body == "sun")
                change = update(sun_point).where(*same, c.exposure_us == exposure_us)
                connection.execute(change.values(ingest_pass=ingest_pass))

    def methods_of_files(self, camera: str) -> tuple[str, ...]:
        """Return the methods by which the sun was found in image files."""
        c = sun_point.c
        methods = select(c.method).distinct().where(c.camera == camera, c.file != "", c.x_px.is_not(None))
        with self._reading() as connection:
            return tuple(connection.scalars(methods.order_by(c.method)))

    def scale_sigma(self, camera: str, *, method: str, factor: float, event: Event) -> int:
        """Multiply the stated sigma of a method's sightings of image files, and return how many there are.

        Calibrations that rest on them keep the sigma that they were given, so that they can be solved again. The event
        is stored with it: both are, or neither is.
        """
        c = sun_point.c
        of_series = and_(c.camera == camera, c.method == method, c.file != "", c.sigma_px.is_not(None))
        with self._writing() as connection:
            keep_sigma(connection, camera)
            insert_event(connection, event)
            return connection.execute(update(sun_point).where(of_series).values(sigma_px=c.sigma_px * factor)).rowcount


def _set_others_aside(connection: Connection, point: SunPoint) -> None:
    c = sun_point.c
    same_image = (c.camera == point.camera, c.time == point.time, c.body == point.body, c.file == point.file)
    others = (c.exposure_us == point.exposure_us, c.method != point.method, c.accepted.is_(True))
    change = update(sun_point).where(*same_image, *others)
    connection.execute(change.values(accepted=False, verdict="set_aside", reason=SUPERSEDED))


def image_key(time: datetime, exposure_us: float | None, file: str) -> ImageKey:
    """Return the key of an image that was not looked at yet."""
    return to_microseconds(time), exposure_us or 0.0, file
