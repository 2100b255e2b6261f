"""Plateaus with a rim: where a sun may be in an ordinary image, and how certain each centre is."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.array_types import FloatArray, Image
from sunarc.detection.photo.part import SURROUNDINGS, Part
from sunarc.detection.photo.plateau import Plateau, plateaus, step_of
from sunarc.detection.photo.rim import Rim, rim_of
from sunarc.detection.values import Bayer

MIN_LEVEL = 0.35
"""Of full scale: a darker plateau is no sun in an ordinary exposure (a camera that clips at 160 of 255 has 0.63)."""
MIN_NEAR = 0.65
"""Light at 1.7 radii over the plateau's (in counts), below which it is no sun in its glare but something white."""
OFF_GLARE = 0.009
"""Of the smaller side: farther from the middle of the glare there is cloud, not the sun. Real suns were within 0.006 of
it without cloud and 0.014 with; half of the patches of cloud were beyond 0.02."""

_LEAST_NEAR = 0.3
"""Light at 1.7 radii of the inscribed circle over the plateau's, below which it is text, a box or a roof: beside suns
in a short exposure it was 0.37 and more."""
_MAX_RADIUS_FRACTION = 0.12
"""A plateau wider than this share of the image's smaller side is no sun; thin cloud before it gave 0.09 at most."""
_GLARE_PX, _GLARE_BLUR_PX = 240, 4.0
"""Smaller side of the image, and the blur, in which the middle of the glare is found: 3 degrees wide."""
_AS_LIGHT, _AWAY = 0.9, 2.6
"""Of the plateau's level (in tones), and radii beyond which so much light is another's: in glare it is below 0.84."""
_LINEAR_TONES = 1.0 / 2.2
"""Images of more than 8 bits are taken for linear: their light beside the sun is compared by the tones of 8 bits."""
_EIGHT_BITS = 255
_MIN_SIGMA_PX = 0.2
_MIN_SIGMA_RADIUS = 0.015
"""1-sigma per axis over the radius, at best: real suns in haze, against a camera fitted to them."""
_SCATTER, _SPREAD, _OFFSET = 7.0, 0.5, 0.45
"""Sigma over the square of the scatter (over the share) over the radius, over the spread and over the offset: by
maximum likelihood on 28 real suns and 283 stand-ins without an edge, each series of equal weight, rounded
(docs/studies.md, "Stand-ins"). Cloud that scatters the rim also moves it, by a share that grows with the scatter."""
_EDGED_RADIUS, _EDGED_SHARE, _EDGED_UNEVEN = 0.04, 0.25, 0.9
"""Sigma of a rim with an edge over the radius, over that times the share that does not follow, and over that times the
squared unevenness: cloud before a sun in a short exposure is a gap in the rim (docs/studies.md, "A day of clouds")."""
_LIT, _LIT_SHARE = 0.06, 0.25
"""Of the plateau, and of the image: what is darker is the rim of the field; where little is lighter it is night."""


class Candidate(NamedTuple):
    """A plateau with a rim.

    rim : its rim. sigma_px : 1-sigma per axis of the rim's centre. off_glare_px, off_local_glare_px : how far that is
    from the middle of the glare, px: the brightest place of the blurred image, and of its surroundings. size_px :
    smaller side of the image. other_area : area beyond 2.6 radii that is as light as 0.9 of the plateau, over the
    square of the smaller side. sky : median light beyond 2.6 radii over the level, 0 at night. lighter : share of
    it above the lesser of the light at 1.7 and 2.6 radii: small in the sun's aureole.
    """

    rim: Rim
    sigma_px: float
    off_glare_px: float
    off_local_glare_px: float
    size_px: float
    other_area: float
    sky: float = 0.0
    lighter: float = 1.0

    @property
    def score(self) -> float:
        """Say how sun-like it is: large, clipped, round, standing out, in the middle of the glare."""
        rim, radius = self.rim, self.rim.radius
        uneven = (rim.scatter / (0.1 * radius)) ** 2 + (rim.spread / (0.2 * radius)) ** 2
        off = self.off_glare_px / (3.0 * OFF_GLARE * self.size_px)
        return radius * rim.flat * max(1.0 - rim.far, 0.01) * rim.share**2 / (1.0 + uneven) * math.exp(-(off**2))


def candidates_in(
    part: Part, *, full_scale: int, least_level: float = MIN_LEVEL, least_near: float | None = None
) -> list[Candidate]:
    """Return the plateaus of a part of an image that have a rim, in px of the image.

    Parameters
    ----------
    part, full_scale : where, and the largest count.
    least_level, least_near : of full scale and of a plateau's level, as in `plateaus`; None is an ordinary exposure's.
    """
    return _with_rims(part, _plateaus(part, full_scale, least_level, least_near), full_scale)


def candidates_near(part: Part, *, full_scale: int) -> list[Candidate] | None:
    """Return the candidates in the window about a predicted place; None where one may have more light beyond it."""
    found = _plateaus(part, full_scale, MIN_LEVEL, None)
    if not all(part.has_room(each.x, each.y, each.radius) for each in found):
        return None
    seen = _with_rims(part, found, full_scale)
    return seen if all(part.holds(each.rim.x, each.rim.y, each.rim.radius) for each in seen) else None


def window_step(image: Image, bayer: Bayer | None) -> int:
    """Return px of the plane by which a window may begin, so that its reduced images are parts of the whole one's."""
    size = min(image.shape[:2]) // (1 if bayer is None or image.ndim == 3 else 2)
    return math.lcm(step_of(size), _glare_step(size))


