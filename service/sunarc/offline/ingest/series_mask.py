"""What stands still in a folder's images: text overlays, logos, painted marks."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from sunarc.array_types import Image
from sunarc.detection.photo.static_mask import static_mask
from sunarc.offline.detect_files import full_scale_of
from sunarc.offline.ingest.image_checks import read_checked_image
from sunarc.offline.ingest.index import ImageFile
from sunarc.offline.ingest.packed_mask import PackedMask, pack_mask
from sunarc.offline.messages import RefusedImageError
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

_IMAGES = 24
_LEAST_MOTION_DEG = 40.0
"""Largest angle between two suns of the images that are compared, at least: the glare of one is 20 degrees wide at
most, and has to leave every place."""


def series_mask(folder: Path, images: Sequence[ImageFile], *, size: tuple[int, int], site: Site) -> PackedMask | None:
    """Return what stands still in the images of a folder; None where nothing does, or they cannot tell."""
    some = images[:: len(images) // _IMAGES + 1]
    if not some or _motion_deg(some, site) < _LEAST_MOTION_DEG:
        return None
    images_read = _read(folder, some, size)
    first = next(images_read, None)
    if first is None:
        return None
    like_first = (one for one in images_read if (one.shape, one.dtype) == (first.shape, first.dtype))
    mask = static_mask(itertools.chain([first], like_first), full_scale=full_scale_of(first))
    return None if mask is None or not np.any(mask) else pack_mask(mask)


def _read(folder: Path, images: Sequence[ImageFile], size: tuple[int, int]) -> Iterator[Image]:
    for image in images:
        try:
            yield read_checked_image(folder / image.path, size=size)
        except RefusedImageError:
            continue


def _motion_deg(images: Sequence[ImageFile], site: Site) -> float:
    """Return the largest angle between the suns of two images."""
    directions = sun_directions(np.array([image.unix_s for image in images]), site)
    return float(np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)).max()))
