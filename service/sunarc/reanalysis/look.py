"""What a worker does with images: read, check, look for the sun; it keeps nothing."""

from __future__ import annotations

import hashlib
import itertools
import math
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import cv2
import numpy as np

from sunarc.array_types import BoolArray, Image
from sunarc.calibration.model.result import Calibration
from sunarc.detection.photo.plateau import static_mask
from sunarc.detection.values import Detection, Expectation
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.reanalysis.detect_files import Method, detect_in_image, full_scale_of, selected_method
from sunarc.reanalysis.image_files import images_in, read_checked_image
from sunarc.reanalysis.messages import RefusedImageError
from sunarc.reanalysis.sources import HashedSource, open_source
from sunarc.sky.site import Site

_LARGEST_SIDE = 640


class PackedMask(NamedTuple):
    """A mask, (rows, columns), compressed."""

    shape: tuple[int, int]
    compressed: bytes

    def unpacked(self) -> BoolArray:
        """Return the mask, (rows, columns)."""
        bits = np.frombuffer(zlib.decompress(self.compressed), dtype=np.uint8)
        return np.unpackbits(bits, count=self.shape[0] * self.shape[1]).reshape(self.shape).astype(np.bool_)


def pack_mask(mask: BoolArray) -> PackedMask:
    """Return a mask reduced to 640 px at most; a reduced pixel is set where any of it is."""
    shrink = min(1.0, _LARGEST_SIDE / max(mask.shape))
    size = max(1, round(shrink * mask.shape[1])), max(1, round(shrink * mask.shape[0]))
    reduced = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0
    return PackedMask((size[1], size[0]), zlib.compress(np.packbits(reduced).tobytes()))


class Item(NamedTuple):
    """An image of a chunk.

    expectation: where the sun should be; None without a prediction. outside: whether it should be outside the image.
    found: where one was accepted without a prediction, px. content: of its file when it was looked at before, where
    the rest of what decides the answer is the same. unix_s: when it was taken, of an image of the night.
    """

    file: str
    number: int
    exposure_us: float | None
    expectation: Expectation | None = None
    outside: bool = False
    found: tuple[float, float] | None = None
    content: str | None = None
    unix_s: float = 0.0


class StarNaming(NamedTuple):
    """What the stars in images of a night are named by: a calibration, the site, how far the clock was ahead."""

    calibration: Calibration
    site: Site
    clock_offset_s: float


class NamedStars(NamedTuple):
    """The stars of an image that are sightings: name, x, y and 1-sigma in px of each."""

    rows: tuple[tuple[str, float, float, float], ...]


class Chunk(NamedTuple):
    """A unit of work: some images of a camera, in one source, in the order of their files and numbers.

    night: what names the stars in them; None of images of the day.
    """

    camera: str
    address: str
    method: Method
    size: tuple[int, int]
    items: tuple[Item, ...]
    static: PackedMask | None = None
    night: StarNaming | None = None


class Answer(NamedTuple):
    """What came of an image: a detection, with or without a sun, or its stars, or the finding why it is left out.

    None where its file has the content that the item states: it is not looked at again. content: hash of the file's
    bytes; None where it was not read as a whole.
    """

    file: str
    number: int
    found: Detection | NamedStars | Finding | None
    content: str | None = None


def look_at(chunk: Chunk) -> list[Answer]:
    """Return an answer for each image of a chunk."""
    cv2.setNumThreads(1)
    static = None if chunk.static is None else chunk.static.unpacked()
    source, answers = HashedSource(open_source(chunk.address)), list[Answer]()
    for file, members in itertools.groupby(chunk.items, key=lambda item: item.file):
        items = {item.number: item for item in members}
        changed = [number for number, item in items.items() if not _is_unchanged(source, item)]
        answers += [Answer(file, number, None, source.content(file)) for number in items if number not in changed]
        if changed:
            answers += [
                Answer(
                    file,
                    number,
                    image if isinstance(image, Finding) else _look(image, items[number], chunk, static),
                    source.content(file),
                )
                for number, image in images_in(source, file, changed, size=chunk.size)
            ]
    return answers


def _is_unchanged(source: HashedSource, item: Item) -> bool:
    if item.content is None:
        return False
    try:
        source.read(item.file)
    except OSError:  # it is read again, for the reason
        return False
    return source.content(item.file) == item.content


def still_parts(chunk: Chunk) -> PackedMask | None:
    """Return what stands still in the images of a chunk that spans hours; None where nothing does."""
    cv2.setNumThreads(1)
    images = (image for _, _, image in _images(chunk) if not isinstance(image, Finding))
    first = next(images, None)
    if first is None:
        return None
    like_first = (one for one in images if (one.shape, one.dtype) == (first.shape, first.dtype))
    mask = static_mask(itertools.chain([first], like_first), full_scale=full_scale_of(first))
    return None if mask is None or not mask.any() else pack_mask(mask)


def _images(chunk: Chunk) -> Iterator[tuple[str, int, Image | Finding]]:
    source = open_source(chunk.address)
    for file, items in itertools.groupby(chunk.items, key=lambda item: item.file):
        numbers = [item.number for item in items]
        for number, image in images_in(source, file, numbers, size=chunk.size):
            yield file, number, image


def _look(image: Image, item: Item, chunk: Chunk, static: BoolArray | None) -> Detection | Finding:
    if item.outside:
        method = selected_method(image, chunk.method, full_scale=full_scale_of(image))
        return Detection(method=method, accepted=False, verdict="hidden", findings=(Finding("sun_outside_image"),))
    try:
        found = detect_in_image(
            image,
            method=chunk.method,
            expectation=item.expectation,
            static=static,
            exposure_us=item.exposure_us,
            elsewhere=False,  # what is there was found without a prediction
        )
    except Exception as error:  # noqa: BLE001 - whatever an image does to a detector, the others go on
        return Finding("image_failed", {"error": f"{type(error).__name__}: {error}"})
    return _as_reflection(found, item)


def _as_reflection(found: Detection, item: Item) -> Detection:
    """Return a detection; a reflection where nothing is at the prediction, and a sun was accepted elsewhere."""
    if item.expectation is None or item.found is None or found.x_px is not None or found.method != "paper":
        return found
    distance = math.hypot(item.found[0] - item.expectation.x_px, item.found[1] - item.expectation.y_px)
    displaced = (Finding("blob_displaced", {"distance_px": distance}),)
    return replace(found, verdict="reflection", findings=displaced)


def key_of(parts: Iterable[object]) -> str:
    """Return a hash of what decides a result."""
    return hashlib.blake2b(repr(tuple(parts)).encode(), digest_size=12).hexdigest()


FileAnswer = Detection | Finding
"""A detection, with or without a sun; or why the image is left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LookTask:
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


def detect_in_file(task: LookTask) -> FileAnswer:
    """Read one image and look for the sun in it."""
    image = read_for(task)
    return image if isinstance(image, Finding) else detect_in_read(image, task)


def read_for(task: LookTask) -> Image | Finding:
    """Return the image of a task, or why it is left out."""
    try:
        return read_checked_image(task.path, size=task.size)
    except RefusedImageError as error:
        return error.finding


def detect_in_read(image: Image, task: LookTask) -> FileAnswer:
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
