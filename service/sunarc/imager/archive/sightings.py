"""Sightings of the service and of image files, in the pose epochs of their cameras."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Mapping
from dataclasses import fields
from datetime import date, datetime, timedelta
from typing import Literal, NamedTuple

from sqlalchemy import BigInteger, ColumnElement, Connection, and_, func, select, text, type_coerce, update

from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.findings import Finding
from sunarc.common.utc import DAY_S
from sunarc.detection.values import Detection
from sunarc.imager.archive.columns import (
    CandidateColumns,
    keep_measured,
    keep_sigma,
    listed,
    read_candidates,
    read_columns,
    read_levels,
    read_times,
)
from sunarc.imager.archive.database.store import Part, given, insert_new, upsert
from sunarc.imager.archive.database.tables import sun_point
from sunarc.imager.archive.epochs import assign_epochs
from sunarc.imager.archive.events import insert_event
from sunarc.imager.archive.pictures_of_one_time import ELSEWHERE, judge_pictures
from sunarc.imager.archive.values import Event, SightingCounts, SunPoint, SunPointColumns, field_values
from sunarc.sky.days import SECONDS_PER_DEGREE, day_bounds_unix_s, solar_date
from sunarc.sky.night import SUN
from sunarc.sources.image_key import ImageKey

SUPERSEDED = (Finding("sighting_superseded"),)
"""Findings of a sighting that was set aside: an image counts once."""
_NOT_NAMED_AGAIN = (Finding("star_not_named_again"),)
FIRST_SIGHTING = "first sighting"
"""Reason of a camera's first pose epoch."""
_STAR = "star"
_KEY = ("camera", "time", "body", "exposure_us", "method", "file", "folder")


class FileSighting(NamedTuple):
    """Archive's record of an image file by one method; `file` is empty where it is not known (version 0.2)."""

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
    folder: str = ""

    @property
    def key(self) -> ImageKey:
        """Return the key that distinguishes the image from others."""
        return ImageKey(self.time_us, self.exposure_us, self.file, self.folder)


def _reject_other_methods(connection: Connection, point: SunPoint) -> None:
    others = (*_same_image_conditions(point), sun_point.c.method != point.method, sun_point.c.accepted.is_(True))
    folders = (point.folder, "")  # that of former sightings is not known (revision 0019)
    change = update(sun_point).where(*others, sun_point.c.folder.in_(folders))
    connection.execute(change.values(accepted=False, verdict="set_aside", findings=SUPERSEDED))


def _set_missing_folder(connection: Connection, point: SunPoint) -> None:
    """Set the folder of former sightings of an image (revision 0019 and before) to that of a new sighting."""
    here = select(sun_point.c.id).where(*_same_image_conditions(point), sun_point.c.folder == point.folder)
    unknown = (*_same_image_conditions(point), sun_point.c.folder == "", sun_point.c.method == point.method)
    connection.execute(update(sun_point).where(*unknown, ~here.exists()).values(folder=point.folder))


def _same_image_conditions(point: SunPoint) -> tuple[ColumnElement[bool], ...]:
    c = sun_point.c
    same_time = (c.camera == point.camera, c.time == point.time, c.body == point.body)
    return *same_time, c.exposure_us == point.exposure_us, c.file == point.file


FROZEN: Literal["frozen"] = "frozen"
"""Verdict on a sighting in an image that the camera had delivered before."""
MOVED = (Finding("camera_had_moved"),)
"""Findings of a sighting that was found elsewhere and accepted once the camera was known to have moved."""


_FIRST_OF_EACH_DAY = text(
    """
    WITH RECURSIVE first(time) AS (
        SELECT min(time) FROM sun_point WHERE camera = :camera AND time >= :since AND body = 'sun'
        UNION ALL
        SELECT (
            SELECT min(time) FROM sun_point
            WHERE camera = :camera AND time >= ((first.time + :ahead) / :day + 1) * :day - :ahead AND body = 'sun'
        )
        FROM first WHERE first.time IS NOT NULL
    )
    SELECT time FROM first WHERE time IS NOT NULL
    """
)
"""One index lookup a day; five years take milliseconds."""


