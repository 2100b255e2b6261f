"""Routes: the measured air of a solar day, which the refraction of that day's sun is computed with."""

from __future__ import annotations

from datetime import timedelta
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request

from sunarc.api.context import ApiContext
from sunarc.api.middleware.authentication import require_write_token
from sunarc.api.problems import answers
from sunarc.api.schemas.record import DayAirIn, DayAirOut
from sunarc.archive.values import DayAir
from sunarc.json_fields import SolarDate

Day = Annotated[SolarDate, Path(description="Local mean solar date.", examples=["2013-05-13"])]


def day_air_routes(context: ApiContext) -> APIRouter:
    """Return the routes that take and answer the measured air of days."""
    routes = APIRouter(prefix="/days/{date}/air", tags=["record"])

    @routes.get("", responses=answers(422))
    def day_air(request: Request, date: Day) -> DayAirOut:
        """Answer the measured air of a solar day; nulls where nothing was measured."""
        selected = context.of(request)
        stored = selected.archive.day_air(selected.camera, since=date, until=date + timedelta(days=1))
        return air_out(stored[0]) if stored else DayAirOut(temperature_c=None, pressure_hpa=None, set_at=None)

    @routes.put(
        "",
        dependencies=[Depends(require_write_token(context.token))],
        responses=answers(400, 403, 404, 408, 413, 415, 422),
    )
    def set_day_air(request: Request, date: Day, air: DayAirIn) -> DayAirOut:
        """Set the measured air of a solar day, in place of what was set before; both null remove it.

        The sun's position on that day is computed with it from now on, and the next refit uses it for the day's
        sightings, except for those that were imported with an air of their own.
        """
        selected = context.of(request)
        given = DayAir(
            camera=selected.camera,
            date=date,
            temperature_c=air.temperature_c,
            pressure_hpa=air.pressure_hpa,
            set_at=selected.frame_clock(),
        )
        return air_out(selected.archive.set_day_air(given))

    return routes


def air_out(air: DayAir) -> DayAirOut:
    """Return a day's air as an answer."""
    return DayAirOut(temperature_c=air.temperature_c, pressure_hpa=air.pressure_hpa, set_at=air.set_at)
