"""Which sightings of a long record a fit uses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.selection import (
    Candidates,
    SelectionOptions,
    select_sightings,
    sigma_grade,
    sky_patches,
    solid_angle_sr,
)
from sunarc.common.errors import InputError
from sunarc.sky.days import solar_days
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from collections.abc import Iterable

SITE = Site(latitude=36.6, longitude=-97.5)
DAY = 86_400.0
NOON = 1_368_403_200.0 + 43_200.0 + 97.5 * 240.0


def record(days: Iterable[int], *, cadence_s: float = 60.0, sigma_px: float = 0.02, epoch: int = 0) -> Sightings:
    times = np.concatenate([NOON + DAY * day + np.arange(-15_000.0, 15_000.0, cadence_s) for day in days])
    return Sightings.of(unix_s=times, pixels=np.zeros((times.size, 2)), sigma_px=sigma_px, epoch=epoch)


def joined(*parts: Sightings) -> Sightings:
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("unix_s", "pixels", "sigma_px", "epoch", "clock_error_s")
    }
    return Sightings.of(**columns)


def test_patches_have_about_the_same_area() -> None:
    count = np.bincount(sky_patches(hemisphere(400_000), width_deg=5.0))
    inner = count[count > 0][:-80]  # the last ring ends at the horizon
    assert np.all(np.abs(inner / np.median(inner) - 1.0) < 0.35)
    assert solid_angle_sr(hemisphere(400_000), width_deg=2.0) == pytest.approx(2.0 * np.pi, rel=0.03)


def test_a_short_record_is_used_whole() -> None:
    points = record([0])
    assert select_sightings(points, site=SITE).index.tolist() == list(range(len(points)))


def test_a_thousand_days_come_down_to_what_a_patch_holds_and_no_direction_is_lost() -> None:
    points = record(range(0, 1000, 4), cadence_s=240.0)
    chosen = select_sightings(points, site=SITE, options=SelectionOptions(patch_deg=2.0, most=8000))
    assert chosen.index.size <= 8000
    middles = (np.floor(points.unix_s / 240.0) + 0.5) * 240.0
    patches = sky_patches(sun_directions(middles, SITE), width_deg=2.0)
    assert set(patches[chosen.index]) == set(patches)
    assert chosen.n_supplied == chosen.index.size + chosen.n_repeated


def test_a_day_in_a_new_part_of_the_sky_counts_whole_beside_a_hundred_alike() -> None:
    alike, new = record(range(-10, 50), cadence_s=120.0), record([215], cadence_s=120.0)
    chosen = select_sightings(joined(alike, new), site=SITE, options=SelectionOptions(most=3000))
    assert np.sum(chosen.index >= len(alike)) > 0.9 * len(new)
    assert np.sum(chosen.index < len(alike)) < 0.3 * len(alike)


def test_every_pose_epoch_keeps_its_share_of_a_patch() -> None:
    old, moved = record(range(60), cadence_s=120.0), record(range(60, 63), cadence_s=120.0, epoch=1)
    chosen = select_sightings(joined(old, moved), site=SITE, options=SelectionOptions(most_per_epoch=24))
    assert np.sum(chosen.index >= len(old)) > 0.9 * len(moved)


def test_precise_sightings_come_before_many_coarse_ones() -> None:
    coarse, fine = record(range(50), sigma_px=1.0), record([50], sigma_px=0.02)
    usual = record(range(100, 160), sigma_px=0.02)
    chosen = select_sightings(
        joined(coarse, fine, usual), site=SITE, options=SelectionOptions(most_per_patch=8, most_per_epoch=8)
    )
    assert np.all(np.isin(np.arange(len(coarse), len(coarse) + len(fine)), chosen.index))
    assert np.mean(np.isin(np.arange(len(coarse)), chosen.index)) < 0.2


def test_of_a_bracket_the_most_precise_sighting_stands_for_its_slot() -> None:
    first = record([0])
    second = Sightings.of(unix_s=first.unix_s + 0.4, pixels=first.pixels, sigma_px=np.array(0.01))
    chosen = select_sightings(joined(first, second), site=SITE, slot_s=60.0)
    assert chosen.n_brackets == len(first)
    assert np.all(chosen.index >= len(first))


def test_doubtful_clocks_and_days_are_left_out_and_counted() -> None:
    good, bad = record([0]), record([1])
    stepped = Sightings.of(unix_s=bad.unix_s, pixels=bad.pixels, clock_error_s=np.array(5.0))
    chosen = select_sightings(joined(good, stepped), site=SITE)
    assert chosen.n_doubtful_clock == len(bad)
    assert np.all(chosen.index < len(good))
    day = int((NOON - 97.5 * 240.0) // DAY)
    left = select_sightings(joined(good, bad), site=SITE, left_out_days=np.array([day]))
    assert left.n_other_days == len(good)
    assert np.all(left.index >= len(good))


def test_the_same_record_in_another_order_gives_the_same_sightings() -> None:
    points = record(range(0, 300, 10))
    turned = np.random.default_rng(1).permutation(len(points))
    options = SelectionOptions(most=5000)
    first = select_sightings(points, site=SITE, options=options).index
    second = turned[select_sightings(points.select(turned), site=SITE, options=options).index]
    assert np.array_equal(first, second)


def test_an_empty_record_gives_an_empty_selection() -> None:
    assert select_sightings(record([0]).select(slice(0, 0)), site=SITE).index.size == 0


def test_limits_that_leave_nothing_are_refused() -> None:
    with pytest.raises(InputError, match="most_per_patch"):
        SelectionOptions(most_per_patch=0)


def test_a_pass_is_graded_by_the_mean_of_its_sigmas_in_powers_of_two() -> None:
    sigma = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.4, 0.1, 0.4, 0.02, np.nan])
    member = np.array([0, 0, 0, 0, 0, 1, 2, 2, 3, 4])
    count = np.bincount(member)
    # a lone sighting of four times the usual sigma is two grades down, beside a usual one it is one; finer is usual
    assert sigma_grade(sigma, member, count).tolist() == [0, 2, 1, 0, 0]
    assert sigma_grade(np.full(10, np.nan), member, count).tolist() == [0, 0, 0, 0, 0]


def test_patches_of_the_whole_sphere_have_numbers_of_their_own() -> None:
    upper = hemisphere(100_000)
    sphere = np.concatenate([upper, -upper])
    patch = sky_patches(sphere, width_deg=10.0)
    np.testing.assert_array_equal(np.unique(patch), np.arange(patch.max() + 1))
    assert solid_angle_sr(sphere, width_deg=10.0) == pytest.approx(4.0 * np.pi, rel=0.03)
    for number in range(0, int(patch.max()) + 1, 7):
        inside = sphere[patch == number]
        assert np.degrees(np.arccos(np.min(inside @ inside[0]).clip(-1.0, 1.0))) < 2.0 * 10.0


@pytest.mark.parametrize(("clock_error_s", "retained"), [(1.9, True), (2.1, False)])
def test_clocks_are_doubtful_from_two_seconds_on(clock_error_s: float, *, retained: bool) -> None:
    one = record([0])
    points = Sightings.of(unix_s=one.unix_s, pixels=one.pixels, clock_error_s=np.array(clock_error_s))
    assert (select_sightings(points, site=SITE).index.size > 0) == retained


def test_what_decides_of_sightings_is_enough_and_one_without_a_place_is_none() -> None:
    points = record(range(0, 200, 5), sigma_px=0.03)
    options = SelectionOptions(most=3000)
    whole = select_sightings(points, site=SITE, options=options)
    alone = Candidates(
        unix_s=points.unix_s, sigma_px=points.sigma_px, clock_error_s=points.clock_error_s, epoch=points.epoch
    )
    np.testing.assert_array_equal(select_sightings(alone, site=SITE, options=options).index, whole.index)
    pixels = points.pixels.copy()
    pixels[whole.index[0], 1] = np.nan
    nowhere = select_sightings(Sightings.of(unix_s=points.unix_s, pixels=pixels), site=SITE, options=options)
    assert whole.index[0] not in nowhere.index
    assert nowhere.n_supplied == len(points)


def selected_by_hand(points: Sightings, options: SelectionOptions, slot_s: float) -> tuple[list[int], int]:
    """Return the rows of a selection and its fill, pass by pass."""
    slots: dict[tuple[int, float], list[int]] = {}
    for row in range(len(points)):
        slots.setdefault((int(points.epoch[row]), float(points.unix_s[row] // slot_s)), []).append(row)
    sigma = np.nan_to_num(points.sigma_px, nan=np.inf)
    rows = np.sort([min(some, key=lambda row: (sigma[row], points.unix_s[row])) for some in slots.values()])
    day = solar_days(points.unix_s, longitude=SITE.longitude)
    toward = sun_directions((points.unix_s // 240.0 + 0.5) * 240.0, SITE)
    patch = sky_patches(toward, width_deg=options.patch_deg)
    stated = np.isfinite(points.sigma_px)
    usual = float(np.median(points.sigma_px[rows][stated[rows]]))
    passes: dict[tuple[int, int, int], list[int]] = {}
    for row in rows.tolist():
        passes.setdefault((int(patch[row]), int(points.epoch[row]), int(day[row] - day[rows].min())), []).append(row)
    latest = int(points.epoch[rows].max())

    def order(key: tuple[int, int, int]) -> tuple[int, ...]:
        logs = [np.log2(points.sigma_px[row] / usual) if stated[row] else 0.0 for row in passes[key]]
        grade = max(round(float(np.mean(logs))), 0)
        return key[0], int(key[1] < latest), grade, int(f"{key[2]:017b}"[::-1], 2), key[1], key[2]

    ordered = sorted(passes, key=order)

    def filled(fill: int, in_epoch: float) -> list[int]:
        of_patch: dict[int, int] = {}
        of_epoch: dict[tuple[int, int], int] = {}
        taken = []
        for key in ordered:
            if of_patch.get(key[0], 0) < fill and of_epoch.get(key[:2], 0) < in_epoch:
                taken += passes[key]
            of_patch[key[0]] = of_patch.get(key[0], 0) + len(passes[key])
            of_epoch[key[:2]] = of_epoch.get(key[:2], 0) + len(passes[key])
        return taken

    fill, found = options.most_per_patch, filled(options.most_per_patch, options.most_per_epoch)
    while len(found) > options.most and fill > 1:
        fill -= 1
        found = filled(fill, max(1.0, options.most_per_epoch / options.most_per_patch * fill))
    return sorted(found, key=lambda row: float(points.unix_s[row])), fill


@pytest.mark.parametrize(
    ("most", "per_patch", "per_epoch"), [(30_000, 12, 7), (260, 20, 13), (450, 24, 24), (20, 8, 3)]
)
def test_a_selection_is_that_of_its_rules_pass_by_pass(most: int, per_patch: int, per_epoch: int) -> None:
    rng = np.random.default_rng(most)
    days = [record(range(begin, begin + 30, 4), cadence_s=500.0, epoch=k) for k, begin in enumerate((0, 25, 60))]
    points = joined(*days)
    again = rng.choice(len(points), 150, replace=False)
    points = joined(points, points.select(again))
    times = points.unix_s + rng.uniform(-200.0, 200.0, len(points))
    sigma = np.where(rng.random(len(points)) < 0.1, np.nan, 0.02 * 2.0 ** rng.uniform(-2.0, 3.0, len(points)))
    points = Sightings.of(unix_s=times, pixels=points.pixels, sigma_px=sigma, epoch=points.epoch)
    options = SelectionOptions(patch_deg=5.0, most=most, most_per_patch=per_patch, most_per_epoch=per_epoch)
    found = select_sightings(points, site=SITE, options=options, slot_s=40.0)
    rows, fill = selected_by_hand(points, options, 40.0)
    assert (found.index.tolist(), found.fill) == (rows, fill)


def test_a_usual_fit_uses_30_000_sightings_96_a_patch_and_64_of_an_epoch() -> None:
    usual = SelectionOptions()
    assert (usual.most, usual.most_per_patch, usual.most_per_epoch, usual.patch_deg) == (30_000, 96, 64, 4.0)
