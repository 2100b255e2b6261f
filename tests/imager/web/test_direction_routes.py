from __future__ import annotations

import io
import math
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import httpx
import numpy as np
import pytest

from sunarc.calibration.answers.covariance import project_with_covariance, sigma_px, unproject_with_sigma
from sunarc.formats.calibration_document import from_document
from sunarc.sky.directions import angles_from_direction, angular_distance, direction_from_angles

if TYPE_CHECKING:
    from tests.fixtures.served import Made

HERE = {"zenith_deg": [30.0], "azimuth_deg": [200.0]}


def ask(made: Made, path: str, body: dict[str, Any], **how: Any) -> dict[str, Any]:  # noqa: ANN401 - of httpx
    answer = made.client.post(path, json=body, **how)
    assert answer.status_code == 200, answer.text
    told: dict[str, Any] = answer.json()
    return told


def test_a_direction_comes_back_through_its_pixel_to_1e_9_degrees(made: Made) -> None:
    rng = np.random.default_rng(3)
    zenith, azimuth = rng.uniform(0.0, 89.0, 500), rng.uniform(0.0, 360.0, 500)
    there = ask(made, "/v1/project", {"zenith_deg": zenith.tolist(), "azimuth_deg": azimuth.tolist()})
    back = ask(made, "/v1/back-project", {"pixels": there["pixels"]})
    wanted = direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth)
    by_angles = direction_from_angles(zenith_deg=back["zenith_deg"], azimuth_deg=back["azimuth_deg"])
    assert np.degrees(angular_distance(wanted, by_angles)).max() < 1e-9
    assert np.degrees(angular_distance(wanted, back["direction_enu"])).max() < 1e-9


def test_answers_are_the_calibrations_own(made: Made) -> None:
    calibration = from_document(made.client.get("/v1/calibration").json())
    pixels = [[871.96, 883.0], [400.0, 912.5], [1500.25, 300.0]]
    direction, sigma, inside = unproject_with_sigma(calibration, pixels)
    zenith, azimuth = angles_from_direction(direction)
    told = ask(made, "/v1/back-project", {"pixels": pixels})
    assert (told["calibration"], told["inside"]) == ("second", inside.tolist())
    np.testing.assert_allclose(told["zenith_deg"], zenith, atol=1e-8)
    np.testing.assert_allclose(told["azimuth_deg"], azimuth, atol=1e-8)
    np.testing.assert_allclose(told["direction_enu"], direction, atol=1e-10)
    np.testing.assert_allclose(told["sigma_deg"], sigma, rtol=1e-4)
    landed, covariance = project_with_covariance(calibration, direction)
    told = ask(made, "/v1/project", {"zenith_deg": zenith.tolist(), "azimuth_deg": azimuth.tolist()})
    assert (told["calibration"], told["inside"]) == ("second", [True, True, True])
    np.testing.assert_allclose(told["pixels"], landed, atol=1e-9)
    np.testing.assert_allclose(told["sigma_px"], sigma_px(covariance), rtol=1e-4)
    np.testing.assert_allclose(told["covariance_px2"], covariance, atol=1e-6)


def test_outside_the_field_there_is_no_number(made: Made) -> None:
    told = ask(made, "/v1/back-project", {"pixels": [[0.0, 0.0], [871.0, 883.0], [-1e300, 1e300]]})
    assert told["inside"] == [False, True, False]
    for name in ("zenith_deg", "azimuth_deg", "direction_enu", "sigma_deg"):
        assert [value is None for value in told[name]] == [True, False, True]
    told = ask(made, "/v1/project", {"zenith_deg": [170.0, 20.0], "azimuth_deg": [0.0, 0.0]})
    assert told["inside"] == [False, True]
    for name in ("pixels", "sigma_px", "covariance_px2"):
        assert [value is None for value in told[name]] == [True, False]


def test_a_vector_of_any_length_is_a_direction(made: Made) -> None:
    unit = ask(made, "/v1/project", {"direction_enu": [[0.0, 0.6, 0.8]]})["pixels"][0]
    for length in (1e-300, 1e-9, 5.0, 1e300):
        scaled = ask(made, "/v1/project", {"direction_enu": [[0.0, 0.6 * length, 0.8 * length]]})["pixels"][0]
        assert math.dist(unit, scaled) < 1e-9


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/v1/back-project", {"pixels": []}),
        ("/v1/project", {"zenith_deg": [], "azimuth_deg": []}),
        ("/v1/project", {"direction_enu": []}),
    ],
)
def test_asking_for_nothing_is_answered_with_nothing(made: Made, path: str, body: dict[str, Any]) -> None:
    assert ask(made, path, body)["inside"] == []


