"""Obstructions of the epochs of a camera: the mask and the horizon that the images of their clearest days show."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.archives.fit import Final
from sunarc.archives.passes import FoundSun, Looked
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import BoolArray, FloatArray, Image, IntArray
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.common.utc import DAY_S
from sunarc.imaging.horizon import HorizonProfile
from sunarc.imaging.obstructions import FREE, HIDDEN, UNKNOWN, CellGrid
from sunarc.imaging.preview import decoded
from sunarc.public.mask_files import horizon_csv, learn_mask, mask_png
from sunarc.sources.image_files import read_one_image
from sunarc.sources.look import PackedMask, pack_mask
from sunarc.sources.sources import open_source

_MOST_IMAGES = 240
"""Images that an epoch's mask is made of: about four clear days."""
_APART_S = 600.0
_LOW_DEG = 1.0


class EpochImage(NamedTuple):
    """An image by its source, file and number, and its time by the true clock, s since 1970."""

    address: str
    file: str
    number: int
    unix_s: float


class EpochImages(NamedTuple):
    """Images of an epoch in the order of time, and its calibration."""

    calibration: Calibration
    size: tuple[int, int]
    images: tuple[EpochImage, ...]


class EpochObstructions(NamedTuple):
    """Mask and horizon of an epoch as files by their endings, and the horizon's numbers; or the reason why not.

    seen, hidden: azimuths that the image shows, and those of them whose sky is hidden up to 1 degree or more.
    """

    files: dict[str, bytes]
    seen: int
    hidden: int
    missing: str | None
    picture: bytes

    def no_sky(self) -> PackedMask | None:
        """Return the parts of the image that show no sky; None where the mask is missing."""
        mask = decoded(self.files.get("png", b""))
        return None if mask is None else pack_mask(mask == HIDDEN)


def select_epoch_images(looked: Looked, final: Final, size: tuple[int, int]) -> list[EpochImages]:
    """Return the images that show the obstructions of each epoch: of the days with most suns, ten minutes apart.

    Parameters
    ----------
    looked : the camera's images, and what was found in them.
    final : epochs and calibrations.
    size : width and height of the images, px.
    """
    times = np.array([image.unix_s for image in looked.images])
    suns = np.array([isinstance(one, FoundSun) and one.accepted for one in looked.found], dtype=bool)
    every = []
    for epoch in final.epochs:
        state = final.states[epoch.state]
        rows = np.flatnonzero((times >= epoch.start_unix_s) & (times <= epoch.end_unix_s))
        picked = tuple(
            EpochImage(one.address, one.file, one.number, one.unix_s - state.clock_offset_s)
            for one in map(looked.images.__getitem__, _select_clearest_days(rows, times, suns))
        )
        every.append(EpochImages(final.fitted[state.pose].calibration, size, picked))
    return every


def _select_clearest_days(rows: IntArray, times: FloatArray, suns: BoolArray) -> list[int]:
    """Return the numbers of images of the days with most suns, in the order of time, not more than are read."""
    ordered = rows[np.argsort(times[rows], kind="stable")]
    slots, first = np.unique(np.floor(times[ordered] / _APART_S), return_index=True)
    spaced = ordered[first]
    days = (slots * _APART_S // DAY_S).astype(int)
    clearest = Counter(np.floor(times[ordered[suns[ordered]]] / DAY_S).astype(int).tolist()).most_common()
    picked: list[int] = []
    for day, _ in clearest:
        of_day = spaced[days == day].tolist()
        if len(picked) + len(of_day) > _MOST_IMAGES and picked:
            break
        picked += of_day
    return sorted(picked[:_MOST_IMAGES], key=times.__getitem__)


def epoch_obstructions(given: EpochImages) -> EpochObstructions:
    """Return the obstructions that the images of an epoch show."""
    cv2.setNumThreads(1)
    try:
        found = learn_mask(_read_images(given), given.calibration)
    except InputError as error:
        return EpochObstructions(
            {}, 0, 0, error.problem, _encode_png(np.full(given.size[::-1], UNKNOWN, dtype=np.uint8))
        )
    profile = found.horizon
    known = np.isfinite(profile.elevation_deg)
    return EpochObstructions(
        files={"png": mask_png(found.mask), "csv": horizon_csv(profile).encode()},
        seen=int(np.count_nonzero(known)),
        hidden=int(np.count_nonzero(profile.elevation_deg[known] >= _LOW_DEG)),
        missing=None,
        picture=_draw_horizon_picture(profile, found.mask.grid),
    )


def _read_images(given: EpochImages) -> Iterator[tuple[float, Image | None]]:
    for one in given.images:
        image = read_one_image(open_source(one.address), one.file, one.number, size=given.size)
        yield one.unix_s, None if isinstance(image, Finding) else image


def _draw_horizon_picture(profile: HorizonProfile, grid: CellGrid) -> bytes:
    """Return a PNG of the image's size: 255 above the horizon, 0 below it, 128 outside the camera's field."""
    state = np.where(profile.hides(np.moveaxis(grid.directions, 0, -1).astype(np.float64)), HIDDEN, FREE).astype(
        np.uint8
    )
    state[~grid.directions.any(axis=0)] = UNKNOWN
    return _encode_png(cv2.resize(state, grid.size, interpolation=cv2.INTER_NEAREST))


def _encode_png(state: NDArray[Any]) -> bytes:
    return cv2.imencode(".png", state)[1].tobytes()
