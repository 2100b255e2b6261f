"""Steps of cameras under one sun: what steps is named with its size, what drifts or errs alike is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fixtures.rotated_cameras import Wrong, neighbours

from sunarc.calibration.evidence import DAYS as LIMITS
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.changes.daily_rotations import DailyRotations, daily_rotations
from sunarc.changes.fleet import agreeing, explain_step, find_steps, site_rotation, step_sizes
from sunarc.common.array_types import FloatArray, picked
from sunarc.sky.site import Site, pole_enu
from sunarc.sky.sun import sun_directions

SITE = Site(latitude=36.6, longitude=-97.5)
COVARIANCE = np.diag([0.003, 0.002, 0.004]) ** 2
DAYS = np.arange(40.0)


def days_of(rotation_deg: FloatArray, day: FloatArray) -> DailyRotations:
    covariance = np.broadcast_to(COVARIANCE, (len(day), 3, 3)).copy()
    return DailyRotations(day=day, rotation_deg=rotation_deg, covariance_deg2=covariance)


def noise(rng: np.random.Generator, day: FloatArray) -> FloatArray:
    return rng.multivariate_normal(np.zeros(3), COVARIANCE, len(day))


def step_of(rotation_deg: list[float]) -> PoseChange:
    return PoseChange(
        time=0.0,
        bracket=(0.0, 9.0),
        rotation_deg=np.array(rotation_deg),
        covariance_deg2=COVARIANCE,
        cause="moved",
        gain=99.0,
    )


def named(wrong: Wrong, *, seed: int) -> tuple[PoseChange | None, ...]:
    """Return what is found of three cameras, the second of which is wrong."""
    cameras = neighbours(Wrong(), wrong, Wrong(), seed=seed)
    rng = np.random.default_rng(seed)
    steps = find_steps([one.rotations(DAYS, rng) for one in cameras])
    return tuple(
        None if step is None else explain_step(step, before=one.stated_site(0), after=one.stated_site(39))[0]
        for one, step in zip(cameras, steps, strict=True)
    )


@pytest.mark.parametrize("seed", [1, 2])
def test_a_clock_a_longitude_and_north_in_one_of_three_are_named_with_their_sizes(seed: int) -> None:
    for wrong, cause in (
        (Wrong(clock_s=2.0), "clock"),
        (Wrong(east_deg=0.01), "longitude"),
        (Wrong(north_deg=0.1), "north"),
    ):
        first, found, third = named(wrong, seed=seed)
        assert first is None
        assert third is None
        assert found is not None
        assert found.cause == cause
        size = step_sizes(found, SITE)
        if cause == "clock":
            assert abs(size["clock_s"] - 2.0) < 3.0 * size["clock_sigma_s"] < 1.0
        if cause == "longitude":
            assert abs(size["longitude_deg"] - 0.01) < 3.0 * size["longitude_sigma_deg"] < 0.004
        if cause == "north":
            assert abs(size["north_deg"] - 0.1) < 3.0 * size["north_sigma_deg"] < 0.01


def test_a_clock_and_a_longitude_are_one_rotation() -> None:
    late, typed = (
        sun_directions(1.78e9 + np.linspace(0.0, 2e4, 50) + 240.0 * clock_s, Site(latitude=36.6, longitude=east))
        for clock_s, east in ((1.0, 10.0), (0.0, 11.0))
    )
    # the equation of time and the declination change by the rest in four minutes
    assert np.degrees(np.linalg.norm(late - typed, axis=1)).max() < 0.002


def test_a_restated_site_turns_a_camera_as_it_turns_the_sun() -> None:
    after = Site(latitude=SITE.latitude + 0.02, longitude=SITE.longitude - 0.03)
    unix_s = 1.78e9 + np.linspace(-1e4, 1e4, 50)
    before = sun_directions(unix_s, SITE)
    turned = Rotation.from_rotvec(site_rotation(SITE, after), degrees=True).apply(before)
    assert np.degrees(np.linalg.norm(turned - sun_directions(unix_s, after), axis=1)).max() < 2e-4


def test_a_change_of_the_site_that_does_not_explain_the_step_is_not_its_cause() -> None:
    step = step_of([0.0, 0.0, 0.1])
    typed = Site(latitude=SITE.latitude, longitude=SITE.longitude + 0.01)
    assert explain_step(step, before=SITE, after=typed)[0].cause == "north"
    step = step_of([0.1, 0.0, 0.0])
    assert explain_step(step, before=SITE, after=SITE)[0].cause == "moved"
    assert explain_step(step, before=SITE, after=replace(SITE, latitude=SITE.latitude + 0.1))[0].cause == "site"
    polar = Site(latitude=89.9, longitude=0.0)
    step = step_of([0.0, 0.0, 0.1])
    assert explain_step(step, before=polar, after=polar)[0].cause == "clock_or_north"


def test_the_stated_error_of_a_step_is_that_of_many_draws() -> None:
    rng = np.random.default_rng(5)
    size = np.array([0.01, -0.01, 0.02])
    squares = []
    for _ in range(200):
        found = find_steps([days_of(noise(rng, DAYS) + (DAYS >= 25)[:, None] * size, DAYS)])[0]
        assert found is not None
        assert found.time == 25.0
        off = found.rotation_deg - size
        squares.append(off @ np.linalg.solve(found.covariance_deg2, off))
    assert 2.4 < np.mean(squares) < 4.5  # 3 for a known scatter; that of 40 days is not known exactly


def test_what_drifts_is_no_step() -> None:
    rng = np.random.default_rng(6)
    found = 0
    for _ in range(40):
        axis = rng.normal(size=3)
        slow = np.outer(0.05 * DAYS / 60.0, axis / np.linalg.norm(axis))
        walk = np.cumsum(rng.normal(0.0, 0.002, (40, 3)), axis=0)
        steps = [find_steps([days_of(noise(rng, DAYS) + drift, DAYS)])[0] for drift in (slow, walk)]
        found += sum(explain_step(step, before=SITE, after=SITE)[0].cause != "slow_turn" for step in steps if step)
    assert found <= 2  # of 80


@pytest.mark.parametrize(
    ("changed", "cameras", "agree"),
    [
        ({0}, 2, 0),
        ({0}, 3, 2),
        ({0}, 4, 3),
        ({0}, 6, 5),
        ({0, 1, 2}, 6, 0),  # half of all: which half is not known
        ({0, 1}, 6, 4),
        ({1}, 6, 0),  # another's change
        ({1, 2, 3}, 4, 3),  # all others alike: that is not told from its own
    ],
)
def test_a_change_is_the_cameras_own_where_most_others_show_it_each_by_itself(
    changed: set[int], cameras: int, agree: int
) -> None:
    rng = np.random.default_rng(14)
    size = (DAYS >= 25)[:, None] * np.array([0.0, 0.03, 0.04])
    days = [days_of(noise(rng, DAYS) + (size if k in changed else 0.0), DAYS) for k in range(cameras)]
    step = find_steps([days_of(noise(rng, DAYS) + size * (1.0 if 0 in changed else -1.0), DAYS)])[0]
    assert step is not None
    assert agreeing(days, 0, step) == agree
    few = [picked(one, one.day >= 22.0) for one in days[1:]]
    assert agreeing([days[0], *few], 0, step) == 0  # three days before it


def test_the_confidence_falls_where_causes_are_alike() -> None:
    clear, alike = step_of([0.0, 0.0, 0.1]), step_of([0.0, 0.0, 0.1])
    polar = Site(latitude=75.0, longitude=0.0)
    _, sure = explain_step(clear, before=SITE, after=SITE)
    _, unsure = explain_step(replace(alike, covariance_deg2=100.0 * COVARIANCE), before=polar, after=polar)
    assert 0.94 < sure <= 0.95  # in one case of twenty it is none of the causes weighed
    assert 0.2 < unsure < 0.9
    _, faint = explain_step(replace(step_of([0.06, 0.05, -0.06]), gain=LIMITS.gain), before=SITE, after=SITE)
    assert faint < 0.5


def test_what_all_cameras_do_is_none_of_them() -> None:
    rng = np.random.default_rng(7)
    common = (DAYS >= 25)[:, None] * np.array([0.0, 0.02, 0.02])
    assert find_steps([days_of(noise(rng, DAYS) + common, DAYS) for _ in range(4)]) == (None,) * 4
    # of two cameras each shows it
    assert all(find_steps([days_of(noise(rng, DAYS) + common, DAYS) for _ in range(2)]))


def test_too_few_days_and_single_bad_days_are_no_step() -> None:
    rng = np.random.default_rng(8)
    rotation = noise(rng, DAYS) + (DAYS >= 37)[:, None] * np.array([0.0, 0.05, 0.05])
    assert find_steps([days_of(rotation, DAYS)])[0] is None  # three days after it
    assert find_steps([days_of(rotation[:4], DAYS[:4])])[0] is None
    assert find_steps([days_of(rotation[:0], DAYS[:0]), days_of(rotation[:9], DAYS[:9])]) == (None, None)
    bad = noise(rng, DAYS)
    bad[[12, 29]] += 0.5
    assert find_steps([days_of(bad, DAYS)])[0] is None
    assert find_steps([days_of(np.zeros((40, 3)), DAYS)])[0] is None


def test_a_day_of_false_sightings_among_true_ones_turns_little() -> None:
    rng = np.random.default_rng(9)
    expected = sun_directions(1.78e9 + np.linspace(-1.2e4, 1.2e4, 80), SITE)
    turn = Rotation.from_rotvec([0.0, 0.3, -0.2], degrees=True)
    observed = turn.inv().apply(expected) + rng.normal(0.0, 1e-5, expected.shape)
    observed[::4] += rng.normal(0.0, 0.02, (20, 3))
    found = daily_rotations(np.zeros(80), observed=observed, expected=expected)
    assert (
        np.abs(found.rotation_deg[0] - [0.0, 0.3, -0.2]).max() < 4.0 * np.sqrt(found.covariance_deg2[0].max()) < 0.005
    )
    few = np.where(np.arange(80)[:, None] < 15, observed, np.nan)
    assert len(daily_rotations(np.zeros(80), observed=few, expected=expected).day) == 0


def test_the_stated_error_of_a_day_is_that_of_many_draws() -> None:
    rng = np.random.default_rng(10)
    expected = np.tile(sun_directions(1.78e9 + np.linspace(-1.2e4, 1.2e4, 60), SITE), (150, 1))
    observed = expected + rng.normal(0.0, 1e-4, expected.shape)
    observed /= np.linalg.norm(observed, axis=1)[:, None]
    found = daily_rotations(np.repeat(np.arange(150.0), 60), observed=observed, expected=expected)
    squares = np.einsum("ni,nij,nj->n", found.rotation_deg, np.linalg.inv(found.covariance_deg2), found.rotation_deg)
    assert 2.4 < squares.mean() < 3.8


def settling(size_deg: list[float], *, day: float, settling_days: float) -> FloatArray:
    """Return (40, 3): a mast that settles by a rotation from a day on."""
    return np.outer(1.0 - np.exp(-np.maximum(DAYS - day, 0.0) / settling_days), size_deg)


def test_a_mast_that_settles_turns_slowly_and_its_neighbours_do_nothing() -> None:
    rng = np.random.default_rng(11)
    size = [0.06, -0.05, 0.06]
    squares = []
    beside: list[PoseChange] = []
    for _ in range(20):
        mast = noise(rng, DAYS) + settling(size, day=12.0, settling_days=10.0)
        found, *others = find_steps([days_of(one, DAYS) for one in (mast, noise(rng, DAYS), noise(rng, DAYS))])
        beside += [one for one in others if one is not None]
        assert found is not None
        turn, _ = explain_step(found, before=SITE, after=SITE)
        assert turn.cause == "slow_turn"
        assert 6.0 <= turn.settling <= 25.0
        assert abs(turn.time - 12.0) <= 4.0
        off = turn.rotation_deg - np.array(size) * (1.0 - np.exp(-2.7))
        squares.append(off @ np.linalg.solve(turn.covariance_deg2, off))
    assert len(beside) <= 2  # of 40
    assert {explain_step(one, before=SITE, after=SITE)[0].cause for one in beside} <= {"slow_turn"}
    assert 1.0 < np.mean(squares) < 12.0  # 3 where time constant and first day are known, which they are not


def test_a_clock_that_gains_is_one_and_a_blow_is_no_slow_turn() -> None:
    rng = np.random.default_rng(12)
    gaining = -np.outer(np.maximum(DAYS - 10.0, 0.0) / 240.0, pole_enu(SITE))  # 1 s a day
    found = find_steps([days_of(noise(rng, DAYS) + gaining, DAYS)])[0]
    assert found is not None
    explained, _ = explain_step(found, before=SITE, after=SITE)
    assert (explained.cause, np.isinf(explained.settling)) == ("clock", True)
    size = step_sizes(explained, SITE)
    assert abs(size["clock_s"] - 29.0) < 4.0 * size["clock_sigma_s"] < 4.0
    blow = (DAYS >= 25)[:, None] * np.array([0.03, -0.02, 0.03])
    found = find_steps([days_of(noise(rng, DAYS) + blow, DAYS)])[0]
    assert found is not None
    assert found.slower is not None
    assert found.gain > found.slower.gain + 2.0
    explained, _ = explain_step(found, before=SITE, after=SITE)
    assert (explained.cause, explained.time, explained.bracket, explained.settling) == (
        "moved",
        25.0,
        (24.0, 25.0),
        0.0,
    )


@pytest.mark.parametrize("days_after", [1, 2, 3])
def test_a_step_of_the_last_days_is_reported_of_no_camera(days_after: int) -> None:
    rng = np.random.default_rng(13)
    stepped = noise(rng, DAYS) + (days_after > 39 - DAYS)[:, None] * np.array([0.0, 0.0, 0.1])
    assert find_steps([days_of(one, DAYS) for one in (stepped, noise(rng, DAYS), noise(rng, DAYS))]) == (None,) * 3


def test_the_progress_of_a_change_goes_from_nothing_to_all_of_it() -> None:
    for settling_days, halfway in ((0.0, 1.0), (np.inf, 0.5), (10.0, (1.0 - np.exp(-0.5)) / (1.0 - np.exp(-1.0)))):
        change = replace(step_of([1.0, 0.0, 0.0]), time=5.0, bracket=(5.0, 15.0), settling=settling_days)
        done = change.progress(np.array([0.0, 4.9, 5.0, 10.0, 15.0]))
        assert done == pytest.approx([0.0, 0.0, 1.0 if settling_days == 0.0 else 0.0, halfway, 1.0])
