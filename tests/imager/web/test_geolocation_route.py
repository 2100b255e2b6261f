from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from tests.fixtures.served import Made


def ask(made: Made, body: dict[str, Any], **how: Any) -> dict[str, Any]:  # noqa: ANN401 - of httpx
    answer = made.client.post("/v1/geolocate", json=body, **how)
    assert answer.status_code == 200, answer.text
    told: dict[str, Any] = answer.json()
    return told


def test_one_height_for_all_and_one_for_each_say_the_same(made: Made) -> None:
    pixels = [[700.0, 760.0], [900.0, 500.0]]
    together = ask(made, {"pixels": pixels, "height_m": 1500.0})
    apart = ask(made, {"points": [[*pixel, 1500.0] for pixel in pixels]})
    assert together == apart
    assert (together["calibration"], together["time"]) == ("second", "2013-05-13T18:30:00Z")
    assert together["cloud"]["altitude"] == pytest.approx([1818.0, 1818.0], abs=1e-3)
    assert together["shadow"]["altitude"] == pytest.approx([318.0, 318.0], abs=1e-3)
    assert all(0.0 < sigma < 10.0 for sigma in together["cloud"]["sigma_m"])
    rows = io.BytesIO()
    np.save(rows, np.array([[*pixel, 1500.0] for pixel in pixels], dtype=np.float32))
    headers = {"content-type": "application/x-npy"}
    answer = made.client.post("/v1/geolocate", content=rows.getvalue(), headers=headers)
    told = np.load(io.BytesIO(answer.content))
    columns = dict(zip(answer.headers["sunarc-columns"].split(","), told.T, strict=True))
    assert told.dtype == np.float64
    np.testing.assert_allclose(columns["shadow_latitude"], together["shadow"]["latitude"], atol=1e-9)
    np.testing.assert_allclose(columns["cov_en_m2"], [row[0][1] for row in together["cloud"]["covariance_m2"]])


def test_where_there_is_no_place_there_is_null(made: Made) -> None:
    told = ask(made, {"points": [[0.0, 0.0, 1500.0], [800.0, 800.0, 1500.0]]})
    for name, values in told["cloud"].items():
        assert [value is None for value in values] == [True, False], name


@pytest.mark.parametrize("height_m", [-5.0, 0.0, 30_001.0])
def test_a_height_that_is_none_is_refused_wherever_it_stands_and_has_no_place_in_an_array(
    made: Made, height_m: float
) -> None:
    good, bad = [800.0, 800.0, 1500.0], [800.0, 800.0, height_m]
    for body, field in (
        ({"pixels": [bad[:2]], "height_m": height_m}, "height_m"),
        ({"points": [good, bad]}, "points[1][2]"),
    ):
        answer = made.client.post("/v1/geolocate", json=body)
        assert (answer.status_code, [error["field"] for error in answer.json()["errors"]]) == (422, [field])
    answer = made.client.get("/v1/remap", params={"grid": "ground", "size": 16, "height": height_m})
    assert (answer.status_code, [error["field"] for error in answer.json()["errors"]]) == (422, ["height"])
    for query in ("", "?draws=2"):
        rows = io.BytesIO()
        np.save(rows, np.array([good, bad, [800.0, 800.0, np.nan]]))
        headers = {"content-type": "application/x-npy"}
        answer = made.client.post(f"/v1/geolocate{query}", content=rows.getvalue(), headers=headers)
        found = np.atleast_3d(np.load(io.BytesIO(answer.content))).reshape(
            -1, 3, len(answer.headers["sunarc-columns"].split(","))
        )
        assert np.all(np.isfinite(found[:, 0]))
        assert np.all(np.isnan(found[:, 1:]))


def test_at_night_there_are_clouds_and_no_shadows(made: Made) -> None:
    told = ask(made, {"pixels": [[800.0, 800.0]], "height_m": 1500.0}, params={"at": "2013-05-13T06:30:00Z"})
    assert told["sun"]["apparent_zenith"] > 90.0
    assert told["cloud"]["east_m"][0] is not None
    assert told["shadow"]["latitude"] == [None]
    assert told["shadow"]["covariance_m2"] == [None]


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"pixels": [[1.0, 2.0]]},
        {"height_m": 100.0},
        {"pixels": [[1.0, 2.0]], "height_m": 0.0},
        {"pixels": [[1.0, 2.0]], "height_m": -10.0},
        {"pixels": [[1.0, 2.0]], "height_m": "low"},
        {"points": [[1.0, 2.0]]},
        {"points": [[1.0, 2.0, 3.0]], "height_m": 100.0},
    ],
)
def test_what_names_no_place_is_refused(made: Made, body: dict[str, Any]) -> None:
    answer = made.client.post("/v1/geolocate", json=body)
    assert answer.status_code == 422
    assert answer.json()["errors"]
