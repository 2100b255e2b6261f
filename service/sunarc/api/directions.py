"""Routes: from pixels to directions and back."""

from __future__ import annotations

import math
from http import HTTPStatus
from typing import Any

import numpy as np
from fastapi import APIRouter, Request
from numpy.typing import NDArray

from sunarc.api.fields import Time
from sunarc.api.problems import Fault, RefusedError, answers
from sunarc.api.schemas import BackProjectAnswer, BackProjectRequest, ProjectAnswer, ProjectRequest
from sunarc.api.served import Served
from sunarc.calibration import Calibration, camera_sees, project_with_covariance, sigma_px, unproject_with_sigma
from sunarc.sky import angles_from_direction, direction_from_angles

FloatArray = NDArray[np.float64]


def direction_routes(served: Served) -> APIRouter:
    """Return the routes that compute."""
    routes = APIRouter(tags=["directions"])

    @routes.post("/back-project", responses=answers(400, 404, 408, 413, 415, 422))
    def back_project(request: Request, asked: BackProjectRequest, at: Time | None = None) -> BackProjectAnswer:
        """Tell where pixels look, and how sure that is, now or at the moment `at`."""
        _require_few(len(asked.pixels), most=served.options.max_points, field="pixels")
        record = served.of(request).record(at)
        pixels = np.array(asked.pixels, dtype=np.float64).reshape(-1, 2)
        return _back_projected(served.parsed.get(record), pixels, record.id)

    @routes.post("/project", responses=answers(400, 404, 408, 413, 415, 422))
    def project(request: Request, asked: ProjectRequest, at: Time | None = None) -> ProjectAnswer:
        """Tell where directions land, and how sure that is, now or at the moment `at`."""
        directions = _directions(asked)
        _require_few(len(directions), most=served.options.max_points, field="directions")
        record = served.of(request).record(at)
        return _projected(served.parsed.get(record), directions, record.id)

    return routes


def _back_projected(calibration: Calibration, pixels: FloatArray, calibration_id: str) -> BackProjectAnswer:
    with np.errstate(all="ignore"):  # what lies beyond all bounds is answered with null
        directions, sigma, inside = unproject_with_sigma(calibration, pixels)
    zenith, azimuth = angles_from_direction(directions)
    return BackProjectAnswer(
        calibration=calibration_id,
        zenith_deg=_numbers(zenith),
        azimuth_deg=_numbers(azimuth),
        direction_enu=_rows(directions),
        sigma_deg=_numbers(sigma),
        inside=inside.tolist(),
    )


def _projected(calibration: Calibration, directions: FloatArray, calibration_id: str) -> ProjectAnswer:
    pixels, covariance = project_with_covariance(calibration, directions)
    return ProjectAnswer(
        calibration=calibration_id,
        pixels=_rows(pixels),
        sigma_px=_numbers(sigma_px(covariance)),
        covariance_px2=_rows(covariance),
        inside=camera_sees(calibration.camera, pixels).tolist(),
    )


def _directions(asked: ProjectRequest) -> FloatArray:
    if asked.direction_enu is None:
        return direction_from_angles(zenith_deg=asked.zenith_deg or [], azimuth_deg=asked.azimuth_deg or [])
    vectors = np.array(asked.direction_enu, dtype=np.float64).reshape(-1, 3)
    scaled = vectors / np.max(np.abs(vectors), axis=-1, keepdims=True)  # the squares of tiny or huge ones would fail
    return np.asarray(scaled / np.linalg.norm(scaled, axis=-1, keepdims=True))


def _require_few(count: int, *, most: int, field: str) -> None:
    if count > most:
        raise RefusedError(
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
            Fault(field=field, problem=f"{count} at once, more than {most}", remedy="ask in parts"),
        )


def _numbers(values: FloatArray) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]


def _rows(values: FloatArray) -> list[Any]:
    """Return rows of any shape, None for one that holds no number."""
    known = np.all(np.isfinite(values), axis=tuple(range(1, values.ndim)))
    return [row if finite else None for row, finite in zip(values.tolist(), np.atleast_1d(known), strict=True)]
