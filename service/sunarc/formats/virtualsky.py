"""Values of VirtualSky, which draws stars and constellations over a picture of the whole sky.

It draws into a square about the zenith: in its projections `polar`, `fisheye` and `ortho` a direction stands at
x = w/2 - r sin(A - B), y = h/2 - r cos(A - B), where r is h/2 times `_RADIUS` of the zenith angle, A is the azimuth,
and B is its value `az` less 180 degrees. Reference: https://github.com/slowe/VirtualSky (its README and its formulas).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.common.array_types import FloatArray
from sunarc.formats.view import View
from sunarc.optics.camera import Camera, camera_sees
from sunarc.optics.forward import project
from sunarc.sky.site import Site

MOST_DEG = 2.0
"""Largest error of a direction from which a picture of the sky no longer fits its stars: four diameters of the moon."""
_RADIUS: Mapping[str, tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray], FloatArray]]] = {
    "polar": (lambda zenith: zenith / (0.5 * math.pi), lambda radius: radius * (0.5 * math.pi)),
    "fisheye": (
        lambda zenith: np.sin(0.5 * zenith) * math.sqrt(2.0),
        lambda radius: 2.0 * np.arcsin(np.clip(radius / math.sqrt(2.0), 0.0, 1.0)),
    ),
    "ortho": (np.sin, lambda radius: np.arcsin(np.clip(radius, 0.0, 1.0))),
}
"""Radius of a zenith angle (radians) as a share of the horizon's, and the zenith angle of a radius."""
_FITTED = 2003
_CORNER_PX = 0.5
"""From the centre of the top-left pixel to its corner, from which browsers count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualSky:
    """A square over an image in which VirtualSky draws."""

    projection: str
    center_px: tuple[float, float]
    """Zenith: column and row."""
    radius_px: float
    """From the zenith to the horizon."""
    azimuth_deg: float
    """Azimuth of the upper edge, B."""


def virtualsky_model(camera: Camera) -> VirtualSky:
    """Return the square and the projection that are closest to a camera, by least squares over its sky."""
    directions = hemisphere(_FITTED)
    pixels = project(camera, directions)
    seen = camera_sees(camera, pixels)
    fitted = [_fit_square(projection, directions[seen], pixels[seen]) for projection in _RADIUS]
    return min(fitted, key=lambda one: one[0])[1]


def _fit_square(projection: str, directions: FloatArray, pixels: FloatArray) -> tuple[float, VirtualSky]:
    """Return the sum of squares, px², and the square of a projection: it is linear in the radius' two components."""
    east, north = _map_to_unit_circle(projection, directions).T
    one, nothing = np.ones_like(east), np.zeros_like(east)
    matrix = np.concatenate([
        np.stack([one, nothing, -east, north], axis=-1),
        np.stack([nothing, one, -north, -east], axis=-1),
    ])  # fmt: skip
    values = pixels.T.ravel()
    found = np.linalg.lstsq(matrix, values, rcond=None)[0]
    x, y, cosine, sine = found.tolist()
    square = VirtualSky(
        projection=projection,
        center_px=(x, y),
        radius_px=math.hypot(cosine, sine),
        azimuth_deg=math.degrees(math.atan2(sine, cosine)) % 360.0,
    )
    return float(np.sum((matrix @ found - values) ** 2)), square


def _map_to_unit_circle(projection: str, directions: FloatArray) -> FloatArray:
    """Return (n, 2) shares of the horizon's radius, to the east and to the north."""
    radius, _ = _RADIUS[projection]
    across = np.hypot(directions[:, 0], directions[:, 1])
    share = radius(np.arctan2(across, directions[:, 2]))
    return np.asarray(directions[:, :2] * (share / np.maximum(across, np.finfo(float).tiny))[:, None])


def virtualsky_view(square: VirtualSky, *, size: tuple[int, int]) -> View:
    """Return the view of a square over an image."""
    turn = math.radians(square.azimuth_deg)
    # to x and y of the image, from east and north
    matrix = square.radius_px * np.array([[-math.cos(turn), math.sin(turn)], [-math.sin(turn), -math.cos(turn)]])
    center, (_, zenith) = np.array(square.center_px), _RADIUS[square.projection]

    def project_directions(directions: FloatArray) -> FloatArray:
        return np.asarray(center + _map_to_unit_circle(square.projection, directions) @ matrix.T)

    def unproject_pixels(pixels: FloatArray) -> FloatArray:
        place = (pixels - center) @ np.linalg.inv(matrix).T
        share = np.hypot(*place.T)
        angle = zenith(share)
        across = place * (np.sin(angle) / np.maximum(share, np.finfo(float).tiny))[:, None]
        return np.concatenate([across, np.cos(angle)[:, None]], axis=-1)

    return View(
        form="virtualsky", width=size[0], height=size[1], project=project_directions, unproject=unproject_pixels
    )


def virtualsky_json(square: VirtualSky, *, size: tuple[int, int], site: Site, notes: list[str]) -> bytes:
    """Return the file: the values of `S.virtualsky({...})`, and where its element stands over the image, px."""
    side = 2.0 * square.radius_px
    left, top = (center + _CORNER_PX - square.radius_px for center in square.center_px)
    written = {
        "virtualsky": {
            "projection": square.projection,
            "az": round((square.azimuth_deg + 180.0) % 360.0, 3),
            "width": round(side, 2),
            "height": round(side, 2),
            "latitude": site.latitude,
            "longitude": site.longitude,
        },
        "element": {"left": round(left, 2), "top": round(top, 2), "image_size_px": list(size)},
        "notes": [
            *notes,
            "VirtualSky draws without precession since 2000 (0.36 degrees in 2026) and refraction (0.5 at the horizon)",
        ],
    }
    return json.dumps(written, indent=2).encode() + b"\n"
