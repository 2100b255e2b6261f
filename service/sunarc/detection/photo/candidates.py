"""Plateaus with a rim: where a sun may be in an ordinary image, and how certain each centre is."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.common.array_types import BoolArray, FloatArray, Image
from sunarc.detection.photo.plateau import Near, Plateau, cell_minimum, faintest_colour, plateau_step, plateaus
from sunarc.detection.photo.rim import Rim, fit_rim, light_radius
from sunarc.detection.values import Bayer, Expectation

MAX_SIGMA = 0.01
"""Of the image's smaller side: a less certain position is of no use."""
REACH_SIGMAS, REACH_PX = 5.0, 2.0
"""A plateau within so many sigmas (and px) of the prediction is the sun's."""
SURROUNDINGS = 0.08
"""Of the smaller side, beyond the radius: where a predicted sun is the brightest."""

_WINDOW_RADIUS = 0.05
"""Of the smaller side: the largest plateau that a window has room for at the edge of the prediction's reach. Clear suns
have up to 0.05; one of 0.07, as thin cloud before the sun gave, has room where it is near the prediction."""
_BLUR = 0.035
"""Of the smaller side: twice the blur in which the middle of the glare is found."""


class ImagePart(NamedTuple):
    """A part of the faintest colour of an image.

    Attributes
    ----------
    plane : (rows, columns), counts.
    static : (rows, columns), pixels that do not take part; None for none.
    left, top : columns and rows of the whole plane before it.
    whole : rows and columns of the whole plane.
    cell : px of the image in one of the plane: 2 for a mosaic's, else 1.
    near : the predicted place in its px; None for all of an image.
    """

    plane: Image
    static: BoolArray | None
    left: int
    top: int
    whole: tuple[int, int]
    cell: int
    near: Near | None = None

    @property
    def size(self) -> int:
        """Smaller side of the whole plane, px."""
        return min(self.whole)

    def has_room(self, x: float, y: float, radius: float) -> bool:
        """Return whether the rays of a plateau end within it, or at the edge of the image."""
        reach, (rows, columns) = light_radius(radius), self.plane.shape
        return (
            (x - reach >= 0.0 or self.left == 0)
            and (y - reach >= 0.0 or self.top == 0)
            and (x + reach <= columns - 1 or self.left + columns >= self.whole[1])
            and (y + reach <= rows - 1 or self.top + rows >= self.whole[0])
        )

    def holds(self, x: float, y: float, radius: float) -> bool:
        """Return whether it has room for a plateau that is stated in px of the image."""
        shift = (self.cell - 1) / 2.0
        return self.has_room(
            (x - shift) / self.cell - self.left, (y - shift) / self.cell - self.top, radius / self.cell
        )


def whole_part(image: Image, *, static: BoolArray | None, bayer: Bayer | None) -> ImagePart:
    """Return all of an image; see `detect_sun_in_photo`."""
    plane = faintest_plane(image, bayer)
    rows, columns = plane.shape
    cell = 1 if plane.shape == image.shape[:2] else 2
    return ImagePart(plane, _resize_mask(static, (rows, columns)), 0, 0, (rows, columns), cell)


def part_near(
    image: Image,
    expectation: Expectation,
    *,
    step: int,
    static: BoolArray | None,
    bayer: Bayer | None,
    complete: bool = False,
) -> ImagePart:
    """Return the window of an image in which a predicted sun is.

    Parameters
    ----------
    image, expectation, static, bayer : as in `detect_sun_in_photo`.
    step : px of the plane that its left and top are a multiple of.
    complete : all of the image is the window.
    """
    cell = 1 if bayer is None or image.ndim == 3 else 2
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    size = min(rows, columns)
    x, y = ((value - (cell - 1) / 2.0) / cell for value in (expectation.x_px, expectation.y_px))
    reach = REACH_SIGMAS * math.hypot(expectation.uncertainty_px / cell, MAX_SIGMA * size) + REACH_PX
    radius = _WINDOW_RADIUS * size
    half = reach + max(light_radius(radius), radius + (SURROUNDINGS + _BLUR) * size)
    half = max(rows, columns) + abs(x) + abs(y) if complete else half
    left, right = _window_range(x, half, columns, step)
    top, bottom = _window_range(y, half, rows, step)
    window = slice(cell * top, cell * bottom), slice(cell * left, cell * right)
    shown = _resize_mask(static, (rows, columns), (top, bottom, left, right))
    near = Near(x - left, y - top, reach)
    return ImagePart(faintest_plane(image[window], bayer), shown, left, top, (rows, columns), cell, near)


def faintest_plane(image: Image, bayer: Bayer | None) -> Image:
    """Return the faintest colour of an image, (rows, columns), or of the cells of a raw mosaic, half of both."""
    return faintest_colour(image) if bayer is None or image.ndim == 3 else cell_minimum(image)


