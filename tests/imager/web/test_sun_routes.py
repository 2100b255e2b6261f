from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.common.findings import Finding
from sunarc.imager.runtime.status import ClockStatus
from sunarc.optics.forward import project
from sunarc.sky.days import solar_date
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.night import body_directions
from sunarc.sky.sun import sun_angles, sun_directions

if TYPE_CHECKING:
    from tests.fixtures.served import Made


def test_the_sun_is_where_the_almanac_has_it_and_on_the_lens_pixel(made: Made) -> None:
    told = made.client.get("/v1/sun").json()
    angles = sun_angles(made.noon.timestamp(), made.site)
    assert told["time"] == "2013-05-13T18:30:00Z"
    assert (told["apparent_zenith"], told["azimuth"]) == (float(angles.apparent_zenith), float(angles.azimuth))
    assert told["zenith"] > told["apparent_zenith"]
    expected = project(made.lens, sun_directions(made.noon.timestamp(), made.site))
    np.testing.assert_allclose(told["pixel"], expected, atol=1e-9)
    assert told["inside"] is True
    assert 0.04 < told["sigma_px"] < 0.06
    assert told["calibration"] == "second"


def test_the_sun_at_night_is_on_no_pixel(made: Made) -> None:
    told = made.client.get("/v1/sun", params={"at": "2013-05-13T06:30:00Z"}).json()
    assert told["apparent_zenith"] > 110.0
    assert (told["pixel"], told["sigma_px"], told["inside"]) == (None, None, False)


def test_without_a_calibration_the_sun_still_has_angles(empty: Made) -> None:
    told = empty.client.get("/v1/sun").json()
    assert 18.0 < told["apparent_zenith"] < 19.0
    assert (told["pixel"], told["calibration"]) == (None, None)
    track = empty.client.get("/v1/sun/track").json()
    assert set(track["pixels"]) == {None}


def test_the_track_is_one_solar_day_above_the_horizon(made: Made) -> None:
    told = made.client.get("/v1/sun/track", params={"step_s": 600}).json()
    assert told["date"] == "2013-05-13"
    assert max(told["apparent_zenith"]) <= 90.0
    times = [datetime.fromisoformat(time) for time in told["time"]]
    assert all((b - a).total_seconds() == 600 for a, b in pairwise(times))
    assert {solar_date(t.timestamp(), longitude=made.site.longitude).isoformat() for t in times} == {told["date"]}
    seconds = [t.timestamp() for t in times]
    np.testing.assert_allclose(told["pixels"], project(made.lens, sun_directions(seconds, made.site)), atol=1e-9)
    other = made.client.get("/v1/sun/track", params={"date": "2013-12-21", "step_s": 600}).json()
    assert len(other["time"]) < len(told["time"])
    assert made.client.get("/v1/sun/track", params={"at": "2013-12-21T18:00:00Z", "step_s": 600}).json()["date"] == (
        "2013-12-21"
    )


def test_sightings_are_the_newest_first_with_the_rejected_ones(made: Made) -> None:
    told = made.client.get("/v1/sun-points", params={"limit": 1000}).json()
    points = told["sun_points"]
    assert points[0]["time"] == "2013-05-13T18:30:00Z"
    assert [p["time"] for p in points] == sorted((p["time"] for p in points), reverse=True)
    hidden = [p for p in points if not p["accepted"]]
    assert len(hidden) == 12
    assert {(p["verdict"], p["findings"][0]["code"], p["x_px"]) for p in hidden} == {
        ("hidden", "disc_too_few_pixels", None)
    }
    assert {p["reason"] for p in hidden} == {Finding("disc_too_few_pixels").text}
    assert told["next"] is None
    assert all(p["residual"] is None for p in points)


def test_sightings_can_be_chosen_and_paged(made: Made) -> None:
    first = made.client.get("/v1/sun-points", params={"limit": 10, "accepted": True}).json()
    assert (len(first["sun_points"]), first["next"] is None) == (10, False)
    last = first["sun_points"][-1]["time"]
    following = made.client.get("/v1/sun-points", params={"until": last, "limit": 10, "accepted": True}).json()
    assert following["sun_points"][0]["time"] < last
    since = made.client.get("/v1/sun-points", params={"since": last, "accepted": True}).json()
    assert [p["time"] for p in since["sun_points"]] == [p["time"] for p in first["sun_points"]]


