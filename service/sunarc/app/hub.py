"""The life of a hub: its database and its web server, started and stopped in order."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

from sunarc.api import create_hub_app
from sunarc.app.serving import new_server, stop_on_signals, with_credentials
from sunarc.archive import open_archive
from sunarc.runtime.clock import SystemClock
from sunarc.runtime.heartbeats import Heartbeat
from sunarc.runtime.preflight import listen
from sunarc.runtime.systemd import notifier_from, watchdog_interval_s
from sunarc.settings import HubSettings


def serve_hub(settings: HubSettings) -> int:
    """Run a hub until SIGTERM or SIGINT; return the process's exit code.

    Raises
    ------
    SchemaError : the database is of another revision; its owner migrates it.
    OutsideError : the database does not answer; the port is taken.
    """
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    clock = SystemClock()
    with listen(settings.api.host, settings.api.port) as listening, open_archive(settings.archive) as archive:
        notifier = notifier_from(os.environ)
        options = with_credentials(settings.api)
        app = create_hub_app(archive=archive, now=clock.now, options=options, stopping=lambda: server.should_exit)
        server = new_server(
            app,
            options,
            on_started=lambda: notifier.ready(f"hub at http://{options.host}:{options.port}/"),
            heartbeat=_Fed(clock.monotonic, notifier.watchdog, watchdog_interval_s(os.environ, pid=os.getpid())),
        )
        stop_on_signals(server)
        server.run(sockets=[listening])
        notifier.stopping()
    return 0


class _Fed(Heartbeat):
    """A heartbeat of the server's loop that resets systemd's watchdog.

    Parameters
    ----------
    monotonic : seconds that never jump.
    feed : resets the watchdog.
    interval_s : within which it has to be reset; None where there is none.
    """

    def __init__(self, monotonic: Callable[[], float], feed: Callable[[], None], interval_s: float | None) -> None:
        super().__init__(monotonic)
        self._now_s, self._feed = monotonic, feed
        self._every_s = None if interval_s is None else interval_s / 3.0
        self._fed_s = monotonic()

    def beat(self) -> None:
        """Beat, and reset the watchdog when a third of its interval is over."""
        super().beat()
        if self._every_s is not None and self._now_s() - self._fed_s >= self._every_s:
            self._fed_s = self._now_s()
            self._feed()
