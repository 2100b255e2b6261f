"""The offset of stars against the sun: along the radius, by the stars whose predictions are sure."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.common.array_types import FloatArray
from sunarc.imager.workers.night.named_stars import radial_offset

CENTRE = np.array([870.0, 880.0])


def stars(count: int = 4000) -> FloatArray:
    rng = np.random.default_rng(4)
    angle, far = rng.uniform(0.0, 2.0 * np.pi, count), 800.0 * np.sqrt(rng.uniform(size=count))
    return np.asarray(CENTRE + far[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def outwards(places: FloatArray, size_px: FloatArray | float) -> FloatArray:
    away = places - CENTRE
    return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True) * np.reshape(size_px, (-1, 1)))


def test_coma_is_found_and_taken_off() -> None:
    places, rng = stars(), np.random.default_rng(5)
    far = np.linalg.norm(places - CENTRE, axis=-1)
    seen = places + outwards(places, -0.13 * (far / 800.0) ** 2) + rng.normal(0.0, 0.1, places.shape)
    found = radial_offset(seen, places, sigma_px=np.full(far.size, 0.05), centre=CENTRE)
    np.testing.assert_allclose(found.at(places), outwards(places, -0.13 * (far / 800.0) ** 2), atol=0.015)
    assert found.largest_px == pytest.approx(0.13, abs=0.02)
    np.testing.assert_allclose(found.at(CENTRE[None]), 0.0, atol=1e-12)


def test_a_shift_or_a_turn_of_the_camera_is_no_offset_along_the_radius() -> None:
    places = stars()
    away = places - CENTRE
    turned = places + 1e-3 * np.stack([-away[:, 1], away[:, 0]], axis=-1)
    for seen in (places + np.array([0.3, -0.2]), turned):
        found = radial_offset(seen, places, sigma_px=np.full(places.shape[0], 0.05), centre=CENTRE)
        assert found.largest_px < 0.03


def test_stars_whose_prediction_is_unsure_say_little() -> None:
    places = stars()
    north = places[:, 1] < CENTRE[1]
    sigma = np.where(north, 1.0, 0.01)
    seen = places + outwards(places, np.where(north, 0.5, 0.1))
    found = radial_offset(seen, places, sigma_px=sigma, centre=CENTRE)
    ring = np.linalg.norm(places - CENTRE, axis=-1) > 400.0
    np.testing.assert_allclose(np.linalg.norm(found.at(places), axis=-1)[ring], 0.1, atol=0.02)


def test_false_matches_do_not_move_it() -> None:
    places = stars()
    seen = places + outwards(places, 0.1)
    seen[::10] += [3.0, 3.0]
    found = radial_offset(seen, places, sigma_px=np.full(places.shape[0], 0.05), centre=CENTRE)
    assert found.largest_px < 0.15


@pytest.mark.parametrize("count", [0, 1, 59])
def test_a_few_stars_have_no_offset(count: int) -> None:
    places = stars(count)
    found = radial_offset(places + 0.5, places, sigma_px=np.ones(count), centre=CENTRE)
    assert found.largest_px == 0.0
    assert not np.any(found.at(np.array([[1.0, 2.0]])))
