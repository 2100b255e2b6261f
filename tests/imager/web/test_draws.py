"""Draws of an ensemble over HTTP: the first axis, reproducible, as wide as the uncertainty that is stated."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.calibration.answers.error_model import MOST_DRAWS, draw_ensemble
from sunarc.imager.web.options import ApiOptions

if TYPE_CHECKING:
    from tests.fixtures.served import Made

PIXELS = [[700.0, 760.0], [900.0, 500.0], [-500.0, 10.0]]
NPY = {"content-type": "application/x-npy"}


def ask(made: Made, route: str, body: dict[str, Any], **params: object) -> dict[str, Any]:
    answer = made.client.post(route, json=body, params=params)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def rows(made: Made, route: str, question: NDArray[Any], **params: object) -> tuple[NDArray[Any], list[str]]:
    stream = io.BytesIO()
    np.save(stream, question)
    answer = made.client.post(route, content=stream.getvalue(), headers=NPY, params=params)
    assert answer.status_code == 200, answer.text
    return np.load(io.BytesIO(answer.content)), answer.headers["sunarc-columns"].split(",")


def test_directions_by_each_draw_are_those_of_the_ensemble_and_spread_as_stated(made: Made) -> None:
    found = ask(made, "/v1/back-project", {"pixels": PIXELS}, draws=MOST_DRAWS, seed=7)
    drawn = found["draws"]
    assert [len(drawn[name]) for name in ("zenith_deg", "azimuth_deg", "direction_enu")] == [MOST_DRAWS] * 3
    calibration = made.archive.calibrations.model(found["calibration"])
    ensemble = draw_ensemble(calibration, draws=MOST_DRAWS, seed=7, calibration_id=found["calibration"])
    for k in (0, MOST_DRAWS - 1):
        np.testing.assert_allclose(
            drawn["direction_enu"][k][:2], ensemble.back_project(k, np.array(PIXELS[:2])), atol=1e-12
        )
        assert drawn["direction_enu"][k][2] is None
        assert drawn["zenith_deg"][k][2] is None
    directions = np.array([each[:2] for each in drawn["direction_enu"]])
    spread = np.degrees(np.sqrt(0.5 * np.sum(np.var(directions, axis=0), axis=-1)))
    assert np.all((spread / found["sigma_deg"][:2] > 0.6) & (spread / found["sigma_deg"][:2] < 1.5))


def test_pixels_by_each_draw_spread_as_the_stated_covariance(made: Made) -> None:
    found = ask(made, "/v1/project", {"zenith_deg": [30.0, 50.0], "azimuth_deg": [10.0, 200.0]}, draws=MOST_DRAWS)
    pixels = np.array(found["draws"]["pixels"])
    assert pixels.shape == (MOST_DRAWS, 2, 2)
    spread = np.sqrt(0.5 * np.sum(np.var(pixels, axis=0), axis=-1))
    assert np.all((spread / found["sigma_px"] > 0.6) & (spread / found["sigma_px"] < 1.5))


def test_the_same_seed_gives_the_same_draws_and_another_others(made: Made) -> None:
    one, again, other = (ask(made, "/v1/back-project", {"pixels": PIXELS}, draws=2, seed=s) for s in (3, 3, 4))
    more = ask(made, "/v1/back-project", {"pixels": PIXELS[:1]}, draws=5, seed=3)
    assert one == again
    assert one["draws"] != other["draws"]
    assert {k: v for k, v in one.items() if k != "draws"} == {k: v for k, v in other.items() if k != "draws"}
    assert [each[0] for each in one["draws"]["zenith_deg"]] == [each[0] for each in more["draws"]["zenith_deg"][:2]]
    assert "draws" not in ask(made, "/v1/back-project", {"pixels": PIXELS})


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_binary_answer_has_the_draws_as_its_first_axis(made: Made, kind: type) -> None:
    question: NDArray[Any] = np.array(PIXELS, dtype=kind)
    found, columns = rows(made, "/v1/back-project", question, draws=3, seed=7)
    assert columns == ["zenith_deg", "azimuth_deg", "east", "north", "up"]
    assert found.shape == (3, 3, 5)
    assert found.dtype == np.dtype(kind)
    drawn = ask(made, "/v1/back-project", {"pixels": PIXELS}, draws=3, seed=7)["draws"]
    np.testing.assert_allclose(found[:, :2, 0], [each[:2] for each in drawn["zenith_deg"]], rtol=1e-6)
    directions: NDArray[Any] = np.array([[0.0, 0.6, 0.8], [0.3, 0.0, 0.9]], dtype=kind)
    pixels, columns = rows(made, "/v1/project", directions, draws=3, seed=7)
    assert (columns, pixels.shape) == (["x_px", "y_px"], (3, 2, 2))
    drawn = ask(made, "/v1/project", {"direction_enu": directions.astype(float).tolist()}, draws=3, seed=7)["draws"]
    np.testing.assert_allclose(pixels, drawn["pixels"], rtol=1e-6)


def test_more_rows_than_a_part_come_draw_by_draw(made: Made) -> None:
    question = np.tile(np.array(PIXELS[:2]), (40_000, 1))
    found, _ = rows(made, "/v1/back-project", question, draws=2)
    assert found.shape == (2, 80_000, 5)
    np.testing.assert_array_equal(found[:, :2], found[:, -2:])
    assert np.abs(found[0, 0] - found[1, 0]).max() > 1e-6


def test_places_by_each_draw_spread_with_the_calibration_and_the_height(made: Made) -> None:
    body = {"pixels": PIXELS[:2], "height_m": 1500.0, "height_sigma_m": 150.0}
    found = ask(made, "/v1/geolocate", body, draws=MOST_DRAWS, seed=1)
    plain = ask(made, "/v1/geolocate", body | {"height_sigma_m": 0.0})
    assert np.all(np.array(found["cloud"]["sigma_m"]) > 3.0 * np.array(plain["cloud"]["sigma_m"]))
    for part in ("cloud", "shadow"):
        drawn = found["draws"][part]
        assert set(drawn) == {"east_m", "north_m", "up_m", "latitude", "longitude", "altitude"}
        place = np.stack([np.array(drawn["east_m"]), np.array(drawn["north_m"])], axis=-1)
        sigma = np.sqrt(0.5 * np.sum(np.var(place, axis=0), axis=-1))
        ratio = sigma / np.array(found[part]["sigma_m"])
        assert np.all((ratio > 0.7) & (ratio < 1.35)), part
    # one height's error for all: both clouds are too high together
    up = np.array(found["draws"]["cloud"]["up_m"])
    assert np.corrcoef(up.T)[0, 1] > 0.99
    four = np.array([[*pixel, 1500.0, 150.0] for pixel in PIXELS[:2]])
    binary, columns = rows(made, "/v1/geolocate", four, draws=2, seed=1)
    assert (binary.shape, columns[0], columns[-1]) == ((2, 2, 12), "east_m", "shadow_altitude")
    np.testing.assert_allclose(binary[:, :, 0], found["draws"]["cloud"]["east_m"][:2])
    joint, _ = rows(made, "/v1/geolocate", four)
    np.testing.assert_allclose(joint[:, 6], found["cloud"]["sigma_m"])


@pytest.mark.parametrize(
    "params", [{"draws": -1}, {"draws": MOST_DRAWS + 1}, {"draws": "many"}, {"seed": -1}, {"seed": 2**32}]
)
def test_draws_and_seeds_beyond_their_bounds_are_refused(made: Made, params: dict[str, object]) -> None:
    answer = made.client.post("/v1/back-project", json={"pixels": PIXELS}, params=params)
    assert answer.status_code == 422
    assert next(iter(params)) in answer.json()["errors"][0]["field"]


def test_more_numbers_than_one_answer_may_have_are_refused(made: Made) -> None:
    most = ApiOptions().max_points
    answer = made.client.post("/v1/back-project", json={"pixels": [[1.0, 2.0]] * (most // 60)}, params={"draws": 64})
    assert answer.status_code == 413
    assert answer.json()["errors"][0]["field"] == "draws"


@pytest.mark.parametrize("height_sigma_m", [-1.0, 1e5, "much", float("inf")])
def test_a_height_s_error_is_a_number_from_0(made: Made, height_sigma_m: object) -> None:
    content = str({"pixels": PIXELS[:1], "height_m": 1500.0, "height_sigma_m": height_sigma_m}).replace("'", '"')
    answer = made.client.post("/v1/geolocate", content=content, headers={"content-type": "application/json"})
    assert answer.status_code in {400, 422}
