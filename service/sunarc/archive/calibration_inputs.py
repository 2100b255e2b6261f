"""Sightings that a calibration was fitted to, so that it can be reproduced years later."""

from __future__ import annotations

import hashlib
import zlib
from contextlib import suppress
from dataclasses import replace

import numpy as np
from sqlalchemy import Connection, insert, select, update

from sunarc.archive.columns import listed, read_columns
from sunarc.archive.store import Store
from sunarc.archive.tables import calibration, used_sightings
from sunarc.archive.values import SunPointColumns
from sunarc.array_types import FloatArray, IntArray
from sunarc.errors import InputError, NotFoundError


class UsedSightings(Store):
    """The part of the archive with the inputs of calibrations."""

    def sightings_of(self, calibration_id: str) -> SunPointColumns:
        """Return the sightings that a calibration was given, as they were.

        Raises
        ------
        NotFoundError : nothing was kept for this calibration.
        InputError : they were changed or deleted since.
        """
        with self._reading() as connection:
            row = connection.execute(
                select(used_sightings, calibration.c.camera)
                .join(calibration, calibration.c.id == used_sightings.c.calibration)
                .where(used_sightings.c.calibration == calibration_id)
            ).one_or_none()
            if row is None:
                raise NotFoundError(
                    field="id",
                    problem=f"no sightings were kept with calibration {calibration_id}",
                    remedy="name one that a refit made, see `sunarc calibrations list`",
                )
            try:
                ids, epochs = _unpacked(row.ids), [(str(name), int(start)) for name, start in row.epochs]
                air = _unpacked_air(row.air, ids.size)
                sigma = _unpacked_sigma(row.sigma, ids.size)
            except (TypeError, ValueError, zlib.error):
                raise _changed(calibration_id, "the list of its sightings is damaged") from None
            found = read_columns(connection, row.camera, [listed(connection, ids)])
        if found.ids.size != ids.size:
            raise _changed(calibration_id, f"{ids.size - found.ids.size} of its {ids.size} sightings are gone")
        columns = _as_then(found, epochs, air)
        columns = columns if sigma is None else replace(columns, sigma_px=sigma)
        # Rows of the same keys may have been edited since: the fit would not be the same.
        if _digest(columns) != row.digest:
            raise _changed(calibration_id, "its sightings were changed since")
        return columns


def keep_used(connection: Connection, calibration_id: str, columns: SunPointColumns) -> None:
    """Write down which sightings a calibration rests on."""
    starts = np.searchsorted(columns.epoch, np.arange(len(columns.epoch_ids)))  # epochs follow each other in time
    connection.execute(
        insert(used_sightings).values(
            calibration=calibration_id,
            ids=_packed(columns.ids),
            digest=_digest(columns),
            epochs=[[name, int(start)] for name, start in zip(columns.epoch_ids, starts, strict=True)],
            air=_packed_air(columns),
        )
    )


def keep_sigma(connection: Connection, camera: str) -> None:
    """Store with each calibration of a camera the sigma of its sightings, before the sightings' own is changed."""
    c = used_sightings.c
    rows = connection.execute(
        select(c.calibration, c.ids)
        .join(calibration, calibration.c.id == c.calibration)
        .where(calibration.c.camera == camera, c.sigma.is_(None))
    ).all()
    for row in rows:
        with suppress(TypeError, ValueError, zlib.error):  # a damaged list cannot be solved again anyway
            found = read_columns(connection, camera, [listed(connection, _unpacked(row.ids))])
            packed = zlib.compress(found.sigma_px.astype("<f8").tobytes(), 9)
            connection.execute(update(used_sightings).where(c.calibration == row.calibration).values(sigma=packed))


def copy_used(connection: Connection, calibration_id: str, *, to: str) -> None:
    """Store the same sightings as the inputs of a copy of a calibration."""
    row = connection.execute(select(used_sightings).where(used_sightings.c.calibration == calibration_id)).one_or_none()
    if row is not None:
        connection.execute(insert(used_sightings).values({**row._mapping, "calibration": to}))  # noqa: SLF001 - public


def _as_then(found: SunPointColumns, epochs: list[tuple[str, int]], air: FloatArray) -> SunPointColumns:
    """Return sightings in the pose epochs and in the air (2, n) that they had when the calibration was made."""
    starts = np.array([start for _, start in epochs])
    return replace(
        found,
        epoch=np.searchsorted(starts, np.arange(found.ids.size), side="right").astype(np.int64) - 1,
        epoch_ids=tuple(name for name, _ in epochs),
        temperature=air[0],
        pressure=air[1],
    )


def _packed(ids: IntArray) -> bytes:
    """Return keys as steps, compressed: a few thousand take a few kilobytes."""
    # Keys rise by small steps: their differences compress to a few bits each.
    return zlib.compress(np.diff(ids, prepend=0).astype("<i8").tobytes(), 9)


def _unpacked(packed: bytes) -> IntArray:
    return np.cumsum(np.frombuffer(zlib.decompress(packed), dtype="<i8")).astype(np.int64)


def _packed_air(columns: SunPointColumns) -> bytes | None:
    """Return temperature and pressure, compressed; None where nothing was measured. A day's is given later, or anew."""
    air = np.stack([columns.temperature, columns.pressure])
    return None if np.all(np.isnan(air)) else zlib.compress(air.astype("<f8").tobytes(), 9)


def _unpacked_air(packed: bytes | None, count: int) -> FloatArray:
    """Return temperature and pressure, (2, n); NaN where nothing was kept."""
    if packed is None:
        return np.full((2, count), np.nan)
    return np.frombuffer(zlib.decompress(packed), dtype="<f8").astype(np.float64).reshape(2, count)


def _unpacked_sigma(packed: bytes | None, count: int) -> FloatArray | None:
    """Return the sigma that a calibration was given, (n,) px; None where it is the sightings' own still."""
    if packed is None:
        return None
    return np.frombuffer(zlib.decompress(packed), dtype="<f8").astype(np.float64).reshape(count)


def _digest(columns: SunPointColumns) -> str:
    """Return what changes when a sighting that counted is changed."""
    digest = hashlib.sha256()
    for column in (columns.unix_s, columns.pixels, columns.sigma_px, columns.clock_error_s):
        digest.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
    return digest.hexdigest()


def _changed(calibration_id: str, problem: str) -> InputError:
    return InputError(
        field=f"calibration {calibration_id}",
        problem=problem,
        remedy="take the sightings from a backup (sunarc db backup), or calibrate anew",
    )
