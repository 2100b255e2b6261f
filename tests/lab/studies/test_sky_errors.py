"""Errors over the sky are those of the cameras, on the side where they are."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest

from sunarc.common.errors import OutsideError
from sunarc.lab.simulation.imager import truth_document
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.lab.studies.sky_errors import sky_errors, write_picture

NOW = datetime(2013, 5, 13, tzinfo=UTC)
TRUE = true_camera()
TRUTH = truth_document(TRUE, SGP, name="truth", created_at=NOW)


def document_of(**changes: object) -> dict[str, object]:
    return truth_document(replace(TRUE, **changes), SGP, name="made", created_at=NOW)  # type: ignore[arg-type]


def test_a_shifted_camera_is_as_far_off_everywhere() -> None:
    x, y = TRUE.principal_point_px
    found = sky_errors(document_of(principal_point_px=(x + 0.3, y - 0.4)), TRUTH)
    assert (found.north_px, found.south_px) == pytest.approx((0.5, 0.5), abs=1e-6)
    inside = np.isfinite(found.map_px)
    np.testing.assert_allclose(found.map_px[inside], 0.5, atol=1e-6)
    assert np.mean(inside) == pytest.approx(np.pi / 4.0, abs=0.01)


def test_the_true_camera_has_no_error() -> None:
    found = sky_errors(TRUTH, TRUTH)
    assert (found.north_px, found.south_px) == (0.0, 0.0)


def test_a_camera_tilted_about_the_east_is_wrong_in_the_north_and_south_alike() -> None:
    turned = tuple((np.array(TRUE.rotation_cam_enu) * 1.001).tolist())
    found = sky_errors(document_of(rotation_cam_enu=turned), TRUTH)
    assert found.north_px > 0.1
    assert found.south_px > 0.1
    assert np.nanmax(found.map_px) >= max(found.north_px, found.south_px)


def test_the_picture_shows_both_maps_beside_each_other(tmp_path: Path) -> None:
    x, y = TRUE.principal_point_px
    maps = {
        "day": sky_errors(document_of(principal_point_px=(x + 0.3, y)), TRUTH),
        "day and night": sky_errors(TRUTH, TRUTH),
    }
    write_picture(maps, tmp_path / "errors.png")
    picture = cv2.imread(str(tmp_path / "errors.png"))
    assert picture is not None
    assert picture.shape == (440, 880, 3)
    assert picture[220, 220].tolist() != picture[220, 660].tolist()
    with pytest.raises(OutsideError):
        write_picture(maps, tmp_path / "none" / "errors.png")
