"""Routes of a hub: its cameras, refused rows, cross-checks of neighbours, and heights by two cameras."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import date, datetime
from pathlib import Path as FilePath
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import FileResponse, JSONResponse, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import Metric
from prometheus_client.registry import Collector
from pydantic import BaseModel, ConfigDict, Field

from sunarc.common.errors import InputError, OutsideError
from sunarc.geolocation.pair_height import PairView, pair_height
from sunarc.hub.archive import HubArchive
from sunarc.hub.feeds import HubRun
from sunarc.hub.fleet_states import FleetMember, members, status_number
from sunarc.hub.nightly_store import CrossChecks, DaySummary, NightlyRun
from sunarc.imager.archive.feed_rows import FleetCamera, Quarantined
from sunarc.imager.runtime.deadline import SingleCall
from sunarc.imager.runtime.json_fields import Time, described
from sunarc.imager.runtime.status import StatusSnapshot
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.parameters import Body, Number, Pixel, row_limit
from sunarc.imager.web.problems import answers
from sunarc.imager.web.routes.health import readiness
from sunarc.imager.web.routes.metrics import Labelled, labelled, push_metrics, service_metrics
from sunarc.imager.web.schemas import Alive, Readiness

_READY_WITHIN_S = 8.0
"""Longer than a trial row and a lock are waited for, whose errors say more."""


class Fleet(BaseModel):
    """The cameras of the fleet."""

    time: Time
    cameras: Annotated[list[FleetMember], described("The worst first.")]
    hubs: Annotated[list[HubRun], described("Hubs beside each other on this database; empty where it is a file.")]


class HubReadiness(Readiness):
    """Readiness of a hub, and of the hubs at the same database."""

    hubs: Annotated[list[HubRun], described("Hubs beside each other on this database; empty where it is a file.")]


class Quarantine(BaseModel):
    """Rows that were refused or set apart."""

    rows: Annotated[list[Quarantined], described("The newest first.")]


def fleet_routes(
    archive: HubArchive, now: Callable[[], datetime], registry: CollectorRegistry, status: Callable[[], StatusSnapshot]
) -> APIRouter:
    """Return the routes of the fleet."""
    routes = APIRouter(tags=["fleet"])

    @routes.get("/v1/fleet")
    def fleet() -> Fleet:
        """Return every camera of the fleet: its site, when it last sent something, and its state."""
        time = now()
        cameras = members(archive.feeds.fleet(), time, archive.nightly.cross_checks())
        return Fleet(time=time, cameras=cameras, hubs=list(archive.feeds.hubs()))

    @routes.get("/v1/quarantine")
    def quarantine(
        camera: Annotated[str | None, Query(description="Of this camera alone.")] = None,
        limit: Annotated[int, row_limit()] = 100,
    ) -> Quarantine:
        """Return the rows of imagers that the hub refused or set aside, each with its reason, the newest first."""
        return Quarantine(rows=list(archive.feeds.quarantine(camera, limit=limit)))

    @routes.get("/healthz")
    async def healthz() -> Alive:
        """Return 200 while the process answers."""
        return Alive()

    def storing() -> tuple[HubRun, ...]:
        """Return the hubs at the same database, where rows of every kind can be stored."""
        archive.cameras.all()
        archive.feeds.require_storing()
        if status().health != "not_ready":
            archive.require_storing(now=now())
        return archive.feeds.hubs()

    trial = SingleCall(storing, name="readiness")

    @routes.get("/readyz", response_model=HubReadiness, responses=answers(503))
    async def readyz(request: Request) -> HubReadiness | JSONResponse:
        """Return whether rows of every kind can be stored (503 if not), and which of the hub's jobs fail."""
        # A database that has stopped holds every thread of the pool: this one is not of it.
        try:
            hubs = await asyncio.wait_for(asyncio.shield(asyncio.wrap_future(trial.start())), _READY_WITHIN_S)
        except TimeoutError:
            raise OutsideError(f"the database did not answer within {_READY_WITHIN_S:g} s") from None
        found = readiness(status(), request.url.path)
        return found if isinstance(found, JSONResponse) else HubReadiness(**dict(found), hubs=list(hubs))

    @routes.get(
        "/metrics",
        response_class=Response,
        responses={200: {"description": "Prometheus text.", "content": {"text/plain": {}}}},
    )
    def metrics() -> Response:
        """Return the metrics of every camera in Prometheus's text format."""
        return Response(generate_latest(registry), headers={"content-type": CONTENT_TYPE_LATEST})

    return routes


def fleet_page(folder: FilePath) -> APIRouter:
    """Return the route of the fleet page."""
    routes = APIRouter()

    @routes.get("/", include_in_schema=False)
    def page() -> FileResponse:
        return FileResponse(folder / "fleet.html")

    return routes


_NUMBERS: tuple[tuple[str, str, Callable[[FleetCamera], float | None]], ...] = (
    ("received_seconds", "When it last sent something, Unix time.", lambda c: _unix_s(c.received_at)),
    ("status_seconds", "When its last report of itself came, Unix time.", lambda c: _unix_s(c.status_at)),
    ("last_sighting_seconds", "Time of its newest sighting, Unix time.", lambda c: _unix_s(c.last_sighting_at)),
    ("sky_sigma_degrees", "1-sigma of its calibration over the sky (RMS).", lambda c: c.sky_rms_deg),
    ("quarantined", "Things of it in quarantine.", lambda c: c.n_quarantined),
    ("disk_free_bytes", "Free space where its images are.", lambda c: status_number(c, "disk_free_bytes")),
    ("clock_error_seconds", "Bound of its clock's error.", lambda c: status_number(c, "clock_error_s")),
    ("drift_degrees", "Rotation against its calibration on its last day.", lambda c: status_number(c, "drift_deg")),
)


