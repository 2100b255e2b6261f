"""Files by camera, and the images in them with their times; the unusable ones, and why."""

from __future__ import annotations

import itertools
import math
import tomllib
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, Protocol, TypeVar, get_args

import numpy as np

from sunarc.calibration.model.options import CalibrationOptions, Mirrored
from sunarc.common.array_types import evenly_spread
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import MOST_BYTES, name_path, name_text
from sunarc.common.utc import DAY_S, rfc3339, to_microseconds
from sunarc.optics.projections import PROJECTIONS
from sunarc.sky.days import solar_date
from sunarc.sky.site import Site
from sunarc.sky.sun import DARK_ZENITH_DEG, sun_angles
from sunarc.sources.detect_files import Method
from sunarc.sources.file_kinds import ONE_IMAGE, find_kind, is_derived, unread_finding
from sunarc.sources.files import read_file
from sunarc.sources.image_files import UPRIGHT, exif_orientation, follows_exif, image_size
from sunarc.sources.image_key import ImageKey, image_key
from sunarc.sources.image_times import TimedFrame, TimeRules, parse_utc_offset, timed_frames
from sunarc.sources.source_files import ImageSource, SourceFile, stored_address
from sunarc.sources.sources import content_hash, open_source, upright_addresses
from sunarc.sources.time_patterns import checked_pattern

ReportProgress = Callable[[str, int, int], None]

MOST_IMAGES = 60
"""Of a night, evenly over it: more say nothing new of the camera."""
Taken = TypeVar("Taken", bound="Timed")


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
    def path(self) -> str:
        """The file's path below its source, with the number of the frame where there are several."""
        return self.file + (f"#{self.number}" if self.number else "")

    @property
    def name(self) -> str:
        """Label for display: the path, with the name of its source before it."""
        return _show_path(self.address, self.path)

    @property
    def named(self) -> ImageKey:
        """Common name of an image's copies: its key without the folder."""
        return self.key._replace(folder="")

    @property
    def key(self) -> ImageKey:
        """Key that distinguishes it from other images of its camera."""
        return image_key(self.time_us, self.exposure_us, self.path)


def _show_path(address: str, path: str) -> str:
    return f"{PurePosixPath(address).name}/{path}"


class Failure(NamedTuple):
    """A file, or a camera, that could not be used, and why."""

    file: str
    finding: Finding


class Selector(NamedTuple):
    """Which files are a camera's: those of some sources whose names match a pattern of `fnmatch`.

    only: their paths below the source, where some are chosen of them; None for all.
    """

    sources: tuple[str, ...]
    files: str = "*"
    only: frozenset[str] | None = None

    def takes(self, name: str) -> bool:
        """Return whether a file, by its path below its source, belongs to the camera."""
        chosen = self.only is None or name in self.only
        return chosen and fnmatch(PurePosixPath(name).name, self.files)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPlan:
    """A camera of an archive.

    Attributes
    ----------
    name : of its folder in the output.
    part_of : the camera whose images of one size these are; None where all have one size.
    site : where it stands.
    selector : which files are its.
    rules : how times are read.
    image_size : width and height, px; None for what most of its images have.
    method : see `detect_in_image`.
    options : how it is calibrated.
    clock_error_s : bound of the error of its times, s; None where none is stated.
    calibration : file of the document that the search for its states begins with; None for none.
    largest_zenith_deg : apparent zenith angle of the sun beyond which an image is not one of the day.
    stacks : whether images of one time are exposures of one scene, with one sighting.
    one_by_one : whether each is a unit of work, so that a run that is ended loses few.
    """

    name: str
    site: Site
    selector: Selector
    rules: TimeRules = field(default_factory=TimeRules)
    image_size: tuple[int, int] | None = None
    method: Method = "auto"
    options: CalibrationOptions = field(default_factory=CalibrationOptions)
    clock_error_s: float | None = None
    calibration: Path | None = None
    largest_zenith_deg: float = 90.0
    part_of: str | None = None
    stacks: bool = False
    one_by_one: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraImages:
    """A camera with its images.

    Attributes
    ----------
    plan : see there; of a camera that was found among others, with its own name.
    images : those by day, in the order of time and name.
    example : an image's name and time (UTC) as it was read, for confirmation.
    family : what states the times.
    size : width and height of its images, px.
    nights : those of the night (the sun 12 degrees below the horizon or deeper), in the order of time and name.
    dusk : those between, which are left out.
    findings : about its files.
    """

    plan: CameraPlan
    images: tuple[ArchiveImage, ...]
    example: tuple[str, str]
    family: str
    size: tuple[int, int]
    nights: tuple[ArchiveImage, ...] = ()
    dusk: tuple[ArchiveImage, ...] = ()
    findings: tuple[Finding, ...] = ()


