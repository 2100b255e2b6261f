"""The measured air of a day by the API: set, bounded, answered, and in the sun's position."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import pandas as pd
import pvlib
import pytest

if TYPE_CHECKING:
    from tests.fixtures.served import Made, Make

PATH = "/v1/days/2013-05-12/air"
WARM = {"temperature_c": 35.0, "pressure_hpa": 960.0}
NONE = {"temperature_c": None, "pressure_hpa": None, "set_at": None}
LOW_SUN = datetime(2013, 5, 12, 12, 0, tzinfo=UTC)


def zenith_by_pvlib(made: Made, *, temperature_c: float, pressure_hpa: float) -> float:
    site = made.site
    found = pvlib.solarposition.get_solarposition(
        pd.DatetimeIndex([LOW_SUN]), site.latitude, site.longitude, altitude=site.altitude,
        pressure=100.0 * pressure_hpa, temperature=temperature_c, delta_t=None,
    )  # fmt: skip
    return float(found["apparent_zenith"].iloc[0])


def test_the_air_of_a_day_is_set_and_answered(made: Made) -> None:
    assert made.client.get(PATH).json() == NONE
    answer = made.client.request("PUT", PATH, json=WARM, headers=made.bearer)
    assert (answer.status_code, answer.json()) == (200, {**WARM, "set_at": "2013-05-13T18:30:00Z"})
    again = made.client.request("PUT", PATH, json=WARM, headers=made.bearer)
    assert again.json() == answer.json() == made.client.get(PATH).json()
    days = made.client.get("/v1/days").json()["days"]
    assert [day["air"] for day in days] == [answer.json(), None]
    assert made.client.get("/v1/status").json()["last_day"]["air"] == answer.json()


def test_a_null_removes_it_and_one_value_is_enough(made: Made) -> None:
    made.client.request("PUT", PATH, json=WARM, headers=made.bearer)
    answer = made.client.request("PUT", PATH, json={"temperature_c": 20}, headers=made.bearer)
    assert (answer.json()["temperature_c"], answer.json()["pressure_hpa"]) == (20.0, None)
    made.client.request("PUT", PATH, json={"temperature_c": None, "pressure_hpa": None}, headers=made.bearer)
    assert made.client.get(PATH).json() == NONE


@pytest.mark.parametrize(
    ("field", "accepted", "refused"),
    [
        ("temperature_c", (-60, 60.0), (-60.1, 60.1, "35", True)),
        ("pressure_hpa", (300, 1100.0), (299.9, 1100.1, 97_500)),
        ("wind", (), (1.0,)),
    ],
)
def test_what_is_out_of_bounds_is_refused_by_name(
    made: Made, field: str, accepted: tuple[Any, ...], refused: tuple[Any, ...]
) -> None:
    for value in accepted:
        assert made.client.request("PUT", PATH, json={field: value}, headers=made.bearer).status_code == 200
    for value in refused:
        answer = made.client.request("PUT", PATH, json={field: value}, headers=made.bearer)
        assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, field)


def test_a_date_that_is_none_is_refused(made: Made) -> None:
    answer = made.client.request("PUT", "/v1/days/2013-05-32/air", json=WARM, headers=made.bearer)
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, "date")


def test_without_the_token_nothing_is_set(made: Made) -> None:
    assert made.client.request("PUT", PATH, json=WARM).status_code == 401
    assert made.client.get(PATH).json() == NONE


def test_air_of_a_camera_that_the_archive_does_not_know_is_refused(made: Made) -> None:
    path = "/v1/cameras/cellar/days/2013-05-12/air"
    assert made.client.request("PUT", path, json=WARM, headers=made.bearer).status_code == 404
    assert made.client.request("PUT", path.replace("cellar", "roof"), json=WARM, headers=made.bearer).is_success


def test_the_sun_of_that_day_is_refracted_by_it(made: Made) -> None:
    at = {"at": LOW_SUN.isoformat()}
    before = made.client.get("/v1/sun", params=at).json()
    made.client.request("PUT", PATH, json=WARM, headers=made.bearer)
    after = made.client.get("/v1/sun", params=at).json()
    expected = zenith_by_pvlib(made, **WARM)
    assert after["apparent_zenith"] == pytest.approx(expected, abs=1e-5)
    assert after["apparent_zenith"] - before["apparent_zenith"] > 0.002
    assert after["zenith"] == before["zenith"]
    track = made.client.get("/v1/sun/track", params={"date": "2013-05-12", "step_s": 600}).json()
    place = track["time"].index("2013-05-12T12:00:00Z")
    assert track["apparent_zenith"][place] == pytest.approx(expected, abs=1e-5)


def test_the_sun_of_another_day_is_not(made: Made) -> None:
    at = {"at": "2013-05-13T12:00:00Z"}
    before = made.client.get("/v1/sun", params=at).json()
    made.client.request("PUT", PATH, json=WARM, headers=made.bearer)
    assert made.client.get("/v1/sun", params=at).json() == before


def test_residuals_and_maps_are_of_the_measured_air(make: Make) -> None:
    made = make(history="small")
    asked = {"residuals": "true", "accepted": "true", "limit": "1000"}
    tag = made.client.get("/v1/back-projection-map", params={"sun_radius_deg": 5, "at": "2013-05-13T12:00:00Z"})
    before = made.client.get("/v1/sun-points", params=asked).json()["sun_points"][-1]["residual"]
    made.client.request("PUT", "/v1/days/2013-05-13/air", json=WARM, headers=made.bearer)
    after = made.client.get("/v1/sun-points", params=asked).json()["sun_points"][-1]["residual"]
    assert after["apparent_zenith"] > before["apparent_zenith"] + 0.002
    again = made.client.get("/v1/back-projection-map", params={"sun_radius_deg": 5, "at": "2013-05-13T12:00:00Z"})
    assert tag.headers["etag"] != again.headers["etag"]
