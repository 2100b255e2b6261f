"""Frames from a known truth: the sky, the lens, the sensor, faults; in-process, or served as a GigE Vision camera."""

from sunarc.simulation.options import WEATHERS, Obstruction, SceneOptions, SensorModel, Weather
from sunarc.simulation.scene import Scene
from sunarc.simulation.truth import SGP, true_camera, truth_document

__all__ = [
    "SGP",
    "WEATHERS",
    "Obstruction",
    "Scene",
    "SceneOptions",
    "SensorModel",
    "Weather",
    "true_camera",
    "truth_document",
]
