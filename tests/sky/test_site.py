from __future__ import annotations

import math

import pytest

from sunarc.common.errors import InputError
from sunarc.sky.site import Site


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("latitude", 90.1),
        ("latitude", math.nan),
        ("longitude", -180.1),
        ("longitude", math.inf),
        ("altitude", 9001.0),
        ("temperature", 285.0),
        ("pressure", 1013.0),
    ],
)
def test_what_is_no_place_is_refused_by_name_and_with_the_unit(field: str, value: float) -> None:
    with pytest.raises(InputError) as caught:
        Site(**{"latitude": 36.6, "longitude": -97.5, field: value})
    assert caught.value.field == f"site.{field}"
    assert caught.value.remedy.startswith("give ")


@pytest.mark.parametrize(
    ("field", "accepted", "refused"),
    [
        ("temperature", -60.0, -60.1),
        ("temperature", 60.0, 60.1),
        ("pressure", 30_000.0, 29_999.0),
        ("pressure", 110_000.0, 110_001.0),
    ],
)
def test_the_air_is_bounded_on_both_sides(field: str, accepted: float, refused: float) -> None:
    assert getattr(Site(**{"latitude": 36.6, "longitude": -97.5, field: accepted}), field) == accepted
    with pytest.raises(InputError) as caught:
        Site(**{"latitude": 36.6, "longitude": -97.5, field: refused})
    assert caught.value.field == f"site.{field}"


def test_a_site_in_other_air_keeps_its_place_and_what_was_not_measured() -> None:
    site = Site(latitude=36.6, longitude=-97.5, altitude=318.0, temperature=15.0)
    warm = site.replace_air(temperature=35.0, pressure=None)
    assert (warm.latitude, warm.longitude, warm.altitude) == (36.6, -97.5, 318.0)
    assert (warm.temperature, warm.pressure_pa) == (35.0, site.pressure_pa)
    assert site.replace_air(temperature=None, pressure=97_000.0).pressure_pa == 97_000.0


@pytest.mark.parametrize(("altitude", "pressure"), [(0.0, 101_325.0), (1000.0, 89_875.0), (5000.0, 54_020.0)])
def test_the_pressure_follows_the_standard_atmosphere(altitude: float, pressure: float) -> None:
    # ICAO standard atmosphere, doc 7488
    assert Site(latitude=0.0, longitude=0.0, altitude=altitude).pressure_pa == pytest.approx(pressure, rel=1e-3)


def test_a_pressure_that_was_set_is_kept() -> None:
    assert Site(latitude=0.0, longitude=0.0, altitude=1000.0, pressure=90_000.0).pressure_pa == 90_000.0
