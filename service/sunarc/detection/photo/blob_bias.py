"""What the centre of a saturated blob is off, because the lens maps a round blob to a slightly lopsided one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """As much of a lens as the bias of a blob needs.

    Attributes
    ----------
    axis_px : the pixel on the optical axis.
    radius_px : the radius from that pixel as a function of the angle off the axis in radians, rising.
    max_angle : radians up to which it is used.
    """

    axis_px: tuple[float, float]
    radius_px: Callable[[FloatArray], FloatArray]
    max_angle: float = math.radians(95.0)


def radial_bias_px(lens: Lens, *, angle: float, blob_radius: float) -> float:
    """Return how much farther out than the sun the centroid of a round blob lands, px (negative: towards the axis).

    Parameters
    ----------
    lens : the lens.
    angle : of the sun off the axis, radians.
    blob_radius : angular radius of the blob around the sun, radians.

    The image of the blob's rim is taken as a polygon; its centroid is compared with the image of its centre.
    """
    angle_around = np.linspace(0.0, 2.0 * math.pi, 721)[:-1]
    sine, cosine = math.sin(blob_radius), math.cos(blob_radius)
    along = math.sin(angle) * cosine + math.cos(angle) * sine * np.cos(angle_around)
    across = sine * np.sin(angle_around)
    upward = math.cos(angle) * cosine - math.sin(angle) * sine * np.cos(angle_around)
    horizontal = np.hypot(along, across)
    radius = lens.radius_px(np.arctan2(horizontal, upward))
    safe = np.maximum(horizontal, 1e-300)
    x, y = radius * along / safe, radius * across / safe
    next_x, next_y = np.roll(x, -1), np.roll(y, -1)
    # The shoelace formula: exact for the polygon, and 720 corners are 1e-5 of a circle's area off.
    cross = x * next_y - next_x * y
    centroid = float(np.sum((x + next_x) * cross) / (3.0 * np.sum(cross)))
    return centroid - float(lens.radius_px(np.array([angle]))[0])


def bias_at(lens: Lens, *, x_px: float, y_px: float, radius_px: float) -> float:
    """Return the radial bias of a blob seen at a pixel, px; its angles follow from the lens."""
    grid = np.linspace(0.0, lens.max_angle, 512)
    radii = lens.radius_px(grid)
    distance = math.hypot(x_px - lens.axis_px[0], y_px - lens.axis_px[1])
    angle = float(np.interp(distance, radii, grid))
    radial = float(np.interp(distance, radii, np.gradient(radii, grid)))
    tangential = distance / max(math.sin(angle), 1e-9) if angle > 1e-3 else radial
    return radial_bias_px(lens, angle=angle, blob_radius=radius_px / math.sqrt(max(radial * tangential, 1e-9)))
