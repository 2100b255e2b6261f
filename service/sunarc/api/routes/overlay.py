"""Routes: what a page draws over an image, computed here so that it need not know any lens."""

from __future__ import annotations

import math
from datetime import date, datetime
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from pydantic import BaseModel
from scipy.spatial.transform import Rotation

from sunarc.api.context import ApiContext
from sunarc.api.problems import answers
from sunarc.api.routes.calibrations import tagged
from sunarc.api.routes.choice import BY_CALIBRATION
from sunarc.api.routes.sun import track_of
from sunarc.api.schemas.overlay import AzimuthLine, Difference, Overlay, SunPath, Uncertainty, ZenithCircle
from sunarc.api.schemas.parameters import At, IfNoneMatch
from sunarc.array_types import FloatArray
from sunarc.calibration.model.covariance import unproject_with_sigma
from sunarc.calibration.model.result import Calibration
from sunarc.errors import InputError
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.days import solar_date
from sunarc.sky.directions import angular_distance, direction_from_angles

_CIRCLES_DEG = (30.0, 60.0, 90.0)
_NAMES = {0: "N", 90: "E", 180: "S", 270: "W"}
_AROUND_DEG = np.arange(0.0, 361.0, 3.0)
_OUTWARDS_DEG = np.arange(6.0, 90.1, 3.0)
_PATH_STEP_S = 300
_FEWEST = 3
"""Directions that a rotation is taken from."""
_Cells = Annotated[int, Query(ge=4, le=96, description="Cells along the image's longer side.")]
_SOLSTICES = (("june solstice", 6, 21), ("december solstice", 12, 21))


def _described(model: type[BaseModel]) -> dict[int | str, dict[str, Any]]:
    return {
        200: {"model": model, "headers": {"ETag": {"description": "Changes with it.", "schema": {"type": "string"}}}},
        304: {"description": "It is the one that If-None-Match names."},
    }


def overlay_routes(context: ApiContext) -> APIRouter:
    """Return the routes that help pages draw."""
    routes = APIRouter(tags=["drawing"])

    @routes.get(
        "/overlay",
        dependencies=BY_CALIBRATION,
        responses=_described(Overlay) | answers(404, 422),
        response_model=Overlay,
    )
    def overlay(request: Request, at: At = None, if_none_match: IfNoneMatch = None) -> Response:
        """Tell lines to draw over an image: zenith, azimuth, and the sun's paths of today and of the solstices."""
        selected = context.of(request)
        return _sent(_overlay(selected, at or selected.frame_clock(), past=at), if_none_match)

    @routes.get(
        "/uncertainty",
        dependencies=BY_CALIBRATION,
        responses=_described(Uncertainty) | answers(404, 422),
        response_model=Uncertainty,
    )
    def uncertainty(
        request: Request,
        at: At = None,
        cells: _Cells = 48,
        if_none_match: IfNoneMatch = None,
    ) -> Response:
        """Tell how sure the calibration is over the image, on a coarse grid."""
        selected = context.of(request)
        record = selected.record(at)
        return _sent(_uncertainty(selected.archive.model(record.id), cells, record.id), if_none_match)

    _add_difference(routes, context)
    return routes


def _add_difference(routes: APIRouter, context: ApiContext) -> None:
    @routes.get(
        "/difference",
        dependencies=BY_CALIBRATION,
        responses=_described(Difference) | answers(404, 422),
        response_model=Difference,
    )
    def difference(
        *,
        request: Request,
        other: Annotated[str, Query(max_length=100, description="Id of a calibration of this camera.")],
        at: At = None,
        cells: _Cells = 48,
        if_none_match: IfNoneMatch = None,
    ) -> Response:
        """Tell how far another calibration's directions are from these over the image, on a coarse grid."""
        selected = context.of(request)
        record, second = selected.record(at), selected.calibration(other, field_name="other")
        both = selected.archive.model(record.id), selected.archive.model(second.id)
        return _sent(_difference(*both, cells, (record.id, second.id)), if_none_match)


def _sent(answer: BaseModel, if_none_match: str | None) -> Response:
    return tagged(answer.model_dump_json().encode(), if_none_match)


