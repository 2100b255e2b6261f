"""The moon's phase, the side of its lit limb and its size against skyfield (JPL's DE421)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from tests.sky.test_night import ARCSEC, MOMENTS, SITES, TIMESCALE

from sunarc.sky.directions import angular_distance, direction_from_angles
from sunarc.sky.night import body_position, moon_disc
from sunarc.sky.site import Site

api = pytest.importorskip("skyfield.api")
kernels = pytest.importorskip("skyfield_data")
_JD_1970 = 2_440_587.5


@pytest.fixture(scope="module")
def planets() -> Iterator[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of files that have expired; DE421 has not
        kernel = api.load_file(f"{kernels.get_skyfield_data_path()}/de421.bsp")
    yield kernel
    kernel.close()


@pytest.mark.parametrize("site", SITES)
def test_phase_lit_limb_and_size_are_those_of_the_ephemeris_of_jpl(site: Site, planets: Any) -> None:  # noqa: ANN401
    for unix_s in MOMENTS:
        disc = moon_disc(unix_s, site)
        place = planets["earth"] + api.wgs84.latlon(site.latitude, site.longitude, elevation_m=site.altitude)
        observed = place.at(TIMESCALE.ut1_jd(_JD_1970 + unix_s / 86_400.0))
        moon, sun = (observed.observe(planets[name]).apparent() for name in ("moon", "sun"))
        assert disc.cos_phase == pytest.approx(math.cos(moon.phase_angle(planets["sun"]).radians), abs=2e-4)
        altitude = moon.altaz()[0].degrees
        if altitude < 15.0:
            continue  # refraction turns and flattens the disc there
        towards = []
        for body in (moon, sun):
            up, azimuth, _ = body.altaz()
            towards.append(direction_from_angles(zenith_deg=90.0 - up.degrees, azimuth_deg=azimuth.degrees))
        limb = towards[1] - (towards[1] @ towards[0]) * towards[0]
        edge = disc.edges / np.linalg.norm(disc.edges, axis=0)
        assert angular_distance(edge[:, 0], limb / np.linalg.norm(limb)) < math.radians(0.3)
        assert abs(edge[:, 0] @ edge[:, 1]) < 5e-3
        radius = math.asin(1737.4 / moon.distance().km)
        assert np.linalg.norm(disc.edges, axis=0) == pytest.approx(radius, rel=3e-3)
        assert np.linalg.norm(disc.direction - body_position("moon", unix_s, site).direction) * ARCSEC < 0.1


def test_the_horizon_flattens_the_disc_by_a_sixth() -> None:
    site, unix_s = SITES[0], MOMENTS[4]
    times = unix_s + np.arange(0.0, 86_400.0, 60.0)
    low = min(times.tolist(), key=lambda at: abs(math.asin(body_position("moon", at, site).direction[2]) - 0.012))
    disc = moon_disc(low, site)
    axes = np.linalg.svd(disc.edges, compute_uv=False)
    assert 0.78 < axes[1] / axes[0] < 0.92
    vertical = np.array([0.0, 0.0, 1.0]) @ np.linalg.svd(disc.edges)[0][:, 1]
    assert abs(vertical) > 0.98


def test_lit_share_is_that_of_the_ephemeris() -> None:
    for unix_s in MOMENTS:
        assert moon_disc(unix_s, SITES[0]).illuminated_fraction == pytest.approx(
            body_position("moon", unix_s, SITES[0]).illuminated_fraction, abs=0.02
        )
