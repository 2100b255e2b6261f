"""Application of an imager, made of its collaborators, and the parts that every application has."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path as FilePath
from typing import Any

from fastapi import Depends, FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.responses import FileResponse
from prometheus_client import CollectorRegistry, ProcessCollector
from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode, models_json_schema
from starlette.datastructures import Headers
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send

import sunarc
from sunarc.calibration.answers.direction_table import lookup
from sunarc.calibration.answers.error_model import draw_ensemble
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.archive.move_pictures import MovePictures
from sunarc.imager.archive.obstructions import ObstructionLearner
from sunarc.imager.archive.values import Refit
from sunarc.imager.runtime.status import StatusSnapshot
from sunarc.imager.web import problems
from sunarc.imager.web.arrays import MOST_BYTES_AHEAD
from sunarc.imager.web.bulk import ComputeSlots
from sunarc.imager.web.context import (
    CAMERA_PREFIX,
    Ages,
    ApiContext,
    DaySites,
    PictureList,
    SingleFlightCache,
    model_key,
)
from sunarc.imager.web.middleware import admission
from sunarc.imager.web.middleware.boundary import Boundary
from sunarc.imager.web.middleware.request_bodies import Occupancy
from sunarc.imager.web.middleware.shared_quota import SharedQuota
from sunarc.imager.web.options import ApiOptions
from sunarc.imager.web.routes.calibrations import calibration_routes, decision_routes, refit_routes
from sunarc.imager.web.routes.directions import direction_routes
from sunarc.imager.web.routes.geolocation import GeolocateRequest, geolocation_routes
from sunarc.imager.web.routes.health import camera_list_routes, health_routes
from sunarc.imager.web.routes.images import image_routes
from sunarc.imager.web.routes.maps import map_routes, mask_routes, remap_routes
from sunarc.imager.web.routes.metrics import RequestCounts, StatusCollector
from sunarc.imager.web.routes.nights import night_routes
from sunarc.imager.web.routes.obstructions import obstruction_routes
from sunarc.imager.web.routes.overlay import overlay_routes
from sunarc.imager.web.routes.record import (
    day_air_routes,
    event_stream_routes,
    housekeeping_routes,
    move_routes,
    record_routes,
)
from sunarc.imager.web.routes.stored_answers import AnswerFiles
from sunarc.imager.web.routes.sun import sun_routes
from sunarc.imager.web.schemas import BackProjectRequest, ProjectRequest
from sunarc.sky.site import Site

_DESCRIPTION = """Keeps the geometric calibration of an all-sky imager right, from the sun and the stars.

Pixels are (x, y) in px, x right, y down, (0, 0) the centre of the top-left pixel. Zenith and azimuth are in degrees,
azimuth clockwise from north; directions are apparent (refracted) unit vectors, east-north-up. Times are RFC 3339, UTC.
A sigma is per axis, an RMSE is of the two-dimensional distance. null means that there is no answer.

Every route below /v1 but /v1/status and /v1/cameras answers for this service's own camera; as /v1/cameras/{camera}/…
it answers for any camera that /v1/cameras lists (404 for another name)."""

_OTHERS: tuple[tuple[type[BaseModel], JsonSchemaMode], ...] = (
    (problems.Problem, "serialization"),
    (problems.Fault, "serialization"),
    (BackProjectRequest, "validation"),
    (ProjectRequest, "validation"),
    (GeolocateRequest, "validation"),
)
"""Shapes that no route's signature names."""
_TAGS = {
    "health": "whether the service answers, its state and its metrics",
    "cameras": "the cameras of the archive",
    "calibrations": "the valid one, the history, and an operator's decisions",
    "directions": "directions of pixels, pixels of directions, positions of clouds and shadows",
    "sun": "its position, and where it was detected",
    "images": "composites, maps of them, masks and tables for OpenCV",
    "record": "days, events and their stream, disk space and temperature, the latest image",
    "refits": "requested, running and completed",
    "epochs": "intervals in which the camera did not move",
    "fleet": "what a hub stores of its cameras, and receives from them",
    "drawing": "lines and maps to draw over the image",
}
_TEXTS = {"text/plain": "string", "application/yaml": "object"}
"""Type of the content of the media types that are no bytes; YAML is the value that its reader makes of it."""


