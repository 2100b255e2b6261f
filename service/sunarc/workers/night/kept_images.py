"""The images of the night as the archive keeps them until the verdict: what was measured in each, to and from bytes."""

from __future__ import annotations

import io
import logging
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from datetime import datetime
from typing import NamedTuple

import numpy as np

from sunarc.archive.camera_archive import CameraArchive
from sunarc.archive.night_images import NightImage
from sunarc.array_types import IntArray
from sunarc.cameras.frame import Frame
from sunarc.detection.moon.cutouts import Cutout
from sunarc.detection.stars.values import Stars
from sunarc.errors import OutsideError
from sunarc.workers.night.warm_file import SensorFormat

_log = logging.getLogger(__name__)

_DAMAGED = (ValueError, KeyError, IndexError, EOFError, OSError, zipfile.BadZipFile, zlib.error)
"""What reading bytes raises that are not as they were written."""


class FrameNote(NamedTuple):
    """A frame without its pixels, the bound of its time's error (s), its checksum, and the camera's serial number."""

    frame: Frame
    clock_error_s: float
    digest: int = 0
    serial: str = ""

    @property
    def sensor(self) -> SensorFormat:
        """What the frame's warm pixels are of."""
        rows, columns = self.frame.image.shape[:2]
        return SensorFormat(rows, columns, self.frame.pixel_format, self.frame.binning, self.serial)


class KeptStars(NamedTuple):
    """What was measured of the stars in an image: detections, the halo about them, pixels that stand out."""

    note: FrameNote
    stars: Stars
    halo: float
    outstanding: IntArray
    n_repeated: int = 0
    picture: bytes | None = None


class KeptMoon(NamedTuple):
    """The brightest places of an image of the moon."""

    note: FrameNote
    cutouts: tuple[Cutout, ...]


class KeptImages:
    """Writes the images of the night to the archive as they are measured, and reads them after a restart.

    Parameters
    ----------
    camera : its archive.
    """

    def __init__(self, camera: CameraArchive) -> None:
        self._camera = camera

    def keep(self, kept: KeptStars | KeptMoon, *, since: datetime) -> None:
        """Store an image, and remove those of its sort from before `since`; where that fails, the night goes on."""
        row = _star_row(kept) if isinstance(kept, KeptStars) else _moon_row(kept)
        try:
            self._camera.add_night_image(row, keep_since=since)
        except OutsideError as error:
            _log.warning("image of the night not stored, a restart would lose it: %s", error)

    def read(self) -> tuple[list[KeptStars], list[KeptMoon]]:
        """Return the images of the nights without a verdict, the oldest first, without those that are damaged."""
        stars, moons = list[KeptStars](), list[KeptMoon]()
        for row in self._camera.night_images():
            try:
                arrays = _unpacked(row.measured)
                if row.kind == "stars":
                    stars.append(_stars_of(row, arrays))
                else:
                    moons.append(KeptMoon(_note_of(row), tuple(_cutouts_of(arrays))))
            except _DAMAGED as error:
                _log.warning("left out a damaged image of the night of %s: %s", row.time.isoformat(), error)
        return stars, moons


def _star_row(kept: KeptStars) -> NightImage:
    arrays = {field.name: getattr(kept.stars, field.name) for field in fields(Stars)}
    return _row(kept.note, kind="stars", arrays=arrays | {"outstanding": kept.outstanding}, kept=kept)


def _moon_row(kept: KeptMoon) -> NightImage:
    corners = np.array([(one.x, one.y) for one in kept.cutouts], dtype=np.int64).reshape(-1, 2)
    images = {f"cutout_{number}": one.image for number, one in enumerate(kept.cutouts)}
    return _row(kept.note, kind="moon", arrays={"corners": corners, **images})


def _row(note: FrameNote, *, kind: str, arrays: Mapping[str, np.ndarray], kept: KeptStars | None = None) -> NightImage:
    frame = note.frame
    packed = io.BytesIO()
    write: Callable[..., None] = np.savez_compressed
    write(packed, **arrays)
    return NightImage(
        time=frame.time,
        kind="stars" if kind == "stars" else "moon",
        exposure_us=frame.exposure_us,
        gain_db=frame.gain_db,
        pixel_format=frame.pixel_format,
        full_scale=frame.full_scale,
        width=frame.image.shape[1],
        height=frame.image.shape[0],
        binning=frame.binning,
        serial=note.serial,
        clock_error_s=note.clock_error_s,
        measured=packed.getvalue(),
        halo=None if kept is None else kept.halo,
        digest=note.digest,
        n_repeated=0 if kept is None else kept.n_repeated,
        picture=None if kept is None else kept.picture,
    )


def _unpacked(measured: bytes) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(measured), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def _note_of(row: NightImage) -> FrameNote:
    frame = Frame(
        image=np.broadcast_to(np.uint16(0), (row.height, row.width)),
        time=row.time,
        exposure_us=row.exposure_us,
        gain_db=row.gain_db,
        pixel_format=row.pixel_format,
        full_scale=row.full_scale,
        frame_id=0,
        binning=row.binning,
    )
    return FrameNote(frame, row.clock_error_s, row.digest, row.serial)


def _stars_of(row: NightImage, arrays: Mapping[str, np.ndarray]) -> KeptStars:
    stars = Stars(**{field.name: arrays[field.name] for field in fields(Stars)})
    halo = float("nan") if row.halo is None else row.halo
    return KeptStars(_note_of(row), stars, halo, arrays["outstanding"], row.n_repeated, row.picture)


def _cutouts_of(arrays: Mapping[str, np.ndarray]) -> Iterable[Cutout]:
    for number, (x, y) in enumerate(arrays["corners"].tolist()):
        yield Cutout(x, y, arrays[f"cutout_{number}"])
