"""What the service stands on: a folder that it may write to, and a port that is free."""

from __future__ import annotations

import os
import socket
import uuid
from pathlib import Path

from sunarc.errors import OutsideError


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
