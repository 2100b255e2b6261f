"""The sun exposure controller."""

from __future__ import annotations

import pytest

from sunarc.errors import InputError
from sunarc.imaging import (
    ExposureBounds,
    Peak,
    SunExposureOptions,
    SunExposureState,
    first_sun_exposures,
    next_sun_exposures,
)

OPTIONS = SunExposureOptions()
BOUNDS = ExposureBounds(minimum_us=10.0, maximum_us=1e6, step_us=1.0)


def followed(rate_per_us: float, *, cycles: int = 12, bounds: ExposureBounds = BOUNDS) -> SunExposureState:
    """Run the controller against a sun whose level is `rate_per_us` times the exposure."""
    state = first_sun_exposures(OPTIONS, bounds)
    for _ in range(cycles):
        peaks = [Peak(exposure_us=e, fraction=rate_per_us * e) for e in state.exposures_us]
        state = next_sun_exposures(state, peaks, options=OPTIONS, bounds=bounds)
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
        state = next_sun_exposures(state, [Peak(exposure_us=50.0, fraction=fraction)], options=OPTIONS, bounds=BOUNDS)
        assert state.exposures_us == (50.0,)


def test_a_lost_sun_is_sought_anew_after_some_cycles() -> None:
    state = SunExposureState(exposures_us=(50.0,), cycles_steady=5)
    for _ in range(OPTIONS.lost_after - 1):
        state = next_sun_exposures(state, [], options=OPTIONS, bounds=BOUNDS)
        assert state.exposures_us == (50.0,)
    state = next_sun_exposures(state, [], options=OPTIONS, bounds=BOUNDS)
    assert state.exposures_us == (20.0, 80.0)


def test_exposures_stand_on_the_cameras_steps() -> None:
    bounds = ExposureBounds(minimum_us=12.0, maximum_us=1e6, step_us=8.0)
    for exposure in followed(0.004, bounds=bounds, cycles=1).exposures_us:
        assert (exposure - 12.0) % 8.0 == pytest.approx(0.0)


def test_nonsense_peaks_count_as_no_sun() -> None:
    state = SunExposureState(exposures_us=(50.0,))
    following = next_sun_exposures(
        state, [Peak(exposure_us=50.0, fraction=float("nan"))], options=OPTIONS, bounds=BOUNDS
    )
    assert following.cycles_lost == 1


def test_a_band_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="target"):
        SunExposureOptions(target_low=0.8, target_high=0.4)
