"""Routes: where the sun is, where it goes, and where it was seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import date, datetime, timedelta
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query, Request

from sunarc.calibration.answers.covariance import sigma_px, sun_with_covariance
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray
from sunarc.common.utc import utc_time
from sunarc.imager.archive.values import SunPoint, field_values
from sunarc.imager.runtime.json_fields import SolarDate
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.parameters import BY_CALIBRATION, At, Cursor, Since, Until, page_at, row_limit
from sunarc.imager.web.problems import answers
from sunarc.imager.web.schemas import Residual, SightingsByDay, Sun, SunPoints, SunPointWithResidual, SunTrack
from sunarc.optics.camera import Camera, camera_sees
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.sky.days import day_bounds_unix_s, solar_date
from sunarc.sky.directions import angles_from_direction, angular_distance, direction_from_angles
from sunarc.sky.night import SOLAR_SYSTEM_BODIES, STAR, SUN, body_directions
from sunarc.sky.site import EARTH_RATE, Site, pole_enu
from sunarc.sky.sun import sun_angles, sun_directions

_HORIZON_DEG = 90.0
_ALL = "all"
_SPEED_OVER_RAD = 1e-3
"""Rotation over which the speed of an image is taken, radians: its path is straight to a thousandth of its length."""
_NAMES = rf"^({SUN}|{'|'.join(SOLAR_SYSTEM_BODIES)}|{STAR}\d{{1,6}}|{_ALL})$"
_DAYS, _MOST_DAYS = 30, 366
"""Of counts by day: unless asked, and at most: a year has a million looks, which are counted in seconds."""

Body = Annotated[
    str,
    Query(
        pattern=_NAMES,
        description="Of which body: `sun`, `moon`, a planet, `star:HIP` and a number, or `all`.",
        examples=["star:HIP32349"],
    ),
]


def sun_routes(context: ApiContext) -> APIRouter:
    """Return the routes of the sun."""
    routes = APIRouter(tags=["sun"])

    @routes.get("/sun", dependencies=BY_CALIBRATION, responses=answers(404, 422))
    def sun(request: Request, at: At = None) -> Sun:
        """Return the sun's direction and its expected pixel, now (by the frames' time) or at the time `at`."""
        return _make_sun(context.of(request), at or context.frame_clock(), past=at)

    @routes.get("/sun/track", dependencies=BY_CALIBRATION, responses=answers(404, 422))
    def sun_track(
        *,
        request: Request,
        date: Annotated[
            SolarDate | None, Query(description="Local mean solar date; today's by the frames' time where not given.")
        ] = None,
        step_s: Annotated[int, Query(ge=10, le=3600, description="Seconds.")] = 120,
        at: At = None,
    ) -> SunTrack:
        """Return the sun's path through a solar day: that of `date`, of the time `at`, or today by the frames' time.

        The pixels are by the current calibration, or by the one that was valid at `at`.
        """
        selected = context.of(request)
        day = date or solar_date((at or context.frame_clock()).timestamp(), longitude=selected.site.longitude)
        return compute_sun_track(selected, day, step_s=step_s, past=at)

    _add_sighting_routes(routes, context)
    return routes


def _add_counts(routes: APIRouter, context: ApiContext) -> None:
    @routes.get("/sun-points/days", responses=answers(422))
    def sightings_by_day(
        *,
        request: Request,
        since: Annotated[
            SolarDate | None, Query(description="From this date on; the last 30 days where not given.")
        ] = None,
        until: Annotated[SolarDate | None, Query(description="Before this date; tomorrow where not given.")] = None,
    ) -> SightingsByDay:
        """Return the number of detections per day, by verdict, and the maximum clock error, of 366 days at most."""
        selected = context.of(request)
        longitude = selected.site.longitude
        end = until or solar_date(context.frame_clock().timestamp(), longitude=longitude) + timedelta(days=1)
        longest = timedelta(days=_DAYS if since is None else _MOST_DAYS)
        begin = max(since or date.min, end - longest)
        counts = selected.archive.sightings.by_day(selected.camera, longitude=longitude, since=begin, until=end)
        return SightingsByDay(days=list(counts))


def _add_sighting_routes(routes: APIRouter, context: ApiContext) -> None:
    """Add the routes that list and count sightings."""

    @routes.get("/sun-points", responses=answers(422))
    def sun_points(
        *,
        request: Request,
        since: Since = None,
        until: Until = None,
        accepted: Annotated[
            bool | None, Query(description="Only the accepted, or the rejected; both where not given.", examples=[True])
        ] = None,
        body: Body = SUN,
        residuals: Annotated[bool, Query(description="Add sighting minus current calibration.")] = False,
        limit: Annotated[int, row_limit()] = 1000,
        cursor: Cursor = None,
    ) -> SunPoints:
        """Return the sightings with since <= time < until, the newest first, the rejected ones with their reason."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = selected.archive.sightings.find(
            selected.camera,
            since=since,
            until=page.until(until),
            accepted=accepted,
            body=None if body == _ALL else body,
            newest_first=True,
            limit=page.rows,
        )
        rows, next_ = page.cut(found, request, time=lambda point: point.time)
        return _make_sun_points(selected, rows, residuals=residuals, next_=next_)

    _add_counts(routes, context)


