"""Values for VirtualSky: its formulas, written here anew, put a direction where the camera sees it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.formats.conftest import LENS, document_of, worst_stated_px

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.common.errors import InputError
from sunarc.common.findings import FindingError
from sunarc.formats.formats import export, read_view
from sunarc.optics.camera import Camera, camera_sees
from sunarc.optics.forward import project

LEVEL = replace(
    LENS, rotation_cam_enu=(0.0, 0.0, 2.1), decentering=(0.0, 0.0, 0.0, 0.0), radial=(0.0,) * 8, skew_px=0.0
)


def drawn(written: dict[str, Any], zenith: float, azimuth: float) -> tuple[float, float]:
    """Return where VirtualSky draws a direction (radians) over the image, px from the middle of its first pixel."""
    options, element = written["virtualsky"], written["element"]
    width, height = options["width"], options["height"]
    turned = azimuth - math.radians(options["az"] - 180.0)
    if options["projection"] == "polar":
        r = height / 2.0 * zenith / (math.pi / 2.0)
    elif options["projection"] == "fisheye":
        r = height / 2.0 * math.sin(zenith / 2.0) / 0.70710678
    else:
        r = height / 2.0 * math.sin(zenith)
    x, y = width / 2.0 - r * math.sin(turned), height / 2.0 - r * math.cos(turned)
    return x + element["left"] - 0.5, y + element["top"] - 0.5


def apart_px(camera: Camera) -> tuple[dict[str, Any], NDArray[np.float64], str]:
    exported = export(document_of(camera), "virtualsky")
    written = json.loads(exported.content)
    directions = hemisphere(601)
    pixels = project(camera, directions)
    seen = camera_sees(camera, pixels)
    there = np.array([drawn(written, math.acos(up), math.atan2(east, north)) for east, north, up in directions[seen]])
    return written, np.linalg.norm(there - pixels[seen], axis=-1), exported.error


@pytest.mark.parametrize(
    ("projection", "named", "focal_px"), [("equidistant", "polar", 500.0), ("equisolid", "fisheye", 601.3)]
)
@pytest.mark.parametrize("turn", [-2.9, -1.0, 0.0, 0.4, 2.1])
def test_a_level_camera_of_its_projections_is_drawn_to_a_hundredth_of_a_pixel(
    projection: Any,  # noqa: ANN401 - of the table
    named: str,
    focal_px: float,
    turn: float,
) -> None:
    camera = replace(
        LEVEL, projection=projection, focal_length_px=(focal_px, focal_px), rotation_cam_enu=(0.0, 0.0, turn)
    )
    written, off, _ = apart_px(camera)
    assert written["virtualsky"]["projection"] == named
    assert off.max() < 0.05  # az is written to a thousandth of a degree
    assert (written["virtualsky"]["latitude"], written["virtualsky"]["longitude"]) != (0.0, 0.0)


def test_the_error_of_a_lens_with_distortion_is_what_is_stated() -> None:
    camera = replace(LENS, rotation_cam_enu=(0.01, -0.008, 2.1))
    written, off, error = apart_px(camera)
    assert off.max() <= 1.1 * worst_stated_px(error)
    assert off.max() > 0.5 * worst_stated_px(error)
    assert error in " ".join(written["notes"])


@pytest.mark.parametrize("tilt", [0.2, 0.5])
def test_a_tilted_camera_is_refused(tilt: float) -> None:
    with pytest.raises(FindingError) as refused:
        export(document_of(replace(LEVEL, rotation_cam_enu=(tilt, 0.0, 0.0))), "virtualsky")
    assert refused.value.finding.code == "format_does_not_hold"
    assert float(refused.value.finding.data["max_deg"]) > float(refused.value.finding.data["limit_deg"])


def test_mirrored_images_are_refused_and_nothing_reads_the_file() -> None:
    with pytest.raises(InputError):
        export(document_of(replace(LEVEL, mirrored=True)), "virtualsky")
    with pytest.raises(FindingError) as refused:
        read_view(export(document_of(LEVEL), "virtualsky").content, name="virtualsky.json")
    assert refused.value.finding.code == "format_without_reader"
