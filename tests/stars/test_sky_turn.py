"""What turns between images: pairs, focal lengths and shares by their definitions, the hypotheses as stored."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fixtures.stored_answers import require_stored

from sunarc.common.array_types import FloatArray
from sunarc.stars.sky_turn import (
    SearchRange,
    Turns,
    angle_to_radius,
    count_on_detections,
    focal_lengths,
    image_pairs,
    radius_to_angle,
    turnings,
)

DAY_S = 86_164.0905
"""A turn of the sky."""


def test_pairs_are_turned_by_3_to_45_degrees_those_nearest_to_15_first() -> None:
    some = [np.full((n, 2), float(k)) for k, n in enumerate((20, 15, 14, 40, 40, 40))]
    times = [DAY_S / 360.0 * degrees for degrees in (0.0, 2.9, 14.0, 17.0, 47.5, 20.5)]
    found = [(int(one.first[0, 0]), int(one.second[0, 0]), math.degrees(one.turn)) for one in image_pairs(times, some)]
    assert [one[:2] for one in found] == [(1, 3), (0, 3), (1, 5)]
    assert [one[2] for one in found] == pytest.approx([14.1, 17.0, 17.6])
    for degrees, count in ((2.9, 0), (3.1, 1), (44.9, 1), (45.1, 0)):
        assert len(image_pairs([0.0, DAY_S / 360.0 * degrees], [some[3], some[4]])) == count
    assert len(image_pairs([0.0, DAY_S / 24.0], [some[3], some[1][:14]])) == 0


@pytest.mark.parametrize("shape", [-0.5, 0.0, 0.5])
def test_focal_lengths_are_of_the_least_and_the_greatest_radius_and_no_further_apart_than_a_step(shape: float) -> None:
    found = np.array(focal_lengths((200.0, 500.0), shape, step=1.06))
    of_right_angle = {-0.5: math.sqrt(2.0), 0.0: math.pi / 2.0, 0.5: 2.0}[shape]
    np.testing.assert_allclose(found[[0, -1]] * of_right_angle, [200.0, 500.0])
    ratios = found[1:] / found[:-1]
    assert ratios.max() <= 1.06 < ratios.max() ** (found.size - 1) / 1.0
    assert found.size == math.ceil(math.log(2.5) / math.log(1.06)) + 1
    assert focal_lengths((300.0, 300.0), shape, step=1.06) == pytest.approx([300.0 / of_right_angle] * 2)


@pytest.mark.parametrize("shape", [-0.5, 0.0, 0.5])
def test_the_share_of_rays_that_come_near_detections_less_that_of_chance(shape: float) -> None:
    rng = np.random.default_rng(1)
    angle, about = rng.uniform(0.05, 1.5, 50), rng.uniform(0.0, 2.0 * math.pi, 50)
    rays = np.stack([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)], axis=-1)
    poles = np.array([[0.0, 0.6, 0.8], [0.0, 0.6, 0.8], [0.6, 0.0, 0.8]])
    angles, reach, largest = np.array([0.3, 0.2, 0.3]), 0.05, 1.4
    there = Rotation.from_rotvec(0.3 * poles[0]).apply(rays)
    off, round_ = np.arctan2(np.hypot(there[:, 0], there[:, 1]), there[:, 2]), np.arctan2(there[:, 1], there[:, 0])
    onto = angle_to_radius(off, shape)[:, None] * np.stack([np.cos(round_), np.sin(round_)], axis=-1)
    onto = onto[off < largest][:30] + rng.normal(0.0, 0.01, (30, 2))
    found = count_on_detections(rays, onto, Turns(poles, angles), shape=shape, reach=reach, largest=largest)
    half = float(np.quantile(np.abs(onto).max(axis=-1), 0.98)) + 2.0 * reach
    grid = np.linspace(-half, half, 160)
    x, y = np.meshgrid(grid, grid)
    nearest = np.min(np.hypot(x[..., None] - onto[:, 0], y[..., None] - onto[:, 1]), axis=-1)
    chance = float(np.mean(nearest[np.hypot(x, y) <= half] <= reach))
    for k in range(3):
        turned = Rotation.from_rotvec(angles[k] * poles[k]).apply(rays)
        theta = np.arctan2(np.hypot(turned[:, 0], turned[:, 1]), turned[:, 2])
        inside = theta <= largest
        at = angle_to_radius(theta, shape)[:, None] * turned[:, :2] / np.hypot(turned[:, 0], turned[:, 1])[:, None]
        hit = inside & (np.min(np.linalg.norm(at[:, None] - onto, axis=-1), axis=1) <= reach)
        share = float(np.sum(hit)) / max(float(np.sum(inside)), 16.0)
        assert found[k] == pytest.approx((share - chance) / (1.0 - chance), abs=0.04)
    assert found[0] > 0.5 > max(found[1:])


def turning_images(*, mirrored: bool) -> tuple[list[float], list[FloatArray]]:
    """Return times and brightest detections of 70 stars about a pole 50 degrees off the axis of an equidistant lens."""
    rng = np.random.default_rng(5)
    rays = rng.normal(size=(150, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    pole, times, images = np.array([math.sin(0.87), 0.0, math.cos(0.87)]), [0.0, 3600.0, 6000.0], []
    for time in times:
        x, y, z = Rotation.from_rotvec(-2.0 * math.pi * time / DAY_S * pole).apply(rays).T
        angle = np.arctan2(np.hypot(x, y), z)
        up = angle < 1.5
        place = (200.0 * angle / np.hypot(x, y))[:, None] * np.stack([x, y], axis=-1) + [330.0, 305.0]
        place = place[up] + rng.normal(0.0, 0.3, (np.count_nonzero(up), 2))
        images.append(np.column_stack([639.0 - place[:, 0], place[:, 1]]) if mirrored else place)
    return times, images


@pytest.mark.parametrize("mirrored", [False, True])
def test_lens_and_pole_come_of_what_turns(*, mirrored: bool) -> None:
    times, images = turning_images(mirrored=mirrored)
    field = SearchRange(centre=(319.5, 300.0), radius_px=(280.0, 350.0), polar_rad=(0.75, 1.0), width=640)
    found = turnings(image_pairs(times, images), field)
    best = found[0]
    assert best.mirrored == mirrored
    np.testing.assert_allclose(best.centre, [330.0, 305.0], atol=1.0)
    np.testing.assert_allclose(best.pole, [math.sin(0.87), 0.0, math.cos(0.87)], atol=0.01)
    assert 200.0 * radius_to_angle(np.array(100.0 / best.focal_px), best.shape) == pytest.approx(100.0, abs=1.0)
    assert best.share > 0.8
    numbers = [best.focal_px, best.share, *best.centre, *(one.share for one in found)]
    stored = Path(__file__).parent / "stored_answers.json"
    require_stored(stored, f"turning_{mirrored}", {"numbers": numbers}, relative=5e-3)