class FleetCollector(Collector):
    """Collects the numbers of the hub and of the fleet.

    Parameters
    ----------
    archive : the hub's.
    now : real time.
    status : returns how the hub is.
    """

    def __init__(self, archive: HubArchive, now: Callable[[], datetime], status: Callable[[], StatusSnapshot]) -> None:
        self._archive = archive
        self._now = now
        self._status = status

    def describe(self) -> Iterator[Metric]:
        """Return no metrics, so that registering does not query the archive."""
        return iter(())

    def collect(self) -> Iterator[Metric]:
        """Read the fleet once; where the database does not answer, that and the hub's own numbers are left."""
        yield from service_metrics(self._status())
        try:
            of_fleet = list(self._fleet_metrics())
        except OutsideError:
            of_fleet = []
        yield labelled("sunarc_store_up", "1 while the hub's database answers.", (), {(): float(bool(of_fleet))})
        yield from of_fleet

    def _fleet_metrics(self) -> Iterator[Metric]:
        cameras, now = self._archive.feeds.fleet(), self._now()
        for name, meaning, value_of in _NUMBERS:
            known: Labelled = {(one.camera,): value for one in cameras if (value := value_of(one)) is not None}
            yield labelled(f"sunarc_fleet_{name}", meaning, ("camera",), known)
        crossed = self._archive.nightly.cross_checks()
        states: Labelled = {(one.camera, one.state): 1.0 for one in members(cameras, now, crossed)}
        yield labelled("sunarc_fleet_state", "1 for the camera's state.", ("camera", "state"), states)
        shown: Labelled = {(check.camera, found): 1.0 for check in crossed.checks for found in check.found}
        yield labelled("sunarc_fleet_cross_check", "1 for what neighbours show of it.", ("camera", "found"), shown)
        yield from push_metrics(self._archive)


def _unix_s(time: datetime | None) -> float | None:
    return None if time is None else time.timestamp()


class NightlyRuns(BaseModel):
    """Runs of the last nights' work."""

    model_config = ConfigDict(title="Nights")

    runs: Annotated[list[NightlyRun], described("The newest first.")]


class Summaries(BaseModel):
    """Solar days of the fleet."""

    days: Annotated[list[DaySummary], described("The newest first.")]


def nightly_routes(archive: HubArchive) -> APIRouter:
    """Return the routes."""
    routes = APIRouter(tags=["fleet"])

    @routes.get("/v1/nightly")
    def nightly(limit: Annotated[int, row_limit()] = 31) -> NightlyRuns:
        """Return the state of the nightly jobs (summaries, retention) of the last nights."""
        return NightlyRuns(runs=list(archive.nightly.runs(limit=limit)))

    @routes.get("/v1/summaries")
    def summaries(
        camera: Annotated[str | None, Query(description="Of this camera alone.")] = None,
        since: Annotated[date | None, Query(description="From this solar date on.")] = None,
        until: Annotated[date | None, Query(description="Before this solar date.")] = None,
        limit: Annotated[int, row_limit()] = 1000,
    ) -> Summaries:
        """Return the solar days of every camera: sightings, verdict, clock, warnings, calibration and rotation."""
        return Summaries(days=list(archive.nightly.summaries(camera, since=since, until=until, limit=limit)))

    @routes.get("/v1/cross-checks")
    def cross_checks(
        camera: Annotated[str | None, Query(description="Of this camera alone.")] = None,
    ) -> CrossChecks:
        """Return last night's cross-checks with neighbours: each camera's clock, stated longitude and north.

        Cameras without others within 50 km are not compared. Sizes have their 1-sigma.
        """
        found = archive.nightly.cross_checks()
        return replace(found, checks=tuple(one for one in found.checks if camera in {None, one.camera}))

    return routes


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
    def measure_pair_height(a: CameraName, b: CameraName, asked: PairRequest) -> PairAnswer:
        """Return the height of a cloud point that two cameras see, with the uncertainty of both calibrations.

        422 where the rays are parallel within their errors, or move apart.
        """
        if a == b:
            raise InputError(field="b", problem="is the same camera", remedy="name two cameras")
        (first, calibration_a), (second, calibration_b) = (
            _make_pair_view(context.named(name), asked.time, pixel, field)
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


def _make_pair_view(context: ApiContext, time: datetime, pixel: list[float], field: str) -> tuple[PairView, str]:
    """Return how a camera sees a pixel at a time, and the id of the calibration that says so."""
    record = context.record(time)
    ready = context.ready.get(record)
    with np.errstate(all="ignore"):  # what lies outside the field has no direction
        direction = np.asarray(ready.back_project(np.array([pixel], dtype=np.float64))[:, 2:5], dtype=np.float64)
        covariance = ready.direction_covariance(np.ascontiguousarray(direction))
    if not np.isfinite(covariance).all():
        raise InputError(field=field, problem="lies outside the camera's field", remedy="give a pixel of the sky")
    return PairView(site=context.site_with_air_at(time), direction=direction[0], covariance=covariance[0]), record.id
