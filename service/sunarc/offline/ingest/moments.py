"""Images by the time at which they were taken: several of one time are a stack of exposures."""

from __future__ import annotations

from collections.abc import Iterable

from sunarc.offline.ingest.index import ImageFile

Moment = tuple[ImageFile, ...]
"""All images of one time, in the order of their names."""

MOST_EXPOSURES = 32
"""More images of one time are no stack, but a series whose names say too little of the time."""


def moments_of(images: Iterable[ImageFile]) -> list[Moment]:
    """Return the images grouped by their time; too many for a stack stand alone."""
    by_time: dict[int, list[ImageFile]] = {}
    for image in images:
        by_time.setdefault(image.key[0], []).append(image)
    moments = list[Moment]()
    for members in by_time.values():
        moments += [tuple(members)] if len(members) <= MOST_EXPOSURES else [(image,) for image in members]
    return moments
