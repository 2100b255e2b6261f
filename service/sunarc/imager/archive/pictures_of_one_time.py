"""Pictures of one time in two folders: two cameras, or raw and annotated. They count once, or not at all."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import Connection, Row, select, update

from sunarc.common.findings import Finding
from sunarc.imager.archive.database.tables import sun_point
from sunarc.sky.night import SUN

TWO_PICTURES = "two_pictures_of_one_time"
ELSEWHERE = "elsewhere"
"""Verdict on a clean disc where the sun should not be, as far as the calibration knows."""
_SAME_PX = 1.0
"""Distance of two suns of one image: it was annotated, or compressed anew."""
_NO_PICTURES = ("in_stack", "frozen", "no_frame")
"""Verdicts of rows without a statement about their picture."""


class _Sun(NamedTuple):
    """A sighting with a sun, and its verdict before this rule set it aside."""

    row: Row[Any]
    path: str
    verdict: str
    findings: tuple[Finding, ...]
    """Its own ones, without that of this rule."""

    def distance_px(self, other: _Sun) -> float:
        return math.hypot(self.row.x_px - other.row.x_px, self.row.y_px - other.row.y_px)


def judge_pictures(connection: Connection, camera: str, times: Collection[datetime]) -> dict[str, Finding]:
    """Reject the sightings of images of one time in several folders that must not count twice.

    Where each picture shows the sun, and at the same pixel, the first one's sighting counts, else that of none.

    Parameters
    ----------
    connection : of the transaction in which sightings were stored.
    camera, times : of the sightings.

    Returns
    -------
    The finding of each picture that was set aside, by its path.
    """
    c = sun_point.c
    of_folders = (c.camera == camera, c.body == SUN, c.folder != "", c.verdict.not_in(_NO_PICTURES))
    columns = (c.id, c.time, c.folder, c.file, c.accepted, c.verdict, c.findings, c.x_px, c.y_px)
    sightings = select(*columns).where(*of_folders, c.time.in_(times)).order_by(c.time, c.folder, c.id)
    rows: list[Any] = [*connection.execute(sightings)]
    found: dict[str, Finding] = {}
    for _, of_time in itertools.groupby(rows, key=lambda row: row.time):
        folders: list[list[Row[Any]]] = [
            list(members) for _, members in itertools.groupby(of_time, key=lambda row: row.folder)
        ]
        if len(folders) > 1:
            found |= _judge_folders(connection, folders)
    return found


def _judge_folders(connection: Connection, folders: Sequence[Sequence[Row[Any]]]) -> dict[str, Finding]:
    suns = [[sun for row in rows if (sun := _find_row_sun(row)) is not None] for rows in folders]
    every = [sun for of_folder in suns for sun in of_folder]
    if not every:
        return {}
    agree = all(suns) and all(sun.distance_px(every[0]) <= _SAME_PX for sun in every)
    counts, others = (suns[0], every[len(suns[0]) :]) if agree else ([], every)
    for sun in counts:
        if sun.verdict != sun.row.verdict:  # it was set aside before
            _update_sighting(
                connection, sun, accepted=sun.verdict != ELSEWHERE, verdict=sun.verdict, findings=sun.findings
            )
    found = {}
    for sun in others:
        other = next(path for path in (_make_file_path(rows[0]) for rows in folders) if path != sun.path)
        found[sun.path] = Finding(TWO_PICTURES, {"file": sun.path, "other": other, "verdict": sun.verdict})
        findings = (found[sun.path], *sun.findings)
        _update_sighting(connection, sun, accepted=False, verdict="set_aside", findings=findings)
    return found


def _find_row_sun(row: Row[Any]) -> _Sun | None:
    aside: Mapping[str, Any] = next((one.data for one in row.findings if one.code == TWO_PICTURES), {})
    has_sun = (row.accepted or row.verdict == ELSEWHERE or aside) and row.x_px is not None and row.y_px is not None
    if not has_sun:
        return None
    own = tuple(one for one in row.findings if one.code != TWO_PICTURES)
    return _Sun(row, _make_file_path(row), str(aside.get("verdict", row.verdict)), own)


def _make_file_path(row: Row[Any]) -> str:
    return str(row.file) if row.folder == "." else f"{row.folder}/{row.file}"


def _update_sighting(connection: Connection, sun: _Sun, **values: Any) -> None:  # noqa: ANN401 - of the columns
    c = sun_point.c
    connection.execute(update(sun_point).where(c.id == sun.row.id, c.time == sun.row.time).values(**values))
