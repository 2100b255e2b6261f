"""The sun exposure controller."""

from __future__ import annotations

import pytest

from sunarc.common.errors import InputError
from sunarc.imaging.exposure import (
    LOST_AFTER,
    ExposureBounds,
    Peak,
    SunExposureOptions,
    SunExposureState,
    SunLook,
    first_sun_exposures,
    next_sun_exposures,
)

OPTIONS = SunExposureOptions()
BOUNDS = ExposureBounds(minimum_us=10.0, maximum_us=1e6, step_us=1.0)
CLOUD = SunLook(peaks=(), apparent_zenith=30.0)


def seen(
    state: SunExposureState, rate_per_us: float, *, apparent_zenith: float = 30.0, clear_level_per_us: float = 0.0
) -> SunLook:
    """Return what a cycle shows of a sun whose level is `rate_per_us` times the exposure."""
    peaks = tuple(Peak(exposure_us=e, fraction=rate_per_us * e) for e in state.exposures_us)
    return SunLook(peaks=peaks, apparent_zenith=apparent_zenith, clear_level_per_us=clear_level_per_us)


def followed(rate_per_us: float, *, cycles: int = 12, bounds: ExposureBounds = BOUNDS) -> SunExposureState:
    """Run the controller against a sun whose level is `rate_per_us` times the exposure."""
    state = first_sun_exposures(OPTIONS, bounds)
    for _ in range(cycles):
        state = next_sun_exposures(state, seen(state, rate_per_us), options=OPTIONS, bounds=bounds)
    return state


def test_it_starts_with_a_bracket_of_two() -> None:
    assert first_sun_exposures(OPTIONS, BOUNDS).exposures_us == (20.0, 80.0)


@pytest.mark.parametrize("rate_per_us", [1e-5, 1e-3, 0.01, 0.05])
def test_it_settles_on_one_exposure_within_the_band(rate_per_us: float) -> None:
    (exposure,) = followed(rate_per_us).exposures_us
    assert OPTIONS.target_low <= rate_per_us * exposure <= OPTIONS.target_high


def test_a_sun_saturated_at_the_shortest_exposure_is_steady() -> None:
    assert followed(3.0).exposures_us == (10.0,)


def test_a_sun_too_faint_for_the_longest_exposure_is_steady_there() -> None:
    assert followed(1e-9).exposures_us == (1e6,)


def test_an_exposure_within_the_band_is_kept() -> None:
    state = SunExposureState(exposures_us=(50.0,), cycles_steady=5)
    for fraction in (0.45, 0.75, 0.6):
        state = next_sun_exposures(state, seen(state, fraction / 50.0), options=OPTIONS, bounds=BOUNDS)
        assert state.exposures_us == (50.0,)


def test_a_lost_sun_is_sought_anew_after_some_cycles() -> None:
    state = SunExposureState(exposures_us=(50.0,), cycles_steady=5)
    for _ in range(LOST_AFTER - 1):
        state = next_sun_exposures(state, CLOUD, options=OPTIONS, bounds=BOUNDS)
        assert state.exposures_us == (50.0,)
    state = next_sun_exposures(state, CLOUD, options=OPTIONS, bounds=BOUNDS)
    assert state.exposures_us == (20.0, 80.0)


def test_exposures_stand_on_the_cameras_steps() -> None:
    bounds = ExposureBounds(minimum_us=12.0, maximum_us=1e6, step_us=8.0)
    for exposure in followed(0.004, bounds=bounds, cycles=1).exposures_us:
        assert (exposure - 12.0) % 8.0 == pytest.approx(0.0)


def test_nonsense_peaks_count_as_no_sun() -> None:
    state = SunExposureState(exposures_us=(50.0,))
    following = next_sun_exposures(
        state, SunLook(peaks=(Peak(exposure_us=50.0, fraction=float("nan")),)), options=OPTIONS, bounds=BOUNDS
    )
    assert following.cycles_lost == 1


def step(state: SunExposureState, look: SunLook) -> SunExposureState:
    return next_sun_exposures(state, look, options=OPTIONS, bounds=BOUNDS)


def test_a_low_sun_always_gets_two_exposures() -> None:
    state = first_sun_exposures(OPTIONS, BOUNDS)
    for _ in range(10):
        state = step(state, seen(state, 0.002, apparent_zenith=85.0))
    short, long = state.exposures_us
    assert OPTIONS.target_low <= 0.002 * short <= OPTIONS.target_high
    assert long == pytest.approx(4.0 * short, abs=2.0)
    state = step(state, seen(state, 0.002, apparent_zenith=70.0))
    assert len(state.exposures_us) == 1


def test_a_sinking_sun_is_followed_within_the_band() -> None:
    state, rate = followed(0.02), 0.02
    outside = 0
    for cycle in range(120):  # an hour, in which the light falls to a fiftieth
        rate = 0.02 * 50.0 ** (-cycle / 120)
        state = step(state, seen(state, rate, apparent_zenith=75.0 + cycle / 10))
        outside += not any(OPTIONS.target_low <= rate * e <= OPTIONS.target_high for e in state.exposures_us)
    assert outside <= 6


def test_after_cloud_the_first_exposures_are_those_of_the_clear_sky_at_the_suns_present_height() -> None:
    state = followed(0.02)
    for _ in range(200):
        state = step(state, CLOUD)
    short, long = state.exposures_us
    assert OPTIONS.target_low <= 0.02 * short <= OPTIONS.target_high
    assert long > short
    known = SunLook(peaks=(), apparent_zenith=80.0, clear_level_per_us=0.005)
    short, _ = step(state, known).exposures_us
    assert OPTIONS.target_low <= 0.005 * short <= OPTIONS.target_high


def test_without_knowledge_of_the_clear_sky_a_lower_sun_is_awaited_with_longer_exposures() -> None:
    state = followed(0.02)
    for _ in range(10):
        high = step(state, CLOUD)
        low = step(state, SunLook(peaks=(), apparent_zenith=85.0))
        state = high
    assert low.exposures_us[0] > 3.0 * high.exposures_us[0]


def test_behind_a_veil_an_exposure_for_the_clear_sun_stands_ready() -> None:
    state = first_sun_exposures(OPTIONS, BOUNDS)
    for _ in range(12):
        state = step(state, seen(state, 0.0005, clear_level_per_us=0.02))
    short, long = state.exposures_us
    assert OPTIONS.target_low <= 0.02 * short <= OPTIONS.target_high
    assert OPTIONS.target_low <= 0.0005 * long <= OPTIONS.target_high


def test_discs_burnt_beyond_use_are_counted_until_the_sun_is_seen_and_clouds_do_not_end_the_count() -> None:
    burnt = SunLook(peaks=(), apparent_zenith=30.0, spoiled=True)
    state = first_sun_exposures(OPTIONS, BOUNDS)
    for look in (burnt, burnt, CLOUD, burnt):
        state = step(state, look)
    assert state.cycles_spoiled == 3
    assert step(state, seen(state, 0.02)).cycles_spoiled == 0


def test_a_band_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="target"):
        SunExposureOptions(target_low=0.8, target_high=0.4)
