"""What a process does with one image file: read, check, look for the sun."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sunarc.array_types import Image
from sunarc.detection import Detection, Expectation
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.offline.detect_files import Method, detect_in_image, full_scale_of, selected_method
from sunarc.offline.ingest.image_checks import read_checked_image
from sunarc.offline.ingest.packed_mask import PackedMask
from sunarc.offline.messages import RefusedImageError

Answer = Detection | Finding
"""A detection, with or without a sun; or why the image is left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """An image to look at.

    Attributes
    ----------
    path : the file.
    exposure_us : exposure time; None where not known.
    method : see `detect_in_image`.
    size : width and height that it must have, px.
    expectation : where the sun should be; None without a prediction.
    static : what stands still in the series.
    outside : whether the sun should be outside the image, or the camera's field: then nothing in it is the sun.
    """

    path: Path
    exposure_us: float | None
    method: Method
    size: tuple[int, int]
    expectation: Expectation | None = None
    static: PackedMask | None = None
    outside: bool = False


def detect_in_file(task: Task) -> Answer:
    """Read one image and look for the sun in it."""
    try:
        image = read_checked_image(task.path, size=task.size)
        if task.outside:
            return _no_sun(image, task)
        return detect_in_image(
            image,
            method=task.method,
            expectation=task.expectation,
            static=None if task.static is None else task.static.unpacked(),
            exposure_us=task.exposure_us,
        )
    except RefusedImageError as error:
        return error.finding
    except InputError as error:
        return Finding("file_not_image", {"error": f"{error.problem}; {error.remedy}"})


def _no_sun(image: Image, task: Task) -> Detection:
    """Return the answer for an image in which the sun cannot be, by the method that would have looked for it."""
    method = selected_method(image, task.method, full_scale=full_scale_of(image))
    outside = (Finding("sun_outside_image"),)
    return Detection(method=method, accepted=False, verdict="hidden", findings=outside, exposure_us=task.exposure_us)
