"""Obstruction mask and horizon profile of image files, and the files they are written to."""

from __future__ import annotations

import io
import itertools
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import Image
from sunarc.common.errors import InputError, disk_errors
from sunarc.common.findings import FindingError
from sunarc.formats.csv_files import write_columns
from sunarc.imaging.horizon import HorizonProfile, find_obstructions
from sunarc.imaging.obstructions import (
    FREE,
    HIDDEN,
    SOILED,
    UNKNOWN,
    ObstructionMask,
    cell_grid,
    no_sums,
    updated_sums,
)
from sunarc.public.star_files import StarOptions, read_time, read_timed
from sunarc.sky.sun import sun_directions

_STATES = {"free": FREE, "unknown": UNKNOWN, "soiled": SOILED, "hidden": HIDDEN}


class LearnedMask(NamedTuple):
    """Obstructions by images: the mask and its horizon, and how many images were used for which purpose."""

    mask: ObstructionMask
    horizon: HorizonProfile
    counts: dict[str, int]

    def as_json(self) -> dict[str, Any]:
        """Return the shares of the sky by state, and the counts."""
        area = self.mask.grid.area_deg2
        shares = {name: float(area[self.mask.state == value].sum() / area.sum()) for name, value in _STATES.items()}
        return {"images": self.counts, "shares_of_the_sky": shares}


def learn_mask_from_files(paths: Sequence[Path], calibration: Calibration, options: StarOptions) -> LearnedMask:
    """Return the mask and the horizon that images show, read in the order of their times.

    Parameters
    ----------
    paths : image files.
    calibration : of the camera.
    options : how times are read, and their distance to the middle of the exposure.

    Raises
    ------
    InputError
        Where an image has another size than the calibration's, or all of them show less than one clear day.
    """
    timed, unread = [], 0
    for path in paths:
        try:
            timed.append((read_time(path, options), path))
        except (FindingError, InputError):
            unread += 1
    images = ((time.timestamp(), _read_or_none(path, options)) for time, path in sorted(timed))
    return learn_mask(itertools.chain(images, itertools.repeat((math.inf, None), unread)), calibration)


def _read_or_none(path: Path, options: StarOptions) -> Image | None:
    try:
        return read_timed(path, options)[1]
    except (FindingError, InputError):
        return None


def learn_mask(images: Iterable[tuple[float, Image | None]], calibration: Calibration) -> LearnedMask:
    """Return the mask and the horizon that images show.

    Parameters
    ----------
    images : with their times, s since 1970, in that order; None counts as unread.
    calibration : of the camera.

    Raises
    ------
    InputError
        Where an image has another size than the calibration's, or all of them show less than one clear day.
    """
    grid, unread = cell_grid(calibration.camera), 0
    sums = no_sums(grid)
    for unix_s, image in images:
        if image is None:
            unread += 1
            continue
        sun = np.asarray(sun_directions(unix_s, calibration.site))
        sums = updated_sums(sums, image, grid, sun=sun, unix_s=unix_s)
    counts = Counter({"unread": unread} if unread else {}) + Counter(sums.counts)
    if not sums.is_ready:
        used = ", ".join(f"{n} {use}" for use, n in sorted(counts.items())) or "none"
        problem = f"show too little sunshine: {sums.missing_h:.1f} h more are needed (images: {used})"
        raise InputError(field="IMAGES", problem=problem, remedy="give images of a whole clear day")
    return LearnedMask(*find_obstructions(sums, grid, sigma_deg=calibration.sky_rms_deg), dict(counts))


def mask_png(mask: ObstructionMask) -> bytes:
    """Return the mask as a PNG of the image's size: 255 free, 128 unknown, 64 soiled, 0 hidden."""
    return cv2.imencode(".png", mask.image())[1].tobytes()


def horizon_csv(profile: HorizonProfile) -> str:
    """Return the horizon as a table: azimuth from north clockwise, elevation and its 1-sigma, degrees."""
    text = io.StringIO()
    columns = {
        "azimuth_deg": np.arange(360.0),
        "horizon_elevation": profile.elevation_deg,
        "sigma_deg": profile.sigma_deg,
    }
    write_columns(text, columns, places={"azimuth_deg": 0, "horizon_elevation": 2, "sigma_deg": 2})
    return text.getvalue()


def pvgis_horizon(profile: HorizonProfile) -> str:
    """Return the elevations as PVGIS takes them for `userhorizon`: 360, from north clockwise, by commas."""
    return ",".join(f"{value:.1f}" for value in np.nan_to_num(profile.elevation_deg).tolist())


def write_mask(found: LearnedMask, *, mask: Path | None, horizon: Path | None, pvgis: Path | None) -> None:
    """Write the files that are asked for; OutsideError where the disk refuses."""
    contents = (
        (mask, mask_png(found.mask)),
        (horizon, horizon_csv(found.horizon).encode()),
        (pvgis, f"{pvgis_horizon(found.horizon)}\n".encode()),
    )
    for path, content in contents:
        if path is not None:
            with disk_errors(path):
                path.write_bytes(content)
