"""An answer for another time than now says when it was decided."""

from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING

import pytest
from tests.fixtures.served import NOON, document

from sunarc.common.utc import rfc3339

if TYPE_CHECKING:
    from tests.fixtures.served import Made

BY_FIRST = rfc3339(NOON - timedelta(days=5))
FIRST_MADE = rfc3339(NOON - timedelta(days=9) + timedelta(hours=8))
HEADER = "sunarc-decided-at"


@pytest.mark.parametrize(
    "path", ["calibration", "sun", "overlay", "uncertainty", "masks/sun", "sun/track?date=2013-05-08"]
)
def test_an_answer_for_a_past_time_names_when_its_calibration_was_made(made: Made, path: str) -> None:
    answer = made.client.get(f"/v1/{path}{'&' if '?' in path else '?'}at={BY_FIRST}")
    assert (answer.status_code, answer.headers.get(HEADER)) == (200, FIRST_MADE)
    camera = made.client.get(f"/v1/cameras/roof/{path}{'&' if '?' in path else '?'}at={BY_FIRST}")
    assert camera.headers[HEADER] == FIRST_MADE


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("back-project", {"pixels": [[871.0, 883.0]]}),
        ("project", {"direction_enu": [[0.0, 0.0, 1.0]]}),
        ("geolocate", {"pixels": [[871.0, 883.0]], "height_m": 1500.0}),
    ],
)
def test_points_for_a_past_time_name_it_too(made: Made, path: str, body: dict[str, object]) -> None:
    assert made.client.post(f"/v1/{path}?at={BY_FIRST}", json=body).headers[HEADER] == FIRST_MADE


def test_a_chosen_calibration_is_the_one_that_decides(made: Made) -> None:
    answer = made.client.get(f"/v1/sun?at={BY_FIRST}&calibration=second")
    assert answer.headers[HEADER] == rfc3339(NOON - timedelta(days=1) + timedelta(hours=8))


def test_what_is_asked_for_now_or_has_no_answer_has_no_such_time(made: Made, empty: Made) -> None:
    assert HEADER not in made.client.get("/v1/calibration").headers
    assert HEADER not in made.client.get("/v1/calibration?at=1999-01-01T00:00:00Z").headers
    assert HEADER not in empty.client.get(f"/v1/sun?at={BY_FIRST}").headers


def test_a_candidate_that_an_operator_activated_later_was_decided_then(made: Made) -> None:
    made.archive.calibrations.add(document("later", valid_from=NOON - timedelta(days=3)))
    decided = NOON + timedelta(hours=2)
    made.archive.calibrations.reinstate("later", at=NOON - timedelta(days=6), decided_at=decided, reason="surveyed")
    answer = made.client.get(f"/v1/sun?at={BY_FIRST}")
    assert (answer.json()["calibration"], answer.headers[HEADER]) == ("later", rfc3339(decided))
