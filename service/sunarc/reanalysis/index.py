"""Which files are whose, and the images in them with their times; what cannot be used, and why."""

from __future__ import annotations

import io
import math
import tomllib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from PIL import Image as Pictures

from sunarc.archive.sightings import ImageKey, image_key
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.errors import InputError
from sunarc.extras import is_installed
from sunarc.findings import Finding
from sunarc.reanalysis.detect_files import Method
from sunarc.reanalysis.files import read_file
from sunarc.reanalysis.image_files import MOST_BYTES, ImageSource, SourceFile, image_size, images_in, kind_of
from sunarc.reanalysis.image_times import Naming, TimedFrame, TimeRules, taken, timed_frames, utc_offset_of
from sunarc.reanalysis.messages import RefusedImageError
from sunarc.reanalysis.sources import open_source
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles
from sunarc.utc import rfc3339, to_microseconds
from sunarc.workers.night.exposures import DARK_ZENITH_DEG


class ArchiveImage(NamedTuple):
    """An image of an archive: in which file of which source, which of its frames, when and how exposed.

    time_us: microseconds since 1970-01-01 as the archive states them, brought to UTC. stamp: changes with the content.
    """

    time_us: int
    file: str
    number: int
    address: str
    exposure_us: float | None
    stamp: str

    @property
    def unix_s(self) -> float:
        """Seconds since 1970-01-01, as the archive states them."""
        return self.time_us / 1e6

    @property
    def name(self) -> str:
        """The file's name as tables show it: below its source, with the number of the frame where there are several."""
        return f"{PurePosixPath(self.address).name}/{self.file}" + (f"#{self.number}" if self.number else "")


class Failure(NamedTuple):
    """A file, or a camera, that could not be used, and why."""

    file: str
    finding: Finding


class Selector(NamedTuple):
    """Which files are a camera's: those of some sources whose names match a pattern of `fnmatch`."""

    sources: tuple[str, ...]
    files: str = "*"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPlan:
    """A camera of an archive.

    Attributes
    ----------
    name : of its folder in the output.
    site : where it stands.
    selector : which files are its.
    rules : how times are read.
    image_size : width and height, px; None for what most of its images have.
    method : see `detect_in_image`.
    options : how it is calibrated.
    """

    name: str
    site: Site
    selector: Selector
    rules: TimeRules = field(default_factory=TimeRules)
    image_size: tuple[int, int] | None = None
    method: Method = "auto"
    options: CalibrationOptions = field(default_factory=CalibrationOptions)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraImages:
    """A camera with its images.

    Attributes
    ----------
    plan : see there; of a camera that was found among others, with its own name.
    images : those by day, in the order of time and name.
    example : an image's name and time (UTC) as it was read, for confirmation.
    family : what tells the times.
    size : width and height of its images, px.
    nights : those of the night (the sun 12 degrees below the horizon or deeper), in the order of time and name.
    """

    plan: CameraPlan
    images: tuple[ArchiveImage, ...]
    example: tuple[str, str]
    family: str
    size: tuple[int, int]
    nights: tuple[ArchiveImage, ...] = ()


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


_NUMBERS = ("latitude", "longitude", "altitude")
_KEYS = {"sources", "files", "utc_offset", "time_pattern", *_NUMBERS, "image_size", "mirrored", "method"}


def read_cameras(path: Path, *, common: CameraPlan) -> list[CameraPlan]:
    """Return the cameras of a file; what it leaves out is that of the command line.

    Raises
    ------
    InputError : it is no TOML, names no camera, or something that a camera does not have.
    """
    try:
        tables = tomllib.loads(read_file(path).decode()).get("cameras", {})
    except (ValueError, AttributeError) as error:
        raise InputError(field=str(path), problem=f"is not TOML ({error})", remedy="correct it") from None
    if not isinstance(tables, dict) or not tables:
        raise InputError(field=str(path), problem="names no camera", remedy="give a table [cameras.NAME] for each")
    return [_plan(name, table, common, path) for name, table in tables.items()]


def _plan(name: str, table: object, common: CameraPlan, path: Path) -> CameraPlan:
    where = f"{path.name}, cameras.{name}"
    if not isinstance(table, dict) or set(table) - _KEYS:
        unknown = sorted(set(table) - _KEYS) if isinstance(table, dict) else [str(table)]
        problem, remedy = f"{', '.join(unknown)} is unknown", f"use {', '.join(sorted(_KEYS))}"
        raise InputError(field=where, problem=problem, remedy=remedy)
    if not name or "/" in name or name.startswith("."):
        raise InputError(field=where, problem="cannot be the name of a folder", remedy="use letters, numbers and -")
    try:
        return _filled(name, table, common, path.parent)
    except (TypeError, ValueError) as error:
        raise InputError(field=where, problem=str(error), remedy="correct it") from None


