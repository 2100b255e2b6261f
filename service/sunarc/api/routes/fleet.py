"""Routes of the hub: the cameras of the fleet, what is in quarantine, and the numbers for Prometheus."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from datetime import datetime, timedelta
from pathlib import Path as FilePath
from typing import Annotated, Literal, get_args

from fastapi import APIRouter, Query, Request
from fastapi.responses import FileResponse, JSONResponse, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from pydantic import BaseModel

from sunarc.api.problems import answers
from sunarc.api.routes.health import readiness
from sunarc.api.routes.metrics import push_metrics, service_metrics
from sunarc.api.schemas.calibration import Alive, Readiness
from sunarc.api.schemas.parameters import row_limit
from sunarc.archive.archive import Archive
from sunarc.archive.feed_values import FleetCamera, Quarantined
from sunarc.errors import OutsideError
from sunarc.json_fields import Time, described
from sunarc.runtime.status import StatusSnapshot

SILENT = timedelta(minutes=15)
"""A camera that sent nothing for so long is silent: imagers tell of themselves every minute."""
State = Literal["silent", "not_ready", "degraded", "quarantine", "uncalibrated", "ready"]
"""How a camera is, the worst first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetMember(FleetCamera):
    """A camera as the hub sees it, with the worst that there is to say of it."""

    state: Annotated[State, described("The worst of it; `quarantine`: something of it was refused or set apart.")]


class Fleet(BaseModel):
    """The cameras of the fleet."""

    time: Time
    cameras: Annotated[list[FleetMember], described("The worst first.")]


class Quarantine(BaseModel):
    """What was refused or set apart."""

    rows: Annotated[list[Quarantined], described("The newest first.")]


def fleet_routes(
    archive: Archive, now: Callable[[], datetime], registry: CollectorRegistry, status: Callable[[], StatusSnapshot]
) -> APIRouter:
    """Return the routes that tell of the fleet."""
    routes = APIRouter(tags=["fleet"])

    @routes.get("/v1/fleet")
    def fleet() -> Fleet:
        """Tell every camera of the fleet: where it is, when it last sent something, and how it is."""
        time = now()
        return Fleet(time=time, cameras=members(archive.fleet(), time))

    @routes.get("/v1/quarantine")
    def quarantine(
        camera: Annotated[str | None, Query(description="Of this camera alone.")] = None,
        limit: Annotated[int, row_limit()] = 100,
    ) -> Quarantine:
        """Tell what imagers sent and the hub refused or set apart, each with its reason, the newest first."""
        return Quarantine(rows=list(archive.quarantine(camera, limit=limit)))

    @routes.get("/healthz")
    async def healthz() -> Alive:
        """Tell that the process answers."""
        return Alive()

    @routes.get("/readyz", response_model=Readiness, responses=answers(503))
    def readyz(request: Request) -> Readiness | JSONResponse:
        """Tell that the database answers and has room (503 where not), and what of the hub's own work fails."""
        archive.cameras()
        snapshot = status()
        if snapshot.health != "not_ready":
            archive.require_room(now=now())
        return readiness(snapshot, request.url.path)

    @routes.get(
        "/metrics",
        response_class=Response,
        responses={200: {"description": "Prometheus text.", "content": {"text/plain": {}}}},
    )
    def metrics() -> Response:
        """Tell the numbers of every camera, in Prometheus's text format."""
        return Response(generate_latest(registry), headers={"content-type": CONTENT_TYPE_LATEST})

    return routes


def fleet_page(folder: FilePath) -> APIRouter:
    """Return the route of the fleet page."""
    routes = APIRouter()

    @routes.get("/", include_in_schema=False)
    def page() -> FileResponse:
        return FileResponse(folder / "fleet.html")

    return routes


def members(cameras: tuple[FleetCamera, ...], now: datetime) -> list[FleetMember]:
    """Return cameras with their states, the worst first; of one state, the most uncertain first."""
    names = [one.name for one in fields(FleetCamera)]
    found = [
        FleetMember(**{name: getattr(camera, name) for name in names}, state=state_of(camera, now))
        for camera in cameras
    ]
    order = get_args(State)
    return sorted(found, key=lambda one: (order.index(one.state), -(one.sky_rms_deg or 0.0), one.camera))


def state_of(camera: FleetCamera, now: datetime) -> State:
    """Return the worst that there is to say of a camera."""
    if camera.received_at is None or now - camera.received_at > SILENT:
        return "silent"
    health = (camera.status or {}).get("health")
    if health == "not_ready":
        return "not_ready"
    if health == "degraded":
        return "degraded"
    if camera.n_quarantined:
        return "quarantine"
    return "uncalibrated" if camera.calibration is None else "ready"


_NUMBERS: tuple[tuple[str, str, Callable[[FleetCamera], float | None]], ...] = (
    ("received_seconds", "When it last sent something, Unix time.", lambda c: _unix_s(c.received_at)),
    ("status_seconds", "When its last report of itself came, Unix time.", lambda c: _unix_s(c.status_at)),
    ("last_sighting_seconds", "Time of its newest sighting, Unix time.", lambda c: _unix_s(c.last_sighting_at)),
    ("sky_sigma_degrees", "1-sigma of its calibration over the sky (RMS).", lambda c: c.sky_rms_deg),
    ("quarantined", "Things of it in quarantine.", lambda c: c.n_quarantined),
    ("disk_free_bytes", "Free space where its images are.", lambda c: _number(c, "disk_free_bytes")),
    ("clock_error_seconds", "Bound of its clock's error.", lambda c: _number(c, "clock_error_s")),
    ("drift_degrees", "Rotation against its calibration on its last day.", lambda c: _number(c, "drift_deg")),
)


class FleetCollector(Collector):
    """Collects the numbers of the hub and of the fleet.

    Parameters
    ----------
    archive : the hub's.
    now : real time.
    status : returns how the hub is.
    """

    def __init__(self, archive: Archive, now: Callable[[], datetime], status: Callable[[], StatusSnapshot]) -> None:
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
            of_fleet = list(self._of_fleet())
        except OutsideError:
            of_fleet = []
        up = GaugeMetricFamily("sunarc_store_up", "1 while the hub's database answers.")
        up.add_metric([], float(bool(of_fleet)))
        yield up
        yield from of_fleet

    def _of_fleet(self) -> Iterator[Metric]:
        cameras, now = self._archive.fleet(), self._now()
        for name, meaning, value_of in _NUMBERS:
            family = GaugeMetricFamily(f"sunarc_fleet_{name}", meaning, labels=["camera"])
            for camera in cameras:
                value = value_of(camera)
                if value is not None:
                    family.add_metric([camera.camera], value)
            yield family
        states = GaugeMetricFamily("sunarc_fleet_state", "1 for the camera's state.", labels=["camera", "state"])
        for camera in cameras:
            states.add_metric([camera.camera, state_of(camera, now)], 1.0)
        yield states
        crossed = GaugeMetricFamily(
            "sunarc_fleet_cross_check", "1 for what neighbours show of it.", labels=["camera", "found"]
        )
        for check in self._archive.cross_checks().checks:
            for found in check.found:
                crossed.add_metric([check.camera, found], 1.0)
        yield crossed
        yield from push_metrics(self._archive)


def _unix_s(time: datetime | None) -> float | None:
    return None if time is None else time.timestamp()


def _number(camera: FleetCamera, name: str) -> float | None:
    value = (camera.status or {}).get(name)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
