"""Route of the hub: the height of what two cameras see."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Path
from pydantic import BaseModel, Field

from sunarc.api.context import ApiContext
from sunarc.api.problems import answers
from sunarc.api.schemas.parameters import Body, Number, Pixel
from sunarc.errors import InputError
from sunarc.geolocation.pair_height import View, pair_height
from sunarc.json_fields import Time, described

CameraName = Annotated[str, Path(min_length=1, max_length=100, description="Name of a camera.")]


class PairRequest(Body):
    """The same point of a cloud, as two cameras saw it at one time."""

    time: Annotated[Time, Field(description="Of both images: clouds move by metres in a second.")]
    pixel_a: Pixel
    pixel_b: Pixel


class PairAnswer(BaseModel):
    """Where the point is."""

    time: Time
    calibration_a: Annotated[str, described("Id of the first camera's calibration.", "20130514T150508Z-52ee44")]
    calibration_b: Annotated[str, described("Id of the second camera's calibration.", "20130514T150510Z-1f02ab")]
    height_m: Annotated[Number, described("Above the first camera's altitude, m.", 1502.3)]
    sigma_m: Annotated[Number, described("Its 1-sigma by both calibrations, m; the pixels are taken as exact.", 8.1)]
    latitude: Annotated[Number, described("Degrees, north positive, WGS 84.", 36.6012)]
    longitude: Annotated[Number, described("Degrees, east positive, WGS 84.", -97.4714)]
    altitude: Annotated[Number, described("Metres, on the same scale as the cameras'.", 1820.3)]
    east_m: Annotated[Number, described("East of the first camera, m.", 1204.1)]
    north_m: Annotated[Number, described("North of the first camera, m.", -310.7)]
    up_m: Annotated[Number, described("Above the first camera's horizontal plane, m.", 1502.1)]
    miss_m: Annotated[Number, described("How far the two rays pass one another, signed, m.", -3.1)]
    miss_sigma_m: Annotated[
        Number,
        described("1-sigma of that, m. A miss of many sigmas: other points, other times, or a camera turned.", 4.0),
    ]
    angle_deg: Annotated[Number, described("Between the rays, degrees.", 21.4)]


def pair_routes(context: ApiContext) -> APIRouter:
    """Return the route."""
    routes = APIRouter(tags=["directions"])

    @routes.post("/v1/pairs/{a}/{b}/height", responses=answers(404, 422))
    def height_of_pair(a: CameraName, b: CameraName, asked: PairRequest) -> PairAnswer:
        """Tell how high a point of a cloud is that two cameras see, with the error of both calibrations.

        422 where the rays are parallel within their errors, or move apart.
        """
        if a == b:
            raise InputError(field="b", problem="is the same camera", remedy="name two cameras")
        (first, calibration_a), (second, calibration_b) = (
            _view(context.named(name), asked.time, pixel, field)
            for name, pixel, field in ((a, asked.pixel_a, "pixel_a"), (b, asked.pixel_b, "pixel_b"))
        )
        found = pair_height(first, second)
        latitude, longitude, altitude = (float(column[0]) for column in found.geodetic[:3])
        east, north, up = found.position_m.tolist()
        return PairAnswer(
            time=asked.time,
            calibration_a=calibration_a,
            calibration_b=calibration_b,
            height_m=found.height_m,
            sigma_m=found.sigma_m,
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            east_m=east,
            north_m=north,
            up_m=up,
            miss_m=found.miss_m,
            miss_sigma_m=found.miss_sigma_m,
            angle_deg=found.angle_deg,
        )

    return routes


def _view(context: ApiContext, time: datetime, pixel: list[float], field: str) -> tuple[View, str]:
    """Return how a camera sees a pixel at a time, and the id of the calibration that says so."""
    record = context.record(time)
    ready = context.ready.get(record)
    with np.errstate(all="ignore"):  # what lies outside the field has no direction
        direction = np.asarray(ready.back_project(np.array([pixel], dtype=np.float64))[:, 2:5], dtype=np.float64)
        covariance = ready.direction_covariance(np.ascontiguousarray(direction))
    if not np.isfinite(covariance).all():
        raise InputError(field=field, problem="lies outside the camera's field", remedy="give a pixel of the sky")
    return View(site=context.site_at(time), direction=direction[0], covariance=covariance[0]), record.id
