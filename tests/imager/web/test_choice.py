"""Which calibration answers: the one of the time, one by its id, or the best of the pose epoch."""

from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING, Any

import pytest
from tests.fixtures.served import document
from tests.imager.web.test_cameras import OTHER

if TYPE_CHECKING:
    from tests.fixtures.served import Made

ASKED: list[tuple[str, str, dict[str, Any] | None]] = [
    ("GET", "/v1/calibration", None),
    ("GET", "/v1/sun", None),
    ("GET", "/v1/sun/track", None),
    ("GET", "/v1/overlay", None),
    ("GET", "/v1/uncertainty", None),
    ("POST", "/v1/back-project", {"pixels": [[700.0, 760.0]]}),
    ("POST", "/v1/project", {"zenith_deg": [30.0], "azimuth_deg": [10.0]}),
    ("POST", "/v1/geolocate", {"pixels": [[700.0, 760.0]], "height_m": 1000.0}),
]


def answering(made: Made, method: str, path: str, body: dict[str, Any] | None, **query: str) -> str:
    answer = made.client.request(method, path, json=body, params=query)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return str(found["id"] if path == "/v1/calibration" else found["calibration"])


@pytest.mark.parametrize(("method", "path", "body"), ASKED)
def test_a_calibration_answers_by_its_id_whatever_the_time(
    made: Made, method: str, path: str, body: dict[str, Any] | None
) -> None:
    assert answering(made, method, path, body) == "second"
    assert answering(made, method, path, body, calibration="first") == "first"
    assert answering(made, method, path, body, calibration="second", **_earlier(path)) == "second"


def _earlier(path: str) -> dict[str, str]:
    return {"date": "2013-05-13"} if path == "/v1/sun/track" else {"at": "2013-05-13T12:00:00Z"}


def test_the_sun_s_time_and_the_calibration_are_chosen_apart(made: Made) -> None:
    query = {"at": "2013-05-13T16:00:00Z", "calibration": "second"}
    chosen, now = (made.client.get("/v1/sun", params=one).json() for one in (query, {}))
    assert chosen["time"] == "2013-05-13T16:00:00Z"
    assert chosen["calibration"] == now["calibration"] == "second"
    assert chosen["apparent_zenith"] != now["apparent_zenith"]


def test_the_best_one_of_the_pose_epoch_has_the_least_uncertainty_over_the_sky(made: Made) -> None:
    records = [one for one in made.archive.calibrations.find(made.archive.cameras.all()[0].name) if one.accepted]
    epoch = next(one.pose_epoch for one in records if one.id == "second")
    rivals = [one for one in records if one.pose_epoch == epoch]
    least = min(rivals, key=lambda one: one.document["uncertainty"]["sky_rms_deg"])
    for method, path, body in ASKED:
        best = answering(made, method, path, body, calibration="best")
        found = next(one for one in rivals if one.id == best)
        assert found.document["uncertainty"]["sky_rms_deg"] == least.document["uncertainty"]["sky_rms_deg"], path


@pytest.mark.parametrize(("chosen", "status"), [("nothing", 404), ("refused", 404), ("x" * 101, 422), ("", 404)])
def test_what_cannot_answer_is_refused(made: Made, chosen: str, status: int) -> None:
    refused = [one.id for one in made.archive.calibrations.find(made.archive.cameras.all()[0].name) if not one.accepted]
    query = {"calibration": refused[0] if chosen == "refused" else chosen}
    for method, path, body in [*ASKED, ("GET", "/v1/back-projection-map", None)]:
        answer = made.client.request(method, path, json=body, params=query)
        assert answer.status_code == status, path
        assert answer.json()["errors"][0]["field"] == "calibration"


def test_routes_without_a_calibration_have_no_such_choice(made: Made) -> None:
    answer = made.client.get("/v1/events", params={"calibration": "best"})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "calibration"


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        *ASKED,
        ("GET", "/v1/remap?size=16", None),
        ("GET", "/v1/masks/sun", None),
        ("GET", "/v1/masks/horizon", None),
        ("GET", "/v1/back-projection-map", None),
        ("GET", "/v1/difference?other=first", None),
    ],
)
def test_a_calibration_of_another_camera_answers_for_none_but_its_own(
    made: Made, method: str, path: str, body: dict[str, Any] | None
) -> None:
    made.archive.cameras.save(OTHER)
    of_mast = path.replace("/v1/", "/v1/cameras/mast/") + ("&" if "?" in path else "?") + "calibration=second"
    answer = made.client.request(method, of_mast, json=body)
    assert answer.status_code == 404
    (fault,) = answer.json()["errors"]
    assert fault["field"] == "calibration"
    assert "/v1/cameras" in fault["remedy"]


def test_calibrations_of_two_cameras_are_not_compared(made: Made) -> None:
    made.archive.cameras.save(OTHER)
    made.archive.epochs.open("mast", at=made.noon - timedelta(days=30), reason="installed")
    made.archive.calibrations.add(document("of_mast") | {"camera": "mast", "pose_epoch": "mast-1"})
    answer = made.client.get("/v1/difference", params={"other": "of_mast"})
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (404, "other")
