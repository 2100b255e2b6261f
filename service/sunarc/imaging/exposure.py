"""Exposure control for the sun: a pure controller on the last peaks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

from annotated_types import Gt, Le, Lt

from sunarc.common.bounds import require_bounds
from sunarc.common.errors import InputError
from sunarc.sky.site import clear_transmission

_BRACKET_RATIO = 4.0
"""The two exposures of a bracket are this factor apart: with a band of a factor of 2 they span a factor of 8."""
_MAX_CHANGE = 16.0
"""Factor by which an exposure changes at most from one cycle to the next: it limits the effect of one wrong peak."""
LOST_AFTER = 3
"""Cycles without a peak after which the search starts anew: 90 s at the default cadence, a small cloud's passage."""
_STEADY_AFTER = 2
"""Cycles with the peak in the band, or at a bound, after which one exposure suffices."""
_LOW_SUN_ZENITH_DEG = 80.0
"""Beyond this apparent zenith angle (dawn, dusk) the light changes so fast that there are always two."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SunExposureOptions:
    """Target and limits of the controller.

    Attributes
    ----------
    target_low, target_high : the band of peak levels, fractions of full scale, in which an exposure is kept.
    first_us : the first exposure tried; the camera's shortest where that is longer.
    """

    target_low: Annotated[float, Gt(0.0), Lt(1.0)] = 0.4
    target_high: Annotated[float, Gt(0.0), Lt(1.0)] = 0.8
    first_us: Annotated[float, Gt(0.0), Le(1e9)] = 20.0

    def __post_init__(self) -> None:
        """Refuse invalid options."""
        require_bounds(self, section_path="sun_exposure")
        if self.target_low >= self.target_high:
            problem = f"{self.target_low:g} is not below sun_exposure.target_high = {self.target_high:g}"
            raise InputError(field="sun_exposure.target_low", problem=problem, remedy="give e.g. 0.4 and 0.8")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureBounds:
    """Bounds of the camera: shortest and longest exposure, and its step (0: any), µs."""

    minimum_us: float
    maximum_us: float
    step_us: float = 0.0

    def nearest(self, exposure_us: float) -> float:
        """Return the nearest exposure that the camera can do."""
        bounded = min(max(exposure_us, self.minimum_us), self.maximum_us)
        if self.step_us <= 0.0:
            return bounded
        # The longest exposure need not be a whole number of steps; 1e-9 forgives the rounding of one that is.
        most = math.floor((self.maximum_us - self.minimum_us) / self.step_us + 1e-9)
        return self.minimum_us + min(round((bounded - self.minimum_us) / self.step_us), most) * self.step_us


@dataclass(frozen=True, slots=True, kw_only=True)
class SunExposureState:
    """State of the controller from cycle to cycle.

    Attributes
    ----------
    exposures_us : the exposures to take now, shortest first.
    cycles_steady : how many cycles the peak has been where it should be.
    cycles_lost : how many cycles no sun has been seen.
    cycles_spoiled : how many cycles the disc was burnt beyond use in the camera's shortest exposure.
    level_above_air : what the last peak amounts to in 1 µs with no air before it; 0 before the first.
    """

    exposures_us: tuple[float, ...]
    cycles_steady: int = 0
    cycles_lost: int = 0
    cycles_spoiled: int = 0
    level_above_air: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The sun's level in one exposure of the last cycle: fraction of full scale, above 1 where extrapolated."""

    exposure_us: float
    fraction: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SunLook:
    """Result of a cycle's sun exposures, and the prediction of the sun.

    Attributes
    ----------
    peaks : of the exposures that show one; empty where no sun was seen.
    apparent_zenith : the sun's, degrees.
    clear_level_per_us : level of the sun in 1 µs under a clear sky, fraction of full scale; 0 where unknown.
    spoiled : the shortest exposure that the camera can do showed a disc burnt beyond use.
    """

    peaks: tuple[Peak, ...]
    apparent_zenith: float = 0.0
    clear_level_per_us: float = 0.0
    spoiled: bool = False


def first_sun_exposures(options: SunExposureOptions, bounds: ExposureBounds) -> SunExposureState:
    """Return the state to start with: a bracket of two."""
    return SunExposureState(exposures_us=_make_bracket(options.first_us, bounds))


