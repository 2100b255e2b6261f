"""The life of a hub: its database, workers and web server, started and stopped in order."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Mapping
from datetime import datetime

from fastapi import FastAPI
from prometheus_client import CollectorRegistry
from starlette.staticfiles import StaticFiles

import sunarc
from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.hub.feed_routes import FeedReceiver, FeedSizes, feed_routes
from sunarc.hub.feeds import HubRun
from sunarc.hub.fleet_routes import FleetCollector, fleet_page, fleet_routes, nightly_routes, pair_routes
from sunarc.hub.fleet_states import FleetMember, members
from sunarc.hub.nightly import NightlyWork, nightly_jobs
from sunarc.imager.app.pushing import push_workers
from sunarc.imager.app.service import hub_recording
from sunarc.imager.app.serving import LOOP_STALE_S, load_credentials, new_server, running, stop_on_signals, supervised
from sunarc.imager.archive.notices import CameraState
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.daily_job import Schedule
from sunarc.imager.runtime.host import listen, notifier_from
from sunarc.imager.runtime.status import StatusRegistry, StatusSnapshot
from sunarc.imager.runtime.supervisor import Heartbeat, Monitored, Watchdog
from sunarc.imager.settings.model import HubSettings
from sunarc.imager.web.app import STATIC, add_camera_routes, complete, new_application, new_context
from sunarc.imager.web.context import refuse_refit
from sunarc.imager.web.options import ApiOptions
from sunarc.imager.web.routes.health import camera_list_routes
from sunarc.sky.site import Site

_LOOK_EVERY_S = 10.0  # at all cameras; imagers report their state every minute
_DUE_EVERY_S = 60.0
_LONGEST_NIGHT_S = 4 * 3600.0  # of all nightly jobs


def serve_hub(settings: HubSettings) -> int:
    """Run a hub until SIGTERM or SIGINT; return the process's exit code.

    Raises
    ------
    SchemaError : the database is of another revision; its owner migrates it.
    OutsideError : the database does not answer; the port is taken.
    """
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    address = f"{socket.gethostname()}:{settings.api.port}"
    run = HubRun(address=address, version=sunarc.__version__, started_at=SystemClock().now())
    store = run.store(settings.archive)
    with listen(settings.api.host, settings.api.port) as listening, open_hub_archive(store) as archive:
        return _serve_at(listening, archive, settings)


def _serve_at(listening: socket.socket, archive: HubArchive, settings: HubSettings) -> int:
    clock = SystemClock()
    board = StatusRegistry(version=sunarc.__version__, started_at=clock.now(), monotonic=clock.monotonic)
    notifier = notifier_from(os.environ)
    options = load_credentials(settings.api)
    app = create_hub_app(
        archive=archive, status=board.snapshot, now=clock.now, options=options, stopping=lambda: server.should_exit
    )
    heartbeat = Heartbeat(clock.monotonic)
    server = new_server(
        app,
        options,
        on_started=lambda: notifier.ready(f"hub at http://{options.host}:{options.port}/"),
        heartbeat=heartbeat,
    )
    workers = push_workers(
        settings.push,
        archive=archive,
        states=fleet_states(archive, clock.now),
        clock=clock,
        board=board,
        client="hub",
        every_s=_LOOK_EVERY_S,
    )
    jobs = nightly_jobs(archive, settings.nightly)
    nightly = NightlyWork(archive=archive, jobs=jobs, clock=clock, board=board)
    schedule = Schedule(nightly.run_due, every_s=_DUE_EVERY_S, clock=clock, board=board)
    stop_on_signals(server)
    with (
        supervised(
            (*workers, *hub_recording(archive, board, clock)),
            clock=clock,
            board=board,
            watchdog=Watchdog(
                feed=notifier.watchdog,
                monitored=[
                    Monitored(name="web", heartbeat=heartbeat, stale_after_s=LOOP_STALE_S),
                    Monitored(name="schedule", heartbeat=schedule.heartbeat, stale_after_s=_LONGEST_NIGHT_S),
                ],
                on_check=[schedule.follow_clock],
            ),
            on_failed=lambda: None,  # no worker of a hub ends it
        ),
        running(schedule),
    ):
        server.run(sockets=[listening])
        notifier.stopping()
    return 0


def fleet_states(archive: HubArchive, now: Callable[[], datetime]) -> Callable[[], Mapping[str, CameraState]]:
    """Return a function that returns the states of a hub's cameras, by their last reports."""

    def states() -> Mapping[str, CameraState]:
        # What was registered and sent nothing yet has no state that could change.
        known = [camera for camera in archive.feeds.fleet() if camera.received_at is not None]
        return {
            camera.camera: CameraState(
                health=camera.state,
                state=camera.service_state,
                state_text=camera.state_text,
                conditions=_fleet_conditions(camera),
                calibration=camera.calibration,
                calibrated_at=camera.calibrated_at,
                sky_rms_deg=camera.sky_rms_deg,
            )
            for camera in members(tuple(known), now(), archive.nightly.cross_checks())
        }

    return states


def _fleet_conditions(camera: FleetMember) -> Mapping[str, Mapping[str, object]]:
    """Return the conditions that an imager reported of itself, and those that the hub finds."""
    reported = (camera.status or {}).get("conditions")
    codes = [str(code) for code in reported] if isinstance(reported, list) else []
    return {code: {"code": code} for code in (*codes, *(one.code for one in camera.why))}


def create_hub_app(
    *,
    archive: HubArchive,
    status: Callable[[], StatusSnapshot],
    now: Callable[[], datetime],
    options: ApiOptions,
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
        moves=None,
        obstructions=None,
        stopping=stopping,
        token=None,
    )
    receiver = FeedReceiver(archive, now)
    numbers = CollectorRegistry()
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
    complete(app, context, numbers)
    app.add_middleware(FeedSizes, receiver=receiver)
    return app
