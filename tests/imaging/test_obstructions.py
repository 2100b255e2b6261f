"""Obstruction mask and horizon profile, of a rendered sky that shares no code with them."""

from __future__ import annotations

import sys
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest

from sunarc.common.errors import InputError
from sunarc.imaging.horizon import HorizonProfile, horizon_profile, sun_hours
from sunarc.imaging.obstructions import (
    FREE,
    HIDDEN,
    SOILED,
    UNKNOWN,
    ObstructionSums,
    add_star_votes,
    carried_over,
    carried_states,
    cell_grid,
    mask_changes,
    no_sums,
    obstruction_mask,
    updated_sums,
)
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.site import Site

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs" / "studies"))
from obstruction_world import Weather, World, sun_enu
from obstructions import Learner, camera_of, horizon_errors

SIZE = 256


@pytest.fixture(scope="module")
def clear_day() -> Learner:
    """Return what a clear day has shown to a small camera."""
    learner = Learner(World(n=SIZE, seed=3))
    learner.day(0, ["clear"], every_min=20.0)
    return learner


def shown(learner: Learner, image: np.ndarray, *, later_s: float = 600.0) -> ObstructionSums:
    """Return the sums with one more image, at noon of the next day."""
    time = learner.world.times(1)[48]
    unix_s = time.timestamp() + later_s
    return updated_sums(learner.sums, image, learner.grid, sun=learner.world.sun(time), unix_s=unix_s)


def test_a_clear_day_makes_a_mask_near_the_truth(clear_day: Learner) -> None:
    assert clear_day.sums.is_ready
    assert 0.95 < clear_day.iou() <= 1.0
    assert clear_day.false_share() < 0.001


def test_the_horizon_is_within_half_a_degree_where_its_edge_is_sharp(clear_day: Learner) -> None:
    near, within_two_sigma = horizon_errors(clear_day)
    assert near >= 0.9
    assert within_two_sigma >= 0.85


@pytest.mark.parametrize("weather", ["fog", "overcast", "bank"])
def test_days_without_the_sun_make_no_mask(weather: Weather) -> None:
    learner = Learner(World(n=SIZE, seed=3, linear=False))
    for day in range(3):
        learner.day(day, [weather], every_min=60.0)
    assert not learner.sums.is_ready


def test_fog_shows_neither_sky_nor_obstructions() -> None:
    learner = Learner(World(n=SIZE, seed=3, linear=False))
    learner.day(0, ["fog"], every_min=60.0)
    high = learner.grid.directions[2] > np.sin(np.radians(5.0))
    assert np.all(learner.mask().state[high] == UNKNOWN)


def test_images_that_are_not_of_the_scene_are_counted_and_do_not_vote(clear_day: Learner) -> None:
    world, time = clear_day.world, clear_day.world.times(1)[48]
    noon = world.frame(time, "clear")
    turned = np.ascontiguousarray(np.rot90(noon))
    again = shown(clear_day, noon)
    frozen = updated_sums(again, noon, clear_day.grid, sun=world.sun(time), unix_s=again.unix_s + 60.0)
    cases = {
        "covered": (clear_day.sums, shown(clear_day, np.full_like(noon, 40))),
        "other_scene": (clear_day.sums, shown(clear_day, turned)),
        "earlier": (clear_day.sums, shown(clear_day, noon, later_s=-86400.0 * 2)),
        "frozen": (again, frozen),
    }
    for use, (before, after) in cases.items():
        assert after.counts.get(use, 0) == before.counts.get(use, 0) + 1, use
        assert np.allclose(after.log_odds, before.log_odds, rtol=2e-2), use


def test_evidence_halves_in_sixty_days(clear_day: Learner) -> None:
    later_s = clear_day.sums.unix_s + 60.0 * 86400.0
    dark = np.full((SIZE, SIZE), 40, np.uint16)
    after = updated_sums(clear_day.sums, dark, clear_day.grid, sun=np.array([0.0, 0.0, 1.0]), unix_s=later_s)
    assert after.counts["covered"] == clear_day.sums.counts.get("covered", 0) + 1
    assert np.allclose(after.log_odds, 0.5 * clear_day.sums.log_odds)


