"""Routes: alive, ready, everything at a glance, and the numbers for Prometheus."""

from __future__ import annotations

import math
from datetime import datetime
from http import HTTPStatus

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest

from sunarc.common.utc import utc_time
from sunarc.imager.archive.values import field_values
from sunarc.imager.runtime.status import StatusSnapshot
from sunarc.imager.web import schemas
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.problems import Fault, answers, problem_response
from sunarc.imager.web.routes.calibrations import summary
from sunarc.imager.web.routes.record import days_out
from sunarc.optics.camera import Camera
from sunarc.optics.mounting import pose_text, top_azimuth_deg
from sunarc.optics.pose import pose_angles
from sunarc.sky.sun import DARK_ZENITH_DEG, find_next_sun_unix_s, sun_angles


def health_routes(context: ApiContext, registry: CollectorRegistry) -> APIRouter:
    """Return the routes of the service's state."""
    routes = APIRouter(tags=["health"])

    @routes.get("/healthz")
    async def healthz() -> schemas.Alive:
        """Return 200 while the process answers."""
        return schemas.Alive()

    @routes.get("/readyz", response_model=schemas.Readiness, responses=answers(503))
    def readyz(request: Request) -> schemas.Readiness | JSONResponse:
        """Return whether the service is ready or degraded (200), or not ready (503), each reason with a remedy."""
        return readiness(context.status(), request.url.path)

    @routes.get("/v1/status")
    def status() -> schemas.Status:
        """Return the state of the service, its workers, camera, clock and disk, and the current calibration."""
        return _make_status(context)

    @routes.get(
        "/metrics",
        response_class=Response,
        responses={200: {"description": "Prometheus text.", "content": {"text/plain": {}}}},
    )
    def metrics() -> Response:
        """Return the metrics in Prometheus's text format."""
        return Response(generate_latest(registry), headers={"content-type": CONTENT_TYPE_LATEST})

    return routes


def readiness(snapshot: StatusSnapshot, path: str) -> schemas.Readiness | JSONResponse:
    """Return the answer to whether the service is ready, for a path."""
    if snapshot.health == "not_ready":
        return _not_ready(snapshot, path)
    return schemas.Readiness(
        status=snapshot.health,
        state=snapshot.state,
        state_text=snapshot.state_text,
        reasons=snapshot.reasons,
        notes=snapshot.notes,
        findings=snapshot.findings,
    )


def _not_ready(snapshot: StatusSnapshot, path: str) -> JSONResponse:
    faults = [Fault(field=reason.code, problem=reason.text, remedy=reason.remedy) for reason in snapshot.reasons]
    worst = next(reason for reason in snapshot.reasons if reason.severity == "not_ready")
    return problem_response(
        HTTPStatus.SERVICE_UNAVAILABLE,
        path=path,
        detail=f"{worst.text}; {worst.remedy}",
        errors=faults,
        members={"state": snapshot.state, "state_text": snapshot.state_text},
    )


def _make_status(context: ApiContext) -> schemas.Status:
    snapshot = context.status()
    found = context.calibration_or_none(None)
    record = None if found is None else found[0]
    days = days_out(context, context.archive.days.find(context.camera, limit=1))
    camera, now = context.archive.cameras.get(context.camera), context.frame_clock()
    return schemas.Status(
        **field_values(snapshot),
        health=snapshot.health,
        state=snapshot.state,
        state_text=snapshot.state_text,
        findings=snapshot.findings,
        camera_name=context.camera,
        frame_time=now,
        sky=_describe_sky(context, now),
        is_replay=context.is_replay,
        timezone=context.timezone,
        disk_free_bytes=None if snapshot.disk is None else snapshot.disk.free_bytes,
        calibration=None if record is None else summary(record),
        pose=None if found is None else _make_pose(found[1].camera),
        last_day=days[0] if days else None,
        image_size=None if camera is None else list(camera.image_size),
        obstructions=_make_obstructions(context),
    )


def _describe_sky(context: ApiContext, now: datetime) -> schemas.SkyNow:
    def next_time(zenith_deg: float, *, rising: bool) -> datetime | None:
        unix_s = find_next_sun_unix_s(now.timestamp(), context.site, zenith_deg=zenith_deg, rising=rising)
        return utc_time(unix_s) if math.isfinite(unix_s) else None

    zenith = float(sun_angles(now.timestamp(), context.site).apparent_zenith)
    is_dark = context.observes_stars and zenith >= DARK_ZENITH_DEG
    return schemas.SkyNow(
        sun_elevation_deg=90.0 - zenith,
        observed="sun" if zenith < context.sun_zenith_deg else "stars" if is_dark else "nothing",
        sun_from=next_time(context.sun_zenith_deg, rising=True),
        stars_from=next_time(DARK_ZENITH_DEG, rising=False) if context.observes_stars else None,
    )


def _make_obstructions(context: ApiContext) -> schemas.ObstructionsShown | None:
    learned = None if context.obstructions is None else context.obstructions.learned
    return None if learned is None else schemas.ObstructionsShown(time=learned.time, hidden_share=learned.hidden_share)


def _make_pose(camera: Camera) -> schemas.Pose:
    angles = pose_angles(camera.rotation_cam_enu)._asdict()
    return schemas.Pose(text=pose_text(camera), top_azimuth_deg=top_azimuth_deg(camera), **angles)


def camera_list_routes(context: ApiContext) -> APIRouter:
    """Return the route that lists the cameras."""
    routes = APIRouter(tags=["cameras"])

    @routes.get("/v1/cameras")
    def cameras() -> schemas.Cameras:
        """Return the cameras of the archive; every route of one camera exists under /v1/cameras/{camera}/ too."""
        return schemas.Cameras(default=context.camera, cameras=list(context.archive.cameras.all()))

    return routes