def next_sun_exposures(
    state: SunExposureState, result: SunLook, *, options: SunExposureOptions, bounds: ExposureBounds
) -> SunExposureState:
    """Return the next cycle's sun exposures.

    Parameters
    ----------
    state : of the last cycle.
    result : what its exposures showed.
    options, bounds : the aim, and the camera's limits.

    Returns
    -------
    The next state: one exposure under a steady sun; two at dawn and dusk, while the sun is sought or has just come
    back, and behind a veil, where the shorter one is ready for the moment when it is gone. Without a neutral filter the
    shortest exposure stays saturated; that counts as steady, for the fit leaves saturated pixels out.
    """
    peaks = [
        peak for peak in result.peaks if _is_finite_positive(peak.exposure_us) and _is_finite_positive(peak.fraction)
    ]
    state = replace(state, cycles_spoiled=_count_spoiled(state, result, peaks))
    if not peaks:
        return _exposures_without_sun(state, result, options, bounds)
    target_us = _compute_target_us(peaks, options, bounds)
    if len(state.exposures_us) == 1 and _is_any_well_exposed(peaks, options, bounds, exposure_us=state.exposures_us[0]):
        target_us = state.exposures_us[0]
    steady = state.cycles_steady + 1 if _is_any_well_exposed(peaks, options, bounds) else 0
    best = _select_best_exposed(peaks, options)
    level = best.fraction / best.exposure_us / _clear_transmission_at_sun(result)
    settled = steady >= _STEADY_AFTER and result.apparent_zenith < _LOW_SUN_ZENITH_DEG
    return SunExposureState(
        exposures_us=_add_clear_sky_exposure(target_us, result, options, bounds, settled=settled),
        cycles_steady=steady,
        cycles_spoiled=state.cycles_spoiled,
        level_above_air=level,
    )


def _count_spoiled(state: SunExposureState, result: SunLook, peaks: Sequence[Peak]) -> int:
    """Return the count of cycles without a usable exposure; clouds leave it unchanged, a detected sun resets it."""
    if result.spoiled:
        return state.cycles_spoiled + 1
    return 0 if peaks else state.cycles_spoiled


def _exposures_without_sun(
    state: SunExposureState, result: SunLook, options: SunExposureOptions, bounds: ExposureBounds
) -> SunExposureState:
    """Return the state without a sun: the exposures are kept for a while, then set for a clear sky at its height."""
    lost = state.cycles_lost + 1
    if lost < LOST_AFTER:
        return replace(state, cycles_lost=lost, cycles_steady=0)
    clear = _clear_sky_exposure_us(state, result, options)
    sought = options.first_us if clear is None else clear
    return replace(state, exposures_us=_make_bracket(sought, bounds), cycles_lost=lost, cycles_steady=0)


def _add_clear_sky_exposure(
    target_us: float, result: SunLook, options: SunExposureOptions, bounds: ExposureBounds, *, settled: bool
) -> tuple[float, ...]:
    """Return the wanted exposure, alone in settled light; through a veil with one for a clear sky."""
    clear = _target_level(options) / result.clear_level_per_us if result.clear_level_per_us > 0.0 else math.inf
    unveiled = bounds.nearest(clear)
    if unveiled * _BRACKET_RATIO < target_us:
        return (unveiled, target_us)
    return (target_us,) if settled else _make_bracket(target_us, bounds)


def _clear_sky_exposure_us(state: SunExposureState, result: SunLook, options: SunExposureOptions) -> float | None:
    level = result.clear_level_per_us or state.level_above_air * _clear_transmission_at_sun(result)
    return _target_level(options) / level if level > 0.0 else None


def _clear_transmission_at_sun(result: SunLook) -> float:
    """Return a clear sky's transmission at the sun's height, below 88 degrees that of 88: for a first guess only."""
    return clear_transmission(min(result.apparent_zenith, 88.0))


def _is_finite_positive(value: float) -> bool:
    return math.isfinite(value) and value > 0.0


def _target_level(options: SunExposureOptions) -> float:
    return math.sqrt(options.target_low * options.target_high)


def _select_best_exposed(peaks: Sequence[Peak], options: SunExposureOptions) -> Peak:
    """Return the best exposed one."""
    return min(peaks, key=lambda peak: (peak.fraction > 1.0, abs(math.log(peak.fraction / _target_level(options)))))


def _compute_target_us(peaks: Sequence[Peak], options: SunExposureOptions, bounds: ExposureBounds) -> float:
    """Return the exposure that brings the peak to the middle of the band, judged from the best exposed frame."""
    best = _select_best_exposed(peaks, options)
    change = min(max(_target_level(options) / best.fraction, 1.0 / _MAX_CHANGE), _MAX_CHANGE)
    return bounds.nearest(best.exposure_us * change)


def _is_any_well_exposed(
    peaks: Sequence[Peak], options: SunExposureOptions, bounds: ExposureBounds, *, exposure_us: float | None = None
) -> bool:
    """Return whether a peak is where it should be, of all exposures or of one."""
    return any(_is_well_exposed(peak, options, bounds) for peak in peaks if exposure_us in {None, peak.exposure_us})


def _is_well_exposed(peak: Peak, options: SunExposureOptions, bounds: ExposureBounds) -> bool:
    if options.target_low <= peak.fraction <= options.target_high:
        return True
    at_shortest = peak.exposure_us <= bounds.minimum_us + bounds.step_us
    at_longest = peak.exposure_us >= bounds.maximum_us - bounds.step_us
    return (peak.fraction > options.target_high and at_shortest) or (peak.fraction < options.target_low and at_longest)


def _make_bracket(shorter_us: float, bounds: ExposureBounds) -> tuple[float, ...]:
    first = bounds.nearest(shorter_us)
    second = bounds.nearest(first * _BRACKET_RATIO)
    return (first, second) if second > first else (first,)
