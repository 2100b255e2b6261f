"""Trials of `sunarc init`: pictures at hand, and whether the sun in them is up at the given site."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import PurePosixPath

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import FloatArray, Image
from sunarc.common.findings import Finding, FindingError
from sunarc.detection.values import Detection
from sunarc.imaging.preview import preview
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles
from sunarc.sources.detect_files import detect_in_image
from sunarc.sources.file_kinds import find_kind, is_derived
from sunarc.sources.image_files import read_one_image
from sunarc.sources.image_times import TimeRules, timed_frames
from sunarc.sources.name_times import time_in_name
from sunarc.sources.source_files import ImageSource


@dataclass(frozen=True, slots=True, kw_only=True)
class TriedPicture:
    """Result of a picture of the source.

    Attributes
    ----------
    name : of its file, or its address.
    size : width and height, px; None where it cannot be read.
    time : when it was taken, aware; None where nothing states it.
    rule : what states the time ("EXIF", "Allsky" …), "" where nothing does.
    found : the sun that was looked for; None where there is no image.
    faults : why there is no image, or no time.
    """

    name: str
    size: tuple[int, int] | None = None
    time: datetime | None = None
    rule: str = ""
    found: Detection | None = None
    faults: tuple[Finding, ...] = ()

    @property
    def shows_sun(self) -> bool:
        """True where a sun was found in it."""
        return self.found is not None and self.found.accepted

    def describe(self) -> str:
        """Return the result in a sentence."""
        size = "" if self.size is None else f"{self.size[0]}x{self.size[1]} px; "
        when = "" if self.time is None else f"taken {self.time:%Y-%m-%d %H:%M:%S} UTC by {self.rule}; "
        sun = ""
        if self.found is not None:
            at = f"sun found at ({self.found.x_px:.0f}, {self.found.y_px:.0f})" if self.shows_sun else "no sun found"
            sun = at if self.shows_sun else f"{at}: {self.found.reason}"
        faults = "; ".join(f"{one.text}: {one.remedy} [{one.code}]" for one in self.faults)
        return "; ".join(part for part in (f"{size}{when}{sun}".rstrip("; "), faults) if part)


_GOLDEN = 0.6180339887498949
"""Steps of this share of a list, modulo 1, come everywhere in it, and in no step with the hours of a day."""


def try_pictures(
    source: ImageSource,
    names: Sequence[str],
    rules: TimeRules,
    *,
    most: int,
    on_image: Callable[[TriedPicture, Image], None],
) -> Iterator[TriedPicture]:
    """Yield the results of pictures of a source: the last one, then others from everywhere in the list.

    Where names state times, pictures whose name states none (a copy of the newest one) are left out.

    Parameters
    ----------
    source, names : the files, in the order of their names.
    rules : how their times are read.
    most : number of pictures that are read.
    on_image : called with the first picture that can be read, and its image.
    """
    every_picture = [name for name in names if find_kind(name) is not None and not is_derived(name)]
    pictures = [name for name in every_picture if time_in_name(name) is not None] or every_picture
    chosen = [len(pictures) - 1, *(int(len(pictures) * ((k * _GOLDEN) % 1.0)) for k in range(1, most))]
    every, shown = frozenset(names), False
    for number in dict.fromkeys(chosen) if pictures else ():
        tried, image = _try_picture(source, pictures[number], rules, every)
        if image is not None and not shown:
            shown = True
            on_image(tried, image)
        yield tried


def _try_picture(
    source: ImageSource, name: str, rules: TimeRules, names: Collection[str]
) -> tuple[TriedPicture, Image | None]:
    tried = TriedPicture(name=PurePosixPath(name).name)
    try:
        frame = timed_frames(source, name, rules, names=names)[-1]
        tried = replace(tried, time=frame.time, rule=frame.family)
        number = frame.number
    except FindingError as error:
        tried, number = replace(tried, faults=(error.finding,)), 0
    image = read_one_image(source, name, number)
    if isinstance(image, Finding):
        return replace(tried, faults=tuple({one.code: one for one in (*tried.faults, image)}.values())), None
    return look_for_sun(tried, image), image


def look_for_sun(tried: TriedPicture, image: Image) -> TriedPicture:
    """Return the result of a picture with its size, and the sun in it."""
    return replace(tried, size=(image.shape[1], image.shape[0]), found=detect_in_image(image))


_HORIZON_DEG = 91.5
"""Apparent zenith angle beyond which the sun is not seen: refraction, the disc, and the dip of a mountain's horizon."""
_EXPLAINED = 0.25
"""A site explains the suns that are down when at most this share of them is down there."""
_LEAST_NAMED = 3
"""Suns that are down for a slip to be named: one or two may be the moon."""
_MOST_LIGHTS = 0.5
"""Share of suns that are down beyond which no moon explains it."""


