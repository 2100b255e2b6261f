from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from sunarc.client import CameraModel
from sunarc.formats.calibration_document import from_document

if TYPE_CHECKING:
    from tests.fixtures.served import Made


def test_the_current_calibration_is_the_archives_document(made: Made) -> None:
    answer = made.client.get("/v1/calibration")
    record = made.archive.calibrations.current("roof")
    assert record is not None
    assert answer.status_code == 200
    assert answer.json() == record.document
    assert (answer.json()["id"], answer.json()["state"]) == ("second", "current")
    assert from_document(answer.json()).camera == from_document(record.document).camera


def test_the_camera_alone_projects_as_the_whole_document(made: Made) -> None:
    whole, camera = made.client.get("/v1/calibration"), made.client.get("/v1/calibration?detail=camera")
    assert (camera.status_code, camera.json()["schema"]) == (200, "sunarc.camera/1")
    assert len(camera.content) < 8000
    assert whole.headers["etag"] != camera.headers["etag"]
    again = made.client.get("/v1/calibration?detail=camera", headers={"if-none-match": camera.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert made.client.get("/v1/calibration?detail=whole").content == whole.content
    directions = np.array([[0.0, 0.0, 1.0], [0.6, 0.2, 0.5], [-0.3, 0.9, 0.1], [0.0, 0.0, -1.0]])
    found, expected = (CameraModel(one.json()).project(directions) for one in (camera, whole))
    np.testing.assert_array_equal(found.pixels, expected.pixels)
    np.testing.assert_array_equal(found.inside, expected.inside)


def test_an_unchanged_calibration_is_not_sent_again(made: Made) -> None:
    tag = made.client.get("/v1/calibration").headers["etag"]
    for known in (tag, f"W/{tag}", f'"other", {tag}', "*"):
        again = made.client.get("/v1/calibration", headers={"if-none-match": known})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert made.client.get("/v1/calibration", headers={"if-none-match": '"other"'}).status_code == 200


def test_the_tag_changes_with_the_calibration_and_with_its_state(made: Made) -> None:
    tag = made.client.get("/v1/calibrations/second").headers["etag"]
    assert made.client.get("/v1/calibration").headers["etag"] == tag
    made.archive.calibrations.retire("second", at=made.noon + timedelta(days=1))
    assert made.client.get("/v1/calibrations/second").headers["etag"] != tag


def test_at_tells_the_calibration_of_that_time(made: Made) -> None:
    before = made.client.get("/v1/calibration", params={"at": "2013-05-10T00:00:00Z"}).json()
    assert (before["id"], before["state"], before["valid_until"]) == ("first", "retired", "2013-05-12T18:30:00Z")
    same = made.client.get("/v1/calibration", params={"at": "2013-05-09T19:00:00-05:00"}).json()
    assert same["id"] == "first"
    assert made.client.get("/v1/calibration", params={"at": "1999-01-01T00:00:00Z"}).status_code == 404


def test_the_history_is_the_newest_first_with_reasons(made: Made) -> None:
    told = made.client.get("/v1/calibrations").json()["calibrations"]
    assert [(one["id"], one["state"]) for one in told] == [
        ("second", "current"),
        ("refused", "refused"),
        ("first", "retired"),
    ]
    assert [found["code"] for found in told[1]["findings"]] == ["cross_validation_rmse"]
    assert len(told[1]["reasons"]) == 1
    assert (told[0]["rmse_px"], told[0]["sky_rms_deg"], told[0]["parent"]) == (0.041, 0.006, "first")
    refused = made.client.get("/v1/calibrations", params={"state": "refused", "limit": 5}).json()["calibrations"]
    assert [one["id"] for one in refused] == ["refused"]


def test_any_calibration_is_found_by_its_id(made: Made) -> None:
    assert made.client.get("/v1/calibrations/refused").json()["verdict"]["accepted"] is False


def test_an_unknown_calibration_is_not_found(empty: Made) -> None:
    assert empty.client.get("/v1/calibrations/nothing").status_code == 404


@pytest.mark.parametrize(
    ("status", "path", "body"),
    [
        (404, "/v1/calibration", None),
        (404, "/v1/masks/sun", None),
        (404, "/v1/masks/horizon", None),
        (404, "/v1/masks/obstructions", None),
        (404, "/v1/horizon", None),
        (503, "/v1/back-project", {"pixels": [[871.0, 883.0]]}),
        (503, "/v1/project", {"zenith_deg": [30.0], "azimuth_deg": [200.0]}),
        (503, "/v1/geolocate", {"pixels": [[871.0, 883.0]], "height_m": 1500.0}),
        (503, "/v1/back-project?at=2013-05-13T18:30:00Z", {"pixels": [[871.0, 883.0]]}),
        (503, "/v1/back-projection-map", None),
        (503, "/v1/images/2013-05-13T18:30:00Z/rectified", None),
        (503, "/v1/remap?grid=sky&size=64", None),
    ],
)
def test_before_the_first_calibration_every_route_says_so_and_when_to_ask_again(
    empty: Made, status: int, path: str, body: dict[str, Any] | None
) -> None:
    answer = empty.client.get(path) if body is None else empty.client.post(path, json=body)
    assert answer.status_code == status
    assert answer.json()["type"] == "urn:sunarc:problem:no_calibration"
    assert 1 <= int(answer.headers["retry-after"]) <= 600