def describe(app: FastAPI) -> None:
    """Make the application return this document."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _make_openapi(app)
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]  # FastAPI's own way to do this


def _make_openapi(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(title=app.title, version=app.version, description=_DESCRIPTION, routes=app.routes)
    template = "#/components/schemas/{model}"
    _, others = models_json_schema([*_OTHERS], ref_template=template)
    schemas = document["components"]["schemas"]
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    schemas |= others["$defs"]
    document["paths"] = {path.replace("{camera}", "", 1): one for path, one in document["paths"].items()}
    for path in document["paths"].values():
        for operation in path.values():
            operation["summary"] = operation["description"].partition("\n")[0].removesuffix(".")
            _replace_error_answers(operation["responses"])
            _describe_bytes(operation["responses"])
    used = {tag for path in document["paths"].values() for one in path.values() for tag in one.get("tags", ())}
    document["tags"] = [{"name": name, "description": _TAGS[name]} for name in sorted(used)]
    return document


def _describe_bytes(responses: dict[str, Any]) -> None:
    """Give a schema to every content that has none: files and texts."""
    for answer in responses.values():
        for media_type, content in answer.get("content", {}).items():
            of_text = _TEXTS.get(media_type)
            described = {"type": of_text} if of_text else {"type": "string", "format": "binary"}
            content.setdefault("schema", described)


def _replace_error_answers(responses: dict[str, Any]) -> None:
    """Replace FastAPI's own answer to invalid requests, and add the ones that any route may give."""
    if "HTTPValidationError" in str(responses.get("422", "")):
        responses["422"] = problems.answers(422)[422]
    for status, answer in problems.answers(400, 401, 421, 422, 429, 500, 503).items():
        responses.setdefault(str(status), answer)


_ENSEMBLES = 4
"""Ensembles that are kept: each of up to 64 draws, 5 MB."""
_MOST_STREAMS = 64
"""Streams of events that are open at once: each queries the archive's revision twice a second."""
STATIC = FilePath(__file__).parent / "static"
_OUR_HEADERS = ("sunarc-calibration", "sunarc-columns", "sunarc-decided-at")
_WORTH_COMPRESSING_BYTES = 1400  # less fits into one packet as it is
_COMPRESSION_LEVEL = 4  # of JSON's numbers, higher ones make little more than work
_COMPRESSED_ALREADY = (
    *DEFAULT_EXCLUDED_CONTENT_TYPES,
    *("application/octet-stream", "application/x-npy", "application/x-npz", "application/x-netcdf"),
)