def test_at_asks_the_calibration_of_that_time(made: Made) -> None:
    told = ask(made, "/v1/project", HERE, params={"at": "2013-05-10T00:00:00Z"})
    assert told["calibration"] == "first"


def test_without_a_calibration_there_is_no_answer(empty: Made) -> None:
    answer = empty.client.post("/v1/project", json=HERE)
    assert answer.status_code == 503
    assert "wait for a clear day" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ('{"pixels": [[NaN, 1]]}', "pixels[0][0]"),
        ('{"pixels": [[1, 1], [2, Infinity]]}', "pixels[1][1]"),
        ('{"pixels": [[1e999, 1]]}', "pixels[0][0]"),
        ('{"pixels": [["1", 2]]}', "pixels[0][0]"),
        ('{"pixels": [[true, 2]]}', "pixels[0][0]"),
        ('{"pixels": [[1, 2, 3]]}', "pixels[0]"),
        ('{"pixels": [[1]]}', "pixels[0]"),
        ('{"pixels": [1, 2]}', "pixels[0]"),
        ('{"pixels": 7}', "pixels"),
        ('{"pixel": [[1, 2]]}', "pixels"),
        ('{"pixels": [[1, 2]], "at": "now"}', "at"),
        ("[[1, 2]]", "body"),
        ('{"pixels": [[1, 2', "body"),
        ("", "body"),
    ],
)
def test_pixels_that_are_none_are_refused_by_name(made: Made, body: str, field: str) -> None:
    answer = made.client.post("/v1/back-project", content=body, headers={"content-type": "application/json"})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == field


@pytest.mark.parametrize(
    "body",
    [
        {"zenith_deg": [1.0]},
        {"zenith_deg": [1.0, 2.0], "azimuth_deg": [1.0]},
        {"zenith_deg": [1.0], "azimuth_deg": [1.0], "direction_enu": [[0.0, 0.0, 1.0]]},
        {"direction_enu": [[0.0, 0.0, 0.0]]},
        {"direction_enu": [[0.0, 1.0]]},
        {"zenith_deg": ["north"], "azimuth_deg": [1.0]},
        {},
    ],
)
def test_directions_that_are_none_are_refused(made: Made, body: dict[str, Any]) -> None:
    answer = made.client.post("/v1/project", json=body)
    assert answer.status_code == 422
    assert answer.json()["errors"]


