"""Routes: lines that a page draws over an image, computed here so that it need not know any lens."""

from __future__ import annotations

import math
from datetime import date, datetime
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from pydantic import BaseModel, Field
from scipy.spatial.transform import Rotation

from sunarc.calibration.answers.covariance import sky_share_within, unproject_with_sigma
from sunarc.calibration.answers.least_certain import find_least_certain
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.imager.archive.values import CalibrationRecord
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.parameters import BY_CALIBRATION, Answers, At, IfNoneMatch, Pair, Size
from sunarc.imager.web.problems import Responses, answers
from sunarc.imager.web.routes.calibrations import tagged
from sunarc.imager.web.routes.sun import compute_sun_track
from sunarc.imager.web.schemas import SunTrack
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.days import solar_date
from sunarc.sky.directions import angular_distance, direction_from_angles


class ZenithCircle(BaseModel):
    """All directions of one apparent zenith angle, as a line in the image."""

    zenith_deg: float = Field(description="Apparent zenith angle, degrees; 90 is the horizon.", examples=[60.0])
    pixels: list[Pair | None] = Field(
        description="x, y in px from north over east; null outside the field.", examples=[[[400.0, 912.5], None]]
    )


class AzimuthLine(BaseModel):
    """All directions of one azimuth, from near the zenith to the horizon, as a line in the image."""

    azimuth_deg: float = Field(description="Degrees clockwise from north.", examples=[90.0])
    name: str | None = Field(description="N, E, S or W; null between them.", examples=["E"])
    pixels: list[Pair | None] = Field(
        description="x, y in px, from the zenith outwards; null outside the field.", examples=[[[400.0, 912.5], None]]
    )


class SunPath(SunTrack):
    """The sun's path through one day, with its name."""

    name: str = Field(description="today, june solstice or december solstice.", examples=["today"])


class Overlay(BaseModel):
    """Lines to draw over an image; without a calibration there are only the sun's angles."""

    calibration: str | None = Field(description="Id of the calibration that answered.", examples=["20130514T150508Z"])
    image_size: Size | None = Field(description="Width, height of the camera's image, px.", examples=[[1748, 1748]])
    zenith_circles: list[ZenithCircle] = Field(description="At 30, 60 and 90 degrees.")
    azimuth_lines: list[AzimuthLine] = Field(description="Every 30 degrees.")
    sun_paths: list[SunPath] = Field(description="Of today and of both solstices of the year.")


class UncertainPart(BaseModel):
    """Part of the visible sky with a 1-sigma above the limit, and the sightings that reduce it."""

    text: str = Field(description="Where it is.", examples=["towards the north, below 20° of elevation"])
    remedy: str = Field(
        description="Which sightings improve it.",
        examples=["it improves with sightings of the sun there, today from 11:40 to 13:05 UTC"],
    )
    elevation_from_deg: float = Field(description="Lowest elevation, degrees; 0 at the horizon.", examples=[0.0])
    elevation_to_deg: float = Field(description="Highest elevation, degrees; 90 at the zenith.", examples=[20.0])


class Uncertainty(BaseModel):
    """1-sigma of directions over the image, on a coarse grid of square cells."""

    calibration: str = Field(description="Id of the calibration that answered.", examples=["20130514T150508Z"])
    x_px: list[float] = Field(description="Of the cells' centres, px.", examples=[[18.0, 54.5]])
    y_px: list[float] = Field(description="Of the cells' centres, px.", examples=[[18.0, 54.5]])
    sigma_deg: list[Answers] = Field(
        description="1-sigma per axis on the sphere, degrees; a row for each y; null outside the field.",
        examples=[[[None, 0.004], [0.004, 0.003]]],
    )
    limit_deg: float = Field(description="1-sigma beyond which a fit is refused over the sky, degrees.", examples=[1.5])
    share_within: float | None = Field(
        description="Share of the sky seen whose 1-sigma is at most `limit_deg`; null where no sky is seen.",
        examples=[0.97],
    )
    least_certain: UncertainPart | None = Field(description="The rest of the sky seen; null without one.")