_SAMPLED = 40
"""Images of a camera whose header is read: most of them have the size and orientation of the camera."""
_OTHER_SIZE = 0.1
"""Share of these that has another size, from which all are read: the picture was resized on some day."""
_FEWEST_OF_SIZE = 5
"""Images of a size that are analysed as a camera of their own."""
_MOST_COPIES = 0.2
"""Share of a camera's images with others of the same name and time, from which they are those of two cameras."""


class Indexed(NamedTuple):
    """Cameras with images, files that cannot be used, and cameras that are refused."""

    cameras: list[CameraImages]
    failures: list[Failure]
    refused: list[Failure]

    @property
    def untimed(self) -> list[Failure]:
        """Frames that state no time where they have to: FITS. Other pictures in a folder may have none by right."""
        unknown = [one for one in self.failures if one.finding.code == "file_time_unknown"]
        return [one for one in unknown if find_kind(one.file) == "fits"]


class _DatedImage(NamedTuple):
    image: ArchiveImage
    frame: TimedFrame


def index_archive(plans: Sequence[CameraPlan]) -> Indexed:
    """Return the images of all cameras.

    Files of one plan whose names differ before their times are those of several cameras: each becomes one of its own.
    An image is used once: a copy (same name, time and exposure) is left out.

    Raises
    ------
    InputError : a source cannot be opened.
    """
    indexed, taken = Indexed([], [], []), {plan.name for plan in plans}
    for plan in plans:
        found, failed = _date_all_images(plan)
        indexed.failures.extend(Failure(_show_path(address, file), finding) for address, file, finding in failed)
        taken.discard(plan.name)
        by_prefix = defaultdict(list)
        for one in found:
            by_prefix[one.frame.prefix].append(one)
        for prefix, members in sorted(by_prefix.items()):
            named = plan if len(by_prefix) == 1 else replace(plan, name=_make_camera_name(plan.name, prefix, taken))
            for sized, of_size, notes in _split_by_size(named, members, taken):
                taken.add(sized.name)
                _add_camera(indexed, sized, of_size, notes)
        if not found:
            unmatched = Finding("camera_without_files", {"files": plan.selector.files})
            indexed.refused.append(Failure(plan.name, Finding("camera_without_images") if failed else unmatched))
    indexed.failures.sort(key=lambda failure: (failure.file, failure.finding.code))
    return indexed


def _split_by_size(
    plan: CameraPlan, members: list[_DatedImage], taken: Container[str]
) -> Iterator[tuple[CameraPlan, list[_DatedImage], tuple[Finding, ...]]]:
    """Yield images by their size where that changed, the most frequent one first; each with a lens of its own.

    Where one size follows the other they are states of one camera, else those of several. Images of a size that hardly
    any has stay with the first, which refuses them.
    """
    some = _sample_images([one.image for one in members])
    sampled = Counter(map(_read_stated_size, some))
    others = [size for size, n in sampled.most_common()[1:] if size is not None and n >= _OTHER_SIZE * len(some)]
    if plan.image_size is not None or not others:
        yield plan, members, ()
        return
    of_size: dict[tuple[int, int] | None, list[_DatedImage]] = defaultdict(list)
    for one in members:
        of_size[_read_stated_size(one.image)].append(one)
    large = {size: found for size, found in of_size.items() if size is not None and len(found) >= _FEWEST_OF_SIZE}
    if not large:
        yield plan, members, ()
        return
    usual, *rest = sorted(large, key=lambda size: -len(large[size]))
    changed = tuple(_make_resized_finding(size, large[size]) for size in rest)
    few = [one for size, found in of_size.items() if size not in large for one in found]
    of = plan.name if _are_consecutive(list(large.values())) else None
    parts = [(replace(plan, image_size=usual, part_of=of), [*large[usual], *few], changed)]
    for size, finding in zip(rest, changed, strict=True):
        name = new_camera_name(f"{plan.name}-{size[0]}x{size[1]}", taken=taken)
        parts.append((replace(plan, name=name, image_size=size, part_of=of), large[size], (finding,)))
    yield from parts if of is None else sorted(parts, key=lambda part: min(one.frame.time for one in part[1]))


