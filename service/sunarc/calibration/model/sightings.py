"""Input of a fit: sightings of the sun, and the selection that a fit may use."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from sunarc.common.array_types import BoolArray, FloatArray, IntArray, NameArray, Rows, even_parts
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.optics.camera import inside_image
from sunarc.sky.days import solar_days
from sunarc.sky.night import SOLAR_SYSTEM_BODIES, STAR, SUN
from sunarc.sky.refraction import ASSUMED_AIR_SD, DAILY_AIR_SD, MEASURED_AIR_SD, refraction_rad
from sunarc.sky.site import EARTH_RATE, Site, pole_enu
from sunarc.sky.sun import sun_angles, sun_directions

# What sightings are of, as far as their noise and their systematic errors differ.

MOON = "moon"
_NIGHT_ZENITH_DEG = 96.0
"""Of the sun: civil dusk, when the ground has been without the sun's heat for half an hour."""


class Kind(IntEnum):
    """The kind of a body: the sun (or a direction without a known body), a point of light, the moon."""

    SUN = 0
    STAR = 1
    MOON = 2


def body_kinds(bodies: NameArray) -> IntArray:
    """Return the kinds (n,) of bodies by their names (n,); planets are points of light as stars are."""
    kinds = np.full(bodies.shape, Kind.SUN, dtype=np.int64)
    rows = np.flatnonzero(bodies != SUN)  # few of millions
    other = bodies[rows]
    star = np.char.startswith(other, STAR) | np.isin(other, [name for name in SOLAR_SYSTEM_BODIES if name != MOON])
    kinds[rows] = np.where(other == MOON, Kind.MOON, np.where(star, Kind.STAR, Kind.SUN))
    return kinds


# Positions that stay where they are while the sun moves: text overlays, reflections at the dome, hot pixels.
#
# How far the sun moved decides, and not how often a position comes again: at a high cadence and with whole pixels the
# sun itself stays on one pixel for a minute. All sightings of one day within 3 x 3 px are looked at together. A sun
# that is seen there has moved by the 3 px only, 0.3 to 2 degrees with any all-sky camera of more than 300 px.

_FEWEST = 8
"""Sightings at one position that can show that it stands still; fewer are left to the robust loss."""
_STILL = math.cos(math.radians(2.5))
"""Cosine of the median angle between the sun and its middle direction above which a position does not follow it: 10
degrees of an even motion, 40 minutes. At the edge of an orthographic image of 600 px, where 3 px are most of the sky,
the angle is 2."""
_LARGEST_PX = 2.0**20
"""Cells further out than this are cut to it; no image is as large."""


class StaticPosition(NamedTuple):
    """A position that does not move: its middle in px, and how many sightings lie there."""

    x: float
    y: float
    n: int


def static_sightings(pixels: FloatArray, directions: FloatArray, group: IntArray) -> BoolArray:
    """Return (n,): which sightings lie at positions that do not move with the sun.

    Parameters
    ----------
    pixels : (n, 2) px.
    directions : (n, 3) unit vectors to the sun.
    group : (n,) whole numbers from 0; sightings of one group are of one day and pose.
    """
    cell = np.floor(np.clip(pixels, -_LARGEST_PX, _LARGEST_PX)).astype(np.int64) + int(_LARGEST_PX) + 1
    width = int(2 * _LARGEST_PX + 4)
    key = (group * width + cell[:, 0]) * width + cell[:, 1]
    by_cell = np.argsort(key, kind="stable")
    ordered = key[by_cell]
    cells = ordered[np.diff(ordered, prepend=-1) > 0]
    # cells of one column follow each other: the nine about one are three runs
    firsts = np.stack([np.searchsorted(ordered, cells + column * width - 1) for column in (-1, 0, 1)])
    lasts = np.stack([np.searchsorted(ordered, cells + column * width + 1, side="right") for column in (-1, 0, 1)])
    around = np.sum(lasts - firsts, axis=0)
    many = np.flatnonzero(around >= _FEWEST)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(directions[by_cell], axis=0)])
    mean = np.sum(sums[lasts[:, many]] - sums[firsts[:, many]], axis=0) / around[many, None]
    # the mean of unit vectors is short where they differ: cheap enough for every cell
    suspect = many[np.linalg.norm(mean, axis=-1) < _STILL]
    static = np.zeros(pixels.shape[0], dtype=bool)
    for one in suspect:
        runs = zip(firsts[:, one], lasts[:, one], strict=True)
        rows = np.concatenate([by_cell[first:last] for first, last in runs])
        # most of them far from their middle: a few false sightings do not make it so
        middle = np.median(directions[rows], axis=0)
        middle /= max(float(np.linalg.norm(middle)), 1e-9)
        static[rows] |= float(np.median(directions[rows] @ middle)) < _STILL
    return static


