"""The service's life: footing, workers, schedule and web server, started and stopped in order."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from typing import cast

import uvicorn

from sunarc.api import ApiOptions, BoundedConnection, create_app
from sunarc.app.cameras import camera_opener, require_stored_site
from sunarc.app.service import Service
from sunarc.archive import ImageStore, Reserve, lock_state, open_archive, prepare_database, require_unlocked
from sunarc.clock import SystemClock
from sunarc.footing import listen, prepare_state
from sunarc.schedule import Schedule
from sunarc.settings import Settings
from sunarc.supervisor import Supervisor
from sunarc.systemd import Notifier, credential, notifier_from, watchdog_interval_s

_STOP_WITHIN_S = 4.0
_KEEP_ALIVE_S = 20


def serve(settings: Settings) -> int:
    """Run the service until SIGTERM or SIGINT; return the process's exit code.

    Raises
    ------
    OutsideError : the state folder cannot be used, or another service uses it; the port is taken.
    """
    require_unlocked(settings.state)  # before the port: a second service mostly has the first one's port too
    listening = listen(settings.api.host, settings.api.port)
    prepare_state(settings.state)
    with lock_state(settings.state):
        return _serve_at(listening, settings)


def _serve_at(listening: socket.socket, settings: Settings) -> int:
    clock = SystemClock()
    prepare_state(settings.images)
    _make_room(settings)
    recovered = prepare_database(settings.database, backups=settings.backups, images=settings.images, now=clock.now())
    archive = open_archive(settings.database)
    require_stored_site(archive, settings)
    service = Service(
        settings,
        archive=archive,
        clock=clock,
        open_camera=camera_opener(settings, clock),
        recovered=recovered,
    )
    notifier = notifier_from(os.environ)
    server = _web_server(service, on_started=lambda: notifier.ready(f"serving at {_address(settings)}"))
    for number in (signal.SIGTERM, signal.SIGINT):  # the web server hands on what it was stopped by; it ends here
        signal.signal(number, lambda *_: None)
    with ExitStack() as stack:
        stack.enter_context(listening)
        stack.callback(service.archive.close)
        supervisor = stack.enter_context(_supervised(service, notifier, on_failed=lambda: _stop_serving(server)))
        stack.enter_context(_scheduled(service))
        gc.collect()
        gc.freeze()  # else looking through all modules again holds every thread up for a tenth of a second
        server.run(sockets=[listening])
        notifier.stopping()
    return 3 if supervisor.failed.is_set() else 0


def _make_room(settings: Settings) -> None:
    """See that the database can be opened, should the disk be full."""
    images = ImageStore(settings.images, options=settings.disk)
    images.make_room()
    Reserve(settings.reserve, size_bytes=int(settings.disk.reserve_mb * 1e6)).balance(images.usage().free_bytes)


def _web_server(service: Service, *, on_started: Callable[[], None]) -> uvicorn.Server:
    options = _with_credentials(service.settings.api)
    app = create_app(
        archive=service.archive,
        camera=service.settings.name,
        site=service.settings.site,
        status=service.board.snapshot,
        request_refit=service.request_refit,
        frame_clock=service.frame_time.now,
        latest_image=lambda: service.images.newest(kind="hdr.jpg", until=service.frame_time.now()),
        options=options,
    )
    return _Server(
        uvicorn.Config(
            app,
            http=cast("type[asyncio.Protocol]", partial(BoundedConnection, options)),
            ws="none",
            log_level="warning",
            access_log=False,  # addresses and queries are nobody's business
            timeout_keep_alive=_KEEP_ALIVE_S,
            timeout_graceful_shutdown=1,
            server_header=False,
            proxy_headers=True,  # for whom a proxy on loopback asks; nobody else is believed
            forwarded_allow_ips=["127.0.0.1", "::1"],
        ),
        on_started=on_started,
    )


def _with_credentials(options: ApiOptions) -> ApiOptions:
    """Return the options with the tokens that systemd holds, where no file is set."""
    return replace(
        options,
        token_file=options.token_file or credential(os.environ, "api-token"),
        read_token_file=options.read_token_file or credential(os.environ, "api-read-token"),
    )


class _Server(uvicorn.Server):
    """A web server that says when it listens; before that, nobody is told that the service is ready."""

    def __init__(self, config: uvicorn.Config, *, on_started: Callable[[], None]) -> None:
        super().__init__(config)
        self._on_started = on_started

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen, and say so."""
        await super().startup(sockets)
        self._on_started()


def _address(settings: Settings) -> str:
    return f"http://{settings.api.host}:{settings.api.port}/"


def _stop_serving(server: uvicorn.Server) -> None:
    server.should_exit = True


@contextmanager
def _supervised(service: Service, notifier: Notifier, *, on_failed: Callable[[], None]) -> Iterator[Supervisor]:
    interval_s = watchdog_interval_s(os.environ, pid=os.getpid())
    supervisor = Supervisor(
        service.workers(),
        clock=service.clock,
        board=service.board,
        feed=notifier.watchdog,
        check_every_s=1.0 if interval_s is None else min(interval_s / 3.0, 1.0),
        on_failed=on_failed,
    )
    supervisor.start()
    try:
        yield supervisor
    finally:
        supervisor.stop(within_s=_STOP_WITHIN_S)


@contextmanager
def _scheduled(service: Service) -> Iterator[None]:
    schedule = Schedule(
        service.look_around,
        every_s=service.settings.refit.check_every_s,
        clock=service.clock,
        board=service.board,
    )
    schedule.start()
    try:
        yield
    finally:
        schedule.stop(within_s=1.0)
