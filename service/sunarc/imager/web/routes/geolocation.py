"""Route: where clouds and their shadows are."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Request
from fastapi.responses import Response
from pydantic import BaseModel, Field, model_validator

from sunarc.calibration.answers.cloud_positions import HIGHEST_CLOUD_M, cloud_positions
from sunarc.calibration.answers.error_model import Ensemble
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.errors import InputError
from sunarc.geolocation.locate import Located, clouds, shadows
from sunarc.imager.runtime.json_fields import Time, described
from sunarc.imager.web import bulk
from sunarc.imager.web.arrays import Rows, parsed_body
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.parameters import BY_CALIBRATION, Answers, At, Body, Draws, ListOf, Number, Pair, Pixel, Seed
from sunarc.imager.web.problems import answers
from sunarc.imager.web.routes.directions import finite_rows
from sunarc.sky.sun import sun_angles, sun_directions

Height = Annotated[
    Number, Field(gt=0.0, le=HIGHEST_CLOUD_M, description="Of the cloud base above the camera's altitude, m.")
]
HeightSigma = Annotated[
    Number, Field(ge=0.0, le=10_000.0, description="1-sigma of the height, the same error for all points, m.")
]
Point = Annotated[list[Number], Field(min_length=3, max_length=3, description="x, y in px, cloud base height in m.")]


class GeolocateRequest(Body):
    """Pixels and the height of the cloud base that they see: one for all (height_m), or one each (points)."""

    pixels: ListOf[Pixel] | None = Field(
        default=None, description="(n, 2) px; with height_m.", examples=[[[400.0, 912.5]]]
    )
    height_m: Height | None = Field(default=None, description="Of all pixels, m.", examples=[1500.0])
    points: ListOf[Point] | None = Field(
        default=None,
        description="(n, 3) px, px, metres (above 0, at most 30 000), in place of pixels and height_m.",
        examples=[[[400.0, 912.5, 1500.0]]],
    )

    height_sigma_m: HeightSigma = Field(default=0.0, examples=[100.0])
    at: ListOf[Time] | None = Field(
        default=None,
        description="A time for each point: it chooses the calibration and the sun; in place of the query's `at`, "
        "without draws.",
        examples=[["2013-05-13T18:30:00Z"]],
    )

    @model_validator(mode="after")
    def _one_way(self) -> GeolocateRequest:
        if (self.pixels is None, self.height_m is None) == (self.points is not None,) * 2:
            return self
        if self.pixels is not None and self.points is None:
            raise ValueError("has pixels without height_m; add height_m, the cloud's height above the camera in metres")
        raise ValueError("has not one way to a position; give pixels and height_m, or points")


class SunPlace(BaseModel):
    """Where the sun stands that casts the shadows."""

    apparent_zenith: float = Field(description="With refraction, degrees.", examples=[18.2])
    azimuth: float = Field(description="Degrees clockwise from north.", examples=[178.1])


class SunPlaces(BaseModel):
    """Where the sun stands at the time of each point."""

    apparent_zenith: list[float] = Field(description="With refraction, degrees.", examples=[[18.2]])
    azimuth: list[float] = Field(description="Degrees clockwise from north.", examples=[[178.1]])


class Each(BaseModel):
    """Calibration that answered for each point, where each has a time."""

    calibration: list[str] = Field(
        description="Ids of the calibrations that answered.", examples=[["20130514T150508Z-52ee44"]]
    )
    time: list[Time] = Field(description="The times that were asked for.", examples=[["2013-05-13T18:30:00Z"]])
    sun: SunPlaces = Field(description="Where the sun stands then, degrees.")


class Places(BaseModel):
    """Positions of clouds, or of their shadows. null without one."""

    east_m: Answers = Field(description="East of the camera, m.", examples=[[1204.1]])
    north_m: Answers = Field(description="North of the camera, m.", examples=[[-310.7]])
    up_m: Answers = Field(
        description="Above the camera's horizontal plane, m; less than the height far away.", examples=[[1499.8]]
    )
    latitude: Answers = Field(description="Degrees, north positive, WGS 84.", examples=[[36.6012]])
    longitude: Answers = Field(description="Degrees, east positive, WGS 84.", examples=[[-97.4714]])
    altitude: Answers = Field(description="Metres, on the same scale as the camera's.", examples=[[1818.0]])
    sigma_m: Answers = Field(
        description="1-sigma per axis on the ground, by the calibration and the height, m.", examples=[[0.2]]
    )
    covariance_m2: list[Annotated[list[Pair], Field(min_length=2, max_length=2)] | None] = Field(
        description="Covariance of east and north, by the calibration and the height, square metres.",
        examples=[[[[0.04, 0.0], [0.0, 0.04]]]],
    )


class PlaceDraws(BaseModel):
    """Positions of clouds, or shadows, for each draw, the first axis; null without one."""

    east_m: list[Answers] = Field(description="(draws, n) metres.", examples=[[[1204.1], [1204.5]]])
    north_m: list[Answers] = Field(description="(draws, n) metres.", examples=[[[-310.7], [-310.2]]])
    up_m: list[Answers] = Field(description="(draws, n) metres.", examples=[[[1499.8], [1499.8]]])
    latitude: list[Answers] = Field(description="(draws, n) degrees.", examples=[[[36.6012], [36.6012]]])
    longitude: list[Answers] = Field(description="(draws, n) degrees.", examples=[[[-97.4714], [-97.4714]]])
    altitude: list[Answers] = Field(description="(draws, n) metres.", examples=[[[1818.0], [1818.0]]])


class GeolocateDraws(BaseModel):
    """Clouds and shadows by each draw of the calibration and of the height."""

    cloud: PlaceDraws = Field(description="Where the clouds are.")
    shadow: PlaceDraws = Field(description="Where their shadows are.")


class GeolocateAnswer(BaseModel):
    """Where clouds and their shadows are."""

    calibration: Annotated[str, described("Id of the calibration that answered.", "20130514T150508Z-52ee44")]
    time: Time
    sun: SunPlace = Field(description="Where the sun stands, degrees.")
    cloud: Places = Field(description="Where the clouds are, metres and degrees.")
    shadow: Places = Field(description="Where their shadows are, metres and degrees.")
    draws: GeolocateDraws | None = Field(default=None, description="Present where draws were asked for.")
    each: Each | None = Field(
        default=None,
        description="Present where each point has a time; `calibration`, `time` and `sun` are then the first one's.",
    )


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
_TIME = 4
"""Column of the question that has the times, s since 1970."""
LOCATED = (*_OF_ONE, *(f"shadow_{name}" for name in _OF_ONE))
"""Columns of the answer: a cloud and its shadow."""


def geolocation_routes(context: ApiContext, slots: bulk.ComputeSlots) -> APIRouter:
    """Return the route of the positions of clouds."""
    routes = APIRouter(tags=["directions"], route_class=bulk.RowsRoute)

    @routes.post(
        "/geolocate",
        dependencies=BY_CALIBRATION,
        response_model=GeolocateAnswer,
        responses=bulk.row_responses(LOCATED) | answers(404, 408, 413, 415, 422, 503),
        openapi_extra=bulk.describe_body(
            "GeolocateRequest",
            "(n, 3) x, y in px, cloud base height in m, without a place where it is not above 0 and at most 30 000; "
            "(n, 4) with the height's 1-sigma in m; (n, 5) with that and a time for each point, s since 1970-01-01 UTC "
            "(float64).",
        ),
    )
    async def geolocate(request: Request, at: At = None, draws: Draws = 0, seed: Seed = 0) -> Response:
        """Return the positions of clouds of a given height and their shadows, now, at `at` or each at its own time."""
        question = bulk.Question(context=context, request=request, at=at, draws=draws, seed=seed)
        return await bulk.compute(_GEOLOCATION, slots, question)

    return routes


def _read_points(body: bytes, most: int) -> FloatArray:
    request = parsed_body(GeolocateRequest, body, most=most)
    if request.points is not None:
        points = np.array(request.points, dtype=np.float64).reshape(-1, 3)
        _require_heights(points[:, 2])
    else:
        pixels = np.array(request.pixels or [], dtype=np.float64).reshape(-1, 2)
        points = np.concatenate([pixels, np.full((len(pixels), 1), request.height_m)], axis=1)
    columns = [points, np.full((len(points), 1), request.height_sigma_m)]
    if request.at is not None:
        _require_each(len(request.at), len(points))
        columns.append(np.array([time.timestamp() for time in request.at], dtype=np.float64).reshape(-1, 1))
    return np.concatenate(columns, axis=1)


def _require_heights(height_m: FloatArray) -> None:
    """Refuse a height in a list as `height_m` is refused, and name its place."""
    valid = _are_heights(height_m)
    if not np.all(valid):
        place = int(np.argmin(valid))
        problem = f"a height of {height_m[place]:g} m is not above 0 and at most {HIGHEST_CLOUD_M:g}"
        raise InputError(field=f"points[{place}][2]", problem=problem, remedy="give the height of a cloud base in m")


def _are_heights(height_m: FloatArray) -> BoolArray:
    return (height_m > 0.0) & (height_m <= HIGHEST_CLOUD_M)


def _require_each(n_times: int, n_points: int) -> None:
    if n_times != n_points:
        problem, remedy = f"{n_times} times for {n_points} points", "give as many times as points"
        raise InputError(field="at", problem=problem, remedy=remedy)


def _locate_points(answering: bulk.Answering, points: Rows) -> Rows:
    exact = np.asarray(points, dtype=np.float64)
    if answering.each is None:
        return _locate_points_at(answering, exact, answering.time.timestamp())
    rows = np.empty((len(exact), len(LOCATED)))
    for one, at in answering.each.split(exact[:, _TIME]):
        rows[at] = _locate_points_at(one, exact[at], exact[at, _TIME])
    return rows


def _locate_points_at(answering: bulk.Answering, exact: FloatArray, unix_s: float | FloatArray) -> FloatArray:
    """Return the answer's rows for points that see the sun of one time, or each of its own, of one solar day."""
    site = answering.context.site_with_air_at(answering.time)
    exact = _check_heights(exact)
    cloud = cloud_positions(
        answering.ready, exact[:, :2], height_m=exact[:, 2], height_sigma_m=_get_height_sigma(exact), site=site
    )
    with np.errstate(all="ignore"):  # what has no place is answered with null
        shadow = shadows(cloud, sun_directions(unix_s, site), site)
        return np.concatenate([_make_row(cloud), _make_row(shadow)], axis=1)


