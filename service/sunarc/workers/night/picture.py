"""The picture of a night: its image with the most stars, small and stretched, and what is named in it."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import cv2
import numpy as np

from sunarc.archive.camera_archive import CameraArchive
from sunarc.archive.images import ImageStore
from sunarc.array_types import BoolArray, Image
from sunarc.calibration.model.backward import camera_sees
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.star_views import StarView
from sunarc.detection.stars.completeness import detected
from sunarc.errors import OutsideError
from sunarc.imaging.metadata import jpeg_with
from sunarc.optics.forward import project
from sunarc.sky.night import wanderer_place
from sunarc.sky.star_names import title_of
from sunarc.utc import rfc3339
from sunarc.workers.night.numbers import TakenImage

_log = logging.getLogger(__name__)

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
    """Return whether an image with so many detections is the one to show, rather than the present one."""
    return present is None or n_stars > present.n_stars


def named_bodies(one: TakenImage, calibration: Calibration, camera: CameraArchive) -> list[dict[str, Any]]:
    """Return the bright stars, planets and the moon in an image: name, title, pixel, V, and whether it was detected.

    `found` is null where no star of the image was named (cloud, another pose), and of the moon, which is no star.
    """
    view, matches = one.view, one.found.matches
    seen = _detected(view, one) if matches.accepted else None
    shown = np.flatnonzero(view.predicted.magnitude <= _SHOWN_TO_V)
    shown = shown[np.argsort(view.predicted.magnitude[shown], kind="stable")][:_MOST]
    bodies = [
        {
            "body": str(view.predicted.names[row]),
            "title": title_of(str(view.predicted.names[row])),
            "pixel": [round(float(value), 2) for value in view.predicted.pixels[row]],
            "magnitude": round(float(view.predicted.magnitude[row]), 2),
            "found": None if seen is None else bool(seen[row]),
        }
        for row in shown.tolist()
    ]
    return [*_moon(view.unix_s, calibration, camera), *bodies]


def _detected(view: StarView, one: TakenImage) -> BoolArray:
    """Return which predicted stars have a detection: the named ones, and those with one at their place."""
    seen = detected(view.stars, view.predicted)
    seen[one.found.matches.star] = True
    return seen


def _moon(unix_s: float, calibration: Calibration, camera: CameraArchive) -> list[dict[str, Any]]:
    """Return the moon where it is in the image."""
    place = wanderer_place("moon", unix_s, camera.site)
    if place.direction[2] <= 0.0:
        return []
    pixel = project(calibration.camera, np.array(place.direction))
    if not (np.all(np.isfinite(pixel)) and camera_sees(calibration.camera, pixel[None])[0]):
        return []
    at = [round(float(value), 2) for value in pixel]
    magnitude = round(place.magnitude, 2)
    return [{"body": "moon", "title": "Moon", "pixel": at, "magnitude": magnitude, "found": None, "lit": place.lit}]


def store_picture(
    store: ImageStore,
    picture: NightPicture,
    bodies: Sequence[dict[str, Any]],
    *,
    calibration: str | None,
    image_size: tuple[int, int] | None,
) -> bool:
    """Write the picture and its names beside the composites, and return whether they were written.

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
