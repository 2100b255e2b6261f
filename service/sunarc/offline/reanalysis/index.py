"""The images of each camera in an archive, with their times; what cannot be used, and why."""

from __future__ import annotations

import io
import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import PurePosixPath
from typing import NamedTuple

import numpy as np
from PIL import Image as Pictures

from sunarc.errors import InputError
from sunarc.extras import is_installed
from sunarc.findings import Finding
from sunarc.offline.messages import RefusedImageError
from sunarc.offline.reanalysis.plan import ArchiveImage, CameraImages, CameraPlan, Failure
from sunarc.offline.sources.frames import MOST_BYTES, images_in, kind_of
from sunarc.offline.sources.opening import open_source
from sunarc.offline.sources.times import TimedFrame, timed_frames
from sunarc.offline.sources.values import ImageSource, SourceFile
from sunarc.sky.sun import sun_angles
from sunarc.utc import rfc3339, to_microseconds
from sunarc.workers.night.exposures import DARK_ZENITH_DEG

_LARGEST_ZENITH_DEG = 90.0
"""Apparent zenith angle of the sun beyond which an image is one of the night."""
_SIZES_READ = 40
"""Images of a camera whose size is read: most of them have that of the camera."""
_MOST_COPIES = 0.2
"""Share of a camera's images beside others of the same name and time, from which they are those of two cameras."""


class Indexed(NamedTuple):
    """Cameras with images, files that cannot be used, and cameras without images by day or mixed with others."""

    cameras: list[CameraImages]
    failures: list[Failure]
    refused: list[Failure]


class _Found(NamedTuple):
    image: ArchiveImage
    frame: TimedFrame


def index_archive(plans: Sequence[CameraPlan]) -> Indexed:
    """Return the images of all cameras.

    Files of one plan whose names differ before their times are those of several cameras: each becomes one of its own.
    An image is used once: a copy (same name and time) is left out.

    Raises
    ------
    InputError : a source cannot be opened.
    """
    indexed = Indexed([], [], [])
    for plan in plans:
        found = _found(plan, indexed.failures)
        by_prefix = defaultdict(list)
        for one in found:
            by_prefix[one.frame.prefix].append(one)
        for prefix, members in sorted(by_prefix.items()):
            named = plan if len(by_prefix) == 1 else replace(plan, name=_camera_name(plan.name, prefix))
            _add(indexed, named, members)
        if not found:
            indexed.refused.append(Failure(plan.name, Finding("camera_without_images")))
    indexed.failures.sort(key=lambda failure: (failure.file, failure.finding.code))
    return indexed


def _camera_name(name: str, prefix: str) -> str:
    cleaned = "".join(letter if letter.isalnum() else "-" for letter in prefix).strip("-")
    return f"{name}-{cleaned}" if cleaned else name


def _found(plan: CameraPlan, failures: list[Failure]) -> list[_Found]:
    found = []
    for address in plan.selector.sources:
        source = open_source(address)
        files = list(source.files())
        names = {file.name for file in files}
        for file in files:
            if kind_of(file.name) is None or not fnmatch(PurePosixPath(file.name).name, plan.selector.files):
                continue
            try:
                found += list(_timed(source, file, plan, names))
            except RefusedImageError as error:
                failures.append(Failure(f"{PurePosixPath(address).name}/{file.name}", error.finding))
    return found


def _timed(source: ImageSource, file: SourceFile, plan: CameraPlan, names: set[str]) -> Iterator[_Found]:
    if file.size > MOST_BYTES and kind_of(file.name) in {"picture", "fits"}:
        raise RefusedImageError(file.name, Finding("file_too_large", {"bytes": file.size, "most": MOST_BYTES}))
    for frame in timed_frames(source, file.name, plan.rules, names=names):
        time_us = to_microseconds(frame.time)
        stamp = f"{file.size}-{file.stamp}"
        yield _Found(ArchiveImage(time_us, file.name, frame.number, source.address, frame.exposure_us, stamp), frame)


def _add(indexed: Indexed, plan: CameraPlan, members: list[_Found]) -> None:
    """Add a camera with its images by day, or the reason why it has none."""
    images, copies = _single(sorted(one.image for one in members))
    if len(copies) > _MOST_COPIES * len(members):
        mixed: dict[str, float | int | str] = {
            "copies": len(copies),
            "images": len(members),
            "file": copies[0].name,
            "other": _other(images, copies[0]),
        }
        indexed.refused.append(Failure(plan.name, Finding("cameras_mixed", mixed)))
        return
    indexed.failures.extend(
        Failure(one.name, Finding("file_copy", {"file": PurePosixPath(one.file).name})) for one in copies
    )
    zenith = np.asarray(sun_angles(np.array([one.unix_s for one in images]), plan.site).apparent_zenith)
    by_day = tuple(one for one, angle in zip(images, zenith, strict=True) if angle <= _LARGEST_ZENITH_DEG)
    # without images of the day there is no calibration that names the stars
    darkest = DARK_ZENITH_DEG if by_day and is_installed("ephem") else math.inf
    nights = tuple(one for one, angle in zip(images, zenith, strict=True) if angle >= darkest)
    indexed.failures.extend(
        Failure(one.name, Finding("file_at_night", {"zenith_deg": float(angle)}))
        for one, angle in zip(images, zenith, strict=True)
        if _LARGEST_ZENITH_DEG < angle < darkest
    )
    if not by_day:
        seen = {"images": len(images), "zenith_deg": float(np.median(zenith))}
        indexed.refused.append(Failure(plan.name, Finding("camera_at_night", seen)))
        return
    size = plan.image_size or _usual_size(by_day)
    if size is None:
        indexed.refused.append(Failure(plan.name, Finding("camera_without_images")))
        return
    first = members[0]
    example = (first.image.name, rfc3339(first.frame.time, timespec="seconds"))
    families = Counter(one.frame.family for one in members).most_common(1)
    indexed.cameras.append(
        CameraImages(plan=plan, images=by_day, example=example, family=families[0][0], size=size, nights=nights)
    )


def _single(images: Sequence[ArchiveImage]) -> tuple[list[ArchiveImage], list[ArchiveImage]]:
    """Return images, and those that have the name, time and number of one before them."""
    single, copies = dict[tuple[int, str, int], ArchiveImage](), []
    for image in images:
        key = (image.time_us, PurePosixPath(image.file).name, image.number)
        if single.setdefault(key, image) is not image:
            copies.append(image)
    return list(single.values()), copies


def _other(images: Sequence[ArchiveImage], copy: ArchiveImage) -> str:
    base = PurePosixPath(copy.file).name
    return next(one.name for one in images if one.time_us == copy.time_us and PurePosixPath(one.file).name == base)


def _usual_size(images: Sequence[ArchiveImage]) -> tuple[int, int] | None:
    """Return the size (width, height) that most of some images have; None where none can be read."""
    some = images[:: len(images) // _SIZES_READ + 1]
    counted = Counter(size for image in some if (size := _size_of(image)) is not None)
    return counted.most_common(1)[0][0] if counted else None


def _size_of(image: ArchiveImage) -> tuple[int, int] | None:
    source = open_source(image.address)
    try:
        if kind_of(image.file) == "picture":
            with Pictures.open(io.BytesIO(source.read(image.file))) as picture:
                return picture.size
        ((_, found),) = images_in(source, image.file, [image.number], size=None)
    except (OSError, ValueError, SyntaxError, Pictures.DecompressionBombError, InputError):
        return None
    return None if isinstance(found, Finding) else (found.shape[1], found.shape[0])
