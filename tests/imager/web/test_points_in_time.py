"""A time for each point in /v1/geolocate: each is answered as if it had been asked alone."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest
from tests.fixtures.served import NOON

from sunarc.common.utc import rfc3339
from sunarc.imager.web import bulk as answering

if TYPE_CHECKING:
    import httpx
    from tests.fixtures.served import Made

    from sunarc.imager.web.context import ApiContext

POINTS = [[700.0, 760.0, 1500.0], [900.0, 500.0, 800.0], [640.0, 900.0, 3000.0], [0.0, 0.0, 900.0], [800.0, 700.0, 1e3]]
TIMES = [NOON, NOON - timedelta(days=3), NOON - timedelta(hours=12), NOON, NOON - timedelta(days=3, seconds=30)]
BODY = {"points": POINTS, "height_sigma_m": 50.0, "at": [rfc3339(time) for time in TIMES]}


def ask(made: Made, body: dict[str, Any], **query: str) -> httpx.Response:
    return made.client.post("/v1/geolocate", json=body, params=query)


def ask_rows(made: Made, times: list[float], *, dtype: str = "float64") -> httpx.Response:
    rows = np.array([[*point, 50.0, time] for point, time in zip(POINTS, times, strict=False)], dtype=dtype)
    stream = io.BytesIO()
    np.save(stream, rows.reshape(-1, 5))
    return made.client.post("/v1/geolocate", content=stream.getvalue(), headers={"content-type": "application/x-npy"})


def test_each_point_is_answered_as_if_it_were_asked_alone(made: Made) -> None:
    together = ask(made, BODY)
    assert together.status_code == 200, together.text
    found = together.json()
    for k, (point, time) in enumerate(zip(POINTS, TIMES, strict=True)):
        alone = ask(made, {"points": [point], "height_sigma_m": 50.0}, at=rfc3339(time)).json()
        each = found["each"]
        assert (each["calibration"][k], each["time"][k]) == (alone["calibration"], alone["time"])
        assert {name: values[k] for name, values in each["sun"].items()} == pytest.approx(alone["sun"], abs=1e-7)
        for place in ("cloud", "shadow"):
            for name, values in found[place].items():
                expected = alone[place][name][0]
                assert (values[k] is None) == (expected is None)
                assert expected is None or np.allclose(values[k], expected, rtol=1e-7, atol=1e-7), name
    assert found["each"]["calibration"] == ["second", "first", "second", "second", "first"]
    assert (found["calibration"], found["time"]) == ("second", "2013-05-13T18:30:00Z")
    assert found["shadow"]["latitude"][2] is None  # in the night
    assert together.headers["sunarc-calibration"] == "first, second"


def test_rows_with_times_answer_the_same(made: Made) -> None:
    answer = ask_rows(made, [time.timestamp() for time in TIMES])
    rows = np.load(io.BytesIO(answer.content))
    columns = dict(zip(answer.headers["sunarc-columns"].split(","), rows.T, strict=True))
    expected = ask(made, BODY).json()
    for column, values in (
        ("latitude", expected["cloud"]["latitude"]),
        ("shadow_sigma_m", expected["shadow"]["sigma_m"]),
    ):
        np.testing.assert_allclose(columns[column], np.array(values, dtype=float), rtol=1e-12)


def test_one_calibration_may_be_chosen_for_all_times(made: Made) -> None:
    assert set(ask(made, BODY, calibration="first").json()["each"]["calibration"]) == {"first"}


def test_no_points_at_no_times_are_answered(made: Made) -> None:
    answer = ask(made, {"points": [], "at": []})
    assert (answer.status_code, answer.json()["cloud"]["east_m"]) == (200, [])


@pytest.mark.parametrize(
    ("change", "query", "status", "field"),
    [
        ({"at": [rfc3339(NOON)]}, {}, 422, "at"),
        ({"at": ["yesterday"] * 5}, {}, 422, "at[0]"),
        ({"at": ["2013-05-13T18:30:00"] * 5}, {}, 422, "at[0]"),
        ({"at": rfc3339(NOON)}, {}, 422, "at"),
        ({"at": [*BODY["at"][:3], "1999-01-01T00:00:00Z", BODY["at"][4]]}, {}, 404, "at[3]"),  # type: ignore[index]
        ({}, {"at": rfc3339(NOON)}, 422, "at"),
        ({}, {"draws": "2"}, 422, "draws"),
        ({}, {"calibration": "another"}, 404, "calibration"),
    ],
)
def test_times_that_cannot_be_answered_for_are_refused_by_their_place(
    made: Made, change: dict[str, Any], query: dict[str, str], *, status: int, field: str
) -> None:
    answer = ask(made, BODY | change, **query)
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (status, field)
    assert answer.json()["errors"][0]["remedy"]


@pytest.mark.parametrize(
    ("time", "dtype", "field"), [(np.nan, "float64", "at[0]"), (1e12, "float64", "at[0]"), (0, "float32", "body")]
)
def test_rows_whose_times_are_none_are_refused(made: Made, *, time: float, dtype: str, field: str) -> None:
    answer = ask_rows(made, [time], dtype=dtype)
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, field)


def test_the_work_of_one_request_is_bounded(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    days = [rfc3339(NOON - timedelta(days=day)) for day in range(400)]
    answer = ask(made, {"pixels": [[800.0, 800.0]] * 400, "height_m": 900.0, "at": days})
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (413, "at")
    monkeypatch.setattr(answering, "_MOST_CALIBRATIONS", 1)
    assert ask(made, BODY).status_code == 413
    assert ask(made, BODY, calibration="first").status_code == 200


@dataclass(frozen=True)
class _Record:
    id: str
    document: dict[str, Any] = field(default_factory=dict)


class _Steps:
    """A context whose calibrations answer for one interval each, and that counts how often it is asked."""

    def __init__(self, ends: list[float]) -> None:
        self._ends, self._records, self.asked = ends, [_Record(str(k)) for k in range(len(ends) + 1)], 0

    def record_or_none(self, at: datetime) -> _Record:
        self.asked += 1
        return self._records[int(np.searchsorted(self._ends, at.timestamp(), side="right"))]


@pytest.mark.parametrize("seed", range(5))
def test_what_answers_is_found_without_asking_for_every_time(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.unique(rng.uniform(1e9, 1e9 + 1e6, 5000).round(3))
    context = _Steps(sorted(rng.uniform(1e9, 1e9 + 1e6, 5).tolist()))
    found = answering.records_at(cast("ApiContext", context), times, times)
    n_asked = context.asked
    expected = [context.record_or_none(datetime.fromtimestamp(time, UTC)) for time in times.tolist()]
    assert [record.id for record in found] == [record.id for record in expected]
    assert n_asked < 150
