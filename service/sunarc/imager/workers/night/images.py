"""Files of a night: the measurements of its images until the verdict, the picture that is shown, the warm pixels."""

from __future__ import annotations

import io
import json
import logging
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import BoolArray, Image, IntArray
from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding
from sunarc.common.foreign_files import read_regular
from sunarc.common.utc import rfc3339
from sunarc.detection.moon import Cutout
from sunarc.detection.stars.photometry import detected
from sunarc.detection.stars.warm_pixels import SensorFormat
from sunarc.detection.values import Stars
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.days import NightImage
from sunarc.imager.archive.images import ImageStore, write_atomically
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.workers.night.named_stars import TakenImage
from sunarc.imaging.metadata import jpeg_with
from sunarc.optics.camera import camera_sees
from sunarc.optics.forward import project
from sunarc.sky.night import body_position, common_name
from sunarc.stars.views import StarView

_log = logging.getLogger(__name__)

_DAMAGED = (ValueError, KeyError, IndexError, EOFError, OSError, zipfile.BadZipFile, zlib.error)
"""Errors of reading bytes that are not as they were written."""


class FrameNote(NamedTuple):
    """Frame without its pixels, the bound of its clock error (s), its checksum, and the camera's serial number."""

    frame: Frame
    clock_error_s: float
    digest: int = 0
    serial: str = ""

    @property
    def sensor(self) -> SensorFormat:
        """Sensor format of the frame's warm pixels."""
        rows, columns = self.frame.image.shape[:2]
        return SensorFormat(rows, columns, self.frame.pixel_format, self.frame.binning, self.serial)


class KeptStars(NamedTuple):
    """Measurements of the stars in an image: detections, the halo about them, pixels that stand out."""

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
    """Store of the night images' measurements, written as they are made and read after a restart.

    Parameters
    ----------
    camera : its archive.
    """

    def __init__(self, camera: CameraArchive) -> None:
        self._camera = camera

    def keep(self, kept: KeptStars | KeptMoon, *, since: datetime) -> None:
        """Store an image, and remove those of its sort from before `since`; where that fails, the night goes on."""
        row = _make_star_row(kept) if isinstance(kept, KeptStars) else _make_moon_row(kept)
        try:
            self._camera.archive.nights.add_image(self._camera.name, row, keep_since=since)
        except OutsideError as error:
            _log.warning("image of the night not stored, a restart would lose it: %s", error)

    def read(self) -> tuple[list[KeptStars], list[KeptMoon]]:
        """Return the images of the nights without a verdict, the oldest first, without those that are damaged."""
        stars, moons = list[KeptStars](), list[KeptMoon]()
        for row in self._camera.archive.nights.images(self._camera.name):
            try:
                arrays = _unpack_arrays(row.measured)
                if row.kind == "stars":
                    stars.append(_read_kept_stars(row, arrays))
                else:
                    moons.append(KeptMoon(_read_note(row), tuple(_read_cutouts(arrays))))
            except _DAMAGED as error:
                _log.warning("left out a damaged image of the night of %s: %s", row.time.isoformat(), error)
        return stars, moons


def _make_star_row(kept: KeptStars) -> NightImage:
    arrays = {field.name: getattr(kept.stars, field.name) for field in fields(Stars)}
    return _make_row(kept.note, kind="stars", arrays=arrays | {"outstanding": kept.outstanding}, kept=kept)


def _make_moon_row(kept: KeptMoon) -> NightImage:
    corners = np.array([(one.x, one.y) for one in kept.cutouts], dtype=np.int64).reshape(-1, 2)
    images = {f"cutout_{number}": one.image for number, one in enumerate(kept.cutouts)}
    return _make_row(kept.note, kind="moon", arrays={"corners": corners, **images})


def _make_row(
    note: FrameNote, *, kind: str, arrays: Mapping[str, np.ndarray], kept: KeptStars | None = None
) -> NightImage:
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


def _unpack_arrays(measured: bytes) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(measured), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def _read_note(row: NightImage) -> FrameNote:
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


def _read_kept_stars(row: NightImage, arrays: Mapping[str, np.ndarray]) -> KeptStars:
    stars = Stars(**{field.name: arrays[field.name] for field in fields(Stars)})
    halo = float("nan") if row.halo is None else row.halo
    return KeptStars(_read_note(row), stars, halo, arrays["outstanding"], row.n_repeated, row.picture)