def _window_range(middle: float, half: float, size: int, step: int) -> tuple[int, int]:
    """Return first and end of a window along an axis; it has one step at least."""
    first = min(max(math.floor((middle - half) / step), 0), (size - 1) // step) * step
    return first, max(min(math.ceil(middle + half) + 1, size), min(first + step, size))


def _resize_mask(
    static: BoolArray | None, whole: tuple[int, int], window: tuple[int, int, int, int] | None = None
) -> BoolArray | None:
    """Return the mask of the static parts in the size of a plane, or of a window of it (top, bottom, left, right)."""
    if static is None:
        return None
    if static.shape != whole:
        enlarged = cv2.resize(static.view(np.uint8), (whole[1], whole[0]), interpolation=cv2.INTER_NEAREST)
        static = np.asarray(enlarged).view(np.bool_)
    top, bottom, left, right = (0, whole[0], 0, whole[1]) if window is None else window
    return static[top:bottom, left:right]


MIN_LEVEL = 0.35
"""Of full scale: a darker plateau is no sun in an ordinary exposure (a camera that clips at 160 of 255 has 0.63)."""
MIN_NEAR = 0.65
"""Light at 1.7 radii over the plateau's (in counts), below which it is no sun in its glare but something white."""
OFF_GLARE = 0.009
"""Of the smaller side: farther from the middle of the glare there is cloud, not the sun. Real suns were within 0.006 of
it without cloud and 0.014 with; half of the patches of cloud were beyond 0.02."""

_LEAST_NEAR = 0.3
"""Light at 1.7 radii of the inscribed circle over the plateau's, below which it is text, a box or a roof: next to suns
in a short exposure it was 0.37 and more."""
_MAX_RADIUS_FRACTION = 0.12
"""A plateau wider than this share of the image's smaller side is no sun; thin cloud before it gave 0.09 at most."""
_GLARE_PX, _GLARE_BLUR_PX = 240, 4.0
"""Smaller side of the image, and the blur, in which the middle of the glare is found: 3 degrees wide."""
_AS_LIGHT, _AWAY = 0.9, 2.6
"""Of the plateau's level (in tones), and radii beyond which so much light is another's: in glare it is below 0.84."""
_LINEAR_TONES = 1.0 / 2.2
"""Images of more than 8 bits are taken for linear: their light around the sun is compared by the tones of 8 bits."""
_EIGHT_BITS = 255
_MIN_SIGMA_PX = 0.2
_MIN_SIGMA_RADIUS = 0.015
"""1-sigma per axis over the radius, at best: real suns in haze, against a camera fitted to them."""
_SCATTER, _SPREAD, _OFFSET = 7.0, 0.5, 0.45
"""Sigma over the square of the scatter (over the share) over the radius, over the spread and over the offset: by
maximum likelihood on 28 real suns and 283 stand-ins without an edge, each series of equal weight, rounded
(docs/studies.md, "Stand-ins"). Cloud that scatters the rim also moves it, by a share that grows with the scatter."""
_PULL = 0.35
"""Sigma over the pull of a rim without an edge: the correction of `fit_rim` is as wrong on all suns of a day."""
_CLOUDY, _CLOUDY_RADIUS = 0.9, 0.7
"""Unevenness from which on the light about a rim without an edge is broken cloud's, and sigma over the radius and the
excess: real clear suns had 0.9 and less; of 47 suns behind broken cloud 17 are left, within 3.1 sigma."""
_LOPSIDED, _SHARE = 0.25, 0.25
"""Sigma over the radius times the lopsidedness of a rim without an edge, and over that times the share of the rays that
does not follow: by maximum likelihood on 1,105 drawn suns at the edges of clouds (docs/studies/cloud_edges.py), with
270 at blown-out horizons and 194 stand-ins, each class of like weight, rounded."""
_EDGED_RADIUS, _EDGED_UNEVEN = 0.04, 0.9
"""Sigma of a rim with an edge over the radius, and over that times the squared unevenness: cloud before a sun in a
short exposure is a gap in the rim (docs/studies.md, "A day of clouds")."""
_LIT, _LIT_SHARE = 0.06, 0.25
"""Of the plateau, and of the image: darker is the rim of the field; where little is lighter it is night."""


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
        """Score of a sun: large, clipped, round, standing out, in the middle of the glare."""
        rim, radius = self.rim, self.rim.radius
        uneven = (rim.scatter / (0.1 * radius)) ** 2 + (rim.spread / (0.2 * radius)) ** 2
        off = self.off_glare_px / (3.0 * OFF_GLARE * self.size_px)
        return radius * rim.flat * max(1.0 - rim.far, 0.01) * rim.share**2 / (1.0 + uneven) * math.exp(-(off**2))


def candidates_in(
    part: ImagePart, *, full_scale: int, least_level: float = MIN_LEVEL, least_near: float | None = None
) -> list[Candidate]:
    """Return the plateaus of a part of an image that have a rim, in px of the image.

    Parameters
    ----------
    part, full_scale : where, and the largest count.
    least_level, least_near : of full scale and of a plateau's level, as in `plateaus`; None is an ordinary exposure's.
    """
    return _fit_rims(part, _find_plateaus(part, full_scale, least_level, least_near), full_scale)


def candidates_near(part: ImagePart, *, full_scale: int) -> list[Candidate] | None:
    """Return the candidates in the window about a predicted place; None where one may have more light beyond it."""
    found = _find_plateaus(part, full_scale, MIN_LEVEL, None)
    if not all(part.has_room(each.x, each.y, each.radius) for each in found):
        return None
    seen = _fit_rims(part, found, full_scale)
    return seen if all(part.holds(each.rim.x, each.rim.y, each.rim.radius) for each in seen) else None


def window_step(image: Image, bayer: Bayer | None) -> int:
    """Return the step, px, at which windows begin, so that their reduced images match the whole image's."""
    size = min(image.shape[:2]) // (1 if bayer is None or image.ndim == 3 else 2)
    return math.lcm(plateau_step(size), _glare_step(size))


def _find_plateaus(part: ImagePart, full_scale: int, least_level: float, least_near: float | None) -> list[Plateau]:
    beside = _LEAST_NEAR ** (1.0 / _tone_exponent(full_scale)) if least_near is None else least_near
    found = plateaus(
        part.plane,
        least_level=least_level * full_scale,
        least_near=beside,
        static=part.static,
        size=part.size,
        near=part.near,
    )
    return [each for each in found if each.radius <= _MAX_RADIUS_FRACTION * part.size]


def _fit_rims(part: ImagePart, found: list[Plateau], full_scale: int) -> list[Candidate]:
    size, tones = part.size, _tone_exponent(full_scale)
    rims = [fit_rim(part.plane, each, static=part.static) for each in found]
    fitting = [rim for rim in rims if rim is not None and rim.radius <= _MAX_RADIUS_FRACTION * size]
    if not fitting:
        return []
    shown = _reduce_plane(part)
    as_light = _AS_LIGHT ** (1.0 / tones)
    return [
        _convert_to_image_px(
            Candidate(
                _linearise_rim(rim, tones),
                sigma_px(rim),
                *_distance_from_glare(shown, rim, size),
                size,
                *_measure_surroundings(shown, rim, as_light * rim.level, tones),
            ),
            part,
        )
        for rim in fitting
    ]


def _tone_exponent(full_scale: int) -> float:
    return 1.0 if full_scale == _EIGHT_BITS else _LINEAR_TONES


def _linearise_rim(rim: Rim, tones: float) -> Rim:
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
        _PULL * rim.pull * (not rim.edged),
        _CLOUDY_RADIUS * rim.radius * max(rim.uneven - _CLOUDY, 0.0) * (not rim.edged),
        _SHARE * rim.radius * (1.0 - rim.share) * (is_glare_cut or not rim.edged),
        _LOPSIDED * rim.radius * rim.lopsided * (not rim.edged),
    )


