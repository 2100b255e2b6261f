"""Heights from two cameras against PROJ's geocentric coordinates, drawn errors and rays that meet nowhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import Transformer

from sunarc.common.errors import InputError
from sunarc.geolocation.locate import local_frame
from sunarc.geolocation.pair_height import PairView, pair_height
from sunarc.sky.site import Site

FloatArray = NDArray[np.float64]
HERE = Site(latitude=53.15, longitude=8.17, altitude=12.0)
THERE = Site(latitude=53.16, longitude=8.19, altitude=40.0)
SIGMA = math.radians(0.05)


def direction_to(site: Site, *, latitude: float, longitude: float, altitude: float) -> FloatArray:
    """Return the straight direction to a place, by PROJ's geocentric coordinates."""
    transformer = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    ends = [
        np.array(transformer.transform(*place))
        for place in ((longitude, latitude, altitude), (site.longitude, site.latitude, site.altitude))
    ]
    ray = local_frame(site)[0] @ (ends[0] - ends[1])
    return np.asarray(ray / np.linalg.norm(ray))


def view(site: Site, direction: FloatArray, sigma: float = SIGMA) -> PairView:
    return PairView(site=site, direction=direction, covariance=sigma**2 * (np.eye(3) - np.outer(direction, direction)))


def views(latitude: float, longitude: float, altitude: float) -> tuple[PairView, PairView]:
    first, second = (
        view(site, direction_to(site, latitude=latitude, longitude=longitude, altitude=altitude))
        for site in (HERE, THERE)
    )
    return first, second


@pytest.mark.parametrize("altitude", [300.0, 2000.0, 11_000.0])
def test_the_height_of_a_place_is_proj_s(altitude: float) -> None:
    found = pair_height(*views(53.18, 8.14, altitude))
    assert found.height_m == pytest.approx(altitude - HERE.altitude, abs=1e-4)
    assert found.miss_m == pytest.approx(0.0, abs=1e-4)
    assert float(found.geodetic.latitude[0]) == pytest.approx(53.18, abs=1e-8)
    assert float(found.geodetic.longitude[0]) == pytest.approx(8.14, abs=1e-8)
    back = pair_height(*reversed(views(53.18, 8.14, altitude)))
    assert back.height_m + THERE.altitude == pytest.approx(found.height_m + HERE.altitude, abs=1e-3)
    assert abs(back.miss_m) == pytest.approx(abs(found.miss_m), abs=1e-6)


@pytest.mark.parametrize(("latitude", "longitude", "altitude"), [(53.155, 8.18, 1500.0), (53.20, 8.10, 4000.0)])
def test_the_stated_errors_are_those_of_drawn_directions(latitude: float, longitude: float, altitude: float) -> None:
    exact = views(latitude, longitude, altitude)
    stated = pair_height(*exact)
    rng = np.random.default_rng(1)
    heights, misses = [], []
    for _ in range(600):
        drawn = []
        for one in exact:
            moved = one.direction + rng.multivariate_normal(np.zeros(3), one.covariance)
            drawn.append(view(one.site, moved / np.linalg.norm(moved)))
        found = pair_height(*drawn)
        heights.append(found.height_m)
        misses.append(found.miss_m)
    assert np.std(heights) == pytest.approx(stated.sigma_m, rel=0.12)
    assert np.std(misses) == pytest.approx(stated.miss_sigma_m, rel=0.12)
    assert abs(np.mean(heights) - stated.height_m) < 0.2 * stated.sigma_m
    assert 0.0 < stated.sigma_m < 0.1 * altitude


def test_one_camera_that_is_turned_shows_in_the_miss() -> None:
    first, second = views(53.19, 8.25, 4000.0)  # in line with both: north moves its rays across
    turned = math.radians(1.0)
    turn = np.array([[math.cos(turned), -math.sin(turned), 0.0], [math.sin(turned), math.cos(turned), 0.0], [0, 0, 1]])
    found = pair_height(first, view(THERE, turn @ second.direction))
    assert abs(found.miss_m) > 5.0 * found.miss_sigma_m


def test_rays_that_do_not_meet_are_refused() -> None:
    up = np.array([0.0, 0.0, 1.0])
    first, second = views(53.18, 8.14, 2000.0)
    far = views(53.18, 8.14, 3_000_000.0)
    for a, b, where in (
        (view(HERE, up), view(THERE, up), "pixel_b"),  # parallel but for the curved Earth
        (*far, "pixel_b"),  # parallel within their errors
        (view(HERE, up), view(HERE, up), "pixel_b"),
        (view(HERE, np.array([-0.6, 0.0, 0.8])), view(THERE, np.array([0.6, 0.0, 0.8])), "pixel_b"),  # they part
        (view(HERE, np.array([0.8, 0.0, -0.6])), second, "pixel_a"),
        (first, view(THERE, np.full(3, np.nan)), "pixel_b"),
    ):
        with pytest.raises(InputError) as refused:
            pair_height(a, b)
        assert refused.value.field == where
