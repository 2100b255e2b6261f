"""Routes of a hub's nightly work: how the last nights went, summaries of solar days, and cross-checks."""

from __future__ import annotations

from dataclasses import replace
from datetime import date
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel

from sunarc.api.schemas.parameters import row_limit
from sunarc.archive.archive import Archive
from sunarc.archive.cross_check import CrossChecks
from sunarc.archive.nightly import DaySummary, NightlyRun
from sunarc.json_fields import described


class Nights(BaseModel):
    """How the work of the last nights went."""

    runs: Annotated[list[NightlyRun], described("The newest first.")]


class Summaries(BaseModel):
    """Solar days of the fleet."""

    days: Annotated[list[DaySummary], described("The newest first.")]


def nightly_routes(archive: Archive) -> APIRouter:
    """Return the routes."""
    routes = APIRouter(tags=["fleet"])

    @routes.get("/v1/nightly")
    def nightly(limit: Annotated[int, row_limit()] = 31) -> Nights:
        """Tell how the nightly jobs of the last nights went: summaries, retention."""
        return Nights(runs=list(archive.nightly_runs(limit=limit)))

    @routes.get("/v1/summaries")
    def summaries(
        camera: Annotated[str | None, Query(description="Of this camera alone.")] = None,
        since: Annotated[date | None, Query(description="From this solar date on.")] = None,
        until: Annotated[date | None, Query(description="Before this solar date.")] = None,
        limit: Annotated[int, row_limit()] = 1000,
    ) -> Summaries:
        """Tell every camera's solar days: sightings, verdict, clock, warnings, calibration and rotation against it."""
        return Summaries(days=list(archive.day_summaries(camera, since=since, until=until, limit=limit)))

    @routes.get("/v1/cross-checks")
    def cross_checks(
        camera: Annotated[str | None, Query(description="Of this camera alone.")] = None,
    ) -> CrossChecks:
        """Tell what neighbours showed last night of each camera's clock, stated longitude and north.

        Cameras without others within 50 km are not compared. Sizes have their 1-sigma beside them.
        """
        found = archive.cross_checks()
        return replace(found, checks=tuple(one for one in found.checks if camera in {None, one.camera}))

    return routes
