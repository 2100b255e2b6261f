"""Simulated imager with a known camera: sky, lens, sensor and faults, in process or as a GigE Vision camera."""

from sunarc.simulation.fake_camera import FakeCamera
from sunarc.simulation.imager import ImagerOptions, halve_speed, run_imager, scene_of
from sunarc.simulation.night_options import NightOptions
from sunarc.simulation.options import WEATHERS, Bump, Obstruction, SceneOptions, SensorModel, Weather
from sunarc.simulation.scene import Scene, bumped_camera
from sunarc.simulation.scene_camera import SceneCamera
from sunarc.simulation.timeline import Timeline
from sunarc.simulation.truth import SGP, true_camera
from sunarc.simulation.truth_document import truth_document

__all__ = [
    "SGP",
    "WEATHERS",
    "Bump",
    "FakeCamera",
    "ImagerOptions",
    "NightOptions",
    "Obstruction",
    "Scene",
    "SceneCamera",
    "SceneOptions",
    "SensorModel",
    "Timeline",
    "Weather",
    "bumped_camera",
    "halve_speed",
    "run_imager",
    "scene_of",
    "true_camera",
    "truth_document",
]