def _make_sun(context: ApiContext, time: datetime, *, past: datetime | None) -> Sun:
    site = context.site_with_air_at(time)
    angles = sun_angles(time.timestamp(), site)
    direction = direction_from_angles(zenith_deg=angles.apparent_zenith, azimuth_deg=angles.azimuth)
    answering = context.calibration_or_none(past)
    pixel, sigma, inside = None, None, False
    if answering is not None:
        measured = site != context.site
        pixels, covariance = sun_with_covariance(answering[1], direction[None], site=site, measured=measured)
        if np.all(np.isfinite(pixels)):
            speed = _compute_sky_speed_px_s(answering[1].camera, direction[None], site)
            clock_px = 0.0 if past else _read_clock_error_s(context) * float(speed[0])
            pixel, sigma = pixels[0].tolist(), math.hypot(float(sigma_px(covariance)[0]), clock_px)
            inside = bool(camera_sees(answering[1].camera, pixels)[0])
    return Sun(
        time=time,
        apparent_zenith=float(angles.apparent_zenith),
        zenith=float(angles.zenith),
        azimuth=float(angles.azimuth),
        direction_enu=direction.tolist(),
        pixel=pixel,
        sigma_px=sigma,
        inside=inside,
        calibration=None if answering is None else answering[0].id,
    )


def _read_clock_error_s(context: ApiContext) -> float:
    """Return the bound on the error of the present time, s; 0 where it is not known."""
    clock = context.status().clock
    return 0.0 if clock is None or clock.max_error_s is None else clock.max_error_s


def _compute_sky_speed_px_s(camera: Camera, directions: FloatArray, site: Site) -> FloatArray:
    """Return how fast the earth's rotation moves the images of directions (n, 3), px/s (n,); 0 beyond the field."""
    turned = directions - _SPEED_OVER_RAD * np.cross(pole_enu(site), directions)
    moved = project(camera, turned / np.linalg.norm(turned, axis=1, keepdims=True)) - project(camera, directions)
    return np.asarray(np.nan_to_num(np.hypot(*moved.T)) * (EARTH_RATE / _SPEED_OVER_RAD))


def compute_sun_track(context: ApiContext, day: date, *, step_s: int, past: datetime | None = None) -> SunTrack:
    """Return the sun's way through a solar day, by the current calibration or the one of a moment in the `past`."""
    start, end = day_bounds_unix_s(day, longitude=context.site.longitude)
    unix_s = np.arange(math.ceil(start / step_s) * step_s, end, step_s)
    angles = sun_angles(unix_s, context.site_in_measured_air(day))
    up = angles.apparent_zenith <= _HORIZON_DEG
    zenith, azimuth = angles.apparent_zenith[up], angles.azimuth[up]
    answering = context.calibration_or_none(past)
    if answering is None:
        pixels = np.full((len(zenith), 2), np.nan)
    else:
        pixels = project(answering[1].camera, direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth))
    return SunTrack(
        date=day,
        time=[utc_time(float(s)) for s in unix_s[up]],
        apparent_zenith=zenith.tolist(),
        azimuth=azimuth.tolist(),
        pixels=[[x, y] if np.isfinite(x + y) else None for x, y in pixels.tolist()],
        calibration=None if answering is None else answering[0].id,
    )


def _make_sun_points(
    context: ApiContext, found: Sequence[SunPoint], *, residuals: bool, next_: str | None
) -> SunPoints:
    answering = context.calibration_or_none(None) if residuals else None
    residual_rows: list[Residual | None] = [None] * len(found)
    if answering is not None:
        residual_rows = _compute_residuals(answering[1], context, found)
    return SunPoints(
        sun_points=[
            SunPointWithResidual(**field_values(point), residual=residual)
            for point, residual in zip(found, residual_rows, strict=True)
        ],
        next=next_,
        calibration=None if answering is None else answering[0].id,
    )


def _compute_residuals(
    calibration: Calibration, context: ApiContext, points: Sequence[SunPoint]
) -> list[Residual | None]:
    """Return the residual of each sighting; None without a pixel, or where the calibration has no pixel for the sun."""
    unix_s = np.array([point.time.timestamp() for point in points])
    observed = np.array([(point.x_px, point.y_px) for point in points], dtype=np.float64).reshape(-1, 2)
    temperature, pressure = context.archive.days.sighting_air(context.camera, points)
    sun = sun_directions(unix_s, context.site, temperature=temperature, pressure=pressure)
    body = np.array([point.body for point in points])
    of_sun = (body == SUN)[:, None]
    others = body_directions(body, unix_s, context.site, temperature=temperature, pressure=pressure)
    directions = np.where(of_sun, sun, others)
    zenith_deg, azimuth_deg = angles_from_direction(directions)
    off_px = observed - project(calibration.camera, directions)
    measured = bool(np.all(np.isfinite(temperature + pressure)))
    _, covariance = sun_with_covariance(calibration, directions, site=context.site, measured=measured)
    own = np.array([np.nan if point.sigma_px is None else point.sigma_px for point in points])
    clock_s = np.array([point.clock_error_s or 0.0 for point in points])
    clock_px = clock_s * _compute_sky_speed_px_s(calibration.camera, directions, context.site)
    sigma = np.sqrt(own**2 + sigma_px(covariance) ** 2 + clock_px**2).tolist()
    off_deg = np.degrees(angular_distance(unproject(calibration.camera, observed), directions))
    return [
        None
        if not np.isfinite(x + y)
        else Residual(
            x_px=x,
            y_px=y,
            distance_px=float(np.hypot(x, y)),
            distance_deg=float(angle) if np.isfinite(angle) else None,
            sigma_px=spread if math.isfinite(spread) else None,
            apparent_zenith=float(zenith),
            azimuth=float(azimuth),
        )
        for (x, y), angle, spread, zenith, azimuth in zip(
            off_px.tolist(), off_deg, sigma, zenith_deg, azimuth_deg, strict=True
        )
    ]
