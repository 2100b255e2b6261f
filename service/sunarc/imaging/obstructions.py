"""Obstruction mask: the cells of an image that never show the sky, from sums over many images."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sunarc.common.array_types import BoolArray, FloatArray, Image, IntArray
from sunarc.common.errors import InputError
from sunarc.optics.camera import Camera, camera_sees
from sunarc.optics.forward import project_fast
from sunarc.optics.inverse_table import inverse_table

Cells = NDArray[np.float32]
States = NDArray[np.uint8]
FREE, UNKNOWN, SOILED, HIDDEN = 255, 128, 64, 0
"""Values of a mask: sky, not enough evidence, dirt on the dome, an obstruction."""

_CELLS = 512
"""Cells across the longer side of the image."""
_VOTE_S = 600.0
"""Images closer in time share one vote: clouds and light are the same in them."""
_MOST_ODDS = 15.0
"""Log odds are clipped here: a clear day has about 60 votes, so that two overturn any history."""
_CLOUDY_WEIGHT, _MOST_CLOUDY_ODDS = 0.1, 3.0
"""Weight of a vote without the sun, and log odds that these can reach: a bank of dark clouds stands for days, a clear
day overturns it."""
_NAMED_STAR, _MISSED_STAR = 2.0, 0.5
"""Log odds of a night's votes: a star is not seen through a wall; one that is missed may be behind a cloud."""
_HALF_LIFE_S = 60.0 * 86400.0
_NEEDED_CLEAR_S = 4.0 * 3600.0
"""Time with the sun seen from which on there is a mask: one clear day, in winter too."""
_DARK, _DARK_WIDTH = 0.5, 0.35
"""Log contrast to the sky at which a cell votes neither way (a cell half covered), and by which it changes by one."""
_BRIGHT, _BRIGHT_WIDTH = 0.4, 0.8
"""Brighter cells are clouds, haze near the horizon or sunlit walls: their votes for the sky fade over this width."""
_STATIC = 0.05
"""Log contrast of a texture that stands still, from which on it is an obstruction's. A smooth sky has below 0.01."""
_STATIC_VOTES = 40.0
"""Votes over which textures are averaged."""
_AUREOLE_DEG, _DISC_DEG, _RING_DEG = 12.0, 2.5, 8.0
_SUN_RATIO, _RING_RATIO, _SATURATED = 1.0, 0.7, 0.98
_CLEAR_SPREAD, _CLEAR_FOR_S = 0.15, 3600.0
"""Spread of the sky's log contrast below which it is clear without the sun, so long after the sun was last seen."""
_FAIR_SPREAD = 0.2
"""The same of a sky that has few clouds; the sun's time counts below it."""
_LEAST_RANGE = 0.02
"""Of the full scale between the darkest and brightest cells of an image that is not covered."""
_OTHER_SCENE, _OTHER_SCENE_S = 0.15, 2.0 * 86400.0
"""Correlation of an image's texture with the stored one below which it shows another scene; after so long in
succession the stored texture is discarded."""
_GAMMA, _LEAST_COUNT = 2.2, 2e-5
"""Of images of 8 bits; share of the full scale that stands for no light."""
_SWEEPS, _COUPLING, _EDGE = 12, 0.7, 0.25
_CERTAIN = math.log(9.0)
"""Log odds of a probability of 0.9, from which on a cell is called free or hidden."""
_RIM_DEG = 3.0
_BLUR_PER_CELL = 0.22
"""Log contrast per cell at the border of dirt on the dome, which is out of focus, at most."""
_FIT_CELLS, _FIT_ROUNDS = 2500, 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellGrid:
    """The cells of an image and the directions they show."""

    camera: Camera
    """Lens and pose."""
    directions: Cells
    """(3, rows, columns) unit vectors of their centres, east-north-up; 0 outside the camera's field."""
    inner: BoolArray
    """(rows, columns) whether they lie away from the edge of the camera's field, a texture that stands still."""
    area_deg2: Cells
    """(rows, columns) solid angles, square degrees."""
    sampled: NDArray[np.int64]
    """Cells (indices) that the sky's light is fitted to."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image, px."""
        return self.camera.width, self.camera.height

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.area_deg2.shape[0], self.area_deg2.shape[1]

    @property
    def sky(self) -> BoolArray:
        """(rows, columns) whether they lie above the astronomical horizon."""
        return np.asarray(self.directions[2] > 0.0)

    @property
    def resolution_deg(self) -> float:
        """Size of a cell near the horizon, degrees."""
        low = self.sky & (self.directions[2] < math.sin(math.radians(30.0)))
        return math.sqrt(float(np.median(self.area_deg2[low]))) if low.any() else 1.0