class Difference(BaseModel):
    """Angle between the directions of two calibrations over the image, on a coarse grid of cells."""

    calibration: str = Field(description="Id of the calibration that answered.", examples=["20130514T150508Z"])
    other: str = Field(description="Id of the one it is compared with.", examples=["20130513T150508Z"])
    x_px: list[float] = Field(description="Of the cells' centres, px.", examples=[[18.0, 54.5]])
    y_px: list[float] = Field(description="Of the cells' centres, px.", examples=[[18.0, 54.5]])
    difference_deg: list[Answers] = Field(
        description="Angle between the directions of a pixel, degrees; a row for each y; null outside either's field.",
        examples=[[[None, 0.004], [0.004, 0.003]]],
    )
    rms_deg: float | None = Field(description="Over the cells, degrees; null where they share none.", examples=[0.004])
    max_deg: float | None = Field(description="At most, degrees; null where they share none.", examples=[0.011])
    rotation_deg: list[float] | None = Field(
        description="Rotation about east, north and up that brings the other's directions closest to these, degrees; "
        "null where they share none.",
        examples=[[0.003, -0.001, 0.002]],
    )
    rms_rotated_deg: float | None = Field(
        description="What is left by that rotation: of the lens, RMS, degrees.", examples=[0.002]
    )


_LIMIT_DEG = CalibrationOptions().max_sky_deg
"""1-sigma that a fit may have over the sky, degrees."""
_CIRCLES_DEG = (30.0, 60.0, 90.0)
_NAMES = {0: "N", 90: "E", 180: "S", 270: "W"}
_AROUND_DEG = np.arange(0.0, 361.0, 3.0)
_OUTWARDS_DEG = np.arange(6.0, 90.1, 3.0)
_PATH_STEP_S = 300
_FEWEST = 3
"""Directions that a rotation is taken from."""
_Cells = Annotated[int, Query(ge=4, le=96, description="Cells along the image's longer side.")]
_SOLSTICES = (("june solstice", 6, 21), ("december solstice", 12, 21))


def _describe_responses(model: type[BaseModel]) -> Responses:
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
        responses=_describe_responses(Overlay) | answers(404, 422),
        response_model=Overlay,
    )
    def overlay(request: Request, at: At = None, if_none_match: IfNoneMatch = None) -> Response:
        """Return lines to draw over an image: zenith angles, azimuths, the sun's paths of today and the solstices."""
        selected = context.of(request)
        return _send_answer(_make_overlay(selected, at or selected.frame_clock(), past=at), if_none_match)

    @routes.get(
        "/uncertainty",
        dependencies=BY_CALIBRATION,
        responses=_describe_responses(Uncertainty) | answers(404, 422),
        response_model=Uncertainty,
    )
    def uncertainty(
        request: Request,
        at: At = None,
        cells: _Cells = 48,
        if_none_match: IfNoneMatch = None,
    ) -> Response:
        """Return the 1-sigma of directions over the image, on a coarse grid."""
        selected = context.of(request)
        record = selected.record(at)
        return _send_answer(_make_uncertainty(selected, record, cells, at or selected.frame_clock()), if_none_match)

    _add_difference(routes, context)
    return routes


