"""Routes: the obstruction mask and the horizon that the images have shown."""

from __future__ import annotations

import io
from datetime import UTC, datetime
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from pydantic import BaseModel, Field

from sunarc.common.errors import NotFoundError, OutsideError
from sunarc.common.utc import rfc3339
from sunarc.imager.archive.obstructions import LearnedObstructions
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.hidden_sky import drawn_mask
from sunarc.imager.web.problems import answers, described_answer
from sunarc.imaging.horizon import sun_hours
from sunarc.imaging.obstructions import ObstructionMask, compared_masks
from sunarc.public.mask_files import horizon_csv, mask_png
from sunarc.sky.days import day_bounds_unix_s
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions


class HorizonSunPath(BaseModel):
    """The way of the sun over one day, where it is up."""

    name: str = Field(description="Month of the day, its 21st.", examples=["Jun"])
    azimuth_deg: list[float] = Field(description="Clockwise from north.", examples=[[59.1, 61.2]])
    elevation_deg: list[float] = Field(description="Apparent elevation.", examples=[[0.1, 2.4]])


class DrawnMask(BaseModel):
    """Comparison of the learned mask with the file of `api.obstruction_mask`, which is used in its place."""

    agreement: float = Field(description="Intersection of what both hide over their union, a share.", examples=[0.96])
    missing_deg2: float = Field(description="Hidden in the images alone, square degrees.", examples=[12.5])
    extra_deg2: float = Field(description="Hidden by the file alone, square degrees.", examples=[3.1])


class Horizon(BaseModel):
    """The horizon that the camera sees, by azimuth in whole degrees from north clockwise."""

    calibration: str = Field(description="Id of the calibration of the mask.", examples=["20130514T150508Z"])
    time: str = Field(description="Of the last image that the mask is made from.", examples=["2013-05-14T15:05:08Z"])
    azimuth_deg: list[int] = Field(description="0 to 359, clockwise from north.", examples=[[0, 1]])
    elevation_deg: list[float | None] = Field(
        description="Highest elevation that is hidden, degrees; 0 where nothing is, null outside the image.",
        examples=[[4.1, 4.3]],
    )
    sigma_deg: list[float] = Field(description="1-sigma of the elevation, degrees.", examples=[[0.2, 0.2]])
    openings_deg: list[list[tuple[float, float]]] = Field(
        description="Spans of elevation below it through which the sky is seen.", examples=[[[], [[1.0, 2.5]]]]
    )
    sun_paths: list[HorizonSunPath] = Field(description="Of the solstices and an equinox.")
    sun_h: list[float] = Field(description="Hours with the sun up, of each month of the mask's year.", examples=[[300]])
    lost_h: list[float] = Field(description="Those of them with the sun behind the horizon.", examples=[[12.5]])
    drawn: DrawnMask | None = Field(description="Of a drawn mask; null without one, or where it cannot be read.")


_EVERY_S = 900.0
_MASK = described_answer(
    "PNG: 255 free, 128 unknown, 64 dirt on the dome, 0 hidden; npz: `probability` and `state` of cells.",
    ["image/png", "application/x-npz"],
)
_HORIZON = described_answer("The same as a table.", ["text/csv"])


def obstruction_routes(context: ApiContext) -> APIRouter:
    """Return the routes of the obstruction mask and of the horizon."""
    routes = APIRouter(tags=["images"])

    def learned(request: Request) -> LearnedObstructions:
        selected = context.of(request)
        found = None if selected.obstructions is None else selected.obstructions.learned
        if found is None:
            selected.record(None)  # without a calibration that is what is missing
            why = "no images are seen here" if selected.obstructions is None else selected.obstructions.missing
            raise NotFoundError(field="obstructions", problem=why, remedy="ask again after a clear day")
        return found

    @routes.get("/masks/obstructions", response_class=Response, responses=_MASK | answers(404, 422))
    def obstruction_mask(
        request: Request,
        format_: Annotated[Literal["png", "npz"], Query(alias="format", description="Of the answer.")] = "png",
    ) -> Response:
        """Return the obstructions of the sky, as the images have shown."""
        found = learned(request)
        if format_ == "png":
            return Response(mask_png(found.mask), media_type="image/png")
        content = io.BytesIO()
        np.savez_compressed(content, probability=found.mask.probability, state=found.mask.state)
        return Response(content.getvalue(), media_type="application/x-npz")

    @routes.get("/horizon", response_model=Horizon, responses=_HORIZON | answers(404, 422))
    def horizon(
        request: Request,
        format_: Annotated[Literal["json", "csv"], Query(alias="format", description="Of the answer.")] = "json",
    ) -> Horizon | Response:
        """Return the elevation below which the sky is hidden, by azimuth."""
        found = learned(request)
        if format_ == "csv":
            return Response(horizon_csv(found.horizon), media_type="text/csv")
        profile, site = found.horizon, context.of(request).site
        hours = sun_hours(profile, site, year=found.time.year)
        return Horizon(
            calibration=found.calibration,
            time=rfc3339(found.time, timespec="seconds"),
            azimuth_deg=list(range(360)),
            elevation_deg=[None if np.isnan(one) else round(one, 2) for one in profile.elevation_deg.tolist()],
            sigma_deg=[round(one, 2) for one in profile.sigma_deg.tolist()],
            openings_deg=[list(spans) for spans in profile.openings],
            sun_paths=[_compute_sun_path(found.time.year, month, site) for month in (6, 9, 12)],
            sun_h=[round(one, 1) for one in hours.up.tolist()],
            lost_h=[round(one, 1) for one in hours.lost.tolist()],
            drawn=_compare_with_drawn(context.of(request), found.mask),
        )

    return routes


def _compare_with_drawn(context: ApiContext, mask: ObstructionMask) -> DrawnMask | None:
    try:
        drawn = drawn_mask(context, mask.grid.size)
    except OutsideError:
        return None
    if drawn is None:
        return None
    compared = compared_masks(mask, drawn)
    return DrawnMask(**{name: round(value, 3) for name, value in compared._asdict().items()})


def _compute_sun_path(year: int, month: int, site: Site) -> HorizonSunPath:
    day = datetime(year, month, 21, tzinfo=UTC)
    begins, ends = day_bounds_unix_s(day.date(), longitude=site.longitude)
    zenith, azimuth = angles_from_direction(sun_directions(np.arange(begins, ends, _EVERY_S), site))
    up = zenith < 90.0
    return HorizonSunPath(
        name=f"{day:%b}",
        azimuth_deg=[round(one, 1) for one in (azimuth[up] % 360.0).tolist()],
        elevation_deg=[round(90.0 - one, 1) for one in zenith[up].tolist()],
    )
