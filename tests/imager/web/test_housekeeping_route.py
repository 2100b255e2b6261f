"""Disk space and temperature over HTTP."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.fixtures.served import Made

PATH = "/v1/housekeeping"


def test_hours_and_days_are_told_the_newest_first(made: Made) -> None:
    hours = made.client.get(PATH).json()
    assert hours["step"] == "hour"
    assert [one["time"] for one in hours["rows"]] == [f"2013-05-13T{hour}:00:00Z" for hour in (18, 17, 16)]
    assert [one["disk_free_bytes"] for one in hours["rows"]] == [8 * 10**9, 9 * 10**9, 10**10]
    assert [one["temperature_c"] for one in hours["rows"]] == [None, 43.0, 40.0]
    (day,) = made.client.get(PATH, params={"step": "day"}).json()["rows"]
    assert (day["time"], day["temperature_c"], day["n_temperatures"]) == ("2013-05-13T00:00:00Z", 41.5, 2)
    assert (day["temperature_min_c"], day["temperature_max_c"], day["disk_free_bytes"]) == (40.0, 43.0, 8 * 10**9)


def test_a_span_is_half_open_and_another_camera_has_its_own(made: Made) -> None:
    span = {"since": "2013-05-13T17:00:00Z", "until": "2013-05-13T18:00:00Z"}
    assert [one["temperature_c"] for one in made.client.get(PATH, params=span).json()["rows"]] == [43.0]
    assert made.client.get("/v1/cameras/roof/housekeeping", params=span).json()["rows"] != []
    assert made.client.get("/v1/cameras/nobody/housekeeping").status_code == 404


@pytest.mark.parametrize("query", [{"step": "minute"}, {"since": "yesterday"}, {"steps": "day"}])
def test_what_is_not_known_is_refused_with_its_name(made: Made, query: dict[str, str]) -> None:
    answer = made.client.get(PATH, params=query)
    assert answer.status_code == 422
    assert next(iter(query)) in answer.json()["errors"][0]["field"]
