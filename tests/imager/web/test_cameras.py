from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from sunarc.imager.archive.values import CameraRecord

if TYPE_CHECKING:
    from tests.fixtures.served import Made

OTHER = CameraRecord(name="mast", latitude=-33.0, longitude=151.0, altitude=20.0, width=640, height=480)


def test_the_archives_cameras_are_told(made: Made) -> None:
    made.archive.cameras.save(OTHER)
    told = made.client.get("/v1/cameras").json()
    assert told["default"] == "roof"
    assert [(one["name"], one["width"], one["latitude"]) for one in told["cameras"]] == [
        ("mast", 640, -33.0),
        ("roof", 1748, 36.604043),
    ]


@pytest.mark.parametrize(
    "path",
    ["/calibration", "/calibrations", "/calibrations/first", "/sun", "/sun/track", "/sun-points?limit=9999", "/days"],
)
def test_a_route_answers_the_same_under_its_cameras_name(made: Made, path: str) -> None:
    named, plain = made.client.get(f"/v1/cameras/roof{path}"), made.client.get(f"/v1{path}")
    assert (named.status_code, named.json()) == (200, plain.json())


def test_every_route_of_a_camera_also_stands_under_its_name(made: Made) -> None:
    paths = {path for path in made.client.get("/openapi.json").json()["paths"] if path.startswith("/v1/")}
    for path in paths - {"/v1/status", "/v1/cameras"}:
        plain, named = (
            made.client.request("DELETE", path.replace("/v1", prefix)) for prefix in ("/v1", "/v1/cameras/roof")
        )
        assert plain.status_code == named.status_code == 405, path
        assert plain.headers["allow"] == named.headers["allow"], path
    assert made.client.get("/v1/cameras/roof/status").status_code == 404


def test_another_camera_has_its_own_sky_and_none_of_this_ones_record(made: Made) -> None:
    made.archive.cameras.save(OTHER)
    noon = {"at": "2013-05-13T02:00:00Z"}
    sun = made.client.get("/v1/cameras/mast/sun", params=noon).json()
    assert sun["apparent_zenith"] < 55.0
    assert sun["azimuth"] > 350.0  # north, at noon in the south
    assert sun["calibration"] is None
    assert made.client.get("/v1/cameras/mast/days").json() == {"days": [], "next": None}
    for path in ("calibration", "image/latest", "calibrations/first"):
        assert made.client.get(f"/v1/cameras/mast/{path}").status_code == 404, path


def test_a_camera_that_another_service_drives_is_not_solved_here(made: Made) -> None:
    made.archive.cameras.save(OTHER)
    answer = made.client.post("/v1/cameras/mast/refits", headers=made.bearer)
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, "camera")
    asked = made.client.post("/v1/cameras/roof/refits", headers=made.bearer)
    assert asked.status_code == 202
    assert made.client.get(f"/v1/cameras/mast/refits/{asked.json()['id']}").status_code == 404


def test_a_camera_that_is_not_known_is_not_found(made: Made) -> None:
    answer = made.client.get("/v1/cameras/none/sun")
    assert answer.status_code == 404
    assert answer.json()["errors"][0] == {
        "field": "camera",
        "problem": "there is no camera none",
        "remedy": "see /v1/cameras",
    }
