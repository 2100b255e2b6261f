"""Routes: the obstruction mask and the horizon that the images have shown."""

from __future__ import annotations

import io
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from pydantic import BaseModel, Field

from sunarc.common.errors import NotFoundError
from sunarc.common.utc import rfc3339
from sunarc.imager.archive.obstructions import LearnedObstructions
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.problems import answers, described_answer
from sunarc.public.mask_files import horizon_csv, mask_png


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
        profile = found.horizon
        return Horizon(
            calibration=found.calibration,
            time=rfc3339(found.time, timespec="seconds"),
            azimuth_deg=list(range(360)),
            elevation_deg=[None if np.isnan(one) else round(one, 2) for one in profile.elevation_deg.tolist()],
            sigma_deg=[round(one, 2) for one in profile.sigma_deg.tolist()],
            openings_deg=[list(spans) for spans in profile.openings],
        )

    return routes