class SightingStore(Part):
    """The sightings: those of the service, and those of image files.

    Sightings whose `pose_epoch` is empty are stored in the one of their time; `first_epoch` is the reason of a camera's
    first one, where they open it.
    """

    def file_sightings(self, camera: str, *, times_us: Container[int]) -> list[FileSighting]:
        """Return the stored sightings of the sun at the given times, microseconds since 1970-01-01 UTC."""
        c = sun_point.c
        names = [name for name in FileSighting._fields if name != "time_us"]
        rows = select(type_coerce(c.time, BigInteger), *(c[name] for name in names)).where(
            c.camera == camera, c.body == "sun"
        )
        with self._database.reading() as connection:
            return [FileSighting(*row) for row in connection.execute(rows.order_by(c.id)) if row[0] in times_us]

    def rename_files(self, camera: str, renamed: Mapping[ImageKey, ImageKey]) -> None:
        """Give sightings of the sun in image files the names and folders of other keys."""
        with self._database.writing() as connection:
            for former, new in renamed.items():
                change = update(sun_point).where(*_image_conditions(camera, former))
                connection.execute(change.values(file=new.file, folder=new.folder))

    def replace(self, points: Iterable[SunPoint], *, first_epoch: str = FIRST_SIGHTING) -> dict[str, Finding]:
        """Store sightings of image files; one that is there already (see the key) is replaced, and keeps its id.

        Where one is accepted, sightings of the same image by other methods are set aside: an image counts once. So are
        those of the other images of its stack, which are among the points.

        Returns
        -------
        What was set aside of pictures of one time in several folders, by their paths; see `judge_pictures`.
        """
        kept, aside = tuple(points), dict[str, Finding]()
        stacked = {point.time for point in kept if point.accepted}
        c = sun_point.c
        self._database.prepare_months([point.time for point in kept])
        with self._database.writing() as connection:
            for camera in {point.camera for point in kept}:
                times = [point.time for point in kept if point.camera == camera]
                keep_measured(connection, camera, (c.camera == camera, c.time.between(min(times), max(times))))
            for point in assign_epochs(connection, kept, first_epoch):
                if point.folder:
                    _set_missing_folder(connection, point)
                upsert(connection, sun_point, field_values(point), key=_KEY)
                if point.accepted or (point.verdict == "in_stack" and point.time in stacked):
                    _reject_other_methods(connection, point)
            for camera in {point.camera for point in kept if point.folder}:
                of_folders = {point.time for point in kept if point.camera == camera and point.folder}
                aside |= judge_pictures(connection, camera, of_folders)
        return aside

    def replace_stars(self, camera: str, points: Iterable[SunPoint]) -> int:
        """Store the stars of images that were read again, and return how many sightings are new.

        Former sightings of stars in these images that are not among them are set aside; those of other images stay.
        """
        named = tuple(points)
        self._database.prepare_months([point.time for point in named])
        c = sun_point.c
        of_images = (c.camera == camera, c.method == _STAR, c.time.in_({point.time for point in named}))
        count = select(func.count()).where(*of_images)
        aside = update(sun_point).where(*of_images, c.accepted.is_(True))
        with self._database.writing() as connection:
            keep_measured(connection, camera, of_images)
            before = int(connection.scalar(count) or 0)
            connection.execute(aside.values(accepted=False, verdict="set_aside", findings=_NOT_NAMED_AGAIN))
            for point in assign_epochs(connection, named, FIRST_SIGHTING):
                upsert(connection, sun_point, field_values(point), key=_KEY)
            return int(connection.scalar(count) or 0) - before

    def mark_predicted(self, camera: str, keys: Iterable[ImageKey], *, ingest_pass: int) -> None:
        """Set the `ingest_pass` of the sightings of image files."""
        with self._database.writing() as connection:
            for key in keys:
                change = update(sun_point).where(*_image_conditions(camera, key))
                connection.execute(change.values(ingest_pass=ingest_pass))

    def file_methods(self, camera: str) -> tuple[str, ...]:
        """Return the methods by which the sun was found in image files."""
        c = sun_point.c
        methods = select(c.method).distinct().where(c.camera == camera, c.file != "", c.x_px.is_not(None))
        with self._database.reading() as connection:
            return tuple(connection.scalars(methods.order_by(c.method)))

    def scale_sigma(self, camera: str, *, method: str, factor: float, event: Event) -> int:
        """Multiply the stated sigma of a method's sightings of image files, and return how many there are.

        Calibrations that rest on them keep the sigma that they were given, so that they can be solved again. The event
        is stored with it: both are, or neither is.
        """
        c = sun_point.c
        of_series = and_(c.camera == camera, c.method == method, c.file != "", c.sigma_px.is_not(None))
        with self._database.writing() as connection:
            keep_sigma(connection, camera)
            insert_event(connection, event)
            return connection.execute(update(sun_point).where(of_series).values(sigma_px=c.sigma_px * factor)).rowcount

    def exclude(self, camera: str, why: Finding, *, since: datetime, until: datetime | None = None) -> int:
        """Leave accepted sightings with `since` <= time < `until` out of every fit, and return how many."""
        c = sun_point.c
        filters = given((c.camera.__eq__, camera), (c.time.__ge__, since), (c.time.__lt__, until))
        change = update(sun_point).where(*filters, c.accepted.is_(True))
        with self._database.writing() as connection:
            return connection.execute(change.values(accepted=False, verdict="set_aside", findings=(why,))).rowcount

    def readmit(self, camera: str, *, since: datetime, until: datetime | None = None) -> int:
        """Accept the discs seen elsewhere with `since` <= time < `until`, and return how many: the camera has moved."""
        c = sun_point.c
        filters = given((c.camera.__eq__, camera), (c.time.__ge__, since), (c.time.__lt__, until))
        filters += [c.verdict == ELSEWHERE, c.x_px.is_not(None), c.y_px.is_not(None)]
        with self._database.writing() as connection:
            change = update(sun_point).where(*filters).values(accepted=True, verdict="clear", findings=MOVED)
            return connection.execute(change).rowcount

    def add(self, points: Iterable[SunPoint], *, first_epoch: str = FIRST_SIGHTING) -> int:
        """Store sightings and return how many were new; one that is there already is left as it is."""
        new = tuple(points)
        if not new:
            return 0
        self._database.prepare_months([point.time for point in new])
        with self._database.writing() as connection:
            rows = [field_values(point) for point in assign_epochs(connection, new, first_epoch)]
            return insert_new(connection, sun_point, rows)

    def widen_clock_errors(self, camera: str, *, since: datetime, until: datetime, error_s: float) -> int:
        """Widen the bound of the clock's error of sightings with `since` <= time <= `until`; return how many."""
        c = sun_point.c
        doubted = [c.camera == camera, c.time >= since, c.time <= until, func.coalesce(c.clock_error_s, 0.0) < error_s]
        with self._database.writing() as connection:
            keep_measured(connection, camera, doubted)
            return connection.execute(update(sun_point).where(*doubted).values(clock_error_s=error_s)).rowcount

    def find(
        self,
        camera: str,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        accepted: bool | None = None,
        pose_epoch: str | None = None,
        body: str | None = SUN,
        ingest_pass: int | None = None,
        largest_clock_error_s: float | None = None,
        newest_first: bool = False,
        limit: int | None = None,
    ) -> tuple[SunPoint, ...]:
        """Return sightings with `since` <= time < `until`, in the order of their times; None does not filter.

        Of the sun unless another `body` is named.
        """
        c = sun_point.c
        filters = _make_filters(camera, since=since, until=until, accepted=accepted, pose_epoch=pose_epoch)
        filters += [*_clock_error_condition(largest_clock_error_s)]
        filters += given((c.body.__eq__, body), (c.ingest_pass.__eq__, ingest_pass))
        fields = [column for column in c if column.name != "id"]
        order = (c.time.desc(), c.id.desc()) if newest_first else (c.time, c.id)
        return self._database.records(select(*fields).where(*filters).order_by(*order).limit(limit), SunPoint)

    def columns(
        self,
        camera: str,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        pose_epoch: str | None = None,
        method: str | None = None,
        body: str | None = SUN,
        no_sun: bool = False,
        file_sightings: bool = False,
        largest_clock_error_s: float | None = None,
        after_id: int | None = None,
    ) -> SunPointColumns:
        """Return the accepted sightings with `since` <= time < `until` as columns, for a fit; None does not filter.

        With `no_sun` only those of other bodies, with `file_sightings` only those in image files, with `after_id` those
        stored since the one of that key.
        """
        c = sun_point.c
        # no column, so that SQLite finds the few new rows by their keys, and does not read all of the camera by theirs
        of_camera = c.camera.__eq__ if after_id is None else c.camera.concat("").__eq__
        filters = _make_filters(None, since=since, until=until, accepted=True, pose_epoch=pose_epoch)
        filters += [of_camera(camera), *_clock_error_condition(largest_clock_error_s)]
        filters += given(
            (c.body.__eq__, body), (c.method.__eq__, method), (c.file.__ne__, "" if file_sightings else None)
        )
        filters += given((c.id.__gt__, after_id), (c.body.__ne__, SUN if no_sun else None))
        with self._database.reading() as connection:
            return read_columns(connection, camera, filters, others=body != SUN)

    def candidates(
        self, camera: str, *, since: datetime | None = None, until: datetime | None = None
    ) -> CandidateColumns:
        """Return the columns by which a fit selects from the accepted sightings of the sun; see `by_ids`."""
        with self._database.reading() as connection:
            return read_candidates(connection, camera, _make_filters(camera, since=since, until=until, accepted=True))

    def by_ids(self, camera: str, ids: IntArray) -> SunPointColumns:
        """Return the sightings of a camera with these keys, in the order of time; without those that are gone."""
        with self._database.reading() as connection:
            return read_columns(connection, camera, [listed(connection, ids)])

    def newest_time(self, camera: str, *, largest_clock_error_s: float) -> datetime | None:
        """Return the time of the newest sighting whose clock error bound is within a limit; None without one."""
        c = sun_point.c
        newest = select(c.time).where(c.camera == camera, *_clock_error_condition(largest_clock_error_s))
        with self._database.reading() as connection:
            return connection.scalar(newest.order_by(c.time.desc()).limit(1))

    def exposure_times(
        self, camera: str, *, since: datetime, until: datetime, largest_clock_error_s: float | None = None
    ) -> FloatArray | None:
        """Return when sun exposures were taken, with a sighting or without, s since 1970-01-01 UTC (n,).

        None where sightings were imported: a file of sightings does not tell when there was an exposure without one.
        Exposures whose clock may be wrong by more than `largest_clock_error_s` are left out, and images that the camera
        had delivered before (`FROZEN`): they show another moment's sky.
        """
        c = sun_point.c
        filters = [*_make_filters(camera, since=since, until=until), *_clock_error_condition(largest_clock_error_s)]
        filters += [c.body == SUN, c.verdict != FROZEN]
        with self._database.reading() as connection:
            imported = select(c.id).where(*filters, c.method == "import").limit(1)
            if connection.scalar(imported) is not None:
                return None
            return read_times(connection, filters)

    def sun_levels(
        self, camera: str, *, since: datetime, until: datetime, largest_clock_error_s: float | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the accepted discs' times (unix seconds) and levels over full scale in 1 µs, background subtracted.

        A saturated disc's level is what the fit made of its edges; above 100 times full scale it counts as that.
        """
        c = sun_point.c
        filters = _make_filters(camera, since=since, until=until, accepted=True) + _clock_error_condition(
            largest_clock_error_s
        )
        filters += [c.method == "disc", c.body == SUN]
        with self._database.reading() as connection:
            return read_levels(connection, filters)

    def dates(self, camera: str, *, longitude: float, since: date | None = None) -> tuple[date, ...]:
        """Return the solar dates (from `since` on) with sightings of the sun, accepted or not."""
        values = {
            "camera": camera,
            "since": 0 if since is None else round(1e6 * day_bounds_unix_s(since, longitude=longitude)[0]),
            "day": round(1e6 * DAY_S),
            "ahead": round(1e6 * longitude * SECONDS_PER_DEGREE),
        }
        with self._database.reading() as connection:
            times = connection.scalars(_FIRST_OF_EACH_DAY, values).all()
        return tuple(solar_date(time / 1e6, longitude=longitude) for time in times)

    def count(self, camera: str, *, since: datetime, until: datetime) -> Mapping[str, int]:
        """Return how many sightings with `since` <= time < `until` have each verdict."""
        c = sun_point.c
        return self._database.counts(
            select(c.verdict, func.count()).where(c.camera == camera, c.time >= since, c.time < until), c.verdict
        )

    def count_accepted_suns(self, camera: str) -> int:
        """Return the number of accepted sightings of the sun."""
        c = sun_point.c
        of_sun = (c.camera == camera, c.body == SUN, c.accepted.is_(True))
        with self._database.reading() as connection:
            return connection.scalar(select(func.count()).select_from(sun_point).where(*of_sun)) or 0

    def by_day(self, camera: str, *, longitude: float, since: date, until: date) -> tuple[SightingCounts, ...]:
        """Return the counts of sightings of the sun on solar dates with `since` <= date < `until`, the newest first."""
        c, ahead = sun_point.c, round(1e6 * longitude * SECONDS_PER_DEGREE)
        begin, end = (round(1e6 * day_bounds_unix_s(one, longitude=longitude)[0]) for one in (since, until))
        time = type_coerce(c.time, BigInteger)
        number = ((time + ahead) // round(1e6 * DAY_S)).label("day")
        counts = select(number, c.verdict, c.accepted, func.count(), func.max(c.clock_error_s))
        of_days = counts.where(c.camera == camera, c.body == SUN, time >= begin, time < end)
        with self._database.reading() as connection:
            rows = connection.execute(of_days.group_by(number, c.verdict, c.accepted)).all()
        by_day: dict[int, list[tuple[str, bool, int, float | None]]] = {}
        for day_number, *row in rows:
            by_day.setdefault(int(day_number), []).append((row[0], row[1], row[2], row[3]))
        return tuple(_make_day_counts(one, by_day[one]) for one in sorted(by_day, reverse=True))


def _image_conditions(camera: str, key: ImageKey) -> tuple[ColumnElement[bool], ...]:
    """Return the conditions that a row is of the sun in an image."""
    c = sun_point.c
    same_time = (type_coerce(c.time, BigInteger) == key.time_us, c.exposure_us == key.exposure_us)
    return c.camera == camera, *same_time, c.file == key.file, c.folder == key.folder, c.body == SUN


def _make_day_counts(day: int, rows: list[tuple[str, bool, int, float | None]]) -> SightingCounts:
    verdicts: Counter[str] = Counter()
    for verdict, _, count, _ in rows:
        verdicts[verdict] += count
    return SightingCounts(
        date=date(1970, 1, 1) + timedelta(days=day),
        verdicts=dict(sorted(verdicts.items())),
        accepted=sum(count for _, accepted, count, _ in rows if accepted),
        clock_error_s=max((error for *_, error in rows if error is not None), default=None),
    )


def _make_filters(
    camera: str | None,
    *,
    since: datetime | None = None,
    until: datetime | None = None,
    accepted: bool | None = None,
    pose_epoch: str | None = None,
) -> list[ColumnElement[bool]]:
    c = sun_point.c
    return given(
        (c.camera.__eq__, camera),
        (c.time.__ge__, since),
        (c.time.__lt__, until),
        (c.accepted.__eq__, accepted),
        (c.pose_epoch.__eq__, pose_epoch),
    )


def _clock_error_condition(largest_s: float | None) -> list[ColumnElement[bool]]:
    """Return the condition that a sighting's clock error bound, where one is known, is within a limit."""
    return [] if largest_s is None else [func.coalesce(sun_point.c.clock_error_s, 0.0) <= largest_s]


_SHARED = {field.name for field in fields(SunPoint)} & {field.name for field in fields(Detection)} - {"exposure_us"}
"""Columns that both have under the same name; the exposure of a detection may be unknown."""


def make_sun_point(
    detection: Detection,
    *,
    camera: str,
    pose_epoch: str,
    time: datetime,
    exposure_us: float = 0.0,
    clock_error_s: float | None = None,
    file: str = "",
    folder: str = "",
    ingest_pass: int | None = None,
) -> SunPoint:
    """Return the sighting that a detection amounts to, accepted or not."""
    return SunPoint(
        camera=camera,
        pose_epoch=pose_epoch,
        time=time,
        exposure_us=exposure_us,
        clock_error_s=clock_error_s,
        file=file,
        folder=folder,
        ingest_pass=ingest_pass,
        **{name: getattr(detection, name) for name in _SHARED},
    )
