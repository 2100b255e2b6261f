"""Errors of calibrations against a known camera over the sky, as numbers and as a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sunarc.common.array_types import FloatArray, Image
from sunarc.common.errors import OutsideError
from sunarc.formats.calibration_document import from_document
from sunarc.optics.forward import project
from sunarc.sky.directions import angles_from_direction, direction_from_angles

_LOWEST_DEG = 85.0
_SIZE_PX, _MARGIN_PX = 360, 40
_WHITE, _GREY = (255, 255, 255), (90, 90, 90)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SkyErrors:
    """Errors of one calibration over the sky to a zenith angle of 85 degrees.

    Attributes
    ----------
    calibration : its id.
    north_px, south_px : root mean square distance from the true pixels over either half of the sky.
    map_px : (360, 360) that distance, north up and east to the left, zenith angles in equal steps from the middle; NaN
        beyond.
    """

    calibration: str
    north_px: float
    south_px: float
    map_px: FloatArray


def sky_errors(document: Mapping[str, Any], truth: Mapping[str, Any]) -> SkyErrors:
    """Return the errors of a calibration against the true camera, both as documents."""
    found, true = (from_document(one).camera for one in (document, truth))
    steps = np.linspace(-1.0, 1.0, _SIZE_PX) * _LOWEST_DEG
    west, south = np.meshgrid(steps, steps)
    zenith = np.hypot(west, south)
    direction = direction_from_angles(zenith_deg=zenith, azimuth_deg=np.degrees(np.arctan2(-west, -south)))
    apart = np.linalg.norm(project(found, direction) - project(true, direction), axis=-1)
    apart[zenith > _LOWEST_DEG] = np.nan
    # as much weight to each part of the sky: the steps are even in the zenith angle
    weight = np.where(np.isfinite(apart), np.sinc(angles_from_direction(direction)[0] / 180.0), 0.0)
    square = np.nan_to_num(apart) ** 2 * weight
    north = south < 0.0
    return SkyErrors(
        calibration=str(document["id"]),
        north_px=float(np.sqrt(square[north].sum() / weight[north].sum())),
        south_px=float(np.sqrt(square[~north].sum() / weight[~north].sum())),
        map_px=apart,
    )


def write_picture(errors: Mapping[str, SkyErrors], path: Path) -> None:
    """Write the maps side by side as PNG, on one scale from 0 to the largest error.

    Raises
    ------
    OutsideError : the file cannot be written.
    """
    largest = max(float(np.nanmax(one.map_px)) for one in errors.values())
    panels = [_draw_panel(name, one, largest) for name, one in errors.items()]
    if not cv2.imwrite(str(path), np.concatenate(panels, axis=1)):
        raise OutsideError(f"{path} cannot be written")


def _draw_panel(name: str, errors: SkyErrors, largest: float) -> Image:
    level = (255.0 * np.nan_to_num(errors.map_px / largest)).astype(np.uint8)
    colours = cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS)
    colours[np.isnan(errors.map_px)] = _WHITE
    panel = np.full((_SIZE_PX + 2 * _MARGIN_PX, _SIZE_PX + 2 * _MARGIN_PX, 3), 255, dtype=np.uint8)
    panel[_MARGIN_PX:-_MARGIN_PX, _MARGIN_PX:-_MARGIN_PX] = colours
    said = f"{name}: N {errors.north_px:.3f} px, S {errors.south_px:.3f} px"
    for text, at in (
        (said, (_MARGIN_PX, 26)),
        (f"north up; yellow {largest:.2f} px", (_MARGIN_PX, panel.shape[0] - 14)),
    ):
        cv2.putText(panel, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, _GREY, 1, cv2.LINE_AA)
    return panel
