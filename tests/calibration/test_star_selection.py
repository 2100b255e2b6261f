"""Stars of a fit: spread over the image, the surest first."""

from __future__ import annotations

import numpy as np

from sunarc.calibration.selection import image_parts, pick_surest_in_parts, sky_parts


def test_the_parts_of_an_image_have_equal_areas() -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(600.0), np.arange(600.0)))
    inside = np.hypot(x - 299.5, y - 299.5) < 300.0
    count = np.bincount(image_parts(np.column_stack([x, y])[inside], (600, 600)), minlength=48)
    assert count.size == 48
    assert count.max() < 1.03 * count.min()


def test_the_parts_of_the_sky_have_equal_areas() -> None:
    directions = np.random.default_rng(1).standard_normal((400_000, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    count = np.bincount(sky_parts(directions[directions[:, 2] > 0.0]), minlength=48)
    assert count.size == 48
    assert count.max() < 1.15 * count.min()


def test_the_surest_of_each_part_come_first_then_the_next_of_each() -> None:
    part = np.array([0, 0, 0, 1, 1, 2])
    sigma = np.array([0.3, 0.1, 0.2, 0.5, 0.4, 0.9])
    assert pick_surest_in_parts(part, sigma, 3).tolist() == [1, 4, 5]
    assert pick_surest_in_parts(part, sigma, 4).tolist() == [1, 2, 4, 5]
    assert pick_surest_in_parts(part, sigma, 5).tolist() == [1, 2, 3, 4, 5]
    assert pick_surest_in_parts(part, sigma, 99).tolist() == [0, 1, 2, 3, 4, 5]
    assert pick_surest_in_parts(part, sigma, 0).tolist() == []
    assert pick_surest_in_parts(part[:0], sigma[:0], 5).tolist() == []


def test_a_part_is_one_of_four_rings_of_one_of_twelve_sectors() -> None:
    rng = np.random.default_rng(2)
    turn, share = rng.uniform(0.0, 2.0 * np.pi, 300), rng.uniform(0.0, 1.2, 300)
    expected = [
        4 * int(12.0 * one / (2.0 * np.pi)) + min(int(4.0 * other), 3) for one, other in zip(turn, share, strict=True)
    ]
    radius = 0.5 * 480.0 * np.sqrt(share)
    pixels = np.column_stack([319.5 + radius * np.cos(turn), 239.5 + radius * np.sin(turn)])
    assert image_parts(pixels, (640, 480)).tolist() == expected
    across = np.sqrt(1.0 - (1.0 - share) ** 2)
    directions = np.column_stack([across * np.sin(turn), across * np.cos(turn), 1.0 - share])
    assert sky_parts(directions).tolist() == expected
