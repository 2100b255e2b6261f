"""Files named by a user: read whole, or refused in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from sunarc.common.array_types import FloatArray, Image
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import name_text, read_regular
from sunarc.optics.camera import inside_image


def read_file(path: Path) -> bytes:
    """Return a file's bytes; InputError when it cannot be read."""
    try:
        return read_regular(path)
    except OSError as error:
        raise InputError(
            field=name_text(path), problem=error.strerror or str(error), remedy="name a file that can be read"
        ) from None


def read_lines(path: Path) -> list[str]:
    """Return a text file's lines; InputError when it is not UTF-8."""
    try:
        return read_file(path).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InputError(field=name_text(path), problem="is not text", remedy="give a CSV file in UTF-8") from None


def read_image(path: Path, *, follow_exif: bool = False) -> Image:
    """Return the image of a file, the first of several, as stored or upright; InputError where it cannot be used."""
    from sunarc.sources.image_files import read_one_image  # noqa: PLC0415 - a file of numbers is read without OpenCV
    from sunarc.sources.sources import open_folder  # noqa: PLC0415

    found = read_one_image(open_folder(path.parent, follow_exif=follow_exif), name_text(path.name))
    if isinstance(found, Finding):
        raise FindingError(name_text(path), found)
    return found


_BEYOND_PX = 1.0
_MOST_BEYOND = 0.05
"""Share of a file's sightings beyond the image by more than a pixel: more are no slips, but images of another size."""


def require_inside(pixels: FloatArray, image_size: tuple[int, int], *, name: str) -> None:
    """Raise InputError where sightings, (n, 2) px, are of images of another size: many lie far outside."""
    outside = np.flatnonzero(~inside_image(pixels, image_size, beyond_px=_BEYOND_PX))
    if outside.size > _MOST_BEYOND * pixels.shape[0]:
        x, y = pixels[outside[0]]
        raise InputError(
            field=f"{name}, sighting {outside[0] + 1}",
            problem=f"pixel ({x:g}, {y:g}) is outside the {image_size[0]}x{image_size[1]} image, as are "
            f"{outside.size} of {pixels.shape[0]} (at most {_MOST_BEYOND:.0%})",
            remedy="correct the image size, or the rows",
        )


@contextmanager
def writing_into(folder: Path) -> Iterator[None]:
    """Create an output folder for a context in which a failure to write is an InputError.

    Raises
    ------
    InputError
        Where the folder or a file in it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise InputError(
            field=str(folder), problem=error.strerror or str(error), remedy="name a folder that can be written to"
        ) from None