def _are_consecutive(parts: Sequence[Sequence[_DatedImage]]) -> bool:
    """Return whether no part begins before another one ends, as the images of a camera whose picture was resized."""
    spans = sorted((min(one.frame.time for one in part), max(one.frame.time for one in part)) for part in parts)
    return all(before[1] < after[0] for before, after in itertools.pairwise(spans))


def _make_resized_finding(size: tuple[int, int], found: Sequence[_DatedImage]) -> Finding:
    first = rfc3339(min(one.frame.time for one in found), timespec="seconds")
    return Finding("image_size_changed", {"n": len(found), "width": size[0], "height": size[1], "first": first})


def _make_camera_name(name: str, prefix: str, taken: Container[str]) -> str:
    cleaned = "".join(letter if letter.isalnum() else "-" for letter in prefix).strip("-")
    return new_camera_name(f"{name}-{cleaned}" if cleaned else name, taken=taken)


_LONGEST_NAME = 120
"""Of a camera, bytes: folders and files of its results are named after it, and a name has 255 at most."""


def new_camera_name(wanted: str, *, taken: Container[str]) -> str:
    """Return a camera's name like the wanted one, short enough for the names of files, and not taken yet."""
    name = wanted.encode()[:_LONGEST_NAME].decode(errors="ignore")
    others = (f"{name}-{number}" for number in itertools.count(2))
    return next(one for one in itertools.chain([name], others) if one not in taken)


def index_folder(plan: CameraPlan) -> tuple[CameraImages, list[Failure]]:
    """Return the images of a plan's folder as those of one camera, and the omitted files by their path below it.

    Raises
    ------
    InputError : it is no folder, or has no images.
    """
    folder = stored_address(plan.selector.sources[0])
    if not Path(name_path(folder)).is_dir():
        raise InputError(field=folder, problem="is no folder", remedy="name a folder of images")
    found, failed = _date_all_images(plan)
    if not found and not failed and plan.selector.only is None:
        raise InputError(field=folder, problem="has no images", remedy="name a folder of PNG, JPEG or TIFF files")
    images, copies = _separate_copies(sorted(one.image for one in found), same=_content_hash)
    parts = _split_by_sun(images, plan, nights=True)
    left_out = [
        *((file, finding) for _, file, finding in failed),
        *((one.path, _copy_finding(one)) for one in copies),
        *((one.path, finding) for one, finding in parts.dusk),
    ]
    size = plan.image_size or _find_usual_size(parts.day) or (0, 0)
    orientation = _find_orientation(parts.day)
    camera = CameraImages(
        plan=plan,
        images=parts.day,
        example=("", ""),
        family="",
        size=size,
        nights=parts.night,
        findings=() if orientation is None else (orientation,),
    )
    return camera, [Failure(path, finding) for path, finding in left_out]


def _date_all_images(plan: CameraPlan) -> tuple[list[_DatedImage], list[tuple[str, str, Finding]]]:
    """Return the images of a plan's sources, and address, name and finding of the files that state no time."""
    found, failed = list[_DatedImage](), list[tuple[str, str, Finding]]()
    for address in plan.selector.sources:
        source = open_source(address)
        files = list(source.files())
        names = {file.name for file in files}
        for file in files:
            if not plan.selector.takes(file.name) or is_derived(file.name):
                continue
            if find_kind(file.name) is None:
                unread = unread_finding(file.name)
                failed += [] if unread is None else [(address, file.name, unread)]
                continue
            try:
                found += list(_date_images(source, file, plan, names))
            except FindingError as error:
                failed.append((address, file.name, error.finding))
    return found, failed


def _date_images(source: ImageSource, file: SourceFile, plan: CameraPlan, names: set[str]) -> Iterator[_DatedImage]:
    if file.size > MOST_BYTES and find_kind(file.name) in ONE_IMAGE:
        raise FindingError(file.name, Finding("file_too_large", {"bytes": file.size, "most": MOST_BYTES}))
    for frame in timed_frames(source, file.name, plan.rules, names=names):
        time_us = to_microseconds(frame.time)
        stamp = f"{file.size}-{file.stamp}"
        yield _DatedImage(
            ArchiveImage(time_us, file.name, frame.number, source.address, frame.exposure_us, stamp), frame
        )