def test_an_image_of_another_size_is_refused(clear_day: Learner) -> None:
    with pytest.raises(InputError) as raised:
        shown(clear_day, np.zeros((100, 100), np.uint8))
    assert raised.value.field == "image"


def test_a_blurred_spot_away_from_the_rim_is_soiled_and_not_of_the_horizon() -> None:
    learner = Learner(World(n=SIZE, seed=3))
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    dirt = 1.0 - 0.9 * np.exp(-((((x - 150) ** 2 + (y - 120) ** 2) / (2 * 9.0**2)) ** 2))
    world = learner.world
    for time in world.times(0, every_min=20.0):
        image = (world.frame(time, "clear") * dirt).astype(np.uint16)
        sun = world.sun(time)
        learner.sums = updated_sums(learner.sums, image, learner.grid, sun=sun, unix_s=time.timestamp())
    mask = learner.mask()
    assert mask.image()[120, 150] == SOILED
    assert not np.any(mask.state[100:140, 140:160] == HIDDEN)
    assert mask.hidden()[120, 150]
    clean = horizon_profile(mask)
    assert np.max(clean.elevation_deg) < 45.0


def test_a_crane_appears_in_the_changes_with_its_direction(clear_day: Learner) -> None:
    learner = Learner(clear_day.world)
    learner.sums, before = clear_day.sums, clear_day.mask()
    for day in (1, 2):
        learner.day(day, ["clear"], crane=True, every_min=20.0)
    appeared, known = mask_changes(before.state, learner.mask())
    assert appeared
    assert mask_changes(known, learner.mask())[0] == []
    assert all(one.appeared for one in appeared)
    away = (appeared[0].azimuth_deg - clear_day.world.crane_at + 180.0) % 360.0 - 180.0
    assert -10.0 < away < 30.0
    assert 15.0 < appeared[0].elevation_deg < 35.0
    assert [one.appeared for one in mask_changes(known, before)[0]][:1] == [False]


def test_an_obstruction_that_is_unknown_in_between_or_grows_bit_by_bit_is_found_once(clear_day: Learner) -> None:
    mask = clear_day.mask()
    free = np.argwhere(mask.state == FREE)
    row, column = free[np.argmin(np.hypot(*(free - SIZE / 2.0 - [25, 0]).T))]
    known, found = mask.state, []
    for state, wide in ((UNKNOWN, 12), (HIDDEN, 2), (UNKNOWN, 12), (HIDDEN, 2), (HIDDEN, 12), (HIDDEN, 12)):
        shown = mask.state.copy()
        shown[row : row + wide, column : column + wide] = state
        changes, known = mask_changes(known, replace(mask, state=shown))
        found += changes
    assert len(found) == 1
    assert found[0].appeared
    assert found[0].area_deg2 == pytest.approx(mask.grid.area_deg2[row : row + 12, column : column + 12].sum(), rel=0.1)


def test_the_sun_is_behind_what_the_mask_hides_and_nowhere_else(clear_day: Learner) -> None:
    mask, world = clear_day.mask(), clear_day.world
    sky = world.elevation > 0.0
    hidden = mask.hides(world.directions[sky])
    truth = world.truth(crane=False)[sky]
    assert np.mean(hidden[truth]) > 0.9
    assert np.mean(hidden[~truth]) < 0.002
    assert not mask.hides(np.array([[0.0, 0.0, -1.0]]))[0]  # outside the image


def test_the_evidence_is_carried_over_a_turn_by_directions(clear_day: Learner) -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rotation = rotation_vector(turn @ rotation_matrix(clear_day.camera.rotation_cam_enu))
    turned = replace(clear_day.camera, rotation_cam_enu=rotation)
    grid = cell_grid(turned)
    carried = obstruction_mask(carried_over(clear_day.sums, clear_day.camera, grid), grid)
    before = clear_day.mask().state
    equal = np.maximum(*(np.mean(np.rot90(before, k)[grid.sky] == carried.state[grid.sky]) for k in (1, 3)))
    assert equal > 0.95


