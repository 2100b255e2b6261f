"""Sightings from a CSV file to the archive, which is made where there is none; and back."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TextIO

import numpy as np

from sunarc.archive.archive import Archive, open_archive
from sunarc.archive.csv_files import SightingTable, read_sightings, write_sightings
from sunarc.archive.recovery import upgrade_present
from sunarc.archive.schema import upgrade
from sunarc.archive.values import SunPoint
from sunarc.array_types import picked
from sunarc.calibration.model.sightings import inside_image
from sunarc.errors import InputError
from sunarc.offline.cameras import known_camera, register_camera
from sunarc.offline.files import read_lines, require_inside
from sunarc.settings.model import Settings
from sunarc.sky.directions import angular_distance
from sunarc.sky.night import SUN, body_directions
from sunarc.sky.site import PA_PER_HPA, Site
from sunarc.utc import utc_time

_MOST_APART_DEG = 0.05
"""Of a stated direction from the body's: the refraction of other air and formulas near the horizon."""


def import_points(settings: Settings, path: Path, *, image_size: tuple[int, int] | None = None) -> tuple[int, int, int]:
    """Add a file's sightings to the archive; return how many were new, how many the file has, and how many are outside.

    Those outside the image are left out.

    A database that does not exist is made, an older one is migrated, and a camera that is not known is stored with
    the settings' site; nothing is written before the whole file was found good.

    Parameters
    ----------
    settings : camera name, site and state folder.
    path : the CSV file.
    image_size : width and height in px; from the archive, or from `camera.region`, unless given.

    Raises
    ------
    InputError : a row is wrong, many lie outside the image, the image size is not known, or the archive's camera is
        another one.
    """
    table = read_sightings(read_lines(path), name=path.name)
    size = image_size or _size_in_archive(settings) or _size_in_settings(settings)
    if size is None:
        raise InputError(
            field="--image-size",
            problem=f"missing, and neither the archive nor camera.region has it for camera {settings.name!r}",
            remedy="give the width and height of its images in px, as --image-size 1748,1748",
        )
    require_inside(table.pixels, size, name=path.name)
    total, table = int(table.unix_s.size), picked(table, inside_image(table.pixels, size))
    _require_bodies(table, settings.site, path.name)
    upgrade_present(settings.archive)
    with open_archive(settings.archive) as archive:
        register_camera(archive, settings, size)
        return (
            archive.add_sun_points(_points(archive, settings, table, path.name)),
            total,
            total - int(table.unix_s.size),
        )


def write_points(settings: Settings, target: TextIO, *, since: datetime | None, until: datetime | None) -> int:
    """Write the accepted sightings as CSV and return how many, with the air where it was measured (see `air_of`)."""
    with open_archive(settings.archive) as archive:
        points = archive.sun_points(settings.name, since=since, until=until, accepted=True, body=None)
        placed = [(p, p.x_px, p.y_px) for p in points if p.x_px is not None and p.y_px is not None]
        air = archive.air_of(settings.name, [point for point, _, _ in placed])
    rows = [(p.time, x, y, p.sigma_px, p.body) for p, x, y in placed]
    if all(p.body == SUN for p, _, _ in placed):
        return write_sightings(target, rows, air=air)
    unix_s, body = np.array([p.time.timestamp() for p, _, _ in placed]), np.array([p.body for p, _, _ in placed])
    directions = body_directions(body, unix_s, settings.site, temperature=air[0], pressure=air[1])
    return write_sightings(target, rows, air=air, directions=directions)


def _size_in_archive(settings: Settings) -> tuple[int, int] | None:
    if settings.store is None:
        if not settings.database.is_file() or settings.database.stat().st_size == 0:
            return None
        upgrade(settings.database)
    with open_archive(settings.archive) as archive:
        known = known_camera(archive, settings)
    return None if known is None else known.image_size


def _size_in_settings(settings: Settings) -> tuple[int, int] | None:
    region = None if settings.camera is None else settings.camera.region
    return None if region is None else (region[2], region[3])


def _points(archive: Archive, settings: Settings, table: SightingTable, name: str) -> list[SunPoint]:
    times = [utc_time(t) for t in table.unix_s]
    reason = f"imported from {name}"
    return [
        SunPoint(
            camera=settings.name,
            pose_epoch=archive.epoch_at(settings.name, time, reason=reason).id,
            time=time,
            body=str(body),
            method="import",
            accepted=True,
            verdict="clear",
            reason=reason,
            x_px=float(x),
            y_px=float(y),
            sigma_px=_finite_or_none(sigma),
            temperature_c=_finite_or_none(temperature),
            pressure_hpa=_finite_or_none(pressure / PA_PER_HPA),
        )
        for time, (x, y), sigma, temperature, pressure, body in zip(
            times, table.pixels, table.sigma_px, table.temperature, table.pressure, table.body, strict=True
        )
    ]


def _require_bodies(table: SightingTable, site: Site, name: str) -> None:
    """Raise InputError where a stated direction is not that of the body: the archive has bodies, and no directions."""
    stated = np.isfinite(table.directions[:, 0])
    if not np.any(stated):
        return
    known = body_directions(table.body, table.unix_s, site, temperature=table.temperature, pressure=table.pressure)
    of_body = np.isfinite(known[:, 0])
    unknown = int(np.count_nonzero(stated & ~of_body))
    if unknown:
        raise InputError(
            field=f"{name}, body",
            problem=f"{unknown} sightings state a direction and no star (star:HIP32349) or planet that it belongs to",
            remedy="fit the file itself with sunarc calibrate, or leave these rows out",
        )
    apart_deg = np.degrees(angular_distance(table.directions[stated], known[stated]))
    worst = int(np.argmax(apart_deg))
    if apart_deg[worst] > _MOST_APART_DEG:
        raise InputError(
            field=f"{name}, zenith_deg",
            problem=f"{table.body[stated][worst]} was {apart_deg[worst]:.2f} degrees from the stated direction",
            remedy="correct the time, the direction, the body, or the site in the settings",
        )


def _finite_or_none(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