def judge_site(pictures: Sequence[TriedPicture], site: Site) -> Finding:
    """Return whether the sun is up at a site in the pictures that show it, and if not, with which slip it would be.

    A longitude that is wrong by some degrees, or a latitude by any, mostly leaves the sun up: that is not seen here.
    """
    times = [one.time.timestamp() for one in pictures if one.shows_sun and one.time is not None]
    if not times:
        return Finding("site_not_held")
    below = _count_below_horizon(np.array(times), site)
    if below == 0:
        return Finding("site_agrees", {"suns": len(times)})
    explaining = [slip for slip, then in _find_slips(np.array(times), site, below) if then <= _EXPLAINED * below]
    if len(explaining) == 1 and below >= _LEAST_NAMED:
        return explaining[0]
    if below > _MOST_LIGHTS * len(times):
        return Finding("site_sun_down", {"below": below, "suns": len(times)})
    return Finding("site_sun_down_in_some", {"below": below, "suns": len(times)})


def _find_slips(times: FloatArray, site: Site, below: int) -> Iterator[tuple[Finding, int]]:
    """Yield the slips that may have been made, each with the number of suns that would then be below the horizon."""
    suns, north, east = times.size, site.latitude, site.longitude
    then = _count_below_horizon(times, replace(site, longitude=-east))
    yield (
        Finding("site_longitude_sign", {"below": below, "suns": suns, "below_then": then, "longitude": -east}),
        then,
    )
    then = _count_below_horizon(times, replace(site, latitude=-north))
    yield Finding("site_latitude_sign", {"below": below, "suns": suns, "below_then": then, "latitude": -north}), then
    if abs(east) <= 90.0:
        then = _count_below_horizon(times, replace(site, latitude=east, longitude=north))
        yield (
            Finding(
                "site_swapped",
                {"below": below, "suns": suns, "below_then": then, "latitude": east, "longitude": north},
            ),
            then,
        )


def _count_below_horizon(times: FloatArray, site: Site) -> int:
    return int(np.count_nonzero(np.asarray(sun_angles(times, site).apparent_zenith) > _HORIZON_DEG))


_SMALL_SIDE = 480
_GREEN, _ORANGE = (0, 200, 0), (0, 140, 255)


def small_picture(image: Image, found: Detection | None) -> bytes:
    """Return a PNG of at most 480 px with a circle about the sun: green where it is accepted, else orange."""
    canvas: NDArray[np.uint8] = preview(image) if image.ndim == 2 else _convert_to_eight_bits(image)
    scale = min(1.0, _SMALL_SIDE / max(canvas.shape[:2]))
    size = max(1, round(scale * canvas.shape[1])), max(1, round(scale * canvas.shape[0]))
    small = cv2.resize(canvas, size, interpolation=cv2.INTER_AREA)
    if small.ndim == 2:
        small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    if found is not None and found.x_px is not None and found.y_px is not None:
        radius = max(round(2.0 * scale * (found.radius_px or 0.0)), 10)
        at = round(scale * found.x_px), round(scale * found.y_px)
        cv2.circle(small, at, radius, _GREEN if found.accepted else _ORANGE, 2, cv2.LINE_AA)
    return cv2.imencode(".png", small)[1].tobytes()


def _convert_to_eight_bits(image: Image) -> NDArray[np.uint8]:
    return image if image.dtype == np.uint8 else (image // 256).astype(np.uint8)  # type: ignore[return-value]
