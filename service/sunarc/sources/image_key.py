"""Key of an image: its time, exposure, name and folder."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import NamedTuple


class ImageKey(NamedTuple):
    """Key that distinguishes an image from others of its camera.

    time_us: microseconds since 1970-01-01 UTC. exposure_us: 0 where not known. file: its name, empty where not known
    (version 0.2). folder: below its source, "." for the source itself; empty where not known (revision 0019).
    """

    time_us: int
    exposure_us: float
    file: str
    folder: str = ""


def image_key(time_us: int, exposure_us: float | None, path: str) -> ImageKey:
    """Return the key of an image by its file's path below the source."""
    file = PurePosixPath(path)
    return ImageKey(time_us, exposure_us or 0.0, file.name, file.parent.as_posix())
