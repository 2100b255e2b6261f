from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from sunarc.sky import Site, angles_from_direction, sun_angles, sun_directions

SITE = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
DAY = datetime(2026, 5, 13, 6, tzinfo=UTC).timestamp() + np.arange(0.0, 86_400.0, 30.0)


def bennett_deg(true_altitude_deg: np.ndarray, site: Site) -> np.ndarray:
    """Bennett's refraction for a true altitude, as the algorithm's Eq. 42 prints it."""
    bent = 1.02 / (60.0 * np.tan(np.radians(true_altitude_deg + 10.3 / (true_altitude_deg + 5.11))))
    return np.asarray(site.pressure_pa / 100.0 / 1010.0 * 283.0 / (273.0 + site.temperature) * bent)


def test_the_sun_is_lifted_by_bennetts_formula() -> None:
    angles = sun_angles(DAY, SITE)
    up = angles.zenith < 90.0
    np.testing.assert_allclose(
        (angles.zenith - angles.apparent_zenith)[up], bennett_deg(90.0 - angles.zenith[up], SITE), atol=1e-9
    )


def test_at_the_horizon_it_is_lifted_by_half_a_degree() -> None:
    angles = sun_angles(DAY, SITE)
    lift = (angles.zenith - angles.apparent_zenith)[np.argmin(np.abs(angles.zenith - 90.0))]
    assert float(lift) == pytest.approx(0.46, abs=0.03)


def test_far_below_the_horizon_it_is_not_lifted() -> None:
    angles = sun_angles(DAY, SITE)
    night = angles.zenith > 91.0
    assert night.sum() > 500
    np.testing.assert_array_equal(angles.apparent_zenith[night], angles.zenith[night])


def test_directions_are_the_apparent_ones() -> None:
    zenith_deg, azimuth_deg = angles_from_direction(sun_directions(DAY, SITE))
    angles = sun_angles(DAY, SITE)
    np.testing.assert_allclose(zenith_deg, angles.apparent_zenith, atol=1e-9)
    np.testing.assert_allclose(azimuth_deg, angles.azimuth, atol=1e-9)


def test_thin_warm_air_bends_less() -> None:
    thin = Site(latitude=SITE.latitude, longitude=SITE.longitude, pressure=60_000.0, temperature=30.0)
    lift, thin_lift = (a.zenith - a.apparent_zenith for a in (sun_angles(DAY, SITE), sun_angles(DAY, thin)))
    up = sun_angles(DAY, SITE).zenith < 89.0
    np.testing.assert_allclose(
        thin_lift[up] / lift[up], (60_000.0 / SITE.pressure_pa) * (273.0 + 12.0) / (273.0 + 30.0), rtol=2e-3
    )
