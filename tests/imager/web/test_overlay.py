from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fixtures.served import document

from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.directions import angular_distance, direction_from_angles

if TYPE_CHECKING:
    from tests.fixtures.served import Made


def test_the_lines_lie_where_the_lens_has_them(made: Made) -> None:
    told = made.client.get("/v1/overlay").json()
    assert (told["calibration"], told["image_size"]) == ("second", [1748, 1748])
    circles = {circle["zenith_deg"]: circle["pixels"] for circle in told["zenith_circles"]}
    east_at_60 = project(made.lens, direction_from_angles(zenith_deg=60.0, azimuth_deg=90.0))
    np.testing.assert_allclose(circles[60.0][30], east_at_60, atol=0.006)
    assert circles[90.0][0] == circles[90.0][-1]
    east = next(line for line in told["azimuth_lines"] if line["name"] == "E")
    assert east["azimuth_deg"] == 90.0
    np.testing.assert_allclose(east["pixels"][18], east_at_60, atol=0.006)


def test_the_suns_paths_are_todays_and_the_solstices(made: Made) -> None:
    paths = {path["name"]: path for path in made.client.get("/v1/overlay").json()["sun_paths"]}
    assert [path["date"] for path in paths.values()] == ["2013-05-13", "2013-06-21", "2013-12-21"]
    heights = {name: min(path["apparent_zenith"]) for name, path in paths.items()}
    assert heights["june solstice"] < heights["today"] < heights["december solstice"]
    assert abs(heights["december solstice"] - heights["june solstice"] - 2 * 23.44) < 0.1
    today = made.client.get("/v1/sun/track", params={"step_s": 300}).json()
    assert paths["today"]["pixels"] == today["pixels"]


def test_without_a_calibration_there_is_no_line_and_no_map(empty: Made) -> None:
    told = empty.client.get("/v1/overlay").json()
    assert (told["calibration"], told["zenith_circles"], told["azimuth_lines"]) == (None, [], [])
    assert all(set(path["pixels"]) == {None} for path in told["sun_paths"])
    assert empty.client.get("/v1/uncertainty").status_code == 404


def test_the_map_of_doubt_is_what_back_projection_says(made: Made) -> None:
    told = made.client.get("/v1/uncertainty", params={"cells": 8}).json()
    pixels = [[x, y] for y in told["y_px"] for x in told["x_px"]]
    answer = made.client.post("/v1/back-project", json={"pixels": pixels}).json()
    flat = [value for row in told["sigma_deg"] for value in row]
    wanted = [s if inside else None for s, inside in zip(answer["sigma_deg"], answer["inside"], strict=True)]
    assert flat[0] is None
    np.testing.assert_allclose(np.array(flat, dtype=float), np.array(wanted, dtype=float), rtol=0.05)


def test_what_is_drawn_is_sent_once(made: Made) -> None:
    for path in ("/v1/overlay", "/v1/uncertainty"):
        tag = made.client.get(path).headers["etag"]
        again = made.client.get(path, headers={"if-none-match": tag})
        assert (again.status_code, again.content) == (304, b"")


def test_two_calibrations_are_compared_over_the_image(made: Made) -> None:
    turned = replace(made.lens, rotation_cam_enu=(0.02, -0.015, 2.1 + 1e-3))  # about the camera's axis, nearly upright
    made.archive.calibrations.add(document("turned", camera=turned))
    found = made.client.get("/v1/difference", params={"other": "turned", "cells": 12}).json()
    pixels = np.array([[x, y] for y in found["y_px"] for x in found["x_px"]])
    apart = np.degrees(angular_distance(unproject(made.lens, pixels), unproject(turned, pixels)))
    values = np.array([value for row in found["difference_deg"] for value in row], dtype=float)
    seen = np.isfinite(values)
    assert 0.5 < seen.mean() < 1.0
    np.testing.assert_allclose(values[seen], apart[seen], atol=1e-5)
    assert found["rms_deg"] == pytest.approx(np.sqrt(np.mean(apart[seen] ** 2)), rel=1e-3)
    assert found["max_deg"] == pytest.approx(apart[seen].max(), rel=1e-3)
    assert (found["calibration"], found["other"]) == ("second", "turned")
    difference = rotation_matrix(made.lens.rotation_cam_enu).T @ rotation_matrix(turned.rotation_cam_enu)
    expected = Rotation.from_matrix(difference).as_rotvec(degrees=True)
    np.testing.assert_allclose(found["rotation_deg"], expected, atol=1e-6)
    assert found["rms_rotated_deg"] < 1e-6 < found["rms_deg"]
    same = made.client.get("/v1/difference", params={"other": "second", "cells": 4}).json()
    assert (same["rms_deg"], same["max_deg"]) == (0.0, 0.0)


def test_what_cannot_be_compared_is_refused(made: Made) -> None:
    small = replace(made.lens, width=800, height=600)
    made.archive.calibrations.add(document("small", camera=small))
    for query, status, field in (
        ({}, 422, "other"),
        ({"other": "absent"}, 404, "other"),
        ({"other": "small"}, 422, "other"),
        ({"other": "first", "cells": 10**9}, 422, "cells"),
        ({"other": "first", "calibration": "absent"}, 404, "calibration"),
    ):
        answer = made.client.get("/v1/difference", params=query)
        assert (answer.status_code, answer.json()["errors"][0]["field"]) == (status, field), query
