"""Detection of sun and stars in a chunk of images, as a worker does it; nothing is stored."""

from __future__ import annotations

import hashlib
import itertools
import math
import zlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path, PurePosixPath
from typing import Final, Literal, NamedTuple

import cv2
import numpy as np

import sunarc
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import BoolArray, Image
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.detection.exposure_stack import detect_sun_in_stack
from sunarc.detection.photo.ordinary_image import Photo
from sunarc.detection.photo.plateau import static_mask
from sunarc.detection.values import Detection, Expectation
from sunarc.sky.site import Site
from sunarc.sources.detect_files import Method, detect_in_image, estimated_full_scale, selected_method
from sunarc.sources.image_files import images_in, read_one_image
from sunarc.sources.sources import HashedSource, open_source

_LARGEST_SIDE = 640
IN_STACK: Final = "in_stack"
"""Verdict of an exposure whose stack has its sighting in another file."""


class PackedMask(NamedTuple):
    """A mask, (rows, columns), compressed."""

    shape: tuple[int, int]
    compressed: bytes

    def unpacked(self) -> BoolArray:
        """Return the mask, (rows, columns); ValueError or zlib.error where it is damaged."""
        bits = np.frombuffer(zlib.decompress(self.compressed), dtype=np.uint8)
        if bits.size != -(-self.shape[0] * self.shape[1] // 8):
            raise ValueError("of another size")
        return np.unpackbits(bits, count=self.shape[0] * self.shape[1]).reshape(self.shape).astype(np.bool_)


def pack_mask(mask: BoolArray) -> PackedMask:
    """Return a mask reduced to 640 px at most; a reduced pixel is set where any of it is."""
    shrink = min(1.0, _LARGEST_SIDE / max(mask.shape))
    size = max(1, round(shrink * mask.shape[1])), max(1, round(shrink * mask.shape[0]))
    reduced = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0
    return PackedMask((size[1], size[0]), zlib.compress(np.packbits(reduced).tobytes()))


class Item(NamedTuple):
    """Image of a chunk: file, number, exposure and prediction.

    expectation: where the sun should be; None without a prediction. outside: whether it should be outside the image.
    found: where one was accepted without a prediction, px. content: of its file when it was read before, where
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
    """Names of stars in images of a night: a calibration, the site, how far the clock was ahead, what shows no sky."""

    calibration: Calibration
    site: Site
    clock_offset_s: float
    hidden: PackedMask | None = None


class NamedStars(NamedTuple):
    """The stars of an image that are sightings: name, x, y and 1-sigma in px of each."""

    rows: tuple[tuple[str, float, float, float], ...]


class Chunk(NamedTuple):
    """A unit of work: some images of a camera, in one source, in the order of their files and numbers.

    night: what names the stars in them; None of images of the day. stack: whether they are exposures of one time.
    """

    camera: str
    address: str
    method: Method
    size: tuple[int, int]
    items: tuple[Item, ...]
    static: PackedMask | None = None
    night: StarNaming | None = None
    stack: bool = False


class Answer(NamedTuple):
    """Answer of an image: a detection, with or without a sun, or its stars, or the finding why it is left out.

    None where its file has the content that the item states: it is not read again. content: hash of the file's
    bytes; None where it was not read as a whole.
    """

    file: str
    number: int
    found: Detection | NamedStars | Finding | None
    content: str | None = None


Done = Callable[[Chunk, list[Answer]], None]
"""Called with a chunk and its answers when they are there."""


def look_at(chunk: Chunk) -> list[Answer]:
    """Return an answer for each image of a chunk."""
    cv2.setNumThreads(1)
    static = None if chunk.static is None else chunk.static.unpacked()
    if chunk.stack:
        return _look_at_folders(chunk, static)
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
                    image if isinstance(image, Finding) else _detect_sun(image, items[number], chunk, static),
                    source.content(file),
                )
                for number, image in images_in(source, file, changed, size=chunk.size)
            ]
    return answers


def _look_at_folders(chunk: Chunk, static: BoolArray | None) -> list[Answer]:
    """Look at the exposures of each folder as a stack: those of another one are of another camera, or copies."""
    folders: dict[PurePosixPath, list[Item]] = {}
    for item in chunk.items:
        folders.setdefault(PurePosixPath(item.file).parent, []).append(item)
    answers = {
        (one.file, one.number): one
        for items in folders.values()
        for one in _look_at_stack(chunk._replace(items=tuple(items)), static)
    }
    return [answers[item.file, item.number] for item in chunk.items]


def _is_unchanged(source: HashedSource, item: Item) -> bool:
    if item.content is None:
        return False
    try:
        source.read(item.file)
    except OSError:  # it is read again, for the reason
        return False
    return source.content(item.file) == item.content


def find_static_mask(chunk: Chunk) -> PackedMask | None:
    """Return the mask of the static parts of the images of a chunk that spans hours; None without any."""
    cv2.setNumThreads(1)
    source = open_source(chunk.address)
    by_file = itertools.groupby(chunk.items, key=lambda item: item.file)
    found = (images_in(source, file, [one.number for one in items], size=chunk.size) for file, items in by_file)
    images = (image for of_file in found for _, image in of_file if not isinstance(image, Finding))
    first = next(images, None)
    if first is None:
        return None
    like_first = (one for one in images if (one.shape, one.dtype) == (first.shape, first.dtype))
    mask = static_mask(itertools.chain([first], like_first), full_scale=estimated_full_scale(first))
    return None if mask is None or not mask.any() else pack_mask(mask)


def _look_at_stack(chunk: Chunk, static: BoolArray | None) -> list[Answer]:
    """Return an answer for each of the exposures of one time.

    Where an ordinary image is among them, one sighting comes from all that are alike: it is the answer for the first of
    these, and the others name that. Microsecond exposures, and files that cannot be stacked, are read one by one.
    """
    source = open_source(chunk.address)
    images = {item: read_one_image(source, item.file, item.number, size=chunk.size) for item in chunk.items}
    read = {item: image for item, image in images.items() if not isinstance(image, Finding)}
    kind = next(((image.shape, image.dtype) for image in read.values()), None)
    stack = {item: image for item, image in read.items() if (image.shape, image.dtype) == kind}
    scale = max((estimated_full_scale(image) for image in stack.values()), default=0)
    ordinary = any(selected_method(image, chunk.method, full_scale=scale) == "paper" for image in stack.values())
    found: dict[Item, Detection | Finding] = {}
    if len(stack) > 1 and ordinary:
        first = next(iter(stack))
        found = {item: _make_member_answer(first, item) for item in stack}
        photos = [Photo(image, scale, item.exposure_us, static) for item, image in stack.items()]
        found[first] = (
            _make_no_sun("paper", first.exposure_us)
            if first.outside
            else _try_detector(partial(detect_sun_in_stack, photos, expectation=first.expectation))
        )
    for item, image in images.items():
        if item not in found:
            found[item] = image if isinstance(image, Finding) else _detect_sun(image, item, chunk, static)
    return [Answer(item.file, item.number, found[item]) for item in chunk.items]


def _make_member_answer(first: Item, item: Item) -> Detection:
    """Return the answer for an exposure whose stack has its sighting in another file."""
    named = (Finding("stack_member", {"file": PurePosixPath(first.file).name}),)
    return Detection(method="paper", accepted=False, verdict=IN_STACK, findings=named, exposure_us=item.exposure_us)


def _detect_sun(image: Image, item: Item, chunk: Chunk, static: BoolArray | None) -> Detection | Finding:
    if item.outside:
        return _make_no_sun(
            selected_method(image, chunk.method, full_scale=estimated_full_scale(image)), item.exposure_us
        )
    found = _try_detector(
        partial(
            detect_in_image,
            image,
            method=chunk.method,
            expectation=item.expectation,
            static=static,
            exposure_us=item.exposure_us,
            elsewhere=False,  # what is there was found without a prediction
        )
    )
    return found if isinstance(found, Finding) else _mark_reflection(found, item)


def _try_detector(detect: Callable[[], Detection]) -> Detection | Finding:
    try:
        return detect()
    except InputError as error:  # a method that takes no such image
        return Finding("file_not_image", {"error": f"{error.problem}; {error.remedy}"})
    except Exception as error:  # noqa: BLE001 - whatever an image does to a detector, the others go on
        return Finding("image_failed", {"error": f"{type(error).__name__}: {error}"})


def _make_no_sun(method: Literal["disc", "paper"], exposure_us: float | None) -> Detection:
    """Return the answer for an image in which the sun cannot be, with the method that would have been used."""
    outside = (Finding("sun_outside_image"),)
    return Detection(method=method, accepted=False, verdict="hidden", findings=outside, exposure_us=exposure_us)


def _mark_reflection(found: Detection, item: Item) -> Detection:
    """Return a detection, as a reflection where nothing is at the prediction and a sun was accepted elsewhere."""
    if item.expectation is None or item.found is None or found.x_px is not None or found.method != "paper":
        return found
    distance = math.hypot(item.found[0] - item.expectation.x_px, item.found[1] - item.expectation.y_px)
    displaced = (Finding("blob_displaced", {"distance_px": distance}),)
    return replace(found, verdict="reflection", findings=displaced)


@cache
def software() -> str:
    """Return the version of this software with a hash of its code, by which answers are kept."""
    return f"{sunarc.__version__}+{code_hash(Path(sunarc.__file__).parent)}"


def code_hash(folder: Path) -> str:
    """Return a hash of a package's code: versions in development are many of one name."""
    hashed = hashlib.blake2b(digest_size=6)
    for path in sorted(one for one in folder.rglob("*") if one.suffix in {".py", ".so"}):
        content = path.read_bytes()
        hashed.update(f"{path.relative_to(folder).as_posix()} {len(content)} ".encode() + content)
    return hashed.hexdigest()


def result_key(parts: Iterable[object]) -> str:
    """Return a hash of the values that decide a result."""
    return hashlib.blake2b(repr(tuple(parts)).encode(), digest_size=12).hexdigest()
