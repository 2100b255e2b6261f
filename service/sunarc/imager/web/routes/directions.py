"""Routes: from pixels to directions and back, one or a million at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from fastapi import APIRouter, Request
from fastapi.responses import Response

from sunarc.calibration.answers.direction_table import BACK_PROJECTED, PROJECTED
from sunarc.calibration.answers.error_model import Ensemble
from sunarc.common.array_types import FloatArray
from sunarc.imager.web.arrays import Rows, parsed_body
from sunarc.imager.web.bulk import (
    Answering,
    Computation,
    ComputeSlots,
    Question,
    RowsRoute,
    RowTable,
    compute,
    describe_body,
    row_responses,
)
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.parameters import BY_CALIBRATION, At, Draws, Seed
from sunarc.imager.web.problems import answers
from sunarc.imager.web.schemas import BackProjectAnswer, BackProjectRequest, ProjectAnswer, ProjectRequest
from sunarc.sky.directions import angles_from_direction, direction_from_angles, unit_vectors


def direction_routes(context: ApiContext, slots: ComputeSlots) -> APIRouter:
    """Return the routes that compute."""
    routes = APIRouter(tags=["directions"], route_class=RowsRoute)
    failures = answers(404, 408, 413, 415, 422, 503)

    @routes.post(
        "/back-project",
        dependencies=BY_CALIBRATION,
        response_model=BackProjectAnswer,
        responses=row_responses(BACK_PROJECTED) | failures,
        openapi_extra=describe_body("BackProjectRequest", "(n, 2) x and y in px."),
    )
    async def back_project(request: Request, at: At = None, draws: Draws = 0, seed: Seed = 0) -> Response:
        """Return the directions of pixels, with their uncertainty, now or at the time `at`."""
        question = Question(context=context, request=request, at=at, draws=draws, seed=seed)
        return await compute(_BACK_PROJECTION, slots, question)

    @routes.post(
        "/project",
        dependencies=BY_CALIBRATION,
        response_model=ProjectAnswer,
        responses=row_responses(PROJECTED) | failures,
        openapi_extra=describe_body("ProjectRequest", "(n, 3) vectors, east-north-up, of any length but 0."),
    )
    async def project(request: Request, at: At = None, draws: Draws = 0, seed: Seed = 0) -> Response:
        """Return the pixels of directions, with their uncertainty, now or at the time `at`."""
        question = Question(context=context, request=request, at=at, draws=draws, seed=seed)
        return await compute(_PROJECTION, slots, question)

    return routes


def read_pixels(body: bytes, most: int) -> FloatArray:
    """Return the pixels (n, 2) that a JSON body holds."""
    pixels = parsed_body(BackProjectRequest, body, most=most).pixels
    return np.array(pixels, dtype=np.float64).reshape(-1, 2)


def finite_rows(rows: Rows) -> list[Any]:
    """Return rows as lists, None for one that holds no number."""
    if np.all(np.isfinite(rows)):
        return list(rows.tolist())
    is_finite = np.all(np.isfinite(rows), axis=1)
    return [row if finite else None for row, finite in zip(rows.tolist(), is_finite, strict=True)]


def _directions_json(_answering: Answering, rows: Rows) -> dict[str, Any]:
    return {
        "zenith_deg": rows[:, 0].tolist(),
        "azimuth_deg": rows[:, 1].tolist(),
        "direction_enu": finite_rows(rows[:, 2:5]),
        "sigma_deg": rows[:, 5].tolist(),
        "inside": (rows[:, 6] == 1.0).tolist(),
    }


def _read_directions(body: bytes, most: int) -> FloatArray:
    request = parsed_body(ProjectRequest, body, most=most, named="directions")
    if request.direction_enu is not None:
        return np.array(request.direction_enu, dtype=np.float64).reshape(-1, 3)
    return direction_from_angles(zenith_deg=request.zenith_deg or [], azimuth_deg=request.azimuth_deg or [])


def _back_project(answering: Answering, pixels: Rows) -> Rows:
    return answering.ready.back_project(pixels)


def _project(answering: Answering, vectors: Rows) -> Rows:
    return answering.ready.project(unit_vectors(vectors))


def _draw_directions(_answering: Answering, ensemble: Ensemble, draw: int, pixels: Rows) -> Rows:
    directions = ensemble.back_project(draw, np.asarray(pixels, dtype=np.float64))
    angles = np.stack(angles_from_direction(directions), axis=-1)
    return _as_precise(np.concatenate([angles, directions], axis=1), pixels)


def _draw_pixels(_answering: Answering, ensemble: Ensemble, draw: int, vectors: Rows) -> Rows:
    return _as_precise(ensemble.project(draw, unit_vectors(np.asarray(vectors, dtype=np.float64))), vectors)


def _as_precise(rows: FloatArray, question: Rows) -> Rows:
    """Return rows in the precision of the question."""
    return rows.astype(np.float32) if question.dtype == np.float32 else rows


def _direction_draws_json(_answering: Answering, drawn: Rows) -> dict[str, Any]:
    return {
        "zenith_deg": drawn[..., 0].tolist(),
        "azimuth_deg": drawn[..., 1].tolist(),
        "direction_enu": [finite_rows(rows[:, 2:5]) for rows in drawn],
    }


def _pixel_draws_json(_answering: Answering, drawn: Rows) -> dict[str, Any]:
    return {"pixels": [finite_rows(rows) for rows in drawn]}


def _pixels_json(_answering: Answering, rows: Rows) -> dict[str, Any]:
    covariance = [None if row is None else [row[:2], row[1:]] for row in finite_rows(rows[:, 3:6])]
    return {
        "pixels": finite_rows(rows[:, :2]),
        "sigma_px": rows[:, 2].tolist(),
        "covariance_px2": covariance,
        "inside": (rows[:, 6] == 1.0).tolist(),
    }


_BACK_PROJECTION = Computation(
    read=read_pixels,
    columns=(2,),
    answer=RowTable(columns=BACK_PROJECTED, compute=_back_project, as_json=_directions_json),
    drawn=RowTable(columns=BACK_PROJECTED[:5], compute=_draw_directions, as_json=_direction_draws_json),
)
_PROJECTION = Computation(
    read=_read_directions,
    columns=(3,),
    answer=RowTable(columns=PROJECTED, compute=_project, as_json=_pixels_json),
    drawn=RowTable(columns=PROJECTED[:2], compute=_draw_pixels, as_json=_pixel_draws_json),
)
