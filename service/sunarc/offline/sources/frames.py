"""The images in a file: one in a picture or a FITS file, many in a NetCDF file or a video."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from pathlib import PurePosixPath
from typing import Literal, NamedTuple

from sunarc.array_types import Image
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.imaging.metadata import document_of
from sunarc.offline.ingest.image_checks import checked_image
from sunarc.offline.messages import RefusedImageError
from sunarc.offline.sources.values import ImageSource

Kind = Literal["picture", "fits", "netcdf", "video"]
_KINDS: dict[str, Kind] = {
    **dict.fromkeys((".png", ".jpg", ".jpeg", ".tif", ".tiff", ".jp2"), "picture"),
    **dict.fromkeys((".fits", ".fit", ".fts"), "fits"),
    **dict.fromkeys((".nc", ".nc4"), "netcdf"),
    **dict.fromkeys((".mp4", ".m4v", ".mov", ".avi"), "video"),
}
MOST_BYTES = 1 << 30
"""Size of a file that is still read: larger ones are no images, and would take a worker's memory."""
_HEAD_BYTES = 1 << 17


class Frame(NamedTuple):
    """An image in a file: its number there, its mid-exposure time (aware, UTC) and exposure, None where not known."""

    number: int
    time: datetime | None = None
    exposure_us: float | None = None


def kind_of(name: str) -> Kind | None:
    """Return the kind of a file by its name; None for one that holds no images."""
    return _KINDS.get(PurePosixPath(name).suffix.lower())


def frames_in(source: ImageSource, name: str, *, sidecar: Callable[[], bytes | None]) -> list[Frame]:
    """Return the images in a file; a picture is not read for that.

    Parameters
    ----------
    source, name : the file.
    sidecar : reads the JSON file beside it; None where there is none.

    Raises
    ------
    RefusedImageError : it cannot be read, or does not tell when its images were taken.
    """
    kind = kind_of(name)
    if kind == "fits":
        from sunarc.offline.sources.fits_file import fits_frame  # noqa: PLC0415 - its library only where it is needed

        return [fits_frame(_content(source, name), name)]
    if kind == "netcdf":
        from sunarc.offline.sources.netcdf_file import netcdf_frames  # noqa: PLC0415

        return netcdf_frames(source.path(name) or _content(source, name), name)
    if kind == "video":
        from sunarc.offline.sources.video_file import video_frames  # noqa: PLC0415

        return video_frames(source.path(name) or _content(source, name), name, sidecar=sidecar())
    return [Frame(0)]


def images_in(
    source: ImageSource, name: str, numbers: Sequence[int], *, size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    """Yield images of a file, each with its number; one that cannot be used gives the finding why.

    Parameters
    ----------
    source, name : the file.
    numbers : of the images, ascending.
    size : width and height that they must have, px; None for any.
    """
    try:
        yield from _images(source, name, numbers, size)
    except RefusedImageError as error:
        yield from ((number, error.finding) for number in numbers)
    except InputError as error:  # an extra is missing
        unread = Finding("file_not_image", {"error": f"{error.problem}; {error.remedy}"})
        yield from ((number, unread) for number in numbers)


def _images(
    source: ImageSource, name: str, numbers: Sequence[int], size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    kind = kind_of(name)
    if kind == "fits":
        from sunarc.offline.sources.fits_file import fits_image  # noqa: PLC0415 - its library only where it is needed

        yield numbers[0], fits_image(_content(source, name), name, size=size)
    elif kind == "netcdf":
        from sunarc.offline.sources.netcdf_file import netcdf_images  # noqa: PLC0415

        yield from netcdf_images(source.path(name) or _content(source, name), name, numbers, size=size)
    elif kind == "video":
        from sunarc.offline.sources.video_file import video_images  # noqa: PLC0415

        yield from video_images(source.path(name) or _content(source, name), name, numbers, size=size)
    else:
        content = _content(source, name)
        if (document_of(content[:_HEAD_BYTES]) or {}).get("preview"):
            raise RefusedImageError(name, Finding("file_preview"))
        yield numbers[0], checked_image(content, name, size=size)


def _content(source: ImageSource, name: str) -> bytes:
    try:
        return source.read(name)
    except OSError as error:
        unread = Finding("file_not_image", {"error": error.strerror or str(error)})
        raise RefusedImageError(name, unread) from None


def require_size(shape: tuple[int, ...], name: str, size: tuple[int, int] | None) -> None:
    """Refuse an image, (rows, columns[, colours]), that has another size than it must have.

    Raises
    ------
    RefusedImageError : it has.
    """
    height, width = shape[:2]
    if size is not None and (width, height) != size:
        sizes = {"width": width, "height": height, "camera_width": size[0], "camera_height": size[1]}
        raise RefusedImageError(name, Finding("file_size_differs", sizes))