def test_too_many_points_at_once_are_refused(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made = make(max_points=2)
    answer = made.client.post("/v1/back-project", json={"pixels": [[1.0, 1.0]] * 3})
    assert answer.status_code == 413
    assert answer.json()["errors"] == [
        {"field": "pixels", "problem": "3 at once, more than 2", "remedy": "ask in parts"}
    ]
    assert made.client.post("/v1/project", json={"direction_enu": [[0.0, 0.0, 1.0]] * 3}).status_code == 413


def npy(rows: np.ndarray[Any, Any]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, rows)
    return stream.getvalue()


def ask_rows(made: Made, path: str, rows: np.ndarray[Any, Any]) -> tuple[np.ndarray[Any, Any], httpx.Headers]:
    answer = made.client.post(path, content=npy(rows), headers={"content-type": "application/x-npy"})
    assert answer.status_code == 200, answer.text
    return np.load(io.BytesIO(answer.content)), answer.headers


@pytest.mark.parametrize("kind", [np.float64, np.float32, ">f8"])
def test_rows_are_answered_with_rows_that_say_what_json_says(made: Made, kind: Any) -> None:  # noqa: ANN401 - of numpy
    pixels = np.random.default_rng(5).integers(0, 1747, (700, 2)).astype(kind)
    told = ask(made, "/v1/back-project", {"pixels": pixels.astype(float).tolist()})
    rows, headers = ask_rows(made, "/v1/back-project", pixels)
    assert rows.dtype == np.dtype(kind).newbyteorder("=")
    assert headers["sunarc-calibration"] == told["calibration"] == "second"
    columns = dict(zip(headers["sunarc-columns"].split(","), rows.T, strict=True))
    for name in ("zenith_deg", "azimuth_deg", "sigma_deg"):
        np.testing.assert_allclose(columns[name], np.array(told[name], dtype=float), atol=2e-5)
    assert (columns["inside"] == 1.0).tolist() == told["inside"]
    vectors = np.stack([columns["east"], columns["north"], columns["up"]], axis=-1)
    landed, headers = ask_rows(made, "/v1/project", 3.0 * vectors)
    known = np.isfinite(landed[:, 0])
    assert headers["sunarc-columns"].startswith("x_px,y_px,sigma_px")
    np.testing.assert_allclose(landed[known, :2], pixels[known], atol=1e-2 if rows.dtype == np.float32 else 1e-6)
    assert np.array_equal(known, np.isfinite(rows[:, 0]))


def test_a_million_pixels_come_back_in_their_order(made: Made) -> None:
    pixels = np.stack(np.meshgrid(np.linspace(300.0, 1400.0, 600), np.linspace(300.0, 1400.0, 500)), axis=-1)
    rows, _ = ask_rows(made, "/v1/back-project", pixels.reshape(-1, 2))
    some = np.arange(0, len(rows), 4999)
    told = ask(made, "/v1/back-project", {"pixels": pixels.reshape(-1, 2)[some].tolist()})
    np.testing.assert_allclose(rows[some, 2:5], told["direction_enu"], atol=1e-12)


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (b"", ".npy"),
        (b"\x93NUMPY\x01\x00\xff\xff{", ".npy"),
        (npy(np.zeros((3, 2)))[:-1], "is cut short"),
        (npy(np.zeros((3, 2))) + b"\0", "is cut short"),
        (npy(np.zeros((3, 4))), "has 4 columns"),
        (npy(np.zeros(6)), "of shape (6,)"),
        (npy(np.zeros((3, 2), dtype=np.int64)), "holds int64"),
        (npy(np.asfortranarray(np.zeros((3, 2)))), "in Fortran order"),
        (npy(np.zeros((3, 2), dtype=complex)), "holds complex128"),
    ],
)
def test_what_is_no_array_of_pixels_is_refused(made: Made, body: bytes, problem: str) -> None:
    answer = made.client.post("/v1/back-project", content=body, headers={"content-type": "application/x-npy"})
    assert answer.status_code == 422
    assert problem in answer.json()["errors"][0]["problem"]


def test_other_media_types_are_not_read(made: Made) -> None:
    answer = made.client.post("/v1/back-project", content=b"<x/>", headers={"content-type": "text/xml"})
    assert answer.status_code == 415
    assert "application/x-npy" in answer.json()["errors"][0]["remedy"]


def test_too_many_rows_are_refused(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made = make(history="filled", max_rows=10)
    body, headers = npy(np.zeros((11, 2))), {"content-type": "application/x-npy"}
    assert made.client.post("/v1/back-project", content=body, headers=headers).status_code == 413


def test_a_large_answer_gives_its_place_back(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made = make(history="filled", max_large_at_once=1)
    for _ in range(3):
        ask_rows(made, "/v1/back-project", np.zeros((5, 2)))
    headers = {"content-type": "application/x-npy"}
    for _ in range(3):
        assert made.client.post("/v1/back-project", content=b"no", headers=headers).status_code == 422
    ask_rows(made, "/v1/back-project", np.zeros((5, 2)))


def test_the_calibration_that_answers_is_the_one_that_was_activated_last(made: Made) -> None:
    assert ask(made, "/v1/project", HERE)["calibration"] == "second"
    made.archive.calibrations.retire("second", at=made.noon)
    assert made.client.post("/v1/project", json=HERE).status_code == 503


def test_small_questions_are_answered_before_the_calibration_is_ready_however_many(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made = make(history="filled", max_large_at_once=1)
    with ThreadPoolExecutor(16) as pool:
        asked = [
            pool.submit(made.client.post, "/v1/back-project", json={"pixels": [[871.0, 883.0]]}) for _ in range(16)
        ]
    assert {one.result().status_code for one in asked} == {200}