class _Compression(GZipMiddleware):
    """Compresses answers for clients that accept it; no cache distinguishes the answers to a POST."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        plain = scope.get("method") == "POST" and "gzip" not in Headers(scope=scope).get("accept-encoding", "")
        await (self.app(scope, receive, send) if plain else super().__call__(scope, receive, send))


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
    timezone: str = "UTC",
    is_replay: bool = False,
    sun_zenith_deg: float = 90.0,
    observes_stars: bool = False,
    moves: MovePictures | None = None,
    obstructions: ObstructionLearner | None = None,
    pictures: PictureList | None = None,
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
    images : the composites; None without them.
    timezone : IANA name of the zone whose local times are shown with those in UTC.
    is_replay : whether the frames' clock is that of a replay or of a simulation.
    sun_zenith_deg : images show the sun while its apparent zenith angle is below this, degrees.
    observes_stars : whether the stars are observed while it is dark.
    moves : the pictures before and after moves; None without them.
    obstructions : the mask that the images have shown; None where no images are seen.
    pictures : lists the pictures of a source that are not among `images`; None without them.
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
        timezone=timezone,
        is_replay=is_replay,
        sun_zenith_deg=sun_zenith_deg,
        observes_stars=observes_stars,
        moves=moves,
        obstructions=obstructions,
        pictures=pictures,
        stopping=stopping,
        token=admission.read_token(options.token_file, setting="api.token_file"),
    )
    numbers = CollectorRegistry()
    numbers.register(StatusCollector(context))
    app = new_application("sunarc imager")
    add_camera_routes(app, context)
    app.include_router(camera_list_routes(context))
    app.include_router(health_routes(context, numbers))
    _add_dashboard(app)
    complete(app, context, numbers)
    return app


def new_context(*, archive: Archive, **collaborators: Any) -> ApiContext:  # noqa: ANN401 - the fields of ApiContext
    """Return the collaborators of an application, with the caches that its routes share."""
    ages = Ages(archive)
    return ApiContext(
        archive=archive,
        sites=DaySites(archive),
        ages=ages,
        ready=SingleFlightCache(lambda record: lookup(ages.model(record)), key=model_key),
        ensembles=SingleFlightCache(
            lambda asked: draw_ensemble(
                ages.model(asked.calibration),
                draws=asked.draws,
                seed=asked.seed,
                calibration_id=asked.calibration.id,
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
        dependencies=[Depends(problems.require_known_names)],
    )


def complete(app: FastAPI, context: ApiContext, numbers: CollectorRegistry) -> None:
    """Add the common parts of every application: problem documents, its description, limits, and counts of requests.

    Parameters
    ----------
    app, context : the application, and its collaborators.
    numbers : where Prometheus's numbers are registered: the requests, and the process's use of resources.
    """
    faults, counts = problems.FaultLog(), RequestCounts()
    problems.add_problem_handlers(app, faults)
    describe(app)
    _add_guards(app, context, faults, counts)
    numbers.register(counts)
    ProcessCollector(registry=numbers)


def _add_guards(app: FastAPI, context: ApiContext, faults: problems.FaultLog, counts: RequestCounts) -> None:
    """Put the guards of every request before the application, the innermost first."""
    options = context.options
    app.add_middleware(
        _Compression,
        minimum_size=_WORTH_COMPRESSING_BYTES,
        compresslevel=_COMPRESSION_LEVEL,
        exclude_content_types=_COMPRESSED_ALREADY,
    )
    app.add_middleware(
        Occupancy,
        max_body_bytes=options.max_body_bytes,
        max_array_bytes=options.max_array_bytes,
        within_s=options.request_within_s,
        quota=SharedQuota(options.max_large_at_once * (options.max_array_bytes + MOST_BYTES_AHEAD)),
        at_once=options.max_at_once,
        streams=_MOST_STREAMS,
    )
    reading = admission.read_token(options.read_token_file, setting="api.read_token_file")
    tokens = tuple(token for token in (reading, context.token) if token is not None)
    if reading is not None:
        app.add_middleware(admission.ReadTokenMiddleware, tokens=tokens)
    app.add_middleware(admission.RateLimit, per_s=options.requests_per_s, burst=options.burst, tokens=tokens)
    if options.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=list(options.cors_origins),
            allow_methods=["GET", "POST", "PUT"],
            allow_headers=["authorization", "content-type", "if-none-match"],
            expose_headers=["etag", "location", "retry-after", *_OUR_HEADERS],
        )
    app.add_middleware(admission.AllowedHosts, names=admission.host_names(options))
    sizes = {"max_body_bytes": options.max_body_bytes, "max_array_bytes": options.max_array_bytes}
    app.add_middleware(Boundary, **sizes, faults=faults, count=counts.add)


def add_camera_routes(app: FastAPI, context: ApiContext) -> None:
    """Add every route of one camera: under /v1 for this service's own, under /v1/cameras/{camera} for any."""
    slots, files = ComputeSlots(context.options.max_large_at_once), AnswerFiles()
    for of_camera in (
        direction_routes(context, slots),  # asked most often: routes are compared in this order
        geolocation_routes(context, slots),
        calibration_routes(context),
        decision_routes(context),
        map_routes(context, files),
        sun_routes(context),
        overlay_routes(context),
        record_routes(context),
        housekeeping_routes(context),
        night_routes(context),
        event_stream_routes(context),
        image_routes(context),
        remap_routes(context, files),
        mask_routes(context, files),
        obstruction_routes(context),
        day_air_routes(context),
        move_routes(context),
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
