"""Notifications to systemd: ready, status, watchdog, stopping (sd_notify(3), Type=notify)."""

from __future__ import annotations

import logging
import socket
from collections.abc import Mapping
from pathlib import Path

_log = logging.getLogger(__name__)


class Notifier:
    """Sends the service's state to its service manager, if there is one.

    Parameters
    ----------
    address : path of the manager's datagram socket, `@name` in the abstract namespace; "" sends nothing.
    """

    def __init__(self, address: str) -> None:
        # systemd writes the zero byte that begins an abstract socket's name as "@".
        self._address = "\0" + address[1:] if address.startswith("@") else address

    def ready(self, status: str) -> None:
        """Notify that the service is ready, with a status line."""
        self._send(f"READY=1\nSTATUS={_line(status)}")

    def status(self, status: str) -> None:
        """Send a status line."""
        self._send(f"STATUS={_line(status)}")

    def watchdog(self) -> None:
        """Reset the watchdog."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Notify that the service is stopping."""
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as outlet:
                outlet.setblocking(False)
                outlet.sendto(message.encode(), self._address)
        except OSError as error:  # a deaf manager is no reason to stop taking pictures
            _log.warning("sd_notify %s failed: %s", message.split("\n", 1)[0], error)


def notifier_from(environment: Mapping[str, str]) -> Notifier:
    """Return the notifier that the process's environment asks for (NOTIFY_SOCKET)."""
    return Notifier(environment.get("NOTIFY_SOCKET", ""))


def credential(environment: Mapping[str, str], name: str) -> Path | None:
    """Return the file of a credential that the unit loads (`LoadCredential=NAME:…`); None without one."""
    folder = environment.get("CREDENTIALS_DIRECTORY")
    path = Path(folder) / name if folder else None
    return path if path is not None and path.exists() else None


def watchdog_interval_s(environment: Mapping[str, str], *, pid: int) -> float | None:
    """Return within how many seconds systemd must hear of this process (WATCHDOG_USEC), None when it does not care.

    Parameters
    ----------
    environment : of the process.
    pid : of the process; a watchdog set for another one (WATCHDOG_PID) is not ours.
    """
    microseconds = environment.get("WATCHDOG_USEC", "")
    if environment.get("WATCHDOG_PID", str(pid)) != str(pid) or not microseconds.isdecimal() or not int(microseconds):
        return None
    return int(microseconds) / 1e6


def _line(text: str) -> str:
    return " ".join(text.split())
