"""What a process does with the image files of one time: one sighting from all exposures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from sunarc.array_types import Image
from sunarc.detection.photo.exposure_stack import Exposure, detect_sun_in_stack
from sunarc.detection.values import Detection
from sunarc.findings import Finding
from sunarc.offline.detect_files import full_scale_of, selected_method
from sunarc.offline.ingest.detect_image import Answer, Task, detect_in_file, detect_in_read, no_sun, read_for

IN_STACK: Final = "in_stack"
"""Verdict of an exposure whose stack has its sighting in another file."""


def detect_in_files(task: Task) -> tuple[Answer, ...]:
    """Read the files of a task and look for the sun in them; return an answer for each, in their order.

    Exposures of one time that an ordinary image is among are a stack: its sighting is the first one's answer, the
    others name that file. Microsecond exposures, and files that cannot be stacked, are looked at one by one.
    """
    if not task.more:
        return (detect_in_file(task),)
    files = [replace(task, path=path, exposure_us=exposure_us, more=()) for path, exposure_us in task.files]
    images = [read_for(one) for one in files]
    stack = _stack_of(images)
    if len(stack) < 2 or not _is_ordinary(list(stack.values()), task):
        return tuple(_alone(image, one) for image, one in zip(images, files, strict=True))
    first, *others = stack
    found = _detect(stack, files, task)
    answers = {first: found} | {n: _member(found, files[n], files[first].path) for n in others}
    return tuple(answers.get(n) or _alone(images[n], one) for n, one in enumerate(files))


def _alone(image: Image | Finding, task: Task) -> Answer:
    return image if isinstance(image, Finding) else detect_in_read(image, task)


def _stack_of(images: list[Image | Finding]) -> dict[int, Image]:
    """Return the images that are like the first one that could be read, by their number."""
    read = {n: image for n, image in enumerate(images) if not isinstance(image, Finding)}
    kinds = [(image.shape, image.dtype) for image in read.values()]
    return {n: image for n, image in read.items() if (image.shape, image.dtype) == kinds[0]}


def _is_ordinary(images: list[Image], task: Task) -> bool:
    scale = max(full_scale_of(image) for image in images)
    return any(selected_method(image, task.method, full_scale=scale) == "paper" for image in images)


def _detect(stack: dict[int, Image], files: list[Task], task: Task) -> Detection:
    if task.outside:
        return no_sun("paper", task.exposure_us)
    return detect_sun_in_stack(
        [Exposure(image, files[n].exposure_us) for n, image in stack.items()],
        full_scale=max(full_scale_of(image) for image in stack.values()),
        expectation=task.expectation,
        static=None if task.static is None else task.static.unpacked(),
    )


def _member(found: Detection, task: Task, first: Path) -> Detection:
    """Return the answer for an exposure whose stack has its sighting in another file."""
    return Detection(
        method=found.method,
        accepted=False,
        verdict=IN_STACK,
        findings=(Finding("stack_member", {"file": first.name}),),
        exposure_us=task.exposure_us,
    )
