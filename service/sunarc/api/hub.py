"""Application of a hub: the rows of imagers are received, and each of their cameras is answered for."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from fastapi import FastAPI
from prometheus_client import CollectorRegistry
from starlette.staticfiles import StaticFiles

from sunarc.api.app import STATIC, add_camera_routes, complete, count_requests, new_application, new_context
from sunarc.api.context import refuse_refit
from sunarc.api.options import ApiOptions
from sunarc.api.routes.feed import FeedReceiver, FeedSizes, feed_routes
from sunarc.api.routes.fleet import FleetCollector, fleet_page, fleet_routes, nightly_routes, pair_routes
from sunarc.api.routes.health import camera_list_routes
from sunarc.archive.archive import Archive
from sunarc.runtime.status import StatusSnapshot
from sunarc.sky.site import Site


def create_hub_app(
    *,
    archive: Archive,
    status: Callable[[], StatusSnapshot],
    now: Callable[[], datetime],
    options: ApiOptions,
    registry: CollectorRegistry | None = None,
    stopping: Callable[[], bool] = lambda: False,
) -> FastAPI:
    """Return an application that takes the rows of imagers, and answers for each of their cameras.

    What an imager decides is not changed here: routes that change something answer 403.

    Parameters
    ----------
    archive : the fleet's.
    status : returns how the hub is.
    now : real time.
    options : limits and the token for reading.
    registry : where Prometheus's numbers are registered; a new one by default.
    stopping : returns whether the hub is about to stop: streams of events end then.
    """
    context = new_context(
        archive=archive,
        camera="",  # the hub has none of its own
        site=Site(latitude=0.0, longitude=0.0),
        status=status,
        request_refit=refuse_refit,
        frame_clock=now,
        latest_image=lambda: None,
        options=options,
        images=None,
        stopping=stopping,
        token=None,
    )
    receiver = FeedReceiver(archive, now)
    numbers = registry or CollectorRegistry()
    numbers.register(FleetCollector(archive, now, status))
    app = new_application("sunarc hub")
    app.include_router(feed_routes(receiver))
    add_camera_routes(app, context)
    app.include_router(camera_list_routes(context))
    app.include_router(fleet_routes(archive, now, numbers, status))
    app.include_router(nightly_routes(archive))
    app.include_router(pair_routes(context))
    app.include_router(fleet_page(STATIC))
    app.mount("/static", StaticFiles(directory=STATIC))
    complete(app, context)
    count_requests(app, numbers)
    app.add_middleware(FeedSizes, receiver=receiver)
    return app
