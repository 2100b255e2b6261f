"""The exposure of a GenICam camera: by which feature it is set, in what unit, within what bounds."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from typing import Any, Literal

from sunarc.cameras.features import has, read, write
from sunarc.errors import CameraError
from sunarc.imaging.exposure import ExposureBounds

_FLOATS = ("ExposureTime", "ExposureTimeAbs")
_SAME = 1.5
"""Factor up to which two exposures may be one to a camera that does not tell its step."""
_RAW, _RAW_UNIT = "ExposureTimeRaw", "ExposureTimeBaseAbs"


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureControl:
    """How exposures are set.

    Attributes
    ----------
    feature, kind : the camera's feature, and whether it holds a float or whole steps.
    unit_us : microseconds in a step of the feature.
    bounds : shortest and longest exposure, and its step.
    """

    feature: str
    kind: Literal["float", "integer"]
    unit_us: float
    bounds: ExposureBounds

    def set(self, camera: Any, exposure_us: float) -> float:  # noqa: ANN401 - a GObject has no types
        """Set the nearest possible exposure, and return the one read back, µs."""
        steps = self.bounds.nearest(exposure_us) / self.unit_us
        pin = write(camera, self.feature, self.kind, round(steps) if self.kind == "integer" else steps)
        return float(pin.value) * self.unit_us

    def get(self, camera: Any) -> float:  # noqa: ANN401 - a GObject has no types
        """Return the exposure read back from the camera, µs."""
        return float(read(camera, self.feature, self.kind)) * self.unit_us


def require_taken(actual_us: float, asked_us: float, *, before_us: float) -> float:
    """Return an exposure that was read back; CameraError where the camera kept the one before instead of another."""
    if actual_us == before_us and not 1.0 / _SAME <= actual_us / asked_us <= _SAME:
        raise CameraError(f"the camera keeps an exposure of {actual_us:g} µs and does not take {asked_us:g} µs")
    return actual_us


def exposure_control(camera: Any) -> ExposureControl:  # noqa: ANN401 - a GObject has no types
    """Find out how a camera's exposure is set; CameraError when it cannot be."""
    for feature in (*_FLOATS, _RAW):
        if not has(camera, feature):
            continue
        unit_us = float(camera.get_float(_RAW_UNIT)) if feature == _RAW and has(camera, _RAW_UNIT) else 1.0
        with contextlib.suppress(Exception):  # a few cameras hold whole microseconds: refused as a float
            bounds = camera.get_float_bounds(feature)
            return _control(feature, "float", unit_us, bounds, _step(camera.get_float_increment, feature))
        bounds = camera.get_integer_bounds(feature)
        return _control(feature, "integer", unit_us, bounds, _step(camera.get_integer_increment, feature))
    raise CameraError(f"the camera's exposure cannot be set: it has none of {', '.join((*_FLOATS, _RAW))}")


def _control(
    feature: str, kind: Literal["float", "integer"], unit_us: float, bounds: tuple[float, float], step: float
) -> ExposureControl:
    return ExposureControl(
        feature=feature,
        kind=kind,
        unit_us=unit_us,
        bounds=ExposureBounds(
            minimum_us=float(bounds[0]) * unit_us, maximum_us=float(bounds[1]) * unit_us, step_us=step * unit_us
        ),
    )


def _step(ask: Any, feature: str) -> float:  # noqa: ANN401 - a GObject's method has no types
    with contextlib.suppress(Exception):  # vendors' descriptions disagree on whether there is one
        step = float(ask(feature))
        return step if math.isfinite(step) and 1e-6 < step < 1e6 else 0.0
    return 0.0
