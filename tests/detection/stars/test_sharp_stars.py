"""Stars that are sharper than a pixel, by a renderer of their own."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import erf

from sunarc.detection.stars.detect import detect_stars, rank_in_part

Places = NDArray[np.float64]
NOISE = 2.0


def lit(places: Places, flux: Places, width: float, size: int) -> NDArray[np.float64]:
    """Return the light of Gaussian stars, each pixel the integral over its area."""
    edges = np.arange(size + 1) - 0.5
    across, down = (np.diff(0.5 * erf((edges - one[:, None]) / (width * np.sqrt(2.0))), axis=-1) for one in places.T)
    return np.asarray(np.einsum("n,ny,nx->yx", flux, down, across))


def night(light: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return counts of 8 bits over a dark sky, with noise."""
    counts = 20.0 + light + rng.normal(0.0, NOISE, light.shape)
    return np.asarray(np.clip(np.round(counts), 0, 255), dtype=np.uint8)


def found(image: NDArray[np.uint8], places: Places) -> tuple[Places, Places]:
    """Return the distance of the nearest detection to each place, px, and its stated sigma."""
    stars = detect_stars(image, full_scale=255)
    apart, row = cKDTree(stars.pixels).query(places)
    return np.asarray(apart), stars.sigma_px[np.asarray(row)]


@pytest.mark.parametrize("width", [0.4, 0.5, 0.6])
def test_stars_sharper_than_a_pixel_are_found_below_aurora(width: float) -> None:
    rng = np.random.default_rng(8)
    places = rng.uniform(8.0, 248.0, (30, 2))
    rows, columns = np.mgrid[:256, :256]
    clumps = cv2.GaussianBlur(rng.normal(0.0, 1.0, (256, 256)), (0, 0), 2.0)
    bands = np.where(rows < 56.0, 60.0 * np.clip(1.0 + 5.0 * clumps + np.sin(columns / 25.0), 0.0, None), 0.0)
    apart, sigma = found(night(lit(places, rng.uniform(45.0, 120.0, 30), width, 256) + bands, rng), places)
    clear = places[:, 1] > 64.0
    assert np.mean(apart[clear] < 0.5) > 0.8
    near = clear & (apart < 0.5)
    assert np.mean(apart[near] < 3.0 * np.sqrt(2.0) * sigma[near]) > 0.9


def test_hot_pixels_are_no_sharp_stars() -> None:
    rng = np.random.default_rng(5)
    light = np.zeros((256, 256))
    light[tuple(rng.integers(8, 248, (2, 150)))] = rng.uniform(20.0, 200.0, 150)
    places = rng.uniform(8.0, 248.0, (40, 2))
    image = night(light + lit(places, rng.uniform(400.0, 1200.0, 40), 1.2, 256), rng)
    assert np.mean(found(image, places)[0] < 0.5) > 0.8


def test_the_rank_in_a_part_counts_those_before() -> None:
    assert rank_in_part(np.array([3, 1, 3, 3, 1, 0])).tolist() == [0, 0, 1, 2, 1, 0]
