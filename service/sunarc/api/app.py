"""The application, made of what it is handed."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path as FilePath
from typing import Any

from fastapi import Depends, FastAPI
from fastapi.responses import FileResponse
from prometheus_client import CollectorRegistry, ProcessCollector
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.staticfiles import StaticFiles

import sunarc
from sunarc.api.arrays import MOST_BYTES_AHEAD
from sunarc.api.compute_slots import ComputeSlots
from sunarc.api.context import CAMERA_PREFIX, ApiContext, DaySites, SingleFlightCache
from sunarc.api.fault_log import FaultLog
from sunarc.api.middleware.allowed_hosts import AllowedHosts, host_names
from sunarc.api.middleware.authentication import ReadTokenMiddleware, read_token
from sunarc.api.middleware.head_requests import HeadRequests
from sunarc.api.middleware.holdings import Holdings
from sunarc.api.middleware.rate_limit import ConcurrencyLimit, RateLimit
from sunarc.api.middleware.request_bodies import BodyReader
from sunarc.api.middleware.request_counts import CountRequests, RequestCounts
from sunarc.api.middleware.request_limits import Boundary
from sunarc.api.openapi import describe
from sunarc.api.options import ApiOptions
from sunarc.api.problems import FaultGuard, add_problem_handlers
from sunarc.api.query_names import require_known_names
from sunarc.api.routes.calibration_actions import decision_routes
from sunarc.api.routes.calibrations import calibration_routes
from sunarc.api.routes.cameras import camera_routes
from sunarc.api.routes.day_air import day_air_routes
from sunarc.api.routes.days_and_events import record_routes
from sunarc.api.routes.directions import direction_routes
from sunarc.api.routes.event_stream import event_stream_routes
from sunarc.api.routes.geolocation import geolocation_routes
from sunarc.api.routes.health import health_routes
from sunarc.api.routes.housekeeping import housekeeping_routes
from sunarc.api.routes.images import image_routes
from sunarc.api.routes.maps import map_routes
from sunarc.api.routes.masks import mask_routes
from sunarc.api.routes.metrics import StatusCollector
from sunarc.api.routes.nights import night_routes
from sunarc.api.routes.overlay import overlay_routes
from sunarc.api.routes.refits import refit_routes
from sunarc.api.routes.remap import remap_routes
from sunarc.api.routes.stored_answers import AnswerFiles
from sunarc.api.routes.sun import sun_routes
from sunarc.archive.archive import Archive
from sunarc.archive.images import ImageStore
from sunarc.archive.values import Refit
from sunarc.calibration.ensemble import draw_ensemble
from sunarc.calibration.model.direction_table import lookup
from sunarc.runtime.status import StatusSnapshot
from sunarc.sky.site import Site

_ENSEMBLES = 4
"""Ensembles that are kept: each of up to 64 draws, 5 MB."""
_MOST_STREAMS = 64
"""Streams of events that are open at once: each costs a look at the archive's revision twice a second."""
STATIC = FilePath(__file__).parent / "static"
_WORTH_COMPRESSING_BYTES = 1400  # less fits into one packet as it is
_COMPRESSION_LEVEL = 4  # of JSON's numbers, higher ones make little more than work
_COMPRESSED_ALREADY = (
    *DEFAULT_EXCLUDED_CONTENT_TYPES,
    *("application/octet-stream", "application/x-npy", "application/x-npz", "application/x-netcdf"),
)


def create_app(
    *,
    archive: Archive,
    camera: str,
    site: Site,
    status: Callable[[], StatusSnapshot],
    request_refit: Callable[[str], Refit],
    frame_clock: Callable[[], datetime],
    latest_image: Callable[[], FilePath | None],
    options: ApiOptions,
    images: ImageStore | None = None,
    registry: CollectorRegistry | None = None,
    stopping: Callable[[], bool] = lambda: False,
) -> FastAPI:
    """Return an application that serves one camera's archive.

    Parameters
    ----------
    archive, camera, site : what was seen, by which camera, and where it stands.
    status : returns the status board's snapshot.
    request_refit : asks for a refit, with a reason.
    frame_clock : the frames' time, aware.
    latest_image : returns the newest preview's file (JPEG or PNG), or None.
    options : limits and the token.
    images : the composites; None where there are none.
    registry : where Prometheus's numbers are registered; a new one by default.
    stopping : returns whether the service is about to stop: streams of events end then.
    """
    context = new_context(
        archive=archive,
        camera=camera,
        site=site,
        status=status,
        request_refit=request_refit,
        frame_clock=frame_clock,
        latest_image=latest_image,
        options=options,
        images=images,
        stopping=stopping,
        token=read_token(options.token_file, setting="api.token_file"),
    )
    numbers = registry or CollectorRegistry()
    numbers.register(StatusCollector(context))
    app = new_application("sunarc")
    add_camera_routes(app, context)
    app.include_router(camera_routes(context))
    app.include_router(health_routes(context, numbers))
    _add_dashboard(app)
    complete(app, context)
    count_requests(app, numbers)
    return app


