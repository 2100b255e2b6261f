"""Images of the night among those of an archive: which belong to one night, and which of them are looked at."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from datetime import date
from typing import Protocol, TypeVar

import numpy as np

from sunarc.array_types import Image, evenly_spread
from sunarc.cameras.frame import Frame
from sunarc.offline.detect_files import full_scale_of
from sunarc.sky.days import solar_date
from sunarc.utc import DAY_S, utc_time

MOST_IMAGES = 60
"""Of a night, evenly over it: more say nothing new of the camera."""
_UNSTATED_US = 1e6
"""Exposure of a file that states none: a second, so that the night's zero point is that of one exposure."""


class Timed(Protocol):
    """What has a time."""

    @property
    def unix_s(self) -> float:
        """Seconds since 1970-01-01 UTC."""


Taken = TypeVar("Taken", bound=Timed)


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


def frame_of(image: Image, unix_s: float, exposure_us: float | None, number: int) -> Frame:
    """Return an image of a file as a frame of a camera.

    Parameters
    ----------
    image : pixels, of 8 or 16 bits.
    unix_s, exposure_us : when it was taken, and for how long; None where that is not stated.
    number : among those of the night.
    """
    return Frame(
        image=image,
        time=utc_time(unix_s),
        exposure_us=exposure_us or _UNSTATED_US,
        gain_db=0.0,
        pixel_format="Mono8" if image.dtype == np.uint8 else "Mono16",
        full_scale=full_scale_of(image),
        frame_id=number,
    )
