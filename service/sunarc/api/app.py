"""The application, made of what it is handed."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse
from prometheus_client import CollectorRegistry
from starlette.staticfiles import StaticFiles

import sunarc
from sunarc.api.boundary import Boundary
from sunarc.api.calibrations import calibration_routes
from sunarc.api.directions import direction_routes
from sunarc.api.health import health_routes
from sunarc.api.metrics import StatusCollector
from sunarc.api.options import ApiOptions, read_token
from sunarc.api.problems import add_problem_handlers
from sunarc.api.record import record_routes
from sunarc.api.refits import refit_routes
from sunarc.api.schema import describe
from sunarc.api.served import Served
from sunarc.api.sun import sun_routes
from sunarc.archive import Archive, Refit
from sunarc.board import StatusSnapshot
from sunarc.sky import Site

_STATIC = Path(__file__).parent / "static"


def create_app(
    *,
    archive: Archive,
    camera: str,
    site: Site,
    status: Callable[[], StatusSnapshot],
    request_refit: Callable[[str], Refit],
    frame_clock: Callable[[], datetime],
    latest_image: Callable[[], Path | None],
    options: ApiOptions,
    registry: CollectorRegistry | None = None,
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
    registry : where Prometheus's numbers are registered; a new one by default.
    """
    served = Served(
        archive=archive,
        camera=camera,
        site=site,
        status=status,
        request_refit=request_refit,
        frame_clock=frame_clock,
        latest_image=latest_image,
        options=options,
        token=read_token(options.token_file),
    )
    numbers = registry or CollectorRegistry()
    numbers.register(StatusCollector(served))
    app = FastAPI(title="sunarc", version=sunarc.__version__, docs_url=None, redoc_url=None)
    for routes in (calibration_routes, direction_routes, sun_routes, record_routes, refit_routes):
        app.include_router(routes(served))
    app.include_router(health_routes(served, numbers))
    _add_dashboard(app)
    add_problem_handlers(app)
    describe(app)
    app.add_middleware(Boundary, max_body_bytes=options.max_body_bytes)
    return app


def _add_dashboard(app: FastAPI) -> None:
    @app.get("/", include_in_schema=False)
    def dashboard() -> FileResponse:
        return FileResponse(_STATIC / "dashboard.html")

    app.mount("/static", StaticFiles(directory=_STATIC))
