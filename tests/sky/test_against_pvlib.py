"""pvlib's documented entry points, with the same algorithm and with an unrelated one."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from pvlib.atmosphere import alt2pres
from pvlib.solarposition import get_solarposition

from sunarc.sky.directions import angular_distance, direction_from_angles
from sunarc.sky.ephemeris import terrestrial_minus_universal_s
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

SITES = [
    Site(latitude=36.604043, longitude=-97.484856, altitude=318.0),
    Site(latitude=-12.0, longitude=-77.0, altitude=150.0),
    Site(latitude=-41.0, longitude=175.0),
    Site(latitude=79.0, longitude=12.0, temperature=-5.0),
]
YEAR = pd.date_range("2026-01-01", "2026-12-31", freq="107min", tz="UTC")
UNIX_S = np.asarray(YEAR.astype("datetime64[ns, UTC]").astype("int64"), dtype=np.float64) / 1e9


def pvlib_angles(site: Site, method: str) -> pd.DataFrame:
    rows: pd.DataFrame = get_solarposition(
        YEAR,
        site.latitude,
        site.longitude,
        altitude=site.altitude,
        pressure=site.pressure_pa,
        temperature=site.temperature,
        method=method,
        **({"delta_t": terrestrial_minus_universal_s(UNIX_S)} if method == "nrel_numpy" else {}),
    )
    return rows


@pytest.mark.parametrize("site", SITES, ids=lambda site: f"{site.latitude:g} N")
def test_the_year_is_pvlibs_year(site: Site) -> None:
    ours, theirs = sun_angles(UNIX_S, site), pvlib_angles(site, "nrel_numpy")
    np.testing.assert_allclose(ours.zenith, theirs["zenith"], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(ours.apparent_zenith, theirs["apparent_zenith"], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(ours.azimuth, theirs["azimuth"], rtol=0.0, atol=1e-12)


@pytest.mark.filterwarnings("ignore:DatetimeIndex.dayofyear is deprecated")  # pvlib's, not ours
@pytest.mark.parametrize("site", SITES, ids=lambda site: f"{site.latitude:g} N")
def test_an_unrelated_algorithm_puts_the_sun_in_the_same_place(site: Site) -> None:
    # pvlib's "ephemeris" (a low-precision formula, topocentric parallax left out) is good to 0.01 to 0.02 degrees
    ours, theirs = sun_angles(UNIX_S, site), pvlib_angles(site, "ephemeris")
    apart = angular_distance(
        direction_from_angles(zenith_deg=ours.zenith, azimuth_deg=ours.azimuth),
        direction_from_angles(zenith_deg=theirs["zenith"], azimuth_deg=theirs["azimuth"]),
    )
    assert np.degrees(apart).max() < 0.025


def test_any_shape_goes_in_and_comes_out() -> None:
    site = SITES[0]
    flat = sun_angles(UNIX_S[:6], site)
    for shape in [(2, 3), (6, 1), (1, 1, 6)]:
        shaped = sun_angles(UNIX_S[:6].reshape(shape), site)
        for one, other in zip(shaped, flat, strict=True):
            np.testing.assert_allclose(one.ravel(), other, atol=1e-9)
            assert one.shape == shape
    assert sun_angles(UNIX_S[0], site).zenith.shape == ()
    assert sun_angles(np.zeros((0, 2)), site).azimuth.shape == (0, 2)


@pytest.mark.parametrize("altitude", [-430.0, 0.0, 318.0, 5640.0])
def test_the_pressure_of_an_altitude_is_pvlibs(altitude: float) -> None:
    site = Site(latitude=0.0, longitude=0.0, altitude=altitude)
    assert site.pressure_pa == pytest.approx(float(alt2pres(altitude)), rel=1e-12)
