"""The parts of the service that its host gives: a state folder, a port, and systemd."""

from __future__ import annotations

import logging
import os
import socket
import uuid
from collections.abc import Mapping
from pathlib import Path

from sunarc.common.errors import OutsideError

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
        self._send_message(f"READY=1\nSTATUS={_join_lines(status)}")

    def status(self, status: str) -> None:
        """Send a status line."""
        self._send_message(f"STATUS={_join_lines(status)}")

    def watchdog(self) -> None:
        """Reset the watchdog."""
        self._send_message("WATCHDOG=1")

    def stopping(self) -> None:
        """Notify that the service is stopping."""
        self._send_message("STOPPING=1")

    def _send_message(self, message: str) -> None:
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


def _join_lines(text: str) -> str:
    return " ".join(text.split())


def prepare_state(folder: Path) -> None:
    """Make the state folder, or a part of it; `OutsideError` names the remedy where it cannot be used."""
    trial = folder / f".{uuid.uuid4().hex}"
    need = "writable"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        trial.touch()
        trial.unlink()
        need = "readable"
        os.scandir(folder).close()
    except OSError as error:
        raise OutsideError(
            f"state folder {folder}: {error.strerror or error}; make it {need}, or set `state` to another"
        ) from None


def listen(host: str, port: int) -> socket.socket:
    """Return a socket bound to the address that is to be served."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)  # named, so that answers go undelayed
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        raise OutsideError(
            f"port {port} at {host}: {error.strerror or error}; end what uses it, or set api.port to another"
        ) from None
    return listening