def _check_heights(points: FloatArray) -> FloatArray:
    """Return points whose height is NaN where it cannot be a cloud's: an array's values are not refused one by one."""
    valid = _are_heights(points[:, 2])
    if not np.all(valid):
        points = points.copy()
        points[~valid, 2] = np.nan
    return points


def _get_height_sigma(points: FloatArray) -> FloatArray:
    """Return (n,): 1-sigma of the heights, m; 0 where none is given."""
    return points[:, 3] if points.shape[1] > 3 else np.zeros(len(points))


def _draw_places(answering: bulk.Answering, ensemble: Ensemble, draw: int, points: Rows) -> Rows:
    """Return (n, 12): clouds and shadows by one draw; its heights are off by one number of sigmas, all to one side."""
    site, exact = (
        answering.context.site_with_air_at(answering.time),
        _check_heights(np.asarray(points, dtype=np.float64)),
    )
    directions = ensemble.back_project(draw, exact[:, :2])
    height = exact[:, 2] + ensemble.common[draw] * _get_height_sigma(exact)
    with np.errstate(all="ignore"):  # what has no place is answered with null
        cloud = clouds(directions, height_m=height, covariance=np.zeros((len(exact), 3, 3)), site=site)
        shadow = shadows(cloud, sun_directions(answering.time.timestamp(), site), site)
        return np.concatenate([_make_row(cloud)[:, :6], _make_row(shadow)[:, :6]], axis=1)