def _add_camera(indexed: Indexed, plan: CameraPlan, members: list[_DatedImage], notes: tuple[Finding, ...]) -> None:
    """Add a camera with its images by day, or the reason why it has none."""
    images, copies = _separate_copies(sorted(one.image for one in members))
    if len(copies) > _MOST_COPIES * len(members):
        mixed: dict[str, float | int | str] = {
            "copies": len(copies),
            "images": len(members),
            "file": copies[0].name,
            "other": next(one.name for one in images if one.named == copies[0].named),
        }
        indexed.refused.append(Failure(plan.name, Finding("cameras_mixed", mixed)))
        return
    indexed.failures.extend(Failure(one.name, _copy_finding(one)) for one in copies)
    parts = _split_by_sun(images, plan, nights=True)
    usual = parts.day or parts.night
    indexed.failures.extend(Failure(one.name, finding) for one, finding in parts.dusk)
    if not usual:
        indexed.refused.append(Failure(plan.name, all_at_night(images, plan.site)))
        return
    size = plan.image_size or _find_usual_size(usual)
    if size is None:
        indexed.refused.append(Failure(plan.name, Finding("camera_without_images")))
        return
    first, orientation = members[0], _find_orientation(usual)
    example = (first.image.name, rfc3339(first.frame.time, timespec="seconds"))
    families = Counter(one.frame.family for one in members).most_common(1)
    indexed.cameras.append(
        CameraImages(
            plan=plan,
            images=parts.day,
            example=example,
            family=families[0][0],
            size=size,
            nights=parts.night,
            dusk=tuple(one for one, _ in parts.dusk),
            findings=notes if orientation is None else (orientation, *notes),
        )
    )


class _SunParts(NamedTuple):
    """Images of the day, of the night, and those of neither, with the finding why."""

    day: tuple[ArchiveImage, ...]
    night: tuple[ArchiveImage, ...]
    dusk: list[tuple[ArchiveImage, Finding]]


def _split_by_sun(images: Sequence[ArchiveImage], plan: CameraPlan, *, nights: bool) -> _SunParts:
    """Return images by the sun's height: of the night where it is 12 degrees below the horizon or deeper."""
    zenith = zeniths_deg(images, plan.site)
    darkest = DARK_ZENITH_DEG if nights else math.inf
    pairs = list(zip(images, zenith, strict=True))
    return _SunParts(
        tuple(one for one, angle in pairs if angle <= plan.largest_zenith_deg),
        tuple(one for one, angle in pairs if angle >= darkest),
        [(one, at_night(angle)) for one, angle in pairs if plan.largest_zenith_deg < angle < darkest],
    )


def zeniths_deg(images: Sequence[ArchiveImage], site: Site) -> list[float]:
    """Return the apparent zenith angle of the sun at the time of each image."""
    times = np.array([image.unix_s for image in images])
    return np.asarray(sun_angles(times, site).apparent_zenith).tolist() if images else []


def at_night(zenith_deg: float) -> Finding:
    """Return why an image is left out at whose time the sun was too low."""
    return Finding("file_at_night", {"zenith_deg": zenith_deg})


def all_at_night(images: Sequence[ArchiveImage], site: Site) -> Finding:
    """Return that the sun was below the horizon in all of a camera's images, with its median zenith angle."""
    zenith = float(np.median(zeniths_deg(images, site)))
    return Finding("camera_at_night", {"images": len(images), "zenith_deg": zenith})


def _separate_copies(
    images: Sequence[ArchiveImage], *, same: Callable[[ArchiveImage], object] = lambda _: None
) -> tuple[list[ArchiveImage], list[ArchiveImage]]:
    """Return images, and the copies of those before them: of the same name, time and exposure.

    Parameters
    ----------
    images : sorted.
    same : what copies have in common besides; asked of images with another of their name, time and exposure.
    """
    alike = Counter(image.named for image in images)
    single: dict[tuple[object, ...], ArchiveImage] = {}
    copies = []
    for image in images:
        key = (image.named, same(image) if alike[image.named] > 1 else None)
        if single.setdefault(key, image) is not image:
            copies.append(image)
    return list(single.values()), copies


