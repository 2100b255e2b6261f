"""What a process does with one image file: read, check, look for the sun."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sunarc.array_types import Image
from sunarc.detection.values import Detection, Expectation
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
    more : further files of the same time, with their exposure times.
    """

    path: Path
    exposure_us: float | None
    method: Method
    size: tuple[int, int]
    expectation: Expectation | None = None
    static: PackedMask | None = None
    outside: bool = False
    more: tuple[tuple[Path, float | None], ...] = ()

    @property
    def files(self) -> tuple[tuple[Path, float | None], ...]:
        """All its files with their exposure times."""
        return ((self.path, self.exposure_us), *self.more)


def detect_in_file(task: Task) -> Answer:
    """Read one image and look for the sun in it."""
    image = read_for(task)
    return image if isinstance(image, Finding) else detect_in_read(image, task)


def read_for(task: Task) -> Image | Finding:
    """Return the image of a task, or why it is left out."""
    try:
        return read_checked_image(task.path, size=task.size)
    except RefusedImageError as error:
        return error.finding


def detect_in_read(image: Image, task: Task) -> Answer:
    """Look for the sun in an image that was read."""
    if task.outside:
        return no_sun(selected_method(image, task.method, full_scale=full_scale_of(image)), task.exposure_us)
    try:
        return detect_in_image(
            image,
            method=task.method,
            expectation=task.expectation,
            static=None if task.static is None else task.static.unpacked(),
            exposure_us=task.exposure_us,
        )
    except InputError as error:
        return Finding("file_not_image", {"error": f"{error.problem}; {error.remedy}"})


def no_sun(method: Literal["disc", "paper"], exposure_us: float | None) -> Detection:
    """Return the answer for an image in which the sun cannot be, by the method that would have looked for it."""
    outside = (Finding("sun_outside_image"),)
    return Detection(method=method, accepted=False, verdict="hidden", findings=outside, exposure_us=exposure_us)