def _place_draws_json(_answering: bulk.Answering, drawn: Rows) -> dict[str, Any]:
    parts = {"cloud": drawn[..., :6], "shadow": drawn[..., 6:]}
    return {part: {name: rows[..., k].tolist() for k, name in enumerate(_OF_ONE[:6])} for part, rows in parts.items()}


def _make_row(found: Located) -> FloatArray:
    spread = found.covariance_m2
    position = found.geodetic
    columns = (
        position.latitude,
        position.longitude,
        position.altitude,
        found.sigma_m,
        spread[:, 0, 0],
        spread[:, 0, 1],
        spread[:, 1, 1],
    )
    row = np.concatenate([found.position_m, np.stack(columns, axis=-1)], axis=1)
    row[np.isnan(row[:, 0])] = np.nan
    return row


def _geolocation_json(answering: bulk.Answering, rows: Rows) -> dict[str, Any]:
    sun = sun_angles(answering.time.timestamp(), answering.context.site_with_air_at(answering.time))
    each = {} if answering.each is None else {"each": _each_json(answering.each)}
    return {
        "time": answering.time,
        "sun": {"apparent_zenith": float(sun.apparent_zenith), "azimuth": float(sun.azimuth)},
        "cloud": _columns_by_name(rows[:, :10]),
        "shadow": _columns_by_name(rows[:, 10:]),
        **each,
    }


def _each_json(each: bulk.Timeline) -> dict[str, Any]:
    zenith, azimuth = np.empty((2, len(each.asked)))
    for one, at in each.split(each.asked):
        sun = sun_angles(each.asked[at], one.context.site_with_air_at(one.time))
        zenith[at], azimuth[at] = sun.apparent_zenith, sun.azimuth
    return {
        "calibration": each.point_calibrations(),
        "time": [bulk.moment(time) for time in each.asked.tolist()],
        "sun": {"apparent_zenith": zenith.tolist(), "azimuth": azimuth.tolist()},
    }


def _columns_by_name(rows: Rows) -> dict[str, Any]:
    singles = {name: rows[:, k].tolist() for k, name in enumerate(_OF_ONE[:7])}
    spread = [None if row is None else [row[:2], row[1:]] for row in finite_rows(rows[:, 7:])]
    return singles | {"covariance_m2": spread}


_GEOLOCATION = bulk.Computation(
    read=_read_points,
    columns=(3, 4, _TIME + 1),
    answer=bulk.RowTable(columns=LOCATED, compute=_locate_points, as_json=_geolocation_json),
    drawn=bulk.RowTable(
        columns=(*_OF_ONE[:6], *(f"shadow_{name}" for name in _OF_ONE[:6])),
        compute=_draw_places,
        as_json=_place_draws_json,
    ),
    time_column=_TIME,
)
