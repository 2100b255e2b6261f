"""Cameras that are known, and where they stand."""

from __future__ import annotations

import numpy as np
from sqlalchemy import select

from sunarc.common.errors import InputError
from sunarc.imager.archive.database import tables
from sunarc.imager.archive.database.store import Database, Part, upsert
from sunarc.imager.archive.values import CameraRecord, field_values
from sunarc.sky.site import Site

_EARTH_RADIUS_M = 6_371_000.0
SITE_LIMIT_M = 500.0
"""A site that is wrong by this much turns the sun by 0.0045 degrees, about the best accuracy that is stated."""


def require_same_site(record: CameraRecord, site: Site) -> None:
    """Raise `InputError` when the settings name another site than the archive has for the camera.

    Its sightings, poses and calibrations are directions of the sun at the stored site; at another one the same camera
    would seem to have been turned.
    """
    distance = distance_m(record.site, site)
    if distance > SITE_LIMIT_M:
        raise InputError(
            field="site",
            problem=f"latitude {site.latitude:g}, longitude {site.longitude:g} is {distance / 1e3:.1f} km from "
            f"{record.latitude:g}, {record.longitude:g}, where the archive has camera {record.name!r} "
            f"(limit {SITE_LIMIT_M / 1e3:g} km)",
            remedy="correct [site]; or, at a new site, set `name` to a new one (or `state` to an empty folder)",
        )


def distance_m(first: Site, second: Site) -> float:
    """Return the great-circle distance of two places in metres (haversine, a sphere)."""
    a, b = np.radians([first.latitude, second.latitude])
    east = np.radians(second.longitude - first.longitude)
    # The haversine stays exact for near places, where the cosine rule loses all its digits.
    square = np.sin((b - a) / 2.0) ** 2 + np.cos(a) * np.cos(b) * np.sin(east / 2.0) ** 2
    return float(2.0 * _EARTH_RADIUS_M * np.arcsin(np.sqrt(min(square, 1.0))))


class CameraStore(Part):
    """The cameras that are known."""

    def __init__(self, database: Database) -> None:
        super().__init__(database)
        self._saved: dict[str, CameraRecord] = {}

    def save(self, record: CameraRecord) -> None:
        """Save a camera, in place of the stored one of the same name."""
        with self._database.writing() as connection:
            upsert(connection, tables.camera, field_values(record), key=["name"])
        self._saved = {**self._saved, record.name: record}

    def saved(self) -> tuple[CameraRecord, ...]:
        """Return the cameras that this object has stored."""
        return tuple(self._saved.values())

    def all(self) -> tuple[CameraRecord, ...]:
        """Return the known cameras by name."""
        return self._database.records(select(tables.camera).order_by(tables.camera.c.name), CameraRecord)

    def get(self, name: str) -> CameraRecord | None:
        """Return the camera of a name; None where it is not known."""
        return next(
            iter(self._database.records(select(tables.camera).where(tables.camera.c.name == name), CameraRecord)), None
        )
