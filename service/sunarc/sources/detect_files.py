"""The sun in image files of which nothing need be known but the pixels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import cv2
import numpy as np

from sunarc.common.array_types import BoolArray, Image
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import name_text
from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.exposure_stack import detect_disc_in_colours, is_short
from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_photo
from sunarc.detection.values import Bayer, Detection, Expectation, Sensor
from sunarc.imaging.preview import preview
from sunarc.sources.files import read_image

Method = Literal["auto", "disc", "paper"]
METHODS: tuple[Method, ...] = get_args(Method)

_FULL_SCALES = (255, 1023, 4095, 16383, 65535)
_DARK = 0.03
_CROSS_PX = 60


def detect_in_files(
    paths: Sequence[Path],
    *,
    method: Method = "auto",
    full_scale: int | None = None,
    bayer: Bayer | None = None,
    follow_exif: bool = False,
) -> list[dict[str, Any]]:
    """Look for the sun in each file; one that is no image gets a row with its reason, and no sun.

    Parameters
    ----------
    paths : image files.
    method : see `detect_in_image`.
    full_scale : the largest count; judged from the file where None.
    bayer : colours of a raw mosaic's top-left 2×2 pixels.
    follow_exif : turn pictures as their EXIF orientation states; they are read as they are stored otherwise.
    """
    options = _Options(method, full_scale, bayer, follow_exif)
    return [_make_row(path, options) for path in paths]


class _Options(NamedTuple):
    """Options of `detect_in_files`."""

    method: Method
    full_scale: int | None
    bayer: Bayer | None
    follow_exif: bool


def detect_in_image(
    image: Image,
    *,
    method: Method = "auto",
    full_scale: int | None = None,
    bayer: Bayer | None = None,
    expectation: Expectation | None = None,
    static: BoolArray | None = None,
    exposure_us: float | None = None,
    elsewhere: bool = True,
) -> Detection:
    """Look for the sun in one image.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3), uint8 or uint16.
    method : "disc" for raw microsecond frames (of colours their linear sum), "paper" for ordinary and HDR images;
        "auto" takes an image with an exposed sky, or in colours, for an ordinary one, unless it is dark and shows the
        disc.
    full_scale, bayer : as in `detect_in_files`.
    expectation : where the sun should be, where that is known.
    static : what stands still in the series of an ordinary image, (rows, columns) or reduced.
    exposure_us : returned in the result.
    elsewhere : as in `detect_sun_in_photo`.
    """
    top = full_scale or estimated_full_scale(image)
    selected = selected_method(image, method, full_scale=top)
    photo = Photo(image, top, exposure_us, static, bayer)
    if image.ndim == 3 and (selected == "disc" or (method == "auto" and is_short(photo))):
        found = detect_disc_in_colours(photo, expectation=expectation)
        if found.accepted or selected == "disc":
            return found
        ordinary = detect_sun_in_photo(photo, expectation=expectation, elsewhere=elsewhere)
        return found if found.x_px is not None and ordinary.x_px is None else ordinary
    if selected == "paper":
        return detect_sun_in_photo(photo, expectation=expectation, elsewhere=elsewhere)
    sensor = Sensor.from_full_well(full_scale=top, bayer=bayer)
    return detect_sun(image, sensor=sensor, expectation=expectation, exposure_us=exposure_us)


def draw_overlay(path: Path, found: dict[str, Any], target: Path, *, follow_exif: bool = False) -> None:
    """Write the image with a cross on the sun: green where it is accepted, orange where it is rejected."""
    image = read_image(path, follow_exif=follow_exif)
    canvas = preview(image) if image.ndim == 2 else _convert_to_eight_bits(image)
    if canvas.ndim == 2:
        canvas = cv2.cvtColor(canvas, cv2.COLOR_GRAY2BGR).astype(np.uint8)
    if found["x_px"] is not None:
        at = round(found["x_px"]), round(found["y_px"])
        colour = (0, 200, 0) if found["accepted"] else (0, 140, 255)
        cv2.drawMarker(canvas, at, colour, markerType=cv2.MARKER_CROSS, markerSize=_CROSS_PX, thickness=2)
        if found["radius_px"]:
            cv2.circle(canvas, at, max(round(2.0 * found["radius_px"]), 8), colour, 2)
    with disk_errors(target):
        target.write_bytes(cv2.imencode(".png", canvas)[1].tobytes())


def _make_row(path: Path, options: _Options) -> dict[str, Any]:
    try:
        image = read_image(path, follow_exif=options.follow_exif)
        found = detect_in_image(image, method=options.method, full_scale=options.full_scale, bayer=options.bayer)
    except InputError as error:
        unreadable = Finding("file_unreadable", {"error": str(error)})
        why = error.finding if isinstance(error, FindingError) else unreadable
        found = Detection(method="disc", accepted=False, verdict="no_frame", findings=(why,))
    row = {name: getattr(found, name) for name in Detection.__slots__}
    return {
        "file": name_text(path),
        **row,
        "findings": [one.as_json() for one in found.findings],
        "reason": found.reason,
    }


def selected_method(image: Image, method: Method, *, full_scale: int) -> Literal["disc", "paper"]:
    """Return the method that is asked for; for "auto" the one that suits the image, see `detect_in_image`."""
    if method != "auto":
        return method
    exposed = float(np.median(image[::8, ::8])) > _DARK * full_scale
    return "paper" if image.ndim == 3 or exposed else "disc"


def estimated_full_scale(image: Image) -> int:
    """Return the smallest usual full scale that holds the image; counts of 8 bits may be stored as 16."""
    if image.dtype == np.uint8:
        return 255
    top = int(image.max(initial=0))
    return next(scale for scale in _FULL_SCALES if scale >= top)


def _convert_to_eight_bits(image: Image) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return image if image.dtype == np.uint8 else (image // 256).astype(np.uint8)  # type: ignore[return-value]
