"""What cannot be simulated is refused in one line, and the camera's description is sound."""

from __future__ import annotations

import ctypes
import threading
import xml.etree.ElementTree as ET
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import pytest

from sunarc.common.errors import ConfigurationError, InputError
from sunarc.lab.simulation.fake_camera import genicam_xml
from sunarc.lab.simulation.imager import ImagerOptions, make_scene, run_imager
from sunarc.lab.simulation.options import SceneOptions, SensorModel
from sunarc.lab.simulation.truth import true_camera


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"start": datetime(2013, 5, 13, 12)}, "start"),  # noqa: DTZ001 - that it is naive is the point
        ({"speed": 0.0}, "speed"),
        ({"speed": float("nan")}, "speed"),
        ({"clouds": "clear,fog"}, "clouds"),
        ({"clouds": ""}, "clouds"),
        ({"exposure_min_us": 0}, "exposure_min_us"),
        ({"exposure_min_us": 20, "exposure_max_us": 10}, "exposure_min_us"),
    ],
)
def test_wrong_options_are_refused(wrong: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        ImagerOptions(**wrong)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        (SceneOptions, {"nd_transmission": 0.0}),
        (SceneOptions, {"weather": ()}),
        (SceneOptions, {"psf_sigma_px": float("nan")}),
        (SensorModel, {"full_well_e": -1.0}),
        (SensorModel, {"black_level": 0.7}),
    ],
)
def test_wrong_scenes_and_sensors_are_refused(kind: type[SceneOptions | SensorModel], wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        kind(**wrong)


def test_an_imager_shows_the_camera_that_it_is_given() -> None:
    given = replace(true_camera(), width=640, height=480)
    assert make_scene(ImagerOptions(camera=given, lens_seed=3)).camera == given
    assert make_scene(ImagerOptions(lens_seed=3)).camera == true_camera(3)


def test_a_machine_without_aravis_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object) -> None:
        raise OSError

    monkeypatch.setattr(ctypes, "CDLL", missing)
    options = ImagerOptions(start=datetime(2013, 5, 13, 12, tzinfo=UTC), die_with_parent=False)
    with pytest.raises(ConfigurationError, match=r"gir1\.2-aravis-0\.8"):
        run_imager(options, threading.Event())


def test_every_node_that_the_description_refers_to_is_there() -> None:
    root = ET.fromstring(genicam_xml(exposure_min_us=5, exposure_max_us=9_000_000))  # noqa: S314 - our own text
    space = "{http://www.genicam.org/GenApi/Version_1_0}"
    names = {node.get("Name") for node in root.iter()}
    referred = {
        node.text for tag in ("pFeature", "pValue", "pMax", "pPort", "pVariable") for node in root.iter(space + tag)
    }
    assert referred <= names
    assert {"ExposureTime", "Gain", "PixelFormat", "DeviceTemperature", "SimFreezeMs"} <= names