def _content_hash(image: ArchiveImage) -> str:
    """Return the hash of the content of an image's file; of one that cannot be read its path."""
    try:
        return content_hash(open_source(image.address).read(image.file))
    except OSError:
        return image.path


def _copy_finding(copy: ArchiveImage) -> Finding:
    return Finding("file_copy", {"file": PurePosixPath(copy.file).name})


def _find_usual_size(images: Sequence[ArchiveImage]) -> tuple[int, int] | None:
    """Return the size (width, height) that most of some images have; None where none can be read."""
    counted = Counter(size for size in map(_read_stated_size, _sample_images(images)) if size is not None)
    return counted.most_common(1)[0][0] if counted else None


def _sample_images(images: Sequence[Taken]) -> Sequence[Taken]:
    return images[:: len(images) // _SAMPLED + 1]


def _read_stated_size(image: ArchiveImage) -> tuple[int, int] | None:
    return image_size(open_source(image.address), image.file, image.number)


def _find_orientation(images: Sequence[ArchiveImage]) -> Finding | None:
    """Return the orientation that EXIF states of a camera's images; None where it is upright."""
    some = _sample_images(images)
    turned = Counter(
        UPRIGHT if follows_exif(one.address) else exif_orientation(open_source(one.address), one.file) for one in some
    )
    upright = turned.pop(UPRIGHT, 0)
    if not turned:
        return None
    stated = turned.most_common(1)[0][0]
    return Finding("file_rotated", {"orientation": stated, "n": len(some) - upright, "of": len(some)})


_NUMBERS = ("latitude", "longitude", "altitude")
_KEYS = {
    "sources", "files", "utc_offset", "time_pattern", *_NUMBERS, "image_size", "projection", "mirrored", "level_within",
    "method", "clock_error", "calibration", "follow_exif",
}  # fmt: skip


def read_cameras(
    path: Path, *, common: CameraPlan, required: Collection[str] = (), follow_exif: bool = False
) -> list[CameraPlan]:
    """Return the cameras of a file; keys left out are those of the command line, but for the required ones of each.

    Raises
    ------
    InputError : it is no TOML, names no camera, something that a camera does not have, or not what is required.
    """
    try:
        tables = tomllib.loads(read_file(path).decode()).get("cameras", {})
    except (ValueError, AttributeError, RecursionError) as error:
        raise InputError(field=str(path), problem=f"is not TOML ({error})", remedy="correct it") from None
    if not isinstance(tables, dict) or not tables:
        raise InputError(field=str(path), problem="names no camera", remedy="give a table [cameras.NAME] for each")
    for name, table in tables.items():
        for key in required:
            if isinstance(table, dict) and key not in table:
                where = f"{path.name}, cameras.{name}"
                raise InputError(field=where, problem=f"has no {key}", remedy=f"give it there, or --{key}")
    turned = {"follow_exif": follow_exif}
    return [
        _parse_plan(name, turned | table if isinstance(table, dict) else table, common, path)
        for name, table in tables.items()
    ]


def _parse_plan(name: str, table: object, common: CameraPlan, path: Path) -> CameraPlan:
    where = f"{path.name}, cameras.{name}"
    if not isinstance(table, dict) or set(table) - _KEYS:
        unknown = sorted(set(table) - _KEYS) if isinstance(table, dict) else [str(table)]
        problem, remedy = f"{', '.join(unknown)} is unknown", f"use {', '.join(sorted(_KEYS))}"
        raise InputError(field=where, problem=problem, remedy=remedy)
    if not name or "/" in name or name.startswith(".") or len(name.encode()) > _LONGEST_NAME:
        raise InputError(field=where, problem="cannot be the name of a folder", remedy="use letters, numbers and -")
    try:
        return _fill_plan(name, table, common, path.parent)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(field=where, problem=str(error), remedy="correct it") from None


def _fill_plan(name: str, table: Mapping[str, Any], common: CameraPlan, folder: Path) -> CameraPlan:
    sources = _get_converted(table, "sources", lambda given: _parse_sources(given, folder), common.selector.sources)
    if _get_converted(table, "follow_exif", _parse_flag, False):
        sources = upright_addresses(sources)
    rules = TimeRules(
        pattern=_get_converted(table, "time_pattern", _parse_pattern, common.rules.pattern),
        offset=_get_converted(
            table, "utc_offset", lambda given: parse_utc_offset(given, field="utc_offset"), common.rules.offset
        ),
    )
    site = replace(common.site, **{key: float(table[key]) for key in _NUMBERS if key in table})
    return replace(
        common,
        name=name,
        site=site,
        selector=Selector(sources, str(table.get("files", "*"))),
        rules=rules,
        image_size=_get_converted(table, "image_size", _parse_size, common.image_size),
        clock_error_s=_get_converted(table, "clock_error", clock_bound_s, common.clock_error_s),
        calibration=_get_converted(table, "calibration", lambda given: folder / str(given), common.calibration),
        method=_get_converted(table, "method", _make_choice_check("auto", "disc", "paper"), common.method),
        options=replace(
            common.options,
            projection=_choose_statement(
                table, "projection", (*PROJECTIONS, "auto"), common.options.projection, unstated="auto"
            ),
            mirrored=_choose_statement(table, "mirrored", get_args(Mirrored), common.options.mirrored, unstated=None),
            level_within_deg=_get_converted(table, "level_within", float, common.options.level_within_deg),
        ),
    )


def _parse_flag(given: object) -> bool:
    if not isinstance(given, bool):
        raise ValueError(f"follow_exif is {given!r}, neither true nor false")  # noqa: TRY004 - of a file's table
    return given


def _parse_pattern(given: object) -> str:
    return checked_pattern(str(given), field="time_pattern")


def _choose_statement(
    table: Mapping[str, Any],
    key: str,
    choices: Sequence[str],
    common: Any,  # noqa: ANN401
    *,
    unstated: str | None,
) -> Any:  # noqa: ANN401
    """Return the statement of a camera or the command line; ValueError where both state it, and differently."""
    found = _get_converted(table, key, _make_choice_check(*choices), common)
    if common not in {unstated, found}:
        raise ValueError(f"{key} is {found!r}, where --{key} {common} is given; give it in one place")
    return found


_MOST_CLOCK_S = DAY_S
"""A clock that is off by more than a day has no bound."""


def clock_bound_s(given: float | str) -> float:
    """Return the bound of a clock's error, s, from 0 to a day."""
    bound_s = float(given)
    if not 0.0 <= bound_s <= _MOST_CLOCK_S:
        raise ValueError(f"clock_error is {bound_s:g}, not within 0 to {_MOST_CLOCK_S:g} s")
    return bound_s


def _get_converted(table: Mapping[str, Any], key: str, convert: Callable[[Any], Any], default: Any) -> Any:  # noqa: ANN401
    return convert(table[key]) if key in table else default


def _parse_sources(given: object, folder: Path) -> tuple[str, ...]:
    if not isinstance(given, list) or not given:
        raise ValueError(f"sources is {given!r}, not a list of folders or archives")
    return tuple(str(one) if "://" in str(one) else name_text(folder / str(one)) for one in given)


def _parse_size(given: Sequence[Any]) -> tuple[int, int]:
    width, height = (int(number) for number in given)
    return width, height


def _make_choice_check(*choices: str) -> Callable[[Any], str]:
    def convert(given: object) -> str:
        if given not in choices:
            raise ValueError(f"{given!r} is none of {', '.join(choices)}")
        return str(given)

    return convert


class Timed(Protocol):
    """Object with a time."""

    @property
    def unix_s(self) -> float:
        """Seconds since 1970-01-01 UTC."""


def by_night(images: Iterable[Taken], *, longitude: float) -> list[tuple[date, list[Taken]]]:
    """Return images by the solar date of the evening before them, nights and images in the order of their times.

    Parameters
    ----------
    images : in any order.
    longitude : of the camera, degrees, east positive.
    """
    nights: dict[date, list[Taken]] = defaultdict(list)
    for image in sorted(images, key=lambda one: one.unix_s):
        nights[solar_date(image.unix_s - 0.5 * DAY_S, longitude=longitude)].append(image)
    return sorted(nights.items())


def evenly(images: Sequence[Taken]) -> list[Taken]:
    """Return at most 60 of a night's images, spread over it."""
    return [images[row] for row in evenly_spread(len(images), most=MOST_IMAGES).tolist()]