def _add_difference(routes: APIRouter, context: ApiContext) -> None:
    @routes.get(
        "/difference",
        dependencies=BY_CALIBRATION,
        responses=_describe_responses(Difference) | answers(404, 422),
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
        """Return the angle between the directions of two calibrations over the image, on a coarse grid."""
        selected = context.of(request)
        record, second = selected.record(at), selected.calibration(other, field_name="other")
        both = selected.ages.model(record), selected.ages.model(second)
        return _send_answer(_make_difference(*both, cells, (record.id, second.id)), if_none_match)


def _send_answer(answer: BaseModel, if_none_match: str | None) -> Response:
    return tagged(answer.model_dump_json().encode(), if_none_match)


def _make_overlay(context: ApiContext, time: datetime, *, past: datetime | None) -> Overlay:
    answering = context.calibration_or_none(past)
    camera = None if answering is None else answering[1].camera
    today = solar_date(time.timestamp(), longitude=context.site.longitude)
    days = [("today", today), *((name, date(today.year, month, day)) for name, month, day in _SOLSTICES)]
    paths = [(name, compute_sun_track(context, day, step_s=_PATH_STEP_S, past=past)) for name, day in days]
    return Overlay(
        calibration=None if answering is None else answering[0].id,
        image_size=None if camera is None else [camera.width, camera.height],
        zenith_circles=[] if camera is None else _draw_zenith_circles(camera),
        azimuth_lines=[] if camera is None else _draw_azimuth_lines(camera),
        sun_paths=[SunPath(name=name, **path.model_dump()) for name, path in paths],
    )


def _draw_zenith_circles(camera: Camera) -> list[ZenithCircle]:
    return [
        ZenithCircle(zenith_deg=zenith, pixels=_draw_line(camera, np.full_like(_AROUND_DEG, zenith), _AROUND_DEG))
        for zenith in _CIRCLES_DEG
    ]


def _draw_azimuth_lines(camera: Camera) -> list[AzimuthLine]:
    return [
        AzimuthLine(
            azimuth_deg=azimuth,
            name=_NAMES.get(azimuth),
            pixels=_draw_line(camera, _OUTWARDS_DEG, np.full_like(_OUTWARDS_DEG, azimuth)),
        )
        for azimuth in range(0, 360, 30)
    ]


def _draw_line(camera: Camera, zenith_deg: FloatArray, azimuth_deg: FloatArray) -> list[list[float] | None]:
    pixels = project(camera, direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=azimuth_deg))
    return [[round(x, 2), round(y, 2)] if math.isfinite(x + y) else None for x, y in pixels.tolist()]


def _make_uncertainty(context: ApiContext, record: CalibrationRecord, cells: int, time: datetime) -> Uncertainty:
    calibration = context.ages.model(record)
    x, y, pixels = _make_grid(calibration.camera, cells)
    with np.errstate(all="ignore"):  # what lies outside the field is answered with null
        _, sigma, inside = unproject_with_sigma(calibration, pixels)
    rows = np.where(inside, sigma, np.nan).reshape(len(y), len(x))
    share = sky_share_within(calibration, _LIMIT_DEG)
    return Uncertainty(
        calibration=record.id,
        x_px=x.tolist(),
        y_px=y.tolist(),
        sigma_deg=_replace_nonfinite(rows),
        limit_deg=_LIMIT_DEG,
        share_within=share if math.isfinite(share) else None,
        least_certain=_describe_uncertain_part(context, calibration, time),
    )


def _describe_uncertain_part(context: ApiContext, calibration: Calibration, time: datetime) -> UncertainPart | None:
    part = find_least_certain(calibration, context.site, limit_deg=_LIMIT_DEG, unix_s=time.timestamp())
    if part is None:
        return None
    return UncertainPart(
        text=part.text,
        remedy=part.remedy(observes_stars=context.observes_stars),
        elevation_from_deg=part.from_deg,
        elevation_to_deg=part.to_deg,
    )


def _make_difference(calibration: Calibration, other: Calibration, cells: int, ids: tuple[str, str]) -> Difference:
    sizes = [(one.camera.width, one.camera.height) for one in (calibration, other)]
    if sizes[0] != sizes[1]:
        problem = f"is of an image of {sizes[1][0]}x{sizes[1][1]} px, {ids[0]} of {sizes[0][0]}x{sizes[0][1]}"
        raise InputError(field="other", problem=problem, remedy="choose one of the same size")
    x, y, pixels = _make_grid(calibration.camera, cells)
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
        difference_deg=_replace_nonfinite(angles.reshape(len(y), len(x))),
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


def _make_grid(camera: Camera, cells: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x and y of the centres of square cells over the image, and all of them as pixels (n, 2)."""
    step = max(camera.width, camera.height) / cells
    x: FloatArray = (np.arange(math.ceil(camera.width / step), dtype=np.float64) + 0.5) * step - 0.5
    y: FloatArray = (np.arange(math.ceil(camera.height / step), dtype=np.float64) + 0.5) * step - 0.5
    return x, y, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _replace_nonfinite(rows: FloatArray) -> list[list[float | None]]:
    return [[value if math.isfinite(value) else None for value in row] for row in rows.tolist()]