def cell_grid(camera: Camera) -> CellGrid:
    """Return the cells of a camera's image."""
    scale = min(1.0, _CELLS / max(camera.width, camera.height))
    rows, columns = max(round(camera.height * scale), 1), max(round(camera.width * scale), 1)
    y, x = np.mgrid[0:rows, 0:columns]
    centres = np.stack([(x + 0.5) * camera.width / columns - 0.5, (y + 0.5) * camera.height / rows - 0.5], axis=-1)
    found = inverse_table(camera).directions(centres.reshape(-1, 2)).reshape(rows, columns, 3).astype(np.float32)
    right, down = (np.gradient(found, axis=axis) for axis in (1, 0))
    area = np.linalg.norm(np.cross(right, down), axis=-1) * np.degrees(1.0) ** 2
    directions = np.ascontiguousarray(np.moveaxis(np.nan_to_num(found), -1, 0))
    sky, sampled = directions[2] > 0.0, np.flatnonzero(directions[2] > 0.03)
    return CellGrid(
        camera=camera,
        directions=directions,
        inner=cv2.erode(sky.astype(np.uint8), np.ones((9, 9), np.uint8), borderValue=0).astype(bool),
        area_deg2=np.where(sky, np.nan_to_num(area), 0.0).astype(np.float32),
        sampled=sampled[:: max(sampled.size // _FIT_CELLS, 1)],
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObstructionSums:
    """Evidence of obstructions; its size does not depend on the number of images."""

    log_odds: Cells
    """(rows, columns) of hidden against free."""
    texture: Cells
    """(rows, columns) mean of the fine log contrast."""
    contrast: Cells
    """(rows, columns) mean log contrast to the sky's light."""
    last: Cells
    """Coarse log brightness of the last image."""
    votes: float = 0.0
    """Votes that entered the means."""
    clear_s: float = 0.0
    """Time with the sun seen, s; before there is a mask less half of that without it."""
    seen_s: float = -math.inf
    """Last time when the sun was seen, s since 1970."""
    unix_s: float = -math.inf
    """Time of the last image, s since 1970."""
    other_s: float = 0.0
    """Time with another scene, in succession, s."""
    counts: Mapping[str, int] = field(default_factory=dict)
    """Images by their use: clear, cloudy, covered, frozen, other_scene, earlier."""

    @property
    def is_ready(self) -> bool:
        """True with a mask: enough time with the sun seen."""
        return self.clear_s >= _NEEDED_CLEAR_S

    @property
    def missing_h(self) -> float:
        """Hours of sunshine until there is a mask."""
        return max(_NEEDED_CLEAR_S - self.clear_s, 0.0) / 3600.0


def no_sums(grid: CellGrid) -> ObstructionSums:
    """Return the evidence before the first image."""
    empty = np.zeros(grid.shape, dtype=np.float32)
    return ObstructionSums(log_odds=empty, texture=empty, contrast=empty, last=np.zeros((64, 64), np.float32))


def updated_sums(
    sums: ObstructionSums,
    image: Image,
    grid: CellGrid,
    *,
    sun: FloatArray,
    unix_s: float,
    sun_seen: bool | None = None,
) -> ObstructionSums:
    """Return the evidence with one more image.

    Parameters
    ----------
    sums : so far.
    image : (rows, columns) or (rows, columns, 3); 8 bits are taken as gamma-coded, 16 bits as linear.
    grid : of the camera.
    sun : (3,) unit vector of the apparent sun, east-north-up.
    unix_s : time of the image, s since 1970; an image that is not later than the last one does not vote.
    sun_seen : whether the sun was found; None: judged from the image.

    Raises
    ------
    InputError
        Where the image has another size than the camera's.
    """
    if image.shape[1::-1] != grid.size:
        width, height = grid.size
        problem = f"{image.shape[1]}x{image.shape[0]} px, the calibration is of {width}x{height} px"
        raise InputError(field="image", problem=problem, remedy="give images of the calibrated camera")
    elapsed_s = unix_s - sums.unix_s
    if not elapsed_s > 0.0:
        return _count_use(sums, "earlier")
    counts = _reduce_to_cells(image, grid.shape)
    light = _log_light(counts, gamma=_GAMMA if image.dtype == np.uint8 else 1.0)
    coarse = _to_cells(cv2.resize(light, (64, 64), interpolation=cv2.INTER_AREA))
    unusable = _find_fault(counts, coarse, sums, grid)
    fading = np.float32(0.5 ** (elapsed_s / _HALF_LIFE_S))
    kept = replace(sums, log_odds=sums.log_odds * fading, last=coarse, unix_s=unix_s)
    if unusable is not None:
        return _count_use(kept, unusable)
    texture = _compute_texture(light, counts) * grid.inner
    vote = min(elapsed_s, _VOTE_S) / _VOTE_S
    if _is_other_scene(texture, sums, grid):
        other_s = sums.other_s + min(elapsed_s, 3600.0)
        if other_s > _OTHER_SCENE_S:
            return _count_use(replace(no_sums(grid), last=coarse, unix_s=unix_s, counts=sums.counts), "other_scene")
        return _count_use(replace(kept, other_s=other_s), "other_scene")
    return _vote(kept, _CellImage(counts, light, texture), grid, sun=sun, vote=vote, sun_seen=sun_seen)


def add_star_votes(sums: ObstructionSums, grid: CellGrid, *, named: FloatArray, missed: FloatArray) -> ObstructionSums:
    """Return the evidence with a night's: a cell votes once.

    Parameters
    ----------
    sums : so far.
    grid : of the camera.
    named : (n, 3) directions, east-north-up, in which stars were named: the sky is free there.
    missed : (m, 3) those of bright stars that were not found in clear images: hidden, where none was named near by.
    """
    free, near, hidden = (
        cv2.dilate(_mark_cells(grid, directions), np.ones((size, size), np.uint8)) > 0
        for directions, size in ((named, 3), (named, 9), (missed, 5))
    )
    votes = _MISSED_STAR * (hidden & ~near & grid.sky) - _NAMED_STAR * free
    return replace(sums, log_odds=_add_votes(sums.log_odds, _to_cells(votes), most=_MOST_CLOUDY_ODDS))


def _add_votes(odds: Cells, votes: Cells, *, most: float) -> Cells:
    """Return log odds with votes, clipped; votes for an obstruction raise none above `most`."""
    voted = odds + votes
    np.minimum(voted, np.maximum(odds, most), out=voted)
    return np.clip(voted, -_MOST_ODDS, _MOST_ODDS, out=voted)


def _mark_cells(grid: CellGrid, directions: FloatArray) -> NDArray[np.uint8]:
    (row, column), seen = _find_cells(grid, directions)
    marked = np.zeros(grid.shape, dtype=np.uint8)
    marked[row[seen], column[seen]] = 1
    return marked


class _CellImage(NamedTuple):
    """An image by cells: share of the full scale, logarithm of the light, fine part of that."""

    counts: Cells
    light: Cells
    texture: Cells


def _count_use(sums: ObstructionSums, use: str) -> ObstructionSums:
    return replace(sums, counts={**sums.counts, use: sums.counts.get(use, 0) + 1})


def _reduce_to_cells(image: Image, shape: tuple[int, int]) -> Cells:
    """Return the means of cells as shares of the full scale, by halves first: a mosaic's colours are averaged."""
    cells: NDArray[Any] = image
    while cells.shape[0] >= 2 * shape[0]:
        cells = cv2.resize(cells, (cells.shape[1] // 2, cells.shape[0] // 2), interpolation=cv2.INTER_AREA)
    cells = cv2.resize(cells, shape[::-1], interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(cells, cv2.COLOR_BGR2GRAY) if cells.ndim == 3 else cells
    return _to_cells(grey) / np.float32(np.iinfo(image.dtype).max)


def _to_cells(values: ArrayLike) -> Cells:
    return np.asarray(values, dtype=np.float32)


def _log_light(counts: Cells, *, gamma: float) -> Cells:
    return np.float32(gamma) * np.log(np.maximum(counts, np.float32(_LEAST_COUNT)))


def _find_fault(counts: Cells, coarse: Cells, sums: ObstructionSums, grid: CellGrid) -> str | None:
    """Return why an image does not vote: the lens is covered, or the picture is the last one again."""
    low, high = np.quantile(counts.ravel()[grid.sampled], [0.02, 0.98])
    if high - low < _LEAST_RANGE * max(high, 0.05):
        return "covered"
    return "frozen" if float(np.median(np.abs(coarse - sums.last))) < 1e-6 else None


def _compute_texture(light: Cells, counts: Cells) -> Cells:
    """Return the fine part of the log brightness, 0 where cells saturate."""
    fine = np.clip(light - cv2.blur(light, (3, 3)), -0.5, 0.5)
    saturated = cv2.dilate((counts > _SATURATED).astype(np.uint8), np.ones((5, 5), np.uint8))
    return _to_cells(fine * (saturated == 0))


def _is_other_scene(texture: Cells, sums: ObstructionSums, grid: CellGrid) -> bool:
    """Return whether an image's texture is not the stored one, where that is known and seen."""
    texture, stored, up = (one[::2, ::2] for one in (texture, sums.texture, grid.directions[2]))
    strong = (np.abs(stored) > 2.0 * _STATIC) & (up > math.sin(math.radians(_RIM_DEG)))
    n = np.count_nonzero(strong)
    if sums.votes < 0.25 * _STATIC_VOTES or n < 50:
        return False
    now, stored = texture * strong, stored * strong
    if np.vdot(now, now) < n * _STATIC**2:  # fog, snow: nothing is seen, of any scene
        return False
    return bool(np.vdot(now, stored) < _OTHER_SCENE * math.sqrt(np.vdot(now, now) * np.vdot(stored, stored)))


def _vote(
    sums: ObstructionSums, image: _CellImage, grid: CellGrid, *, sun: FloatArray, vote: float, sun_seen: bool | None
) -> ObstructionSums:
    """Return the evidence with the votes of a usable image."""
    towards = _to_cells(np.tensordot(sun.astype(np.float32), grid.directions, 1))
    contrast, spread = _measure_contrast(image.light, sums, grid, towards)
    seen = sun_seen if sun_seen is not None else _sun_is_seen(image, grid, towards)
    odds_at_sun = float(sums.log_odds.flat[int(np.argmax(towards))])
    clear = seen or (
        sun[2] > 0.0 and odds_at_sun > -1.0 and spread < _CLEAR_SPREAD and sums.unix_s - sums.seen_s < _CLEAR_FOR_S
    )
    weight = vote / (1.0 + (spread / _CLEAR_SPREAD) ** 2) ** 2 * (1.0 if clear else _CLOUDY_WEIGHT)
    usable = ((towards < math.cos(math.radians(_AUREOLE_DEG))) & (image.counts < _SATURATED)).astype(np.uint8)
    shows_sky = clear or spread > _CLEAR_SPREAD  # in fog and under an even overcast all looks like the sky
    votes = _score_cells(contrast, _measure_stillness(image.texture, sums), shows_sky=shows_sky)
    votes *= usable * np.float32(weight)
    odds = _add_votes(sums.log_odds, votes, most=_MOST_ODDS if clear else _MOST_CLOUDY_ODDS)
    if seen:
        np.subtract(odds, 4.0 * vote, out=odds, where=towards > math.cos(math.radians(0.4)))
    missed = not seen and sun[2] > 0.0 and odds_at_sun < 1.0
    share, texture, mean = weight / (min(sums.votes, _STATIC_VOTES) + weight), sums.texture.copy(), sums.contrast.copy()
    cv2.accumulateWeighted(image.texture, texture, share)
    cv2.accumulateWeighted(contrast, mean, share, mask=usable)
    found = replace(
        sums,
        log_odds=odds,
        texture=texture,
        contrast=mean,
        votes=sums.votes + weight,
        clear_s=_count_clear_s(sums, vote * _VOTE_S, seen=seen and spread < _FAIR_SPREAD, missed=missed),
        seen_s=sums.unix_s if seen else sums.seen_s,
        other_s=0.0,
    )
    return _count_use(found, "clear" if clear else "cloudy")


def _count_clear_s(sums: ObstructionSums, voted_s: float, *, seen: bool, missed: bool) -> float:
    """Return the time with the sun seen; before there is a mask less half of that without: bright clouds look alike."""
    if seen:
        return sums.clear_s + voted_s
    return max(sums.clear_s - 0.5 * voted_s, 0.0) if missed and not sums.is_ready else sums.clear_s


def _score_cells(contrast: Cells, still: Cells, *, shows_sky: bool) -> Cells:
    """Return votes by cells: above 0 where they are dark or their texture stands still, below where they are sky."""
    dark = np.clip((-_DARK - contrast) / _DARK_WIDTH, -1.0, 1.0)
    scores = np.maximum(dark, 0.0) + still
    if shows_sky:
        fading = np.clip((_BRIGHT + _BRIGHT_WIDTH - contrast) / _BRIGHT_WIDTH, 0.2, 1.0)
        scores += np.minimum(dark, 0.0) * fading * (1.0 - still)
    return _to_cells(scores)


def _sky_planes(directions: Cells, towards: Cells) -> Iterator[Cells]:
    """Yield the terms (...) of a smooth sky's light in directions (3, ...) with these cosines (...) to the sun."""
    yield from directions
    yield directions[2] ** 2
    yield np.exp(-6.0 * np.abs(directions[2]))
    yield towards**2
    yield 1.0 / (1.1 - towards)


def _measure_contrast(light: Cells, sums: ObstructionSums, grid: CellGrid, towards: Cells) -> tuple[Cells, float]:
    """Return the log contrast to a smooth sky, fitted to cells that are not dark, and the spread about it."""
    sampled, sun_cosine = grid.directions.reshape(3, -1)[:, grid.sampled], towards.ravel()[grid.sampled]
    rows = np.stack([np.ones_like(sun_cosine), *_sky_planes(sampled, sun_cosine)], axis=-1).astype(np.float64)
    values = light.ravel()[grid.sampled].astype(np.float64)
    up = rows[:, 3]
    free = 1.0 / (1.0 + np.exp(np.clip(sums.log_odds.ravel()[grid.sampled], -4.0, 4.0)))
    prior = free * (sun_cosine < math.cos(math.radians(_AUREOLE_DEG)))
    weight, ridge = prior * (0.1 + up), np.diag([0.0, 1.0, 1.0, 1.0, 4.0, 4.0, 1.0, 1.0])
    residual = values
    for _ in range(_FIT_ROUNDS):
        weighted = rows * weight[:, None]
        terms = np.linalg.solve(weighted.T @ rows + ridge + 1e-9 * np.eye(8), weighted.T @ values)
        residual = values - rows @ terms
        weight = prior * (0.2 + up) / (1.0 + (residual / np.where(residual < 0.0, 0.25, 0.5)) ** 2)
    contrast = light - np.float32(terms[0])
    for term, plane in zip(terms[1:].tolist(), _sky_planes(grid.directions, towards), strict=True):
        cv2.scaleAdd(plane, -term, contrast, dst=contrast)
    high = (up > 0.17) & (prior > 0.3)
    spread = 1.48 * float(np.median(np.abs(residual[high]))) if np.count_nonzero(high) else 1.0
    return np.clip(contrast, -2.0, 2.0, out=contrast), spread


def _sun_is_seen(image: _CellImage, grid: CellGrid, towards: Cells) -> bool:
    """Return whether the brightest cell about the sun's place stands above the sky, and saturates or above its ring."""
    cells = np.flatnonzero(towards > math.cos(math.radians(_RING_DEG)))
    near = towards.ravel()[cells] > math.cos(math.radians(_DISC_DEG))
    if not near.any() or near.all():
        return False
    light, counts = image.light.ravel()[cells], image.counts.ravel()[cells]
    peak = float(light[near].max())
    if peak - float(np.median(image.light.ravel()[grid.sampled])) < _SUN_RATIO:
        return False
    return bool(counts[near].max() > _SATURATED) or peak - float(np.median(light[~near])) > _RING_RATIO


def _measure_stillness(texture: Cells, sums: ObstructionSums) -> Cells:
    """Return (rows, columns), 0 to 1: how surely a texture is there that stood in earlier images already."""
    if sums.votes < 0.1 * _STATIC_VOTES:
        return np.zeros_like(texture)
    halves = (texture.shape[1] // 2, texture.shape[0] // 2)
    stored, now = (
        cv2.resize(one * sums.texture, halves, interpolation=cv2.INTER_AREA) for one in (sums.texture, texture)
    )
    energy = np.maximum(cv2.blur(stored, (3, 3)), 0.0)
    agreement = cv2.blur(now, (3, 3)) / (energy + 1e-4)
    still = np.clip(np.sqrt(energy) / _STATIC - 1.0, 0.0, 1.0) * np.clip(2.0 * agreement - 0.5, 0.0, 1.0)
    narrowed = cv2.erode(still, np.ones((5, 5), np.uint8))  # what the means have widened
    return _to_cells(cv2.resize(narrowed, texture.shape[::-1], interpolation=cv2.INTER_LINEAR))


# The mask of the evidence.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ObstructionMask:
    """Obstructions of the sky, by cells."""

    grid: CellGrid
    """Of the camera."""
    probability: Cells
    """(rows, columns) of being hidden."""
    state: States
    """(rows, columns): `FREE`, `UNKNOWN`, `SOILED` or `HIDDEN`."""

    def image(self) -> NDArray[np.uint8]:
        """Return the states of all pixels (height, width)."""
        hidden = (255.0 * self.probability).astype(np.uint8)
        fine = cv2.resize(hidden, self.grid.size, interpolation=cv2.INTER_LINEAR)
        state = cv2.threshold(fine, 127, FREE, cv2.THRESH_BINARY_INV)[1]
        for value in (UNKNOWN, SOILED):
            holds = cv2.resize((self.state == value).astype(np.uint8), self.grid.size, interpolation=cv2.INTER_NEAREST)
            state[holds > 0] = value
        return np.asarray(state, dtype=np.uint8)

    def hidden(self) -> BoolArray:
        """Return (height, width): which pixels do not show the sky, dirt on the dome with them."""
        return _hides(self.image())

    @property
    def hidden_cells(self) -> BoolArray:
        """(rows, columns) whether they do not show the sky, dirt on the dome with them."""
        return _hides(self.state)

    def hides(self, directions: FloatArray) -> BoolArray:
        """Return (...): which directions (..., 3), east-north-up, are surely behind an obstruction or dirt."""
        cells, seen = _find_cells(self.grid, directions.reshape(-1, 3))
        hidden = seen & _hides(self.state[cells])
        return hidden.reshape(directions.shape[:-1])


def _hides(states: States) -> BoolArray:
    return np.asarray((states == HIDDEN) | (states == SOILED))


def _find_cells(grid: CellGrid, directions: FloatArray) -> tuple[tuple[IntArray, IntArray], BoolArray]:
    """Return rows and columns (n,) of the cells that directions (n, 3) are in, and whether the camera sees these."""
    at = project_fast(grid.camera, directions)
    seen = camera_sees(grid.camera, at)
    cells = (np.where(seen[:, None], at + 0.5, 0.0) * grid.shape[::-1] / grid.size).astype(int)
    column, row = np.clip(cells, 0, np.array(grid.shape[::-1]) - 1).T
    return (row, column), seen


def obstruction_mask(sums: ObstructionSums, grid: CellGrid) -> ObstructionMask:
    """Return the mask: the evidence, smoothed over neighbours of like brightness by mean-field sweeps."""
    links = [np.exp(-((np.diff(one, axis=0) / _EDGE) ** 2)) for one in (sums.contrast, sums.contrast.T)]
    odds = sums.log_odds.copy()
    for _ in range(_SWEEPS):
        belief = 2.0 * _COUPLING * np.tanh(0.5 * odds)
        odds = sums.log_odds.copy()
        for link, raised, of_others in zip(links, (odds, odds.T), (belief, belief.T), strict=True):
            raised[:-1] += link * of_others[1:]
            raised[1:] += link * of_others[:-1]
    odds[~grid.sky] = _MOST_ODDS
    state = np.where(odds > _CERTAIN, HIDDEN, np.where(odds < -_CERTAIN, FREE, UNKNOWN)).astype(np.uint8)
    state[_find_soiled(state == HIDDEN, sums.contrast, grid)] = SOILED
    probability = (1.0 / (1.0 + np.exp(-np.clip(odds, -30.0, 30.0)))).astype(np.float32)
    return ObstructionMask(grid=grid, probability=probability, state=state)


def _find_soiled(hidden: BoolArray, contrast: Cells, grid: CellGrid) -> BoolArray:
    """Return which hidden cells are dirt on the dome: away from the rim and without a sharp border."""
    rim = ~(grid.directions[2] > math.sin(math.radians(_RIM_DEG)))
    n, labels = cv2.connectedComponents((hidden | rim).astype(np.uint8), connectivity=8)
    slope = cv2.morphologyEx(contrast, cv2.MORPH_GRADIENT, np.ones((2, 2), np.uint8))
    soiled = np.zeros(hidden.shape, dtype=bool)
    for label in set(range(1, n)) - set(np.unique(labels[rim]).tolist()):
        part = labels == label
        border = cv2.dilate(part.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & ~part
        if float(np.median(slope[border])) < _BLUR_PER_CELL:
            soiled |= part
    return soiled


class ComparedMasks(NamedTuple):
    """Agreement of a mask with a drawn one: intersection over union, and what either hides alone, square degrees."""

    agreement: float
    missing_deg2: float
    extra_deg2: float


def compared_masks(mask: ObstructionMask, drawn: BoolArray) -> ComparedMasks:
    """Return how a mask compares with a drawn one (height, width), over the sky whose state is known."""
    hides = cv2.resize(drawn.astype(np.float32), mask.grid.shape[::-1], interpolation=cv2.INTER_AREA) > 0.5
    known, shown = mask.grid.sky & (mask.state != UNKNOWN), mask.hidden_cells
    area = np.where(known, mask.grid.area_deg2, 0.0)
    both, either = (float(area[one].sum()) for one in (shown & hides, shown | hides))
    missing, extra = (float(area[one].sum()) for one in (shown & ~hides, hides & ~shown))
    return ComparedMasks(both / either if either else 1.0, missing, extra)


class Change(NamedTuple):
    """An obstruction that appeared or is gone: direction of its centre, degrees, and solid angle, square degrees."""

    appeared: bool
    azimuth_deg: float
    elevation_deg: float
    area_deg2: float


def mask_changes(known: States, mask: ObstructionMask, *, least_deg2: float = 4.0) -> tuple[list[Change], States]:
    """Return the obstructions that appeared and those that are gone, the largest first, and the states known after.

    A cell keeps the state that is known of it while it is unknown or dirty, or its change is too small: an obstruction
    that grows in the mask bit by bit is found once it is large enough.

    Parameters
    ----------
    known : (rows, columns) states, of former masks of the camera.
    mask : the newest one.
    least_deg2 : solid angle from which on a change counts.
    """
    found, after = [], known.copy()
    for appeared, was, now in ((True, FREE, HIDDEN), (False, HIDDEN, FREE)):
        after[(known != was) & (mask.state == now)] = now
        changed = ((known == was) & (mask.state == now)).astype(np.uint8)
        core = cv2.dilate(cv2.erode(changed, np.ones((2, 2), np.uint8)), np.ones((5, 5), np.uint8))
        n, labels = cv2.connectedComponents(core * changed)
        for label in range(1, n):
            part = labels == label
            area = float(mask.grid.area_deg2[part].sum())
            if area >= least_deg2:
                after[part] = now
                east, north, up = mask.grid.directions[:, part].mean(axis=1).tolist()
                elevation = math.degrees(math.atan2(up, math.hypot(east, north)))
                found.append(Change(appeared, math.degrees(math.atan2(east, north)) % 360.0, elevation, area))
    return sorted(found, key=lambda one: -one.area_deg2), after


def carried_over(sums: ObstructionSums, camera: Camera, grid: CellGrid) -> ObstructionSums:
    """Return the evidence of a camera's former pose for its new one, by directions; it keeps half its log odds.

    Parameters
    ----------
    sums : of the former pose.
    camera : the former pose.
    grid : of the new pose.
    """
    odds, contrast = (_at_former_pose(one, camera, grid) for one in (0.5 * sums.log_odds, sums.contrast))
    empty = no_sums(grid)
    return replace(
        sums, log_odds=odds, contrast=contrast, texture=empty.texture, votes=0.0, other_s=0.0, last=empty.last
    )


def carried_states(states: States, camera: Camera, grid: CellGrid) -> States:
    """Return states of a camera's former pose for its new one; unknown near borders, since poses have errors."""
    carried = np.rint(_at_former_pose(_to_cells(states) - UNKNOWN, camera, grid) + UNKNOWN).astype(np.uint8)
    lowest, highest = (change(carried, np.ones((7, 7), np.uint8)) for change in (cv2.erode, cv2.dilate))
    return np.where(lowest == highest, carried, np.uint8(UNKNOWN))


def _at_former_pose(values: Cells, camera: Camera, grid: CellGrid) -> Cells:
    at = project_fast(camera, grid.directions.reshape(3, -1).T.astype(np.float64)).reshape(*grid.shape, 2)
    return sampled_cells(values, at, camera)


def sampled_cells(values: Cells, pixels: FloatArray, camera: Camera) -> Cells:
    """Return values of cells (rows, columns) at pixels (..., ..., 2), between cells linearly; 0 outside the image."""
    scale = np.array([values.shape[1] / camera.width, values.shape[0] / camera.height])
    at = _to_cells(np.nan_to_num((pixels + 0.5) * scale - 0.5, nan=-9.0))
    columns, rows = np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])
    found = cv2.remap(
        _to_cells(values), columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0
    )
    return _to_cells(found)