def _glare_step(size: int) -> int:
    return max(1, round(size / _GLARE_PX))


def _reduce_plane(part: ImagePart) -> tuple[FloatArray, float, float]:
    """Return a plane in some 240 px of the whole one, the px of the plane to one of its, and the blur there."""
    plane, static = part.plane, part.static
    shown = plane if static is None else np.where(static, np.zeros_like(plane), plane)
    step = _glare_step(part.size)
    rows, columns = (max(1, size // step) for size in plane.shape)
    small = cv2.resize(shown[: rows * step, : columns * step], (columns, rows), interpolation=cv2.INTER_AREA)
    blur = _GLARE_BLUR_PX * (part.size // step) / _GLARE_PX
    return np.asarray(small, dtype=np.float64), float(step), blur


def _distance_from_glare(shown: tuple[FloatArray, float, float], rim: Rim, size: int) -> tuple[float, float]:
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


def _measure_surroundings(
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


def _convert_to_image_px(seen: Candidate, part: ImagePart) -> Candidate:
    """Return a candidate of a part in px of the whole image."""
    rim, cell = seen.rim, part.cell
    shift = (cell - 1) / 2.0
    larger = rim._replace(
        x=cell * (rim.x + part.left) + shift,
        y=cell * (rim.y + part.top) + shift,
        radius=cell * rim.radius,
        scatter=cell * rim.scatter,
        spread=cell * rim.spread,
        offset=cell * rim.offset,
        pull=cell * rim.pull,
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
