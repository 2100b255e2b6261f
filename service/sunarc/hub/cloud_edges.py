"""Delay of one camera's losses of the sun behind another's, as clouds pass over both.

A camera's series has for each exposure whether the sun was seen. It needs neither pose nor site, so that what it says
of a clock no longitude can imitate; what it does not know is the wind (see `clocks`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from sunarc.common.array_types import BoolArray, FloatArray

_STEP_S = 10.0
"""Grid of the series: a third of the usual cadence."""
_LONGEST_GAP_S = 90.0
"""Without an exposure for longer than this, the sky is not known."""
_RANGE_S = 8400.0
"""Lags that are tried: an hour of summer time, twice, and the clouds' own."""
_LEAST_CORRELATION, _LEAST_LEAD = 0.5, 0.15
"""The best lag's correlation, and by how much it exceeds that of any lag that is further away than `_NEAR_S`."""
_NEAR_S = 1200.0
_FEWEST_EDGES, _FEWEST_S = 8, 7200.0
_MATCH_S, _ROUNDS = 60.0, 4
"""Edges that are further apart than two cadences are not of one cloud."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SunSeries:
    """When a camera looked for the sun, and whether it saw it.

    Attributes
    ----------
    unix_s : (n,) rising, s since 1970-01-01 UTC, by the camera's clock.
    seen : (n,).
    """

    unix_s: FloatArray
    seen: BoolArray


def cloud_lag(first: SunSeries, second: SunSeries) -> tuple[float, float] | None:
    """Return by how many seconds the second camera's edges come later, by its own clock, and the 1-sigma of that.

    None where the sky did not change often enough in both, or no lag stands out. The sigma is by the scatter of the
    edges; what the wind adds is not in it.
    """
    if min(len(first.unix_s), len(second.unix_s)) < 2:
        return None
    begin = min(first.unix_s[0], second.unix_s[0])
    count = int((max(first.unix_s[-1], second.unix_s[-1]) - begin) / _STEP_S) + 1
    grid = begin + _STEP_S * np.arange(count)
    a, b = _sample_on_grid(first, grid), _sample_on_grid(second, grid)
    edges = min(_count_edges(first), _count_edges(second))
    if edges < _FEWEST_EDGES:
        return None
    lags, correlation = _correlate_by_lag(a, b)
    best = int(np.argmax(correlation))
    far = np.abs(lags - lags[best]) > _NEAR_S
    lead = correlation[best] - correlation[far].max(initial=-1.0)
    if correlation[best] < _LEAST_CORRELATION or lead < _LEAST_LEAD or not 0 < best < len(lags) - 1:
        return None
    return _refine_lag(first, second, float(lags[best]))


def _refine_lag(first: SunSeries, second: SunSeries, lag_s: float) -> tuple[float, float] | None:
    """Return the mean lag of edges of one kind that match, and its 1-sigma; None of few.

    The correlation has its peak at the most frequent lag, which is not the mean where exposures keep a distance.
    """
    for _ in range(_ROUNDS):
        off = np.concatenate(
            [
                _delay_to_nearest(_find_edge_times(second, kind), _find_edge_times(first, kind) + lag_s)
                for kind in (True, False)
            ]
        )
        off = off[np.abs(off) < _MATCH_S]
        if len(off) < _FEWEST_EDGES:
            return None
        lag_s += float(np.mean(off))
    return lag_s, max(float(np.std(off)), _STEP_S) / len(off) ** 0.5


def _find_edge_times(series: SunSeries, rising: bool) -> FloatArray:  # noqa: FBT001 - the kind of an edge
    """Return when the sun was found again, or lost: the middle between the exposures, none over a gap."""
    change = np.diff(series.seen.astype(np.int8)) == (1 if rising else -1)
    change &= np.diff(series.unix_s) <= _LONGEST_GAP_S
    return np.asarray(0.5 * (series.unix_s[1:] + series.unix_s[:-1])[change])


def _delay_to_nearest(times: FloatArray, asked: FloatArray) -> FloatArray:
    """Return the delay, s, from each asked time to the nearest of other times."""
    if not len(times):
        return np.zeros(0)
    after = np.clip(np.searchsorted(times, asked), 1, max(len(times) - 1, 1))
    near = np.stack([times[np.minimum(after - 1, len(times) - 1)], times[np.minimum(after, len(times) - 1)]]) - asked
    return np.asarray(np.where(np.abs(near[0]) < np.abs(near[1]), near[0], near[1]))


def _count_edges(series: SunSeries) -> int:
    return int(np.count_nonzero(np.diff(series.seen.astype(np.int8))))


def _sample_on_grid(series: SunSeries, grid: FloatArray) -> FloatArray:
    """Return +1 where the nearest exposure saw the sun, -1 where it did not, NaN without one near."""
    middle = 0.5 * (series.unix_s[1:] + series.unix_s[:-1])
    index = np.searchsorted(middle, grid)
    known = np.abs(series.unix_s[index] - grid) <= _LONGEST_GAP_S
    return np.where(known, np.where(series.seen[index], 1.0, -1.0), np.nan)


def _correlate_by_lag(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lags, s, and the correlation of a(t) and b(t + lag) over the times that both know."""
    size = next_fast_len(2 * len(a), real=True)
    known = [np.isfinite(x).astype(np.float64) for x in (a, b)]
    values = [np.nan_to_num(x - np.nanmean(x)) for x in (a, b)]
    (ka, kb), (va, vb) = (rfft(x, size) for x in known), (rfft(x, size) for x in values)
    sa, sb = (rfft(x**2, size) for x in values)
    steps = np.arange(-int(_RANGE_S / _STEP_S), int(_RANGE_S / _STEP_S) + 1)
    steps = steps[np.abs(steps) < len(a)]
    both, product, first, second = (
        irfft(np.conj(x) * y, size)[steps] for x, y in ((ka, kb), (va, vb), (sa, kb), (ka, sb))
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        found = product / np.sqrt(first * second)
    found = np.where(both * _STEP_S > _FEWEST_S, np.nan_to_num(found, nan=-1.0), -1.0)
    return np.asarray(_STEP_S * steps, dtype=np.float64), np.asarray(found, dtype=np.float64)