def test_residuals_are_sighting_minus_the_current_calibration(made: Made) -> None:
    told = made.client.get("/v1/sun-points", params={"residuals": True}).json()
    assert told["calibration"] == "second"
    for point in told["sun_points"]:
        residual = point["residual"]
        assert (residual is None) == (not point["accepted"])
        if residual is None:
            continue
        moment = datetime.fromisoformat(point["time"]).timestamp()
        x, y = project(made.lens, sun_directions(moment, made.site))
        assert residual["x_px"] == pytest.approx(point["x_px"] - x, abs=1e-6)
        assert residual["y_px"] == pytest.approx(point["y_px"] - y, abs=1e-6)
        assert residual["distance_px"] == pytest.approx(np.hypot(residual["x_px"], residual["y_px"]))
        assert 7.0 < residual["distance_px"] / residual["distance_deg"] < 15.5  # px per degree, the lens's range
    newest = next(point for point in told["sun_points"] if point["accepted"])
    expected = made.client.get("/v1/sun", params={"at": newest["time"], "calibration": "second"}).json()
    sigma_px, clock_px = (
        math.hypot(newest["sigma_px"], expected["sigma_px"]),
        newest["clock_error_s"] * speed_px_s(made),
    )
    assert newest["residual"]["sigma_px"] == pytest.approx(math.hypot(sigma_px, clock_px), 1e-5)
    assert newest["residual"]["sigma_px"] > newest["sigma_px"]


def speed_px_s(made: Made) -> float:
    """Return the speed of the sun's image at noon, px/s, from its places 8 s before and after."""
    around = made.noon.timestamp() + np.array([-8.0, 8.0])
    return float(np.hypot(*np.diff(project(made.lens, sun_directions(around, made.site)), axis=0)[0]) / 16.0)


def test_a_clock_that_may_be_wrong_by_16_s_widens_the_pixel_that_is_expected_now(made: Made) -> None:
    exact = made.client.get("/v1/sun", params={"at": made.noon.isoformat()}).json()
    made.board.note(clock=ClockStatus(synchronised=False, max_error_s=16.0))
    now = made.client.get("/v1/sun").json()
    assert now["pixel"] == exact["pixel"]
    assert now["sigma_px"] == pytest.approx(math.hypot(exact["sigma_px"], 16.0 * speed_px_s(made)), rel=0.005)
    assert 0.5 < now["sigma_px"] < 5.0
    at = made.client.get("/v1/sun", params={"at": made.noon.isoformat()}).json()
    assert at["sigma_px"] == exact["sigma_px"]  # whoever gives a time has a clock of his own


def test_a_sighting_of_a_doubtful_clock_has_a_residual_of_that_doubt(made: Made) -> None:
    newest = next(one for one in made.archive.sightings.find("roof", newest_first=True) if one.accepted)
    made.archive.sightings.replace([replace(newest, clock_error_s=16.0)])
    told = made.client.get("/v1/sun-points", params={"residuals": True, "accepted": True, "limit": 1}).json()
    assert told["sun_points"][0]["residual"]["sigma_px"] == pytest.approx(16.0 * speed_px_s(made), rel=0.01)


def test_stars_are_listed_by_name_with_residuals_of_their_own_directions(made: Made) -> None:
    moment = datetime(2013, 5, 13, 9, 0, tzinfo=UTC)
    names = np.array(["star:HIP91262", "star:HIP69673"])
    direction = body_directions(names, np.full(2, moment.timestamp()), made.site)
    pixels = project(made.lens, direction) + np.array([[0.25, -0.5], [1.0, 0.0]])
    point = next(point for point in made.archive.sightings.find("roof") if point.accepted)
    made.archive.sightings.add(
        replace(point, time=moment, method="star", body=name, x_px=x, y_px=y)
        for name, (x, y) in zip(names.tolist(), pixels.tolist(), strict=True)
    )
    number = len(made.client.get("/v1/sun-points").json()["sun_points"])
    everything = made.client.get("/v1/sun-points", params={"body": "all"}).json()["sun_points"]
    assert len(everything) == number + 2
    told = made.client.get("/v1/sun-points", params={"body": "star:HIP91262", "residuals": True}).json()
    (star,) = told["sun_points"]
    assert star["body"] == "star:HIP91262"
    assert (star["residual"]["x_px"], star["residual"]["y_px"]) == pytest.approx((0.25, -0.5), abs=1e-6)
    assert star["residual"]["azimuth"] == pytest.approx(angles_from_direction(direction)[1][0])