def test_named_stars_free_their_cells_and_stars_that_are_never_found_hide_theirs(clear_day: Learner) -> None:
    grid, world = clear_day.grid, clear_day.world
    truth, sky = world.truth(crane=False), world.elevation > 5.0
    rng = np.random.default_rng(5)
    picked = rng.choice(np.flatnonzero(sky.ravel()), 9000)
    directions, behind = world.directions.reshape(-1, 3)[picked], truth.ravel()[picked]
    sums = no_sums(grid)
    for _ in range(8):
        sums = add_star_votes(sums, grid, named=directions[~behind], missed=directions[behind])
    state = obstruction_mask(sums, grid).state
    inside = cv2.erode(truth.astype(np.uint8), np.ones((11, 11))) > 0
    outside = cv2.dilate(truth.astype(np.uint8), np.ones((5, 5))) == 0
    assert np.mean(state[sky & outside] == FREE) > 0.95
    assert np.mean(state[sky & inside] == HIDDEN) > 0.8
    assert not np.any(state[sky & outside] == HIDDEN)
    nothing = add_star_votes(sums, grid, named=np.zeros((0, 3)), missed=np.zeros((0, 3)))
    assert np.array_equal(nothing.log_odds, sums.log_odds)


def test_known_states_are_carried_over_a_turn_and_are_unknown_at_their_borders(clear_day: Learner) -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = camera_of(clear_day.world, turn)
    grid, state = cell_grid(turned), clear_day.mask().state
    carried = carried_states(state, clear_day.camera, grid)
    rotated = max((np.rot90(state, k) for k in (1, 3)), key=lambda one: np.mean(one[grid.sky] == carried[grid.sky]))
    known = grid.sky & (carried != UNKNOWN)
    assert np.array_equal(carried[known], rotated[known])
    assert np.mean(carried[grid.sky] != UNKNOWN) > 0.8
    border = cv2.morphologyEx(rotated, cv2.MORPH_GRADIENT, np.ones((5, 5), np.uint8)) > 0
    assert np.all(carried[border & grid.sky] == UNKNOWN)


def test_the_sky_below_a_jib_is_an_opening_of_the_horizon() -> None:
    learner = Learner(World(n=SIZE, seed=3))
    world, mask = learner.world, learner.mask()
    probability = world.truth(crane=True).astype(np.float32)
    profile = horizon_profile(replace(mask, probability=probability))
    jib = [round(world.crane_at + off) % 360 for off in (14, 18, 22)]
    for azimuth in jib:
        below = float(world.horizon_deg()[azimuth])
        assert profile.elevation_deg[azimuth] == pytest.approx(31.0, abs=0.6)
        ((low, high),) = profile.openings[azimuth]
        assert (low, high) == (pytest.approx(below, abs=0.8), pytest.approx(29.0, abs=0.6))
    a, e = np.radians(jib[0]), np.radians([20.0, 30.0, 40.0])
    directions = np.stack([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)], axis=-1)
    assert profile.hides(directions).tolist() == [False, True, False]


@pytest.mark.parametrize("elevation_deg", [0.0, 12.0, 90.0])
def test_hours_of_sun_are_lost_while_the_sun_is_below_the_horizon(elevation_deg: float) -> None:
    flat = HorizonProfile(
        elevation_deg=np.full(360, elevation_deg), sigma_deg=np.zeros(360), openings=tuple(() for _ in range(360))
    )
    hours = sun_hours(flat, Site(latitude=47.0, longitude=8.0, altitude=0.0), year=2026)
    every = [datetime(2026, 1, 1, tzinfo=UTC) + timedelta(minutes=20 * k) for k in range(365 * 72)]
    height = np.degrees(np.arcsin([sun_enu(time, 47.0, 8.0)[2] for time in every]))
    months = np.array([time.month - 1 for time in every])
    risen = height > -0.57  # the air lifts the setting sun
    low = np.bincount(months, weights=risen & (height < elevation_deg) & (elevation_deg > 0.0), minlength=12) / 3.0
    assert np.allclose(hours.lost, low, atol=6.0)
    assert np.allclose(hours.up, np.bincount(months, weights=risen) / 3.0, atol=6.0)


def test_nothing_is_known_before_the_first_image(clear_day: Learner) -> None:
    empty = no_sums(clear_day.grid)
    assert not empty.is_ready
    assert not np.any(obstruction_mask(empty, clear_day.grid).state[clear_day.grid.sky] == FREE)
