"""The sun that a calibration expects in an image, and detections held against it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from sunarc.calibration.answers.covariance import project_with_covariance, without_clock
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Finding
from sunarc.detection.values import Expectation
from sunarc.optics.forward import local_stretch
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

SEARCHED, PREDICTED, STARS = 1, 2, 3
"""Passes; the third is over the images of the night."""
MOST_EXPOSURES = 32
"""More images of one time are no stack, but a series whose names say too little of the time."""
_LEAST_UNCERTAINTY_PX = 1.0
"""1-sigma of a prediction, at least."""
_CONSISTENT_SIGMAS = 3.5
"""Of sighting and prediction together: two in a thousand right ones are farther away (Rayleigh's distribution), and so
are round gaps in cloud that were taken for the sun (docs/studies.md, "A day of clouds")."""
Seen = TypeVar("Seen", bound="WithMethod")


def expectations(
    calibration: Calibration, unix_s: FloatArray, *, site: Site, misfit_px: float | None = None
) -> list[Expectation | None]:
    """Return the predicted sun at times (n,); None outside the camera's field or image.

    Parameters
    ----------
    calibration, site : of the camera.
    unix_s : seconds since 1970-01-01 UTC.
    misfit_px : by which the camera is wrong beyond its covariance, per axis; None for the scatter of the sightings that
        it was fitted to.
    """
    if unix_s.size == 0:
        return []
    directions = sun_directions(unix_s, site)
    pixels, covariance = project_with_covariance(without_clock(calibration), directions)
    stretch = local_stretch(calibration.camera, directions)
    zenith = np.radians(np.asarray(sun_angles(unix_s, site).apparent_zenith))
    scatter = np.nan_to_num(calibration.evidence.sigma_px) if misfit_px is None else misfit_px
    sigma = np.hypot(np.sqrt(np.trace(covariance, axis1=-2, axis2=-1) / 2.0), scatter)
    camera = calibration.camera
    inside = np.all((pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5), axis=-1)
    return [
        Expectation(
            x_px=float(pixels[n, 0]),
            y_px=float(pixels[n, 1]),
            uncertainty_px=max(float(sigma[n]), _LEAST_UNCERTAINTY_PX),
            stretch_px_per_rad=_matrix_tuple(stretch[n].tolist()),
            apparent_zenith=float(zenith[n]),
        )
        if inside[n] and np.isfinite(sigma[n])
        else None
        for n in range(unix_s.size)
    ]


def _matrix_tuple(rows: list[list[float]]) -> tuple[tuple[float, float], tuple[float, float]]:
    return (rows[0][0], rows[0][1]), (rows[1][0], rows[1][1])


class WithPosition(Protocol):
    """Protocol of a detection or sighting that has a position."""

    @property
    def accepted(self) -> bool:
        """True where fits may use the position."""

    @property
    def x_px(self) -> float | None:
        """Of the sun's centre."""

    @property
    def y_px(self) -> float | None:
        """Of the sun's centre."""

    @property
    def sigma_px(self) -> float | None:
        """1-sigma per axis."""


class WithMethod(WithPosition, Protocol):
    """A sighting with its method, of a detector or of an archive: a frozen dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def method(self) -> str:
        """Method of the detector."""


def is_consistent(sighting: WithPosition, expected: Expectation | None) -> bool:
    """Return whether an accepted sighting lies where the sun is predicted, so that no second search is needed."""
    if not sighting.accepted or expected is None or sighting.x_px is None or sighting.y_px is None:
        return False
    sigma = math.hypot(expected.uncertainty_px, sighting.sigma_px or 0.0)
    distance = math.hypot(sighting.x_px - expected.x_px, sighting.y_px - expected.y_px)
    return distance <= _CONSISTENT_SIGMAS * sigma


def as_predicted(found: Seen, expected: Expectation | None) -> Seen:
    """Return a detection, rejected where it deviates from the prediction by more than both state."""
    if not found.accepted or found.method != "paper" or expected is None or is_consistent(found, expected):
        return found
    distance = math.hypot((found.x_px or 0.0) - expected.x_px, (found.y_px or 0.0) - expected.y_px)
    displaced = (Finding("blob_displaced", {"distance_px": distance}),)
    return replace(found, accepted=False, verdict="reflection", findings=displaced)
