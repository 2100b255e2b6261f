"""The images of a folder with their times: what is to be looked at, and what is not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sunarc.archive.file_sightings import ImageKey, image_key
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.offline.ingest.image_checks import image_size
from sunarc.offline.ingest.image_times import Naming, taken
from sunarc.offline.messages import RefusedImageError
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles
from sunarc.workers.night.exposures import DARK_ZENITH_DEG

_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".jp2")
_SIZES_READ = 100
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
        raise InputError(field=str(folder), problem="is no folder", remedy="name a folder of images")
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
    some = images[:: len(images) // _SIZES_READ + 1]
    counted = Counter(size for image in some if (size := image_size(folder / image.path)) is not None)
    return counted.most_common(1)[0][0] if counted else None