def _overlay(context: ApiContext, time: datetime, *, past: datetime | None) -> Overlay:
    answering = context.calibration_or_none(past)
    camera = None if answering is None else answering[1].camera
    today = solar_date(time.timestamp(), longitude=context.site.longitude)
    days = [("today", today), *((name, date(today.year, month, day)) for name, month, day in _SOLSTICES)]
    paths = [(name, track_of(context, day, step_s=_PATH_STEP_S, past=past)) for name, day in days]
    return Overlay(
        calibration=None if answering is None else answering[0].id,
        image_size=None if camera is None else [camera.width, camera.height],
        zenith_circles=[] if camera is None else _circles(camera),
        azimuth_lines=[] if camera is None else _lines(camera),
        sun_paths=[SunPath(name=name, **path.model_dump()) for name, path in paths],
    )


def _circles(camera: Camera) -> list[ZenithCircle]:
    return [
        ZenithCircle(zenith_deg=zenith, pixels=_drawn(camera, np.full_like(_AROUND_DEG, zenith), _AROUND_DEG))
        for zenith in _CIRCLES_DEG
    ]


def _lines(camera: Camera) -> list[AzimuthLine]:
    return [
        AzimuthLine(
            azimuth_deg=azimuth,
            name=_NAMES.get(azimuth),
            pixels=_drawn(camera, _OUTWARDS_DEG, np.full_like(_OUTWARDS_DEG, azimuth)),
        )
        for azimuth in range(0, 360, 30)
    ]


def _drawn(camera: Camera, zenith_deg: FloatArray, azimuth_deg: FloatArray) -> list[list[float] | None]:
    pixels = project(camera, direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=azimuth_deg))
    return [[round(x, 2), round(y, 2)] if math.isfinite(x + y) else None for x, y in pixels.tolist()]


def _uncertainty(calibration: Calibration, cells: int, calibration_id: str) -> Uncertainty:
    x, y, pixels = _grid(calibration.camera, cells)
    with np.errstate(all="ignore"):  # what lies outside the field is answered with null
        _, sigma, inside = unproject_with_sigma(calibration, pixels)
    rows = np.where(inside, sigma, np.nan).reshape(len(y), len(x))
    return Uncertainty(calibration=calibration_id, x_px=x.tolist(), y_px=y.tolist(), sigma_deg=_finite(rows))


def _difference(calibration: Calibration, other: Calibration, cells: int, ids: tuple[str, str]) -> Difference:
    sizes = [(one.camera.width, one.camera.height) for one in (calibration, other)]
    if sizes[0] != sizes[1]:
        problem = f"is of an image of {sizes[1][0]}x{sizes[1][1]} px, {ids[0]} of {sizes[0][0]}x{sizes[0][1]}"
        raise InputError(field="other", problem=problem, remedy="choose one of the same size")
    x, y, pixels = _grid(calibration.camera, cells)
    with np.errstate(all="ignore"):
        (first, _, in_first), (second, _, in_second) = (unproject_with_sigma(o, pixels) for o in (calibration, other))
    seen = in_first & in_second & np.all(np.isfinite(first + second), axis=-1)
    angles = np.full(len(pixels), np.nan)
    angles[seen] = np.degrees(angular_distance(first[seen], second[seen]))
    answer = Difference(
        calibration=ids[0],
        other=ids[1],
        x_px=x.tolist(),
        y_px=y.tolist(),
        difference_deg=_finite(angles.reshape(len(y), len(x))),
        rms_deg=None,
        max_deg=None,
        rotation_deg=None,
        rms_rotated_deg=None,
    )
    if np.count_nonzero(seen) < _FEWEST:
        return answer
    turn, _ = Rotation.align_vectors(first[seen], second[seen])
    left = np.degrees(angular_distance(first[seen], turn.apply(second[seen])))
    numbers = {
        "rms_deg": float(np.sqrt(np.mean(angles[seen] ** 2))),
        "max_deg": float(np.max(angles[seen])),
        "rotation_deg": turn.as_rotvec(degrees=True).tolist(),
        "rms_rotated_deg": float(np.sqrt(np.mean(left**2))),
    }
    return answer.model_copy(update=numbers)


def _grid(camera: Camera, cells: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x and y of the centres of square cells over the image, and all of them as pixels (n, 2)."""
    step = max(camera.width, camera.height) / cells
    x: FloatArray = (np.arange(math.ceil(camera.width / step), dtype=np.float64) + 0.5) * step - 0.5
    y: FloatArray = (np.arange(math.ceil(camera.height / step), dtype=np.float64) + 0.5) * step - 0.5
    return x, y, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _finite(rows: FloatArray) -> list[list[float | None]]:
    return [[value if math.isfinite(value) else None for value in row] for row in rows.tolist()]