def static_positions(pixels: FloatArray) -> tuple[StaticPosition, ...]:
    """Return the positions of static sightings at pixels (n, 2), the most frequent first; those within 3 px are one."""
    remaining, found = pixels, []
    while remaining.size:
        _, member, count = np.unique(np.floor(remaining), axis=0, return_inverse=True, return_counts=True)
        middle = np.median(remaining[member.ravel() == np.argmax(count)], axis=0)
        near = np.max(np.abs(remaining - middle), axis=-1) <= 3.0
        found.append(StaticPosition(float(middle[0]), float(middle[1]), int(near.sum())))
        remaining = remaining[~near]
    return tuple(sorted(found, key=lambda one: -one.n))


_LOWEST_UP = -math.sin(math.radians(1.0))
_AIR_RUNS = 8
"""Days, or runs of days in a longer record, whose air is taken to differ: the weather's in a short record, the season's
in a long one, whose daily weather averages out."""

_SMALLEST_SIGMA, _LARGEST_SIGMA = 0.01, 100.0
"""Bounds of a sigma over the median of all: no sighting is worth ten thousand, whatever is stated with it."""
MAX_CLOCK_ERROR_S = 2.0
"""Sightings whose clock may be wrong by more are used for nothing: 2 s turn the sky by 0.008 degrees."""


class Filtering(NamedTuple):
    """Counts of sightings left out by `filter_sightings`, and findings about those kept.

    dropped: how many were left out, a finding for each cause. static: positions left out that do not move with the sun.
    stated_sigma_px: root mean square of the stated 1-sigma, px per axis; NaN where none is stated. n_below_horizon:
    sightings of the sun left out because it was below the horizon. below: their pixels (n, 2) and directions (n, 3).
    """

    dropped: tuple[Finding, ...] = ()
    static: tuple[StaticPosition, ...] = ()
    stated_sigma_px: float = math.nan
    n_below_horizon: int = 0
    below: tuple[FloatArray, FloatArray] = (np.zeros((0, 2)), np.zeros((0, 3)))

    def after(self, before: Filtering) -> Filtering:
        """Return this filtering combined with an earlier one of the same sightings."""
        dropped = {one.code: int(one.data["n"]) for one in before.dropped}
        for one in self.dropped:
            dropped[one.code] = dropped.get(one.code, 0) + int(one.data["n"])
        return Filtering(
            dropped=tuple(Finding(code, {"n": n}) for code, n in dropped.items()),
            static=(*before.static, *self.static),
            stated_sigma_px=before.stated_sigma_px if math.isfinite(before.stated_sigma_px) else self.stated_sigma_px,
            n_below_horizon=before.n_below_horizon + self.n_below_horizon,
            below=(np.concatenate([before.below[0], self.below[0]]), np.concatenate([before.below[1], self.below[1]])),
        )


