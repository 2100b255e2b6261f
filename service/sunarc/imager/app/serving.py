"""The service's life: state folder, workers, schedule and web server, started and stopped in order."""

from __future__ import annotations

import gc
import logging
import multiprocessing
import os
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn

import uvicorn
from fastapi import FastAPI

from sunarc.imager.app.cameras import camera_opener, require_stored_site
from sunarc.imager.app.pushing import imager_states, push_workers
from sunarc.imager.app.service import Service, make_recording_workers
from sunarc.imager.app.status_line import FirstFrame, StatusLine
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.recovery import prepare_database
from sunarc.imager.archive.database.state_folder import lock_state, require_unlocked
from sunarc.imager.archive.database.store import Reserve
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.runtime.clock import Clock, SystemClock
from sunarc.imager.runtime.daily_job import Schedule
from sunarc.imager.runtime.host import credential, listen, notifier_from, prepare_state, watchdog_interval_s
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.runtime.supervisor import Heartbeat, Monitored, Supervised, Supervisor, Watchdog
from sunarc.imager.settings.model import Settings
from sunarc.imager.web.app import create_app
from sunarc.imager.web.middleware.connection_limit import bound_connections
from sunarc.imager.web.options import ApiOptions

if TYPE_CHECKING:  # its readers of files are loaded where a folder is followed
    from sunarc.imager.live.folder_archive import FolderAnalysis

_STOP_WITHIN_S = 4.0


@contextmanager
def supervised(
    workers: Sequence[Supervised],
    *,
    clock: Clock,
    board: StatusRegistry,
    watchdog: Watchdog,
    on_failed: Callable[[], None],
) -> Iterator[Supervisor]:
    """Run workers under a supervisor while the context lasts; the parameters are those of `Supervisor`.

    The watchdog is fed thrice in the time that systemd grants, and at least every second.
    """
    interval_s = watchdog_interval_s(os.environ, pid=os.getpid())
    every_s = 1.0 if interval_s is None else min(interval_s / 3.0, 1.0)
    supervisor = Supervisor(
        workers,
        clock=clock,
        board=board,
        watchdog=replace(watchdog, every_s=every_s),
        on_failed=on_failed,
    )
    supervisor.start()
    try:
        yield supervisor
    finally:
        supervisor.stop(within_s=_STOP_WITHIN_S)


@contextmanager
def running(schedule: Schedule) -> Iterator[None]:
    """Run a schedule while the context lasts, and stop it at its end."""
    schedule.start()
    try:
        yield
    finally:
        schedule.stop(within_s=1.0)


_KEEP_ALIVE_S = 20
LOOP_STALE_S = 30.0  # the web server's loop turns every 0.1 s; its longest step on a busy field computer is seconds
LONGEST_CALL_S = 600.0  # of the scheduled job; judging a year of days that were missed takes a minute


def serve_imager(settings: Settings, *, folder_analysis: FolderAnalysis | None = None) -> int:
    """Run the service until SIGTERM or SIGINT; return the process's exit code.

    SIGHUP is ignored: settings are read at the start, and a closed terminal is no reason to stop.

    Parameters
    ----------
    settings : of the service.
    folder_analysis : see `Service`.

    Raises
    ------
    OutsideError : the state folder cannot be used, or another service uses it; the port is taken.
    """
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    require_unlocked(settings.state)  # before the port: a second service mostly has the first one's port too
    listening = listen(settings.api.host, settings.api.port)
    prepare_state(settings.state)
    with lock_state(settings.state):
        return _serve_at(listening, settings, folder_analysis)


def _serve_at(listening: socket.socket, settings: Settings, folder_analysis: FolderAnalysis | None) -> int:
    clock = SystemClock()
    prepare_state(settings.images)
    _make_room(settings)
    recovered = None
    if settings.store is None:
        recovered = prepare_database(
            settings.database, backups=settings.backups, images=settings.images, now=clock.now()
        )
    archive = open_archive(settings.archive)
    require_stored_site(archive, settings)
    if settings.hub.url is None:
        archive.outbox.disable()  # else it would grow for ever
    service = Service(
        settings,
        archive=archive,
        clock=clock,
        open_camera=camera_opener(settings, clock),
        recovered=recovered,
        folder_analysis=folder_analysis,
    )
    recording = make_recording_workers(service)
    notifier = notifier_from(os.environ)
    status = StatusLine(
        notifier, snapshot=service.board.snapshot, address=_service_url(settings), monotonic=clock.monotonic
    )
    server = _new_web_server(service, on_started=status.ready)
    schedule = daily_schedule(service)
    first_frame = FirstFrame(service.board)
    stop_on_signals(server)
    with ExitStack() as stack:
        stack.enter_context(listening)
        stack.callback(service.archive.close)
        supervisor = stack.enter_context(
            supervised(
                (*service.workers(), *recording, *make_push_workers(service)),
                clock=clock,
                board=service.board,
                watchdog=Watchdog(
                    feed=notifier.watchdog,
                    monitored=monitored_parts(service, server=server, schedule=schedule),
                    on_check=(schedule.follow_clock, first_frame.check, service.check_sightings, status.update),
                ),
                on_failed=lambda: _stop_serving(server),
            )
        )
        stack.enter_context(running(schedule))
        gc.collect()
        gc.freeze()  # else looking through all modules again holds every thread up for a tenth of a second
        server.run(sockets=[listening])
        notifier.stopping()
    return 3 if supervisor.failed.is_set() else 0