def _filled(name: str, table: Mapping[str, Any], common: CameraPlan, folder: Path) -> CameraPlan:
    sources = _get(table, "sources", lambda given: _sources(given, folder), common.selector.sources)
    rules = TimeRules(
        pattern=_get(table, "time_pattern", str, common.rules.pattern),
        offset=_get(table, "utc_offset", lambda given: utc_offset_of(given, field="utc_offset"), common.rules.offset),
    )
    site = replace(common.site, **{key: float(table[key]) for key in _NUMBERS if key in table})
    return replace(
        common,
        name=name,
        site=site,
        selector=Selector(sources, str(table.get("files", "*"))),
        rules=rules,
        image_size=_get(table, "image_size", _size, common.image_size),
        method=_get(table, "method", _one_of("auto", "disc", "paper"), common.method),
        options=replace(
            common.options, mirrored=_get(table, "mirrored", _one_of("no", "yes", "auto"), common.options.mirrored)
        ),
    )


def _get(table: Mapping[str, Any], key: str, convert: Callable[[Any], Any], default: Any) -> Any:  # noqa: ANN401
    return convert(table[key]) if key in table else default


def _sources(given: object, folder: Path) -> tuple[str, ...]:
    if not isinstance(given, list) or not given:
        raise ValueError(f"sources is {given!r}, not a list of folders or archives")
    return tuple(str(one) if "://" in str(one) else str(folder / str(one)) for one in given)


def _size(given: Sequence[Any]) -> tuple[int, int]:
    width, height = (int(number) for number in given)
    return width, height


def _one_of(*choices: str) -> Callable[[Any], str]:
    def convert(given: object) -> str:
        if given not in choices:
            raise ValueError(f"{given!r} is none of {', '.join(choices)}")
        return str(given)

    return convert


_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".jp2")
_HEADERS_READ = 100
"""Headers that the image size is decided from: most of them state it."""


class ImageFile(NamedTuple):
    """An image: its path below the folder, and its key in the archive."""

    path: str
    key: ImageKey

    @property
    def unix_s(self) -> float:
        """Seconds since 1970-01-01 UTC."""
        return self.key[0] / 1e6

    @property
    def exposure_us(self) -> float | None:
        """Exposure time; None where not known."""
        return self.key[1] or None


class Skipped(NamedTuple):
    """An image that is left out: its path below the folder, and why."""

    path: str
    finding: Finding


@dataclass(frozen=True, slots=True, kw_only=True)
class Index:
    """The images below a folder, in the order of their names.

    Attributes
    ----------
    images : those taken by day.
    nights : those taken while the sun is 12 degrees below the horizon or deeper.
    skipped : those without a time, taken at dusk, or with the name, time and exposure of one before them.
    """

    folder: Path
    images: list[ImageFile] = field(default_factory=list)
    nights: list[ImageFile] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)


def index_folder(folder: Path, *, naming: Naming, site: Site, largest_zenith_deg: float) -> Index:
    """Return the images below a folder, with their times.

    Parameters
    ----------
    folder : searched with all folders in it.
    naming : how times are read.
    site : where the camera stands.
    largest_zenith_deg : apparent zenith angle of the sun beyond which an image counts as one of the night.

    Raises
    ------
    InputError : it is no folder, or it has no images.
    """
    paths, index, known = _image_paths(folder), Index(folder=folder), set[ImageKey]()
    dated = []
    for path in paths:
        try:
            time, exposure_us = taken(folder / path, naming)
        except RefusedImageError as error:
            index.skipped.append(Skipped(path, error.finding))
            continue
        key = image_key(time, exposure_us, Path(path).name)
        if key in known:
            index.skipped.append(Skipped(path, Finding("file_copy", {"file": key[2]})))
        else:
            known.add(key)
            dated.append(ImageFile(path, key))
    for image, zenith_deg in zip(dated, zeniths_deg(dated, site), strict=True):
        if zenith_deg <= largest_zenith_deg:
            index.images.append(image)
        elif zenith_deg >= DARK_ZENITH_DEG:
            index.nights.append(image)
        else:
            index.skipped.append(Skipped(image.path, Finding("file_at_night", {"zenith_deg": zenith_deg})))
    return index


def _image_paths(folder: Path) -> list[str]:
    if not folder.is_dir():
        raise InputError(field=str(folder), problem="is not a folder", remedy="name a folder of images")
    names = (path for path in folder.rglob("*") if path.suffix.lower() in _SUFFIXES)
    found = sorted(str(path.relative_to(folder)) for path in names)
    if not found:
        raise InputError(field=str(folder), problem="has no images", remedy="name a folder of PNG, JPEG or TIFF files")
    return found


def zeniths_deg(images: Sequence[ImageFile], site: Site) -> list[float]:
    """Return the apparent zenith angle of the sun at the time of each image."""
    times = np.array([image.unix_s for image in images])
    return np.asarray(sun_angles(times, site).apparent_zenith).tolist() if images else []


def usual_size(folder: Path, images: Sequence[ImageFile]) -> tuple[int, int] | None:
    """Return the image size (width, height), px, that most headers state; None where none can be read."""
    some = images[:: len(images) // _HEADERS_READ + 1]
    counted = Counter(size for image in some if (size := image_size(folder / image.path)) is not None)
    return counted.most_common(1)[0][0] if counted else None
