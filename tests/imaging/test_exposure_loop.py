"""The sun exposure controller in a loop with a simulated camera, and each of its rules by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from sunarc.common.errors import InputError
from sunarc.imaging.exposure import (
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
AIM = math.sqrt(0.4 * 0.8)


def shown(state: SunExposureState, level_per_us: float, *, pedestal: float = 0.002, zenith: float = 30.0) -> SunLook:
    """Return what a camera shows of a sun of some level per µs: a saturated disc is extrapolated to 8 at most."""
    fractions = [(e, pedestal + level_per_us * e) for e in state.exposures_us]
    peaks = tuple(Peak(exposure_us=e, fraction=min(f, 8.0)) for e, f in fractions)
    return SunLook(peaks=peaks, apparent_zenith=zenith)


def step(state: SunExposureState, look: SunLook, *, bounds: ExposureBounds = BOUNDS) -> SunExposureState:
    return next_sun_exposures(state, look, options=OPTIONS, bounds=bounds)


def settles(level_per_us: float, bounds: ExposureBounds) -> tuple[int, SunExposureState]:
    """Return after how many cycles one exposure stands, and the state after 40."""
    state, since = first_sun_exposures(OPTIONS, bounds), 0
    for number in range(1, 41):
        before = state.exposures_us
        state = step(state, shown(state, level_per_us), bounds=bounds)
        since = since if state.exposures_us == before else number
    return since, state


@pytest.mark.parametrize("decade", [-5.5, -4.2, -3.0, -2.3, -1.5])
@pytest.mark.parametrize("step_us", [0.0, 1.0])
def test_every_sun_between_the_bounds_ends_in_the_band_within_eight_cycles(decade: float, step_us: float) -> None:
    level = 10.0**decade
    since, state = settles(level, replace(BOUNDS, step_us=step_us))
    (exposure,) = state.exposures_us
    assert 0.4 <= 0.002 + level * exposure <= 0.8
    assert 1 <= since <= 8
    assert state.cycles_steady >= 30


@pytest.mark.parametrize(("level", "exposure"), [(2.0, 10.0), (0.3, 10.0), (1e-7, 1e6)])
def test_a_sun_out_of_reach_ends_at_the_bound(level: float, exposure: float) -> None:
    _, state = settles(level, BOUNDS)
    assert state.exposures_us == (exposure,)


def test_no_exposure_leaves_the_bounds_or_the_steps_whatever_the_light_does() -> None:
    bounds = ExposureBounds(minimum_us=13.0, maximum_us=5_000.0, step_us=7.0)
    state = first_sun_exposures(OPTIONS, bounds)
    for number in range(60):
        level = 10.0 ** (-3.0 + 2.5 * math.sin(number * number))
        state = step(state, shown(state, level), bounds=bounds)
        assert 1 <= len(state.exposures_us) <= 2
        assert list(state.exposures_us) == sorted(set(state.exposures_us))
        for exposure in state.exposures_us:
            assert 13.0 <= exposure <= 5_000.0
            assert (exposure - 13.0) / 7.0 == pytest.approx(round((exposure - 13.0) / 7.0), abs=1e-9)
    # the longest exposure on the grid: 13 + 712 * 7 = 4997, not 5000
    _, dark = settles(1e-9, bounds)
    assert dark.exposures_us == (4997.0,)


def test_one_cycle_changes_the_exposure_by_16_at_most() -> None:
    state = SunExposureState(exposures_us=(1000.0,))
    brighter = step(state, SunLook(peaks=(Peak(exposure_us=1000.0, fraction=1e-4),)))
    darker = step(state, SunLook(peaks=(Peak(exposure_us=1000.0, fraction=50.0),)))
    assert brighter.exposures_us[0] == 16_000.0
    assert darker.exposures_us[0] == pytest.approx(1000.0 / 16.0, abs=0.51)


def test_the_next_exposure_aims_at_the_band_s_geometric_middle() -> None:
    state = SunExposureState(exposures_us=(1000.0,))
    for fraction in (0.1, 0.2, 0.95):
        found = step(state, SunLook(peaks=(Peak(exposure_us=1000.0, fraction=fraction),)))
        assert found.exposures_us[0] == pytest.approx(1000.0 * AIM / fraction, abs=0.51)
        assert found.exposures_us[1] == pytest.approx(4.0 * found.exposures_us[0], abs=2.1)
        assert found.cycles_steady == 0


def test_of_two_peaks_an_unsaturated_one_decides_and_of_those_the_nearer() -> None:
    state = SunExposureState(exposures_us=(100.0, 400.0))
    look = SunLook(peaks=(Peak(exposure_us=100.0, fraction=0.25), Peak(exposure_us=400.0, fraction=1.05)))
    assert step(state, look).exposures_us[0] == pytest.approx(100.0 * AIM / 0.25, abs=0.51)
    look = SunLook(peaks=(Peak(exposure_us=100.0, fraction=0.1), Peak(exposure_us=400.0, fraction=0.39)))
    assert step(state, look).exposures_us[0] == pytest.approx(400.0 * AIM / 0.39, abs=0.51)


def test_the_level_above_the_air_is_the_peak_per_microsecond_over_the_clear_sky_s_transmission() -> None:
    state = SunExposureState(exposures_us=(100.0,))
    for zenith, air_mass in ((0.0, 1.0), (60.0, 1.994), (80.0, 5.58)):
        found = step(state, SunLook(peaks=(Peak(exposure_us=100.0, fraction=0.5),), apparent_zenith=zenith))
        assert found.level_above_air == pytest.approx(0.005 * math.exp(0.2 * air_mass), rel=3e-3)


def test_one_exposure_needs_two_good_cycles_and_a_sun_above_ten_degrees() -> None:
    state = SunExposureState(exposures_us=(100.0, 400.0))
    good = SunLook(peaks=(Peak(exposure_us=100.0, fraction=AIM),), apparent_zenith=79.9)
    first = step(state, good)
    second = step(first, good)
    assert (len(first.exposures_us), first.cycles_steady) == (2, 1)
    assert (second.exposures_us, second.cycles_steady) == ((100.0,), 2)
    assert len(step(first, replace(good, apparent_zenith=80.0)).exposures_us) == 2


def test_the_edges_of_the_band_belong_to_it() -> None:
    state = SunExposureState(exposures_us=(100.0,), cycles_steady=3)
    for fraction, kept in ((0.4, True), (0.8, True), (0.399, False), (0.801, False)):
        found = step(state, SunLook(peaks=(Peak(exposure_us=100.0, fraction=fraction),)))
        assert (found.exposures_us == (100.0,)) is kept
        assert found.cycles_steady == (4 if kept else 0)


def test_within_a_step_of_a_bound_a_peak_beyond_the_band_is_good_on_that_side_only() -> None:
    bounds = ExposureBounds(minimum_us=10.0, maximum_us=1000.0, step_us=2.0)
    for exposure, fraction, steady in (
        (12.0, 3.0, 1), (13.0, 3.0, 0), (12.0, 0.1, 0),
        (998.0, 0.1, 1), (997.0, 0.1, 0), (998.0, 3.0, 0),
    ):  # fmt: skip
        state = SunExposureState(exposures_us=(exposure,))
        look = SunLook(peaks=(Peak(exposure_us=exposure, fraction=fraction),))
        assert step(state, look, bounds=bounds).cycles_steady == steady


def test_a_clear_sun_four_times_brighter_than_the_veiled_one_is_waited_for() -> None:
    state = SunExposureState(exposures_us=(4000.0,), cycles_steady=5)
    peak = (Peak(exposure_us=4000.0, fraction=0.5),)
    clear_us = 900.0  # 4000 is more than four times as long
    found = step(state, SunLook(peaks=peak, clear_level_per_us=AIM / clear_us))
    assert found.exposures_us == pytest.approx((clear_us, 4000.0))
    near = step(state, SunLook(peaks=peak, clear_level_per_us=AIM / 1100.0))
    assert near.exposures_us == (4000.0,)
    assert step(state, SunLook(peaks=peak)).exposures_us == (4000.0,)


def test_a_lost_sun_is_awaited_with_the_exposure_of_a_clear_sky_at_its_height() -> None:
    gone = SunLook(peaks=(), apparent_zenith=60.0)
    state = SunExposureState(exposures_us=(100.0,), cycles_steady=5, level_above_air=0.004)
    for lost in (1, 2):
        state = step(state, gone)
        assert (state.exposures_us, state.cycles_lost, state.cycles_steady) == ((100.0,), lost, 0)
    state = step(state, gone)
    assert state.exposures_us[0] == pytest.approx(AIM / (0.004 * math.exp(-0.2 * 1.994)), abs=1.0)
    assert state.exposures_us[1] == pytest.approx(4.0 * state.exposures_us[0], abs=2.1)
    known = step(state, replace(gone, clear_level_per_us=0.002))
    assert known.exposures_us[0] == pytest.approx(AIM / 0.002, abs=0.51)
    # below 88 degrees the formula is not asked
    deep, edge = (step(state, replace(gone, apparent_zenith=z)) for z in (95.0, 88.0))
    assert deep.exposures_us == edge.exposures_us
    back = step(state, SunLook(peaks=(Peak(exposure_us=100.0, fraction=0.5),)))
    assert back.cycles_lost == 0


def test_peaks_that_are_no_numbers_are_left_out() -> None:
    state = SunExposureState(exposures_us=(100.0,))
    bad = [Peak(exposure_us=e, fraction=f) for e, f in ((0.0, 0.5), (100.0, 0.0), (math.inf, 0.5), (100.0, math.inf))]
    assert step(state, SunLook(peaks=tuple(bad))).cycles_lost == 1
    good = step(state, SunLook(peaks=(*bad, Peak(exposure_us=100.0, fraction=0.5))))
    assert good.cycles_lost == 0
    assert good.cycles_steady == 1


def test_a_bracket_that_does_not_fit_the_bounds_is_one_exposure() -> None:
    narrow = ExposureBounds(minimum_us=50.0, maximum_us=50.0)
    assert first_sun_exposures(OPTIONS, narrow).exposures_us == (50.0,)
    half = ExposureBounds(minimum_us=15.0, maximum_us=40.0)
    assert first_sun_exposures(OPTIONS, half).exposures_us == (20.0, 40.0)
    assert first_sun_exposures(OPTIONS, replace(half, minimum_us=30.0)).exposures_us == (30.0, 40.0)
    # 5002 is 0.7 of a step beyond the last one of the grid, and rounding up would leave the bounds
    grid = ExposureBounds(minimum_us=13.0, maximum_us=5002.0, step_us=7.0)
    assert first_sun_exposures(replace(OPTIONS, first_us=1e9), grid).exposures_us == (4997.0,)


def test_spoiled_cycles_are_counted_over_clouds() -> None:
    state, counts = SunExposureState(exposures_us=(10.0,)), []
    burnt, cloud = SunLook(peaks=(), spoiled=True), SunLook(peaks=())
    seen = SunLook(peaks=(Peak(exposure_us=10.0, fraction=0.5),))
    for look in (burnt, cloud, burnt, replace(seen, spoiled=True), seen):
        state = step(state, look)
        counts.append(state.cycles_spoiled)
    assert counts == [1, 1, 2, 3, 0]


@pytest.mark.parametrize(
    "change",
    [
        {"target_low": 0.0},
        {"target_high": 1.0},
        {"target_low": 0.8},
        {"first_us": 0.0},
    ],
)
def test_options_at_a_bound_that_makes_no_sense_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(InputError) as caught:
        SunExposureOptions(**change)
    assert caught.value.field == f"sun_exposure.{next(iter(change))}"


def test_options_just_within_their_bounds_are_taken() -> None:
    taken = SunExposureOptions(first_us=0.1)
    assert (taken.target_low, taken.target_high, OPTIONS.first_us) == (0.4, 0.8, 20.0)
