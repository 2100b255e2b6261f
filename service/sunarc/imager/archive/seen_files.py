"""The image files of a followed folder that were seen, so that a restart forgets none and takes none twice."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import delete, func, or_, select

from sunarc.imager.archive.database.store import Part, given, read_records, upsert
from sunarc.imager.archive.database.tables import seen_file
from sunarc.imager.archive.values import field_values

_AT_ONCE = 500
"""Names in one statement: SQLite takes some thousand parameters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenFile:
    """A file that was seen.

    Attributes
    ----------
    camera, file : whose, and its path below the folder.
    stamp : its size and the time of its last change: another one is a file that was written over.
    content : hash of its bytes; None where it was not read.
    time : of its image, aware; None where nothing states it.
    code : of the finding why it was left out; None for a file that was read.
    """

    camera: str
    file: str
    stamp: str
    content: str | None = None
    time: datetime | None = None
    code: str | None = None


class SeenFileStore(Part):
    """Which files were seen."""

    def stamps(self, camera: str) -> Mapping[str, str]:
        """Return the stamp of each file that was seen, by its path below the folder."""
        c = seen_file.c
        with self._database.reading() as connection:
            rows = connection.execute(select(c.file, c.stamp).where(c.camera == camera))
            return {row.file: row.stamp for row in rows}

    def newest(self, camera: str, *, limit: int) -> tuple[SeenFile, ...]:
        """Return the files with the newest images, the newest first."""
        c = seen_file.c
        dated = select(seen_file).where(c.camera == camera, c.time.is_not(None)).order_by(c.time.desc()).limit(limit)
        with self._database.reading() as connection:
            return read_records(connection, dated, SeenFile)

    def used(self, camera: str, *, since: datetime | None, until: datetime | None, limit: int) -> tuple[SeenFile, ...]:
        """Return the files that were read with since <= time < until of their image, the newest first."""
        c = seen_file.c
        filters = given((c.time.__ge__, since), (c.time.__lt__, until))
        dated = select(seen_file).where(c.camera == camera, c.time.is_not(None), c.code.is_(None), *filters)
        with self._database.reading() as connection:
            return read_records(connection, dated.order_by(c.time.desc(), c.file).limit(limit), SeenFile)

    def at(self, camera: str, time: datetime) -> tuple[SeenFile, ...]:
        """Return the files with an image of a moment, by name."""
        c = seen_file.c
        with self._database.reading() as connection:
            found = select(seen_file).where(c.camera == camera, c.time == time).order_by(c.file)
            return read_records(connection, found, SeenFile)

    def refused(self, camera: str) -> Mapping[str, int]:
        """Return how many files were left out, by the code of the finding why."""
        c = seen_file.c
        counted = select(c.code, func.count()).where(c.camera == camera, c.code.is_not(None))
        return self._database.counts(counted, c.code)

    def left_out(self, camera: str, codes: Collection[str]) -> Mapping[str, str]:
        """Return the code of each file that was left out for one of some reasons, by its path below the folder."""
        c = seen_file.c
        with self._database.reading() as connection:
            rows = connection.execute(select(c.file, c.code).where(c.camera == camera, c.code.in_(list(codes))))
            return {row.file: row.code for row in rows}

    def add(self, files: Iterable[SeenFile]) -> None:
        """Store files as seen, each in place of its former record."""
        with self._database.writing() as connection:
            for one in files:
                upsert(connection, seen_file, field_values(one), key=["camera", "file"])

    def forget(self, camera: str, files: Collection[str], *, before: datetime) -> None:
        """Forget files that are gone from the folder, but for those with an image since `before`."""
        names = list(files)
        c = seen_file.c
        with self._database.writing() as connection:
            for first in range(0, len(names), _AT_ONCE):
                some = names[first : first + _AT_ONCE]
                connection.execute(
                    delete(seen_file).where(
                        c.camera == camera, c.file.in_(some), or_(c.time.is_(None), c.time < before)
                    )
                )
