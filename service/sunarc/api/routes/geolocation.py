"""Route: where clouds and their shadows are."""

from __future__ import annotations

from typing import Any

import numpy as np
from fastapi import APIRouter, Request
from fastapi.responses import Response

from sunarc.api.arrays import Rows, require_few
from sunarc.api.bulk import Answering, Computation, body_of, compute, parsed_body, row_responses
from sunarc.api.compute_slots import ComputeSlots
from sunarc.api.context import ApiContext
from sunarc.api.problems import answers
from sunarc.api.routes.directions import finite_rows
from sunarc.api.schemas.geolocation import GeolocateAnswer, GeolocateRequest
from sunarc.api.schemas.parameters import At
from sunarc.array_types import FloatArray
from sunarc.geolocation import Located, clouds, shadows
from sunarc.sky import sun_angles, sun_directions

_OF_ONE = (
    "east_m",
    "north_m",
    "up_m",
    "latitude",
    "longitude",
    "altitude",
    "sigma_m",
    "cov_ee_m2",
    "cov_en_m2",
    "cov_nn_m2",
)
LOCATED = (*_OF_ONE, *(f"shadow_{name}" for name in _OF_ONE))
"""Columns of the answer: a cloud and its shadow."""


def geolocation_routes(context: ApiContext, slots: ComputeSlots) -> APIRouter:
    """Return the route that tells where clouds are."""
    routes = APIRouter(tags=["directions"])

    @routes.post(
        "/geolocate",
        response_model=GeolocateAnswer,
        responses=row_responses(LOCATED) | answers(404, 408, 413, 415, 422),
        openapi_extra=body_of("GeolocateRequest", "(n, 3) x, y in px and the cloud base's height in m."),
    )
    async def geolocate(request: Request, at: At = None) -> Response:
        """Tell where clouds of a given height and their shadows are, now or at the moment `at`, and how sure."""
        return await compute(_GEOLOCATION, context, slots, request, at)

    return routes


def _read(body: bytes, most: int) -> FloatArray:
    request = parsed_body(GeolocateRequest, body)
    if request.points is not None:
        require_few(len(request.points), most=most, field="points")
        return np.array(request.points, dtype=np.float64).reshape(-1, 3)
    pixels = np.array(request.pixels or [], dtype=np.float64).reshape(-1, 2)
    require_few(len(pixels), most=most, field="pixels")
    return np.concatenate([pixels, np.full((len(pixels), 1), request.height_m)], axis=1)


def _locate(answering: Answering, points: Rows) -> Rows:
    site, exact = answering.context.site_at(answering.time), np.asarray(points, dtype=np.float64)
    directions = np.asarray(answering.ready.back_project(np.ascontiguousarray(exact[:, :2]))[:, 2:5], dtype=np.float64)
    with np.errstate(all="ignore"):  # what has no place is answered with null
        covariance = answering.ready.direction_covariance(np.ascontiguousarray(directions))
        cloud = clouds(directions, height_m=exact[:, 2], covariance=covariance, site=site)
        shadow = shadows(cloud, sun_directions(answering.time.timestamp(), site), site)
        return np.concatenate([_row(cloud), _row(shadow)], axis=1)


def _row(found: Located) -> FloatArray:
    spread = found.covariance_m2
    sigma = np.sqrt(0.5 * (spread[:, 0, 0] + spread[:, 1, 1]))
    position = found.geodetic
    columns = (
        position.latitude,
        position.longitude,
        position.altitude,
        sigma,
        spread[:, 0, 0],
        spread[:, 0, 1],
        spread[:, 1, 1],
    )
    row = np.concatenate([found.position_m, np.stack(columns, axis=-1)], axis=1)
    row[np.isnan(row[:, 0])] = np.nan
    return row


def _geolocation_json(answering: Answering, rows: Rows) -> dict[str, Any]:
    sun = sun_angles(answering.time.timestamp(), answering.context.site_at(answering.time))
    return {
        "time": answering.time,
        "sun": {"apparent_zenith": float(sun.apparent_zenith), "azimuth": float(sun.azimuth)},
        "cloud": _columns_by_name(rows[:, :10]),
        "shadow": _columns_by_name(rows[:, 10:]),
    }


def _columns_by_name(rows: Rows) -> dict[str, Any]:
    singles = {name: rows[:, k].tolist() for k, name in enumerate(_OF_ONE[:7])}
    spread = [None if row is None else [row[:2], row[1:]] for row in finite_rows(rows[:, 7:])]
    return singles | {"covariance_m2": spread}


_GEOLOCATION = Computation(
    read=_read, columns=(3,), answer=_locate, answer_columns=LOCATED, as_json=_geolocation_json, double=True
)