def _plateaus(part: Part, full_scale: int, least_level: float, least_near: float | None) -> list[Plateau]:
    beside = _LEAST_NEAR ** (1.0 / _tones(full_scale)) if least_near is None else least_near
    found = plateaus(
        part.plane,
        least_level=least_level * full_scale,
        least_near=beside,
        static=part.static,
        size=part.size,
        near=part.near,
    )
    return [each for each in found if each.radius <= _MAX_RADIUS_FRACTION * part.size]


def _with_rims(part: Part, found: list[Plateau], full_scale: int) -> list[Candidate]:
    size, tones = part.size, _tones(full_scale)
    rims = [rim_of(part.plane, each, static=part.static) for each in found]
    fitting = [rim for rim in rims if rim is not None and rim.radius <= _MAX_RADIUS_FRACTION * size]
    if not fitting:
        return []
    shown = _reduced(part)
    as_light = _AS_LIGHT ** (1.0 / tones)
    return [
        _in_the_image(
            Candidate(
                _in_tones(rim, tones),
                sigma_px(rim),
                *_off_glare(shown, rim, size),
                size,
                *_surroundings(shown, rim, as_light * rim.level, tones),
            ),
            part,
        )
        for rim in fitting
    ]


def _tones(full_scale: int) -> float:
    return 1.0 if full_scale == _EIGHT_BITS else _LINEAR_TONES


def _in_tones(rim: Rim, tones: float) -> Rim:
    return rim._replace(near=max(rim.near, 0.0) ** tones, far=max(rim.far, 0.0) ** tones)


def sigma_px(rim: Rim) -> float:
    """Return the 1-sigma per axis of a rim's centre."""
    is_glare_cut = rim.edged and rim.near >= _LEAST_NEAR  # and not a disc in the dark
    return math.hypot(
        _MIN_SIGMA_PX,
        (_EDGED_RADIUS if is_glare_cut else _MIN_SIGMA_RADIUS) * rim.radius,
        _SCATTER * (rim.scatter / rim.share) ** 2 / rim.radius,
        _SPREAD * rim.spread,
        _OFFSET * rim.offset,
        _EDGED_UNEVEN * rim.radius * rim.uneven**2 * is_glare_cut,
        _EDGED_SHARE * rim.radius * (1.0 - rim.share) * is_glare_cut,
    )


def _glare_step(size: int) -> int:
    return max(1, round(size / _GLARE_PX))


def _reduced(part: Part) -> tuple[FloatArray, float, float]:
    """Return a plane in some 240 px of the whole one, the px of the plane to one of its, and the blur there."""
    plane, static = part.plane, part.static
    shown = plane if static is None else np.where(static, np.zeros_like(plane), plane)
    step = _glare_step(part.size)
    rows, columns = (max(1, size // step) for size in plane.shape)
    small = cv2.resize(shown[: rows * step, : columns * step], (columns, rows), interpolation=cv2.INTER_AREA)
    blur = max(_GLARE_BLUR_PX * max(1, part.size // step) / _GLARE_PX, 0.5)
    return np.asarray(small, dtype=np.float64), float(step), blur


def _off_glare(shown: tuple[FloatArray, float, float], rim: Rim, size: int) -> tuple[float, float]:
    """Return how far a rim's centre is from the brightest place of the blurred plane and of its surroundings, px.

    What is brighter than the plateau (an overlay) counts as much as the plateau.
    """
    small, step, blur = shown
    blurred = cv2.GaussianBlur(np.minimum(small, rim.level).astype(np.float32), (0, 0), blur)
    x, y = ((value - (step - 1.0) / 2.0) / step for value in (rim.x, rim.y))
    reach = (rim.radius + SURROUNDINGS * size) / step
    rows, columns = np.ogrid[: small.shape[0], : small.shape[1]]
    around = np.where(np.hypot(columns - x, rows - y) <= reach, blurred, -1.0)
    distances = []
    for plane in (blurred, around):
        row, column = divmod(int(np.argmax(plane)), small.shape[1])
        distances.append(step * math.hypot(column - x, row - y))
    return distances[0], distances[1]


def _surroundings(
    shown: tuple[FloatArray, float, float], rim: Rim, level: float, tones: float
) -> tuple[float, float, float]:
    """Return the `other_area` of a rim at or above a level, and its `sky` and `lighter`."""
    small, step, _ = shown
    x, y = ((value - (step - 1.0) / 2.0) / step for value in (rim.x, rim.y))
    rows, columns = np.ogrid[: small.shape[0], : small.shape[1]]
    others = small[np.hypot(columns - x, rows - y) > _AWAY * rim.radius / step]
    area = float(np.count_nonzero(others >= level) / min(small.shape) ** 2)
    lit = others[others > _LIT * rim.level] / rim.level
    if not lit.size:
        return area, 0.0, 0.0
    sky = float(np.median(lit)) ** tones if lit.size > _LIT_SHARE * others.size else 0.0
    return area, sky, float(np.mean(lit > min(rim.near, rim.far)))


def _in_the_image(seen: Candidate, part: Part) -> Candidate:
    """Return a candidate of a part's plane in px of the image."""
    rim, cell = seen.rim, part.cell
    shift = (cell - 1) / 2.0
    larger = rim._replace(
        x=cell * (rim.x + part.left) + shift,
        y=cell * (rim.y + part.top) + shift,
        radius=cell * rim.radius,
        scatter=cell * rim.scatter,
        spread=cell * rim.spread,
        offset=cell * rim.offset,
    )
    return Candidate(
        rim=larger,
        sigma_px=cell * seen.sigma_px,
        off_glare_px=cell * seen.off_glare_px,
        off_local_glare_px=cell * seen.off_local_glare_px,
        size_px=cell * seen.size_px,
        other_area=seen.other_area,
        sky=seen.sky,
        lighter=seen.lighter,
    )