def _read_cutouts(arrays: Mapping[str, np.ndarray]) -> Iterable[Cutout]:
    for number, (x, y) in enumerate(arrays["corners"].tolist()):
        yield Cutout(x, y, arrays[f"cutout_{number}"])


PICTURE, NAMES = "night.jpg", "night.json"
"""Kinds of the two files in the store of images."""
_WIDEST_PX = 1024
_QUALITY = 80
_DARK_SHARE, _BRIGHTEST_SHARE = 0.3, 0.999
_SOFTENING = 0.1
"""Of the arcsinh stretch: levels below a tenth of the brightest are shown in proportion."""
_SHOWN_TO_V, _MOST = 3.5, 150


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NightPicture:
    """A picture of the night: the middle of its exposure, the detections in it, and the JPEG."""

    time: datetime
    n_stars: int
    jpeg: bytes


def night_picture(image: Image, time: datetime, n_stars: int) -> NightPicture:
    """Return the picture of an image: the mean of its colours, 1024 px wide at most, stretched to 8 bits."""
    levels = image.astype(np.float32)
    gray = levels.mean(axis=2) if levels.ndim == 3 else levels
    height, width = gray.shape
    if width > _WIDEST_PX:
        size = (_WIDEST_PX, max(1, round(height * _WIDEST_PX / width)))
        gray = np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    dark, bright = float(np.quantile(gray, _DARK_SHARE)), float(np.quantile(gray, _BRIGHTEST_SHARE))
    share = np.clip((gray - dark) / max(bright - dark, 1.0), 0.0, 1.0)
    shown = np.rint(255.0 * np.arcsinh(share / _SOFTENING) / np.arcsinh(1.0 / _SOFTENING)).astype(np.uint8)
    encoded = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return NightPicture(time=time, n_stars=n_stars, jpeg=encoded.tobytes())


def better(present: NightPicture | None, *, n_stars: int) -> bool:
    """Return whether an image with so many detections should replace the present picture of the night."""
    return present is None or n_stars > present.n_stars


def named_bodies(one: TakenImage, calibration: Calibration, camera: CameraArchive) -> list[dict[str, Any]]:
    """Return the bright stars, planets and the moon in an image: name, title, pixel, V, and whether it was detected.

    `found` is null where no star of the image was named (cloud, another pose), and of the moon, which is no star.
    """
    view, matches = one.view, one.found.matches
    seen = _is_detected(view, one) if matches.accepted else None
    shown = np.flatnonzero(view.predicted.magnitude <= _SHOWN_TO_V)
    shown = shown[np.argsort(view.predicted.magnitude[shown], kind="stable")][:_MOST]
    bodies = [
        {
            "body": str(view.predicted.names[row]),
            "title": common_name(str(view.predicted.names[row])),
            "pixel": [round(float(value), 2) for value in view.predicted.pixels[row]],
            "magnitude": round(float(view.predicted.magnitude[row]), 2),
            "found": None if seen is None else bool(seen[row]),
        }
        for row in shown.tolist()
    ]
    return [*_describe_moon(view.unix_s, calibration, camera), *bodies]


def _is_detected(view: StarView, one: TakenImage) -> BoolArray:
    """Return which predicted stars have a detection: the named ones, and those with one at their place."""
    seen = detected(view.stars, view.predicted)
    seen[one.found.matches.star] = True
    return seen


def _describe_moon(unix_s: float, calibration: Calibration, camera: CameraArchive) -> list[dict[str, Any]]:
    """Return the moon where it is in the image."""
    place = body_position("moon", unix_s, camera.site)
    if place.direction[2] <= 0.0:
        return []
    pixel = project(calibration.camera, np.array(place.direction))
    if not (np.all(np.isfinite(pixel)) and camera_sees(calibration.camera, pixel[None])[0]):
        return []
    at = [round(float(value), 2) for value in pixel]
    magnitude = round(place.magnitude, 2)
    moon = {"body": "moon", "title": "Moon", "pixel": at, "magnitude": magnitude, "found": None}
    return [{**moon, "lit": place.illuminated_fraction}]