def test_residuals_without_a_calibration_are_absent(empty: Made) -> None:
    told = empty.client.get("/v1/sun-points", params={"residuals": True}).json()
    assert told == {"sun_points": [], "next": None, "calibration": None}


@pytest.mark.parametrize(
    ("path", "params", "field"),
    [
        ("/v1/sun", {"at": "yesterday"}, "at"),
        ("/v1/sun", {"at": "2013-05-13T18:30:00"}, "at"),
        ("/v1/sun", {"at": "1368469800"}, "at"),
        ("/v1/sun", {"at": "9999-12-31T23:59:59-23:00"}, "at"),
        ("/v1/sun", {"at": "0001-01-01T00:00:00+14:00"}, "at"),
        ("/v1/sun/track", {"date": "2013-02-30"}, "date"),
        ("/v1/sun/track", {"date": "0001-01-01"}, "date"),
        ("/v1/sun/track", {"step_s": "0"}, "step_s"),
        ("/v1/sun-points", {"limit": "0"}, "limit"),
        ("/v1/sun-points", {"limit": "1000000"}, "limit"),
        ("/v1/sun-points", {"accepted": "perhaps"}, "accepted"),
        ("/v1/sun-points", {"body": "pluto"}, "body"),
        ("/v1/sun-points", {"body": "star:HIP"}, "body"),
        ("/v1/days", {"since": "2013"}, "since"),
        ("/v1/days", {"until": "0"}, "until"),
        ("/v1/events", {"severity": "loud"}, "severity"),
        ("/v1/calibrations", {"state": "good"}, "state"),
    ],
)
def test_a_parameter_that_cannot_be_used_is_named(made: Made, path: str, params: dict[str, str], field: str) -> None:
    answer = made.client.get(path, params=params)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert [error["field"] for error in answer.json()["errors"]] == [field]


def test_looks_at_the_sun_are_counted_by_day_and_verdict(made: Made) -> None:
    points = made.archive.sightings.find("roof")
    night = datetime(2013, 5, 13, 6, 29, 45, tzinfo=UTC)  # before the solar midnight at 97.5 degrees west
    at_night = [
        replace(points[0], time=night + timedelta(seconds=s), accepted=False, clock_error_s=0.5) for s in (0, 60)
    ]
    made.archive.sightings.add(at_night)
    (today, yesterday) = made.client.get("/v1/sun-points/days").json()["days"]
    clear, hidden = (sum(point.verdict == verdict for point in points) for verdict in ("clear", "hidden"))
    assert (hidden, clear) > (5, 50)
    assert today == {
        "date": "2013-05-13",
        "verdicts": {"clear": clear + 1, "hidden": hidden},
        "accepted": clear,
        "clock_error_s": 0.5,
    }
    assert (yesterday["date"], yesterday["verdicts"], yesterday["accepted"]) == ("2013-05-12", {"clear": 1}, 0)
    older = made.client.get("/v1/sun-points/days", params={"until": "2013-05-13"}).json()["days"]
    assert older == [yesterday]
    far = {"since": "1995-10-31", "until": "2014-05-14"}  # 366 days before its end is after yesterday
    assert made.client.get("/v1/sun-points/days", params=far).json()["days"] == [today]


@pytest.mark.parametrize("query", [{"since": "2013-02-30"}, {"until": "soon"}, {"limit": "5"}])
def test_counts_by_day_of_no_day_are_refused(made: Made, query: dict[str, str]) -> None:
    answer = made.client.get("/v1/sun-points/days", params=query)
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, next(iter(query)))