def end_process(code: int) -> NoReturn:
    """End the process at once, its output written; the orderly part is over.

    An interpreter that finalizes ends its remaining threads wherever they next ask for the lock. Inside OpenCV or
    another library in C++ that is `std::terminate`, and the process dies of SIGABRT ("terminate called without an
    active exception"). What a thread still does after the time given to it to stop is therefore cut here, and with
    it the process of a solve, which would otherwise go on alone.
    """
    for child in multiprocessing.active_children():
        child.kill()
    logging.shutdown()
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def _make_room(settings: Settings) -> None:
    """Free space for the database before it is opened."""
    images = ImageStore(settings.images, options=settings.disk)
    images.make_room()
    Reserve(settings.reserve, size_bytes=int(settings.disk.reserve_mb * 1e6)).balance(images.usage().free_bytes)


def _new_web_server(service: Service, *, on_started: Callable[[], None]) -> Server:
    options = load_credentials(service.settings.api)
    app = create_app(
        archive=service.archive,
        camera=service.settings.name,
        site=service.settings.place,
        status=service.board.snapshot,
        request_refit=service.request_refit,
        frame_clock=service.frame_time.now,
        latest_image=service.latest_image,
        options=options,
        images=service.images,
        timezone=service.settings.site.timezone,
        is_replay=service.settings.is_replay,
        sun_zenith_deg=service.settings.capture.sun_zenith_deg,
        observes_stars=service.settings.night.enabled,
        moves=service.move_pictures,
        obstructions=service.obstructions,
        pictures=service.pictures,
        stopping=lambda: server.should_exit,
    )
    server = new_server(app, options, on_started=on_started, heartbeat=Heartbeat(service.clock.monotonic))
    return server


def new_server(app: FastAPI, options: ApiOptions, *, on_started: Callable[[], None], heartbeat: Heartbeat) -> Server:
    """Return a web server of an application, with the limits of its connections."""
    config = uvicorn.Config(
        app,
        ws="none",
        log_level="warning",
        access_log=False,  # addresses and queries are not logged
        timeout_keep_alive=_KEEP_ALIVE_S,
        timeout_graceful_shutdown=1,
        server_header=False,
        proxy_headers=True,  # forwarded addresses are accepted from a proxy on loopback only
        forwarded_allow_ips=["127.0.0.1", "::1"],
    )
    return Server(bound_connections(config, options), on_started=on_started, heartbeat=heartbeat)


def load_credentials(options: ApiOptions) -> ApiOptions:
    """Return the options with the tokens that systemd holds, where no file is set."""
    return replace(
        options,
        token_file=options.token_file or credential(os.environ, "api-token"),
        read_token_file=options.read_token_file or credential(os.environ, "api-read-token"),
    )


class Server(uvicorn.Server):
    """A web server that reports when it listens, and whose event loop has a heartbeat.

    Parameters
    ----------
    config : of the server.
    on_started : called once it listens; readiness is reported only then.
    heartbeat : beaten at every turn of the loop, every 0.1 s.
    """

    def __init__(self, config: uvicorn.Config, *, on_started: Callable[[], None], heartbeat: Heartbeat) -> None:
        super().__init__(config)
        self.heartbeat = heartbeat
        self._on_started = on_started

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen on the sockets, and report that the server is ready."""
        await super().startup(sockets)
        self._on_started()

    async def on_tick(self, counter: int) -> bool:
        """Record a heartbeat of the event loop, and return whether the server has to stop."""
        self.heartbeat.beat()
        return await super().on_tick(counter)


def _service_url(settings: Settings) -> str:
    return f"http://{settings.api.host}:{settings.api.port}/"


def stop_on_signals(server: uvicorn.Server) -> None:
    """Install handlers of SIGTERM and SIGINT that stop the server, also before it runs."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: _stop_serving(server))


def _stop_serving(server: uvicorn.Server) -> None:
    # A flag that the loop reads: a signal handler may interrupt any line, also one that holds a lock.
    server.should_exit = True


def monitored_parts(service: Service, *, server: Server, schedule: Schedule) -> tuple[Monitored, ...]:
    """Return the web server and the schedule as parts whose heartbeats are watched."""
    stale_after_s = min(service.settings.supervisor.stale_after_s, LOOP_STALE_S)
    return (
        Monitored(name="web", heartbeat=server.heartbeat, stale_after_s=stale_after_s),
        Monitored(
            name="schedule",
            heartbeat=schedule.heartbeat,
            stale_after_s=service.settings.refit.check_every_s + LONGEST_CALL_S,
        ),
    )


def make_push_workers(service: Service) -> tuple[Supervised, ...]:
    """Return the workers that send messages to receivers."""
    return push_workers(
        service.settings.push,
        archive=service.archive,
        states=imager_states(service.camera, service.board),
        clock=service.clock,
        board=service.board,
        client=service.settings.name,
        every_s=1.0,
    )


def daily_schedule(service: Service) -> Schedule:
    """Return the schedule that judges completed days."""
    return Schedule(
        service.judge_completed_days,
        every_s=service.settings.refit.check_every_s,
        clock=service.clock,
        board=service.board,
    )
