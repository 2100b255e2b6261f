"""Answers away from the last sighting: every route states the same larger uncertainty, of the same camera."""

from __future__ import annotations

import io
from datetime import timedelta
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.calibrations import chosen_calibration
from tests.fixtures.served import LENS, NOON, document

from sunarc.client.camera import CameraModel
from sunarc.common.utc import rfc3339
from sunarc.optics.camera import PARAMETER_NAMES

if TYPE_CHECKING:
    from tests.fixtures.served import Made, Make

PIXELS = [[400.0, 500.0], [871.0, 883.0], [1300.0, 900.0]]
LATER = rfc3339(NOON + timedelta(days=150))


@pytest.fixture
def breathing(make: Make) -> Made:
    """Make an application with a calibration whose focal length has an uncertainty."""
    names = (*PARAMETER_NAMES[:2], *PARAMETER_NAMES[3:8])
    covariance = np.diag([1e-4, 1e-4, 1e-4, 1e-4, 1e-10, 1e-10, 1e-10])
    fit = chosen_calibration(LENS, names=names, covariance=covariance, orders=np.array([[1, 1], [2, 1]]))
    made = make()
    made.archive.calibrations.add(document("served", solved=fit))
    made.archive.calibrations.activate("served")
    return made


def sigmas(made: Made, at: str) -> list[float]:
    answer = made.client.post("/v1/back-project", json={"pixels": PIXELS}, params={"at": at})
    assert answer.status_code == 200, answer.text
    return list(answer.json()["sigma_deg"])


def test_all_answers_for_a_time_state_one_uncertainty(breathing: Made) -> None:
    now, later = sigmas(breathing, rfc3339(NOON)), sigmas(breathing, LATER)
    assert now[1] == pytest.approx(later[1], rel=0.02)  # on the axis a focal length has no part
    assert all(after > 2.0 * before for before, after in zip(now[::2], later[::2], strict=True))
    served = breathing.client.get("/v1/calibration", params={"at": LATER})
    assert served.json()["id"] == "served"
    assert served.json()["uncertainty"]["aged_days"] == 183
    ours = CameraModel(served.json()).back_project(PIXELS)
    np.testing.assert_allclose(ours.sigma_deg, later, rtol=0.01)
    answer = breathing.client.get("/v1/back-projection-map", params={"at": LATER, "format": "npz"})
    of_map = np.load(io.BytesIO(answer.content))["sigma"]
    np.testing.assert_allclose([of_map[int(y), int(x)] for x, y in PIXELS], later, rtol=0.01)


def test_a_stored_calibration_keeps_the_uncertainty_of_its_fit(breathing: Made) -> None:
    stored = breathing.client.get("/v1/calibrations/served").json()["uncertainty"]
    later = breathing.client.get("/v1/calibration", params={"at": LATER}).json()["uncertainty"]
    assert "aged_days" not in stored
    assert later["sky_rms_deg"] > stored["sky_rms_deg"]
    assert breathing.client.get("/v1/calibration").json()["uncertainty"] == stored


def test_tags_change_with_the_age(breathing: Made) -> None:
    for route in ("/v1/calibration", "/v1/calibration?format=opencv", "/v1/back-projection-map", "/v1/remap?size=64"):
        mark = "&" if "?" in route else "?"
        tags = {breathing.client.get(f"{route}{mark}at={at}").headers["etag"] for at in (rfc3339(NOON), LATER)}
        assert len(tags) == 2, route
