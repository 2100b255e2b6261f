"""Selection of the sightings that a fit uses: by information for each direction, and stars by image part.

A *pass* is the sun's way through one patch of the sky on one day. Passes are taken whole, so that neighbouring
sightings still show how alike they err. Each patch takes passes up to its fill: those of the latest pose first, among
them the most precise, among alike ones those of days that lie far apart. A direction that is new is never left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Gt, Le

from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S, Sightings
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.bounds import Count, Positive, require_bounds
from sunarc.sky.days import solar_days
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

# Patches of the sky of about equal area, by which one asks how much of it was seen.


def sky_patches(directions: FloatArray, *, width_deg: float) -> IntArray:
    """Return (n,): the patch that each direction lies in.

    The sky is cut into rings about the zenith, `width_deg` high, and each ring into cells of about that width.

    Parameters
    ----------
    directions : (n, 3) unit vectors, east-north-up.
    width_deg : of a patch.
    """
    width = math.radians(width_deg)
    east, north, up = np.moveaxis(directions, -1, 0)
    ring = np.floor(np.arctan2(np.hypot(east, north), up) / width).astype(np.int64)
    rings = math.ceil(math.pi / width)
    middle = (np.arange(rings + 1) + 0.5) * width
    cells = np.maximum(1, np.rint(2.0 * math.pi * np.sin(np.minimum(middle, math.pi)) / width)).astype(np.int64)
    first = np.cumsum(cells) - cells
    # modulo 1, so that north's both sides are the first and the last cell
    fraction = np.arctan2(east, north) / (2.0 * math.pi) % 1.0
    cell = np.minimum((fraction * cells[ring]).astype(np.int64), cells[ring] - 1)
    return np.asarray(first[ring] + cell)


def solid_angle_sr(directions: FloatArray, *, width_deg: float = 2.0) -> float:
    """Return the solid angle of the patches in which at least one direction lies, steradians."""
    return float(np.unique(sky_patches(directions, width_deg=width_deg)).size * math.radians(width_deg) ** 2)


_PATCH_SLOT_S = 240.0
"""The sun moves by a degree meanwhile; its place in every sighting of a long record would take a minute to compute."""
_DAY_BITS = 17
"""Days since 1970 of more than three centuries."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectionOptions:
    """Numbers of sightings that a fit uses, and those that it never does.

    Attributes
    ----------
    patch_deg : width of a patch of sky.
    most_per_patch, most_per_epoch : fill of a patch, over all pose epochs and in each.
    most : sightings in all; the fill is lowered towards it, but every patch keeps one pass.
    largest_clock_error_s : sightings whose clock may be wrong by more are left out.
    """

    patch_deg: Annotated[float, Gt(0.0), Le(90.0)] = 4.0
    most_per_patch: Count = 96
    most_per_epoch: Count = 64
    most: Count = 30_000
    largest_clock_error_s: Positive = MAX_CLOCK_ERROR_S

    def __post_init__(self) -> None:
        """Refuse limits that leave nothing."""
        require_bounds(self, section_path="refit.selection")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidates:
    """Columns of a record's sightings by which a fit selects.

    Attributes
    ----------
    unix_s : (n,) seconds since 1970-01-01 UTC; NaN where a sighting has no time.
    sigma_px : (n,) 1-sigma per axis; NaN where not stated.
    clock_error_s : (n,) NaN where unknown.
    epoch : (n,) which pose epoch, 0, 1, ….
    """

    unix_s: FloatArray
    sigma_px: FloatArray
    clock_error_s: FloatArray
    epoch: IntArray

    @staticmethod
    def of(points: Sightings) -> Candidates:
        """Return the candidates of sightings, in the same order."""
        seen = np.all(np.isfinite(points.pixels), axis=-1)
        return Candidates(
            unix_s=np.where(seen, points.unix_s, np.nan),
            sigma_px=points.sigma_px,
            clock_error_s=points.clock_error_s,
            epoch=points.epoch,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Selection:
    """Which sightings a fit uses, and why not the others.

    Attributes
    ----------
    index : (n,) rows of the sightings supplied, in the order of time.
    n_supplied, n_doubtful_clock, n_other_days, n_brackets, n_repeated : how many there were, and how many were left out
        for their clock, for their day, for another one of their slot, and in patches that were full.
    n_patches : patches of sky that the selected ones lie in; fill: how many sightings filled one.
    """

    index: IntArray
    n_supplied: int
    n_doubtful_clock: int
    n_other_days: int
    n_brackets: int
    n_repeated: int
    n_patches: int
    fill: int

    def counts(self) -> dict[str, int]:
        """Return the counts by name, for the evidence."""
        counts = (field.name for field in fields(self) if field.name != "index")
        return {name: int(getattr(self, name)) for name in counts}


class _SunPasses(NamedTuple):
    """Passes in the order in which they are taken: (k,) each, and the pass of every sighting (n,)."""

    n: IntArray
    before: IntArray
    before_in_epoch: IntArray
    rank: IntArray
    patches: int


def select_sightings(
    points: Sightings | Candidates,
    *,
    site: Site,
    slot_s: float = 30.0,
    options: SelectionOptions | None = None,
    left_out_days: IntArray | None = None,
) -> Selection:
    """Return which sightings a fit uses; the same record gives the same selection.

    Parameters
    ----------
    points : the whole record, in any order; what decides of it is enough.
    site : where the camera stands.
    slot_s : the capture's cadence: sightings within one slot (a bracket) count as one.
    options : the limits.
    left_out_days : local mean solar days, counted from 1970, that are not used.
    """
    effective = SelectionOptions() if options is None else options
    record = points if isinstance(points, Candidates) else Candidates.of(points)
    finite = np.isfinite(record.unix_s)
    doubtful = finite & (np.abs(np.nan_to_num(record.clock_error_s)) > effective.largest_clock_error_s)
    remaining = np.flatnonzero(finite & ~doubtful)
    n_finite, day = remaining.size, solar_days(record.unix_s[remaining], longitude=site.longitude)
    if left_out_days is not None and left_out_days.size:
        used = ~np.isin(day, left_out_days)
        remaining, day = remaining[used], day[used]
    n_days = n_finite - remaining.size
    single = _select_one_per_slot(record, remaining, slot_s)
    n_brackets = remaining.size - int(single.sum())
    if n_brackets:
        remaining, day = remaining[single], day[single]
    passes = _sort_passes(record, remaining, day, site, effective)
    fill, retained = _fill_to_limit(passes, effective)
    index = remaining[retained[passes.rank]]
    return Selection(
        index=index[np.argsort(record.unix_s[index], kind="stable")],
        n_supplied=finite.size,
        n_doubtful_clock=int(doubtful.sum()),
        n_other_days=n_days,
        n_brackets=n_brackets,
        n_repeated=remaining.size - index.size,
        n_patches=passes.patches,
        fill=fill,
    )


def _select_one_per_slot(record: Candidates, among: IntArray, slot_s: float) -> BoolArray:
    """Return which sightings stand for their slot: the most precise of it, the earliest among equals."""
    times, epoch = record.unix_s[among], record.epoch[among]
    slot = np.floor(times / slot_s)
    if np.all(np.diff(slot) > 0):  # most often: in the order of time, and one a slot
        return np.ones(among.size, dtype=bool)
    sigma = np.nan_to_num(record.sigma_px[among], nan=np.inf)
    order = np.lexsort((times, sigma, slot, epoch))
    first = np.ones(among.size, dtype=bool)
    first[1:] = (np.diff(slot[order]) != 0) | (np.diff(epoch[order]) != 0)
    selected = np.zeros(among.size, dtype=bool)
    selected[order[first]] = True
    return selected


def _sort_passes(
    record: Candidates, among: IntArray, day: IntArray, site: Site, options: SelectionOptions
) -> _SunPasses:
    """Return the passes by patch, in each the latest pose's first, by precision, then by their days' bits reversed."""
    epoch, slot = record.epoch[among], np.floor(record.unix_s[among] / _PATCH_SLOT_S)
    # few of the many sightings begin a run of equal slot, epoch and day: what follows is of runs as far as it can be
    begins = np.ones(among.size, dtype=bool)
    begins[1:] = (np.diff(slot) != 0.0) | (np.diff(epoch) != 0) | (np.diff(day) != 0)
    run = np.cumsum(begins) - 1
    patch, epoch, day = _patch_of_slots(slot[begins], site, options.patch_deg), epoch[begins], day[begins]
    first_day = int(day.min()) if day.size else 0
    n_days, n_epochs = int((day - first_day).max(initial=0)) + 1, int(epoch.max(initial=0)) + 1
    key, of_run = np.unique((patch * n_epochs + epoch) * n_days + day - first_day, return_inverse=True)
    member = of_run[run]
    count = np.bincount(member, minlength=key.size)
    of_patch, epoch_number = key // (n_days * n_epochs), key // n_days % n_epochs
    grade = sigma_grade(record.sigma_px[among], member, count)
    bits = _reverse_bits(key % n_days)
    order = np.lexsort((bits, grade, epoch_number < n_epochs - 1, of_patch))
    count, of_patch, epoch_number = count[order], of_patch[order], epoch_number[order]
    rank = np.empty(key.size, dtype=np.int64)
    rank[order] = np.arange(key.size)
    return _SunPasses(
        n=count,
        before=_count_before(count, of_patch),
        before_in_epoch=_count_before(count, of_patch * n_epochs + epoch_number),
        rank=rank[member],
        patches=int(np.unique(of_patch).size),
    )


def _patch_of_slots(slots: FloatArray, site: Site, width_deg: float) -> IntArray:
    """Return the patch of the sun in each slot of a few minutes, taken where it stood in the slot's middle."""
    slot, member = np.unique(slots, return_inverse=True)
    return sky_patches(sun_directions((slot + 0.5) * _PATCH_SLOT_S, site), width_deg=width_deg)[member]


def sigma_grade(sigma_px: FloatArray, member: IntArray, count: IntArray) -> IntArray:
    """Return how many times a pass's sigma doubles the record's usual one: 0, 1, …; 0 where none is stated."""
    has_sigma = np.isfinite(sigma_px) & (sigma_px > 0.0)
    if not np.any(has_sigma):
        return np.zeros(count.size, dtype=np.int64)
    usual = float(np.median(sigma_px[has_sigma]))
    logs = np.log2(np.where(has_sigma, sigma_px, usual) / usual)
    mean = np.bincount(member, weights=logs, minlength=count.size) / np.maximum(count, 1)
    return np.maximum(np.rint(mean), 0.0).astype(np.int64)


def _reverse_bits(day: IntArray) -> IntArray:
    """Return an order of days in which the first few always lie far apart."""
    reverse = np.zeros_like(day)
    for bit in range(_DAY_BITS):
        reverse |= ((day >> bit) & 1) << (_DAY_BITS - 1 - bit)
    return reverse


def _count_before(count: IntArray, group: IntArray) -> IntArray:
    """Return (k,): how many sightings of the same group come before each pass."""
    order = np.argsort(group, kind="stable")
    running = np.cumsum(count[order]) - count[order]
    running -= running[np.searchsorted(group[order], group[order])]
    result = np.empty_like(count)
    result[order] = running
    return result


def _fill_to_limit(passes: _SunPasses, options: SelectionOptions) -> tuple[int, BoolArray]:
    """Return the largest number per patch with at most `most` sightings in all, and the passes that it takes."""
    share = options.most_per_epoch / options.most_per_patch
    low, high = 1, options.most_per_patch
    retained = (passes.before < high) & (passes.before_in_epoch < options.most_per_epoch)
    if int(passes.n[retained].sum()) <= options.most:
        return high, retained
    while high - low > 1:
        fill = (low + high) // 2
        retained = (passes.before < fill) & (passes.before_in_epoch < max(1.0, share * fill))
        low, high = (fill, high) if int(passes.n[retained].sum()) <= options.most else (low, fill)
    return low, (passes.before < low) & (passes.before_in_epoch < max(1.0, share * low))


# Which sightings of stars a fit uses: a few of each part of the image, the surest ones.

MOST_STARS = 150
"""Stars that a fit uses. With a day of the sun they tell as much as thousands (docs/studies.md, "The night"); with
thousands the fit takes the lens's unmodelled field for noise, and states far too little."""
_SECTORS, _RINGS = 12, 4


def image_parts(pixels: FloatArray, image_size: tuple[int, int]) -> IntArray:
    """Return (n,) in which of 48 parts of equal area about the middle of an image pixels (n, 2) are."""
    middle = 0.5 * (np.array(image_size) - 1.0)
    across, down = ((pixels - middle) / (0.5 * min(image_size))).T
    return _number_parts(np.arctan2(down, across), across**2 + down**2)


def sky_parts(directions: FloatArray) -> IntArray:
    """Return (n,) in which of 48 parts of equal area of the sky directions (n, 3) are."""
    east, north, up = directions.T
    return _number_parts(np.arctan2(east, north), 1.0 - up)


def _number_parts(angle: FloatArray, area: FloatArray) -> IntArray:
    """Return the number of sector and ring of angles, rad, and of the share of the area within, 0 to 1."""
    sector = np.floor((angle / (2.0 * np.pi) % 1.0) * _SECTORS).astype(np.int64) % _SECTORS
    return np.asarray(_RINGS * sector + np.clip(np.floor(_RINGS * area), 0, _RINGS - 1).astype(np.int64))


def pick_surest_in_parts(part: IntArray, sigma_px: FloatArray, most: int) -> IntArray:
    """Return rows of at most so many sightings, in their order: the surest of each part (n,), then the next ones."""
    order = np.lexsort((sigma_px, part))
    first = np.searchsorted(part[order], part[order])
    rank = np.arange(order.size) - first
    return np.sort(order[np.lexsort((sigma_px[order], rank))[:most]])


def pick_surest_in_epochs(
    pixels: FloatArray, sigma_px: FloatArray, epoch: IntArray, image_size: tuple[int, int]
) -> IntArray:
    """Return rows of the stars that a fit uses, in their order: those of the latest epoch first, then of the others.

    Parameters
    ----------
    pixels : (n, 2) px, of stars and planets.
    sigma_px : (n,) px.
    epoch : (n,) pose epochs, by number.
    image_size : width and height, px.
    """
    chosen = np.zeros(0, dtype=np.int64)
    for one in np.unique(epoch)[::-1]:
        rows = np.flatnonzero(epoch == one)
        part = image_parts(pixels[rows], image_size)
        chosen = np.concatenate([chosen, rows[pick_surest_in_parts(part, sigma_px[rows], MOST_STARS - chosen.size)]])
    return np.sort(chosen)