def store_picture(
    store: ImageStore,
    picture: NightPicture,
    bodies: Sequence[dict[str, Any]],
    *,
    calibration: str | None,
    image_size: tuple[int, int] | None,
) -> bool:
    """Write the picture and its names into the folder of the composites, and return whether they were written.

    They are removed with those of their age.
    """
    document = {
        "time": rfc3339(picture.time),
        "calibration": calibration,
        "image_size": None if image_size is None else list(image_size),
        "bodies": list(bodies),
    }
    try:
        store.write(picture.time, json.dumps(document).encode("utf-8"), kind=NAMES)
        # it is no image to look for stars in: stretched, and mostly smaller than the camera's
        named = {"schema": "sunarc.night-picture/1", "preview": True, "time_utc": document["time"]}
        store.write(picture.time, jpeg_with(picture.jpeg, named), kind=PICTURE)
    except OutsideError as error:
        _log.warning("picture of the night not written: %s", error)
        return False
    return True


_LIST_VERSION = 1
_MOST_PIXELS = 40_000
"""Pixels of a list: an image has 20,000 that stand out, and a list those that do so in 70 % of the images."""
_MOST_LIST_BYTES = 1 << 20
"""A list of 40,000 pixels of up to 10 digits takes half of it; a larger file is not ours."""


@dataclass(eq=False)
class WarmPixelFile:
    """The file of a camera's warm pixels; a file that cannot be read or written is reported, and the night goes on.

    Parameters
    ----------
    path : of the file.
    report : stores a finding as an event.
    """

    path: Path
    report: Callable[[Finding], object]

    def read(self, sensor: SensorFormat) -> IntArray:
        """Return the flat indices, ascending; none without a file, or where it is damaged or of another sensor."""
        try:
            stored, pixels = _parse_list(read_regular(self.path, most_bytes=_MOST_LIST_BYTES))
        except FileNotFoundError:
            return np.zeros(0, dtype=np.int64)
        except (OSError, ValueError, OverflowError, RecursionError) as error:
            why = error.strerror if isinstance(error, OSError) else None
            self.report(Finding("warm_pixels_unread", {"file": self.path.name, "error": why or str(error)}))
            return np.zeros(0, dtype=np.int64)
        if stored != sensor:
            data = {"file": self.path.name, "stored": _describe_sensor(stored), "present": _describe_sensor(sensor)}
            self.report(Finding("warm_pixels_other_sensor", data))
            return np.zeros(0, dtype=np.int64)
        return pixels

    def write(self, sensor: SensorFormat, pixels: IntArray) -> None:
        """Write a list in place of the former one: the whole of it, or nothing."""
        document = {"version": _LIST_VERSION, "sensor": sensor._asdict(), "pixels": pixels[:_MOST_PIXELS].tolist()}
        try:
            write_atomically(self.path, json.dumps(document).encode())
        except OSError as error:
            found = Finding("warm_pixels_unwritten", {"file": self.path.name, "error": error.strerror or str(error)})
            # no event: a disk that is full has no room for one
            _log.warning("%s: %s", found.code, found.text, extra={"event_kind": found.code})


def _parse_list(content: bytes) -> tuple[SensorFormat, IntArray]:
    """Return the content of a file; ValueError where it is not as it was written."""
    document = json.loads(content)
    if not isinstance(document, dict) or document.get("version") != _LIST_VERSION:
        raise ValueError("not a list of this version")
    sensor, pixels = _parse_sensor_format(document.get("sensor")), document.get("pixels")
    if not isinstance(pixels, list) or len(pixels) > _MOST_PIXELS or not all(type(one) is int for one in pixels):
        raise ValueError("no list of pixels")
    flat = np.array(pixels, dtype=np.int64)
    if flat.size and (flat[0] < 0 or flat[-1] >= sensor.rows * sensor.columns or np.any(np.diff(flat) <= 0)):
        raise ValueError("pixels outside the image, or not in ascending order")
    return sensor, flat


def _parse_sensor_format(stored: Any) -> SensorFormat:  # noqa: ANN401 - of JSON
    if not isinstance(stored, dict) or set(stored) != set(SensorFormat._fields):
        raise ValueError("no sensor")
    sensor = SensorFormat(**stored)
    if any(type(one) is not kind for one, kind in zip(sensor, (int, int, str, int, str), strict=True)):
        raise ValueError("no sensor")
    return sensor


def _describe_sensor(sensor: SensorFormat) -> str:
    binned = f", {sensor.binning}x{sensor.binning} binned" if sensor.binning > 1 else ""
    return (
        f"{sensor.columns}x{sensor.rows} px {sensor.pixel_format}{binned}, serial number {sensor.serial or 'unknown'}"
    )
