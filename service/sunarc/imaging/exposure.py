"""How long to expose for the sun: a pure controller on the last peaks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from sunarc.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class SunExposureOptions:
    """What the controller aims at.

    Attributes
    ----------
    target_low, target_high : the band of peak levels, fractions of full scale, in which an exposure is kept.
    first_us : the first exposure tried; the camera's shortest where that is longer.
    bracket_ratio : the two exposures of a bracket are this factor apart.
    max_change : factor by which an exposure changes at most from one cycle to the next.
    lost_after : cycles without a peak after which the search starts anew.
    steady_after : cycles with the peak in the band, or at a bound, after which one exposure suffices.
    """

    target_low: float = 0.4
    target_high: float = 0.8
    first_us: float = 20.0
    bracket_ratio: float = 4.0
    max_change: float = 16.0
    lost_after: int = 3
    steady_after: int = 2

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if not 0.0 < self.target_low < self.target_high < 1.0:
            raise InputError(
                field="SunExposureOptions", problem="the target is no band within 0 … 1", remedy="say 0.4 and 0.8"
            )
        if min(self.first_us, self.bracket_ratio - 1.0, self.max_change - 1.0) <= 0.0 or self.lost_after < 1:
            raise InputError(
                field="SunExposureOptions", problem="a factor or time is out of range", remedy="give factors above 1"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureBounds:
    """What the camera can do: shortest and longest exposure, and its step (0: any), µs."""

    minimum_us: float
    maximum_us: float
    step_us: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SunExposureState:
    """What the controller remembers from cycle to cycle.

    Attributes
    ----------
    exposures_us : the exposures to take now, shortest first.
    cycles_steady : how many cycles the peak has been where it should be.
    cycles_lost : how many cycles no sun has been seen.
    """

    exposures_us: tuple[float, ...]
    cycles_steady: int = 0
    cycles_lost: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The sun's level in one exposure of the last cycle: fraction of full scale, above 1 where extrapolated."""

    exposure_us: float
    fraction: float


def first_sun_exposures(options: SunExposureOptions, bounds: ExposureBounds) -> SunExposureState:
    """Return the state to start with: a bracket of two."""
    return SunExposureState(exposures_us=_bracket(options.first_us, options, bounds))


def next_sun_exposures(
    state: SunExposureState, peaks: Sequence[Peak], *, options: SunExposureOptions, bounds: ExposureBounds
) -> SunExposureState:
    """Return the next cycle's sun exposures.

    Parameters
    ----------
    state : of the last cycle.
    peaks : what its exposures showed, believed sightings only; empty where no sun was seen.
    options, bounds : the aim, and the camera's limits.

    Returns
    -------
    The next state. Without a neutral filter the shortest exposure stays saturated; that counts as steady, for the
    fit leaves saturated pixels out.
    """
    usable = [peak for peak in peaks if peak.exposure_us > 0.0 and math.isfinite(peak.fraction) and peak.fraction > 0.0]
    if not usable:
        return _without_sun(state, options, bounds)
    wanted = _wanted_us(usable, options, bounds)
    kept = state.exposures_us[0] if len(state.exposures_us) == 1 else None
    if kept is not None and any(_good(peak, options, bounds) for peak in usable if peak.exposure_us == kept):
        wanted = kept
    steady = state.cycles_steady + 1 if any(_good(peak, options, bounds) for peak in usable) else 0
    exposures = (wanted,) if steady >= options.steady_after else _bracket(wanted, options, bounds)
    return SunExposureState(exposures_us=exposures, cycles_steady=steady)


def _without_sun(state: SunExposureState, options: SunExposureOptions, bounds: ExposureBounds) -> SunExposureState:
    lost = state.cycles_lost + 1
    if lost >= options.lost_after:
        return replace(first_sun_exposures(options, bounds), cycles_lost=lost)
    return replace(state, cycles_lost=lost, cycles_steady=0)


def _wanted_us(peaks: Sequence[Peak], options: SunExposureOptions, bounds: ExposureBounds) -> float:
    """Return the exposure that brings the peak to the middle of the band, judged from the best exposed frame."""
    aim = math.sqrt(options.target_low * options.target_high)
    best = min(peaks, key=lambda peak: (peak.fraction > 1.0, abs(math.log(peak.fraction / aim))))
    change = min(max(aim / best.fraction, 1.0 / options.max_change), options.max_change)
    return _within(best.exposure_us * change, bounds)


def _good(peak: Peak, options: SunExposureOptions, bounds: ExposureBounds) -> bool:
    if options.target_low <= peak.fraction <= options.target_high:
        return True
    at_shortest = peak.exposure_us <= bounds.minimum_us + bounds.step_us
    at_longest = peak.exposure_us >= bounds.maximum_us - bounds.step_us
    return (peak.fraction > options.target_high and at_shortest) or (peak.fraction < options.target_low and at_longest)


def _bracket(shorter_us: float, options: SunExposureOptions, bounds: ExposureBounds) -> tuple[float, ...]:
    first = _within(shorter_us, bounds)
    second = _within(first * options.bracket_ratio, bounds)
    return (first, second) if second > first else (first,)


def _within(exposure_us: float, bounds: ExposureBounds) -> float:
    """Return the nearest exposure that the camera can do."""
    steps = round((exposure_us - bounds.minimum_us) / bounds.step_us) if bounds.step_us > 0.0 else 0
    stepped = bounds.minimum_us + steps * bounds.step_us if bounds.step_us > 0.0 else exposure_us
    return min(max(stepped, bounds.minimum_us), bounds.maximum_us)