def new_context(*, archive: Archive, **collaborators: Any) -> ApiContext:  # noqa: ANN401 - the fields of ApiContext
    """Return the collaborators of an application, with the caches that its routes share."""
    return ApiContext(
        archive=archive,
        sites=DaySites(archive),
        ready=SingleFlightCache(
            lambda record: lookup(archive.model(record.id)),
            key=lambda record: record.id,  # a model never changes under one id
        ),
        ensembles=SingleFlightCache(
            lambda asked: draw_ensemble(
                archive.model(asked.calibration),
                draws=asked.draws,
                seed=asked.seed,
                calibration_id=asked.calibration,
            ),
            key=lambda asked: asked.key,
            most=_ENSEMBLES,
        ),
        **collaborators,
    )


def new_application(title: str) -> FastAPI:
    """Return an application without routes."""
    return FastAPI(
        title=title,
        version=sunarc.__version__,
        docs_url=None,
        redoc_url=None,
        generate_unique_id_function=lambda route: route.name,
        dependencies=[Depends(require_known_names)],
    )


def complete(app: FastAPI, context: ApiContext) -> None:
    """Add what every application has in common: problem documents, its description, and limits."""
    faults = FaultLog()
    add_problem_handlers(app, faults)
    describe(app)
    _add_guards(app, context, faults)


def count_requests(app: FastAPI, numbers: CollectorRegistry) -> None:
    """Count the requests and what the process uses, where Prometheus's numbers are registered."""
    counts = RequestCounts()
    numbers.register(counts)
    ProcessCollector(registry=numbers)
    app.add_middleware(CountRequests, counts=counts)


def _add_guards(app: FastAPI, context: ApiContext, faults: FaultLog) -> None:
    """Put what every request passes before the application, the innermost first."""
    options = context.options
    app.add_middleware(
        GZipMiddleware,
        minimum_size=_WORTH_COMPRESSING_BYTES,
        compresslevel=_COMPRESSION_LEVEL,
        exclude_content_types=_COMPRESSED_ALREADY,
    )
    app.add_middleware(ConcurrencyLimit, at_once=options.max_at_once, streams=_MOST_STREAMS)
    app.add_middleware(
        BodyReader,
        max_body_bytes=options.max_body_bytes,
        max_array_bytes=options.max_array_bytes,
        within_s=options.request_within_s,
        holdings=Holdings(options.max_large_at_once * (options.max_array_bytes + MOST_BYTES_AHEAD)),
    )
    reading = read_token(options.read_token_file, setting="api.read_token_file")
    tokens = tuple(token for token in (reading, context.token) if token is not None)
    if reading is not None:
        app.add_middleware(ReadTokenMiddleware, tokens=tokens)
    app.add_middleware(RateLimit, per_s=options.requests_per_s, burst=options.burst, tokens=tokens)
    if options.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=list(options.cors_origins),
            allow_methods=["GET", "POST", "PUT"],
            allow_headers=["authorization", "content-type", "if-none-match"],
            expose_headers=["etag", "location", "retry-after", "sunarc-calibration", "sunarc-columns"],
        )
    app.add_middleware(AllowedHosts, names=host_names(options))
    app.add_middleware(FaultGuard, faults=faults)
    app.add_middleware(HeadRequests)
    app.add_middleware(Boundary, max_body_bytes=options.max_body_bytes, max_array_bytes=options.max_array_bytes)


def add_camera_routes(app: FastAPI, context: ApiContext) -> None:
    """Add every route of one camera: under /v1 for this service's own, under /v1/cameras/{camera} for any."""
    slots, files = ComputeSlots(context.options.max_large_at_once), AnswerFiles()
    for of_camera in (
        calibration_routes(context),
        decision_routes(context),
        direction_routes(context, slots),
        map_routes(context, files),
        geolocation_routes(context, slots),
        sun_routes(context),
        overlay_routes(context),
        record_routes(context),
        housekeeping_routes(context),
        night_routes(context),
        event_stream_routes(context),
        image_routes(context),
        remap_routes(context, files),
        mask_routes(context, files),
        day_air_routes(context),
        refit_routes(context),
    ):
        app.include_router(of_camera, prefix=CAMERA_PREFIX)


def _add_dashboard(app: FastAPI) -> None:
    @app.get("/", include_in_schema=False)
    def dashboard() -> FileResponse:
        return FileResponse(STATIC / "dashboard.html")

    @app.get("/docs", include_in_schema=False)
    def docs() -> FileResponse:
        return FileResponse(STATIC / "docs" / "docs.html")

    app.mount("/static", StaticFiles(directory=STATIC))