_OF_THE_TABLE = {"pixels", "filtering"}
"""Fields that are not stated for all sightings where they have one row."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sightings:
    """Sightings of the sun, of stars and of the moon: one row each; a column of one row counts for all.

    As they are given from outside (see `of`) they have times, pixels and what was stated with them. As a fit takes them
    (see `filter_sightings`) they are in the order of the epochs, in each the sun's track by time, then those of stated
    directions; and all columns are known.

    Attributes
    ----------
    pixels : (n, 2) where the body's centre was seen, px.
    unix_s : (n,) mid-exposure times, seconds since 1970-01-01 UTC; NaN where they do not matter.
    directions : (n, 3) apparent directions, unit vectors, east-north-up. Given from outside: of what is not the sun or
        is known better; NaN takes the sun's. Such sightings make no track: many may be of one moment, and neighbours
        say nothing of one another.
    sigma_px : (n,) stated 1-sigma per axis, px; NaN where none is stated. Fits trust their ratios and find
        their common scale themselves: filtered ones have a median of 1, and 1 where none was stated.
    epoch : (n,) which pose epoch a sighting belongs to, 0, 1, ….
    body : (n,) names of what was seen: `sun`, `venus`, `star:HIP32349`.
    kind : (n,) see `Kind`.
    clock_error_s : (n,) bound of the clock's error, s; NaN where unknown.
    temperature, pressure : (n,) of the air, °C and Pa; NaN where not measured: the site's are assumed.
    count : (n,) how many sightings a row stands for, see `normal_points`.
    index : (n,) their rows in the sightings supplied.
    day : (n,) local mean solar day, counted from 1970.
    alone : (n,) whether the direction was stated: such a sighting has no neighbours in time.
    night : (n,) whether it is not of the sun, and the sun 6 degrees below the horizon or more.
    information : (n,) inverse variance of each axis, px⁻²; relative where the scale is still sought.
    refraction_sd : (n, k) 1-sigma of the refraction, rad, by k independent causes: the measured air, the assumed one,
        and the assumed one of each day (or of so many runs of days); 0 where a cause does not act.
    motion : (n, 3) by what the sky turns a direction, per second.
    false_density : (n,) logarithm of how likely a false sighting is to be just there, px⁻²; 0 where none is sought.
    systematic_px : (n, 2, s) displacements by s errors that many sightings share, each at its 1-sigma, px.
    filtering : what was left out of them.
    """

    pixels: FloatArray
    unix_s: FloatArray = field(default_factory=lambda: np.full(1, np.nan))
    directions: FloatArray = field(default_factory=lambda: np.full((1, 3), np.nan))
    sigma_px: FloatArray = field(default_factory=lambda: np.full(1, np.nan))
    epoch: IntArray = field(default_factory=lambda: np.zeros(1, np.int64))
    body: NameArray = field(default_factory=lambda: np.array([SUN]))
    kind: IntArray = field(default_factory=lambda: np.zeros(1, np.int64))
    clock_error_s: FloatArray = field(default_factory=lambda: np.full(1, np.nan))
    temperature: FloatArray = field(default_factory=lambda: np.full(1, np.nan))
    pressure: FloatArray = field(default_factory=lambda: np.full(1, np.nan))
    count: IntArray = field(default_factory=lambda: np.ones(1, np.int64))
    index: IntArray = field(default_factory=lambda: np.zeros(1, np.int64))
    day: IntArray = field(default_factory=lambda: np.zeros(1, np.int64))
    alone: BoolArray = field(default_factory=lambda: np.zeros(1, np.bool_))
    night: BoolArray = field(default_factory=lambda: np.zeros(1, np.bool_))
    information: FloatArray = field(default_factory=lambda: np.ones(1))
    refraction_sd: FloatArray = field(default_factory=lambda: np.zeros((1, 1)))
    motion: FloatArray = field(default_factory=lambda: np.zeros((1, 3)))
    false_density: FloatArray = field(default_factory=lambda: np.zeros(1))
    systematic_px: FloatArray = field(default_factory=lambda: np.zeros((1, 2, 0)))
    filtering: Filtering = field(default_factory=Filtering)

    def __post_init__(self) -> None:
        """Repeat for every sighting the values stated once for all."""
        n = len(self)
        for name in self.__dataclass_fields__.keys() - _OF_THE_TABLE:
            column = getattr(self, name)
            if column.shape[:1] != (n,):
                object.__setattr__(self, name, np.broadcast_to(column, (n, *column.shape[1:])))

    @classmethod
    def of(
        cls, *, unix_s: ArrayLike, pixels: ArrayLike, body: NameArray | None = None, **stated: ArrayLike
    ) -> Sightings:
        """Return sightings that are given from outside: checked, scalars broadcast, columns read-only copies.

        Parameters
        ----------
        unix_s : (n,) mid-exposure times, seconds since 1970-01-01 UTC.
        pixels : (n, 2) px.
        body : (n,) names, which state the kinds; None: the sun.
        stated : further columns by their names, each (n, ...) or one value for all.
        """
        times = _read_only_column("unix_s", unix_s, None)
        places = np.array(pixels, dtype=np.float64)
        if places.size == 0:
            places = places.reshape(0, 2)
        if places.shape != (times.size, 2):
            problem = f"shape {places.shape} beside {times.size} times"
            raise InputError(field="pixels", problem=problem, remedy="give one x, y a time")
        places.flags.writeable = False
        columns: dict[str, Any] = {name: _read_only_column(name, values, times.size) for name, values in stated.items()}
        epoch = columns.get("epoch", np.zeros(1))
        if not np.all(np.isfinite(epoch)) or np.any(epoch < 0) or np.any(epoch != np.floor(epoch)):
            raise InputError(
                field="epoch", problem="not a whole number from 0", remedy="number the pose epochs 0, 1, …"
            )
        columns |= {name: columns[name].astype(np.int64) for name in ("epoch", "kind") if name in columns}
        if body is not None:
            columns |= {"body": body, "kind": body_kinds(body)}
        return cls(unix_s=times, pixels=places, **columns)

    def __len__(self) -> int:
        return int(self.pixels.shape[0])

    @property
    def variance(self) -> FloatArray:
        """(n,) of each axis by the stated sigma, px²."""
        return np.asarray(self.sigma_px**2)

    def select(self, which: Rows) -> Self:
        """Return the sightings that a slice, an index or a mask picks."""
        columns = {name: getattr(self, name) for name in self.__dataclass_fields__.keys() - _OF_THE_TABLE}
        # what is said of all is said of some, and takes no memory
        some = {name: one[:1] if one.strides[0] == 0 and len(self) else one[which] for name, one in columns.items()}
        return replace(self, pixels=self.pixels[which], **some)

    def thinned(self, most: int) -> Self:
        """Return at most so many of them, spread over their order."""
        return self.select(np.unique(np.linspace(0, len(self) - 1, most).astype(int)))


# Numbers on a grid: cut or rounded before they were written. A cut moves all of them by half a step, a rounding none.

_FEWEST_ON_GRID = 20
_DIGIT_PX, _LEAST_STEP_PX = 1e-4, 0.05
"""Digits to which pixels are compared, and the smallest step that matters."""
_SCHEDULED_MINUTES = 5
"""Minutes that all times are multiples of from which on they are those of a schedule."""
_MINUTE_S = 60.0


def grid_steps_px(pixels: FloatArray) -> FloatArray:
    """Return (2,): the steps by which all x and all y of pixels (n, 2) differ, px; 0 of few, and on no grid."""
    known = pixels[np.all(np.isfinite(pixels), axis=-1)]
    if len(known) < _FEWEST_ON_GRID:
        return np.zeros(2)
    digits = np.round((known - known[0]) / _DIGIT_PX).astype(np.int64)
    step = _DIGIT_PX * np.gcd.reduce(digits, axis=0)
    return np.asarray(np.where(step < _LEAST_STEP_PX, 0.0, step))


def time_step_s(unix_s: FloatArray) -> float:
    """Return the step of times (n,) that are all whole minutes, as a format without seconds writes them, s; else 0.

    Times that are all multiples of five minutes or more are those of a schedule, which begins on the minute: times
    that were cut would be so by chance alone.
    """
    known = unix_s[np.isfinite(unix_s)]
    if len(known) < _FEWEST_ON_GRID or np.any(known % _MINUTE_S):
        return 0.0
    scheduled = np.gcd.reduce((known / _MINUTE_S).astype(np.int64)) >= _SCHEDULED_MINUTES
    return 0.0 if scheduled else _MINUTE_S


def _read_only_column(name: str, values: ArrayLike, length: int | None) -> FloatArray:
    """Return a read-only copy of a column, (n,), or of unit vectors, (n, 3); one row is repeated for all."""
    vectors = name == "directions"
    try:
        column = np.array(values, dtype=np.float64)
        if length is not None:
            column = np.array(np.broadcast_to(column, (length, 3) if vectors else (length,)))
    except (TypeError, ValueError, OverflowError) as fault:
        remedy = "give east, north, up of each sighting" if vectors else "give numbers, one a sighting"
        raise InputError(field=name, problem=str(fault), remedy=remedy) from fault
    if vectors:
        norm = np.linalg.norm(column, axis=-1, keepdims=True)
        if np.any(norm == 0.0) or np.any(np.isinf(norm)):
            problem, remedy = "a vector has no direction", "give unit vectors, NaN for the sun's"
            raise InputError(field=name, problem=problem, remedy=remedy)
        column /= norm
    elif column.ndim != 1:
        raise InputError(field=name, problem=f"{column.ndim} dimensions", remedy="give one column")
    column.flags.writeable = False
    return column


def apparent_directions(points: Sightings, *, site: Site) -> FloatArray:
    """Return (n, 3): the directions of sightings, those of the sun by its path; NaN where a time is no time."""
    directions = points.directions.copy()
    # times beyond the year 5138 are milliseconds or worse, and the sun's algorithm would fail on them
    timely = np.abs(np.nan_to_num(points.unix_s, nan=np.inf)) < 1e11
    of_sun = timely & np.isnan(directions[:, 0])
    directions[of_sun] = sun_directions(
        points.unix_s[of_sun], site, temperature=points.temperature[of_sun], pressure=points.pressure[of_sun]
    )
    directions[~timely] = np.nan
    return directions


def filter_sightings(points: Sightings, *, site: Site, image_size: tuple[int, int] | None = None) -> Sightings:
    """Return the usable sightings: finite, in the image, above the horizon, one a moment, moving with the sun.

    Parameters
    ----------
    points : sightings, in any order.
    site : where the camera stands.
    image_size : width and height, px; None where it is not known.

    Returns
    -------
    The usable ones by time; `filtering` says what was left out, and why.
    """
    directions = apparent_directions(points, site=site)
    finite = np.all(np.isfinite(directions), axis=-1) & np.all(np.isfinite(points.pixels), axis=-1)
    inside = finite if image_size is None else finite & inside_image(points.pixels, image_size)
    above = inside & (np.nan_to_num(directions[:, 2], nan=-1.0) > _LOWEST_UP)
    order = np.flatnonzero(above)
    alone = np.isfinite(points.directions[:, 0])
    # the track by time within each epoch: bins, neighbours and runs rely on it
    stated = [np.nan_to_num(points.directions)] if np.any(alone) else []
    moment = np.column_stack([points.epoch, alone, points.unix_s, *stated])[order]
    by_time = np.lexsort(moment.T[::-1])
    order, moment = order[by_time], moment[by_time]
    single = np.ones(order.size, dtype=bool)
    single[1:] = np.any(np.diff(moment, axis=0) != 0.0, axis=-1)
    retained = order[single]
    day, epoch = solar_days(points.unix_s[retained], longitude=site.longitude), points.epoch[retained]
    # one number for both: pairs are sorted ten times as slowly
    group = np.unique(day * (1 + int(epoch.max(initial=0))) + epoch, return_inverse=True)[1]
    still = static_sightings(points.pixels[retained], directions[retained], group)
    counts = {
        "dropped_not_finite": (~finite).sum(),
        "dropped_outside_image": (finite & ~inside).sum(),
        "dropped_below_horizon": (inside & ~above).sum(),
        "dropped_duplicate_time": (~single).sum(),
        "dropped_static": still.sum(),
    }
    static = static_positions(points.pixels[retained[still]])
    retained, day = retained[~still], day[~still]
    below = inside & ~above & ~alone
    sigma_px, stated_px = _normalise_sigma(points.sigma_px[retained], alone[retained])
    filtering = Filtering(
        dropped=tuple(Finding(code, {"n": int(n)}) for code, n in counts.items() if n),
        static=static,
        stated_sigma_px=stated_px,
        n_below_horizon=int(np.sum(below)),
        below=(points.pixels[below], directions[below]),
    )
    usable, directions = points.select(retained), directions[retained]
    return replace(
        usable,
        index=retained,
        directions=directions,
        sigma_px=sigma_px,
        information=sigma_px**-2.0,
        alone=alone[retained],
        day=day,
        motion=np.cross(directions, EARTH_RATE * pole_enu(site)),
        filtering=filtering.after(points.filtering),
        **_air_columns(usable, directions, day, site),
    )


def _air_columns(points: Sightings, directions: FloatArray, day: IntArray, site: Site) -> dict[str, Any]:
    """Return the columns `night` and `refraction_sd` of sightings at directions (n, 3), of days (n,)."""
    n, other, measured = len(points), points.kind != Kind.SUN, np.isfinite(points.temperature)
    night = np.zeros(n, dtype=np.bool_)
    night[other] = sun_angles(points.unix_s[other], site).apparent_zenith > _NIGHT_ZENITH_DEG
    run = even_parts(day, most=_AIR_RUNS)
    share = np.zeros((n, 3 + int(run.max(initial=-1))))  # of the refraction
    share[:, 0], share[:, 1] = MEASURED_AIR_SD * measured, ASSUMED_AIR_SD * ~measured
    share[np.arange(n), 2 + run] = DAILY_AIR_SD * ~measured
    share *= refraction_rad(directions, site)[:, None]
    return {"night": night, "refraction_sd": share}


def _normalise_sigma(sigma_px: FloatArray, alone: BoolArray) -> tuple[FloatArray, float]:
    """Return (n,): stated 1-sigmas over their median, 1 where nothing is stated; and their root mean square, px.

    A detector of the sun states its sigma to a factor, and its ratios are bounded; those stated with a direction are
    taken as they are. NaN where nothing is stated at all.
    """
    has_sigma = np.isfinite(sigma_px) & (sigma_px > 0.0)
    relative, middle = np.ones(sigma_px.shape), math.nan
    if not np.any(has_sigma):
        return relative, middle
    middle = float(np.median(sigma_px[has_sigma]))
    for kind, (least, most) in ((alone, (0.0, math.inf)), (~alone, (1.0 / 3.0, 10.0))):
        stated = kind & has_sigma
        if np.any(stated):
            median = float(np.median(sigma_px[stated]))
            ratio = np.clip(np.where(has_sigma, sigma_px, median)[kind] / median, least, most)
            relative[kind] = ratio * (median / middle)
    relative = np.clip(relative, _SMALLEST_SIGMA, _LARGEST_SIGMA)
    return relative, float(middle * np.sqrt(np.mean(relative[has_sigma] ** 2)))
