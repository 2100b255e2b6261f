"""Links from imagers to a hub: proxies that fail at random, and a network of its own whose cable is pulled."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

FAULTS = ("cut", "answer_lost", "late", "twice")
"""What a link does to a request: drop it, lose its answer, deliver it after the sender gave it up, deliver it twice."""
_LATE_S = 0.3
_DRIP_S, _MOST_DRIPS = 0.5, 80


@dataclass
class Link:
    """A link from an imager to the hub that fails as it is told: a proxy of one request a connection."""

    hub: tuple[str, int]
    seed: int
    share: float = 0.0
    down: bool = False
    drips: bool = False
    counts: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listening.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._listening.accept()
                threading.Thread(target=self._carry, args=(connection,), daemon=True).start()

    def _carry(self, connection: socket.socket) -> None:
        with suppress(OSError), connection:
            connection.settimeout(30.0)
            request = _whole(connection)
            fault = "cut" if self.down else self._fault()
            self.counts[fault] = self.counts.get(fault, 0) + 1
            if fault == "cut":
                return
            if fault == "late":
                connection.close()
                threading.Event().wait(_LATE_S)
            if fault == "twice":
                self._ask(request)
            answer = self._ask(request)
            for byte in answer[:_MOST_DRIPS] if self.drips else b"":
                connection.sendall(bytes([byte]))
                threading.Event().wait(_DRIP_S)
            if fault in {"", "twice"} and not self.drips:
                connection.sendall(answer)

    def _fault(self) -> str:
        return self._random.choice(FAULTS) if self._random.random() < self.share else ""

    def _ask(self, request: bytes) -> bytes:
        with socket.create_connection(self.hub, timeout=30.0) as hub:
            hub.sendall(request)
            return b"".join(iter(lambda: hub.recv(65_536), b""))


def _whole(connection: socket.socket) -> bytes:
    """Return a request with its body; a sender that closes early leaves what there is."""
    data = b""
    while b"\r\n\r\n" not in data:
        data += _some(connection)
    head, _, body = data.partition(b"\r\n\r\n")
    lengths = [line.split(b":")[1] for line in head.split(b"\r\n") if line.lower().startswith(b"content-length")]
    while len(body) < int(lengths[0]):
        body += _some(connection)
    return head + b"\r\n\r\n" + body


def _some(connection: socket.socket) -> bytes:
    part = connection.recv(65_536)
    if not part:
        raise ConnectionResetError
    return part


class Network:
    """A network namespace for a hub, joined to the others by a cable (a veth pair) that can be pulled; needs root."""

    def __init__(self) -> None:
        self._holder = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])
        self._inside = f"/proc/{self._holder.pid}/ns/net"
        outer, self._inner = (f"fleet{os.getpid() % 10**6}{end}" for end in "ab")
        while Path(self._inside).readlink() == Path("/proc/self/ns/net").readlink():
            threading.Event().wait(0.01)
        subnet = f"10.213.{os.getpid() % 256}"  # of a process; each has its own
        self.host = f"{subnet}.2"
        self.cuts = 0
        _run("ip", "link", "add", outer, "type", "veth", "peer", "name", self._inner, "netns", str(self._holder.pid))
        _run("ip", "addr", "add", f"{subnet}.1/30", "dev", outer)
        _run("ip", "link", "set", outer, "up")
        _run(*self.enter(), "ip", "link", "set", "lo", "up")
        _run(*self.enter(), "ip", "addr", "add", f"{self.host}/30", "dev", self._inner)
        self.mend()

    def enter(self) -> list[str]:
        """Return what starts a command inside."""
        return ["nsenter", f"--net={self._inside}"]

    def cut(self) -> None:
        """Take the hub's end down: what is on the way is lost, and nothing says so."""
        _run(*self.enter(), "ip", "link", "set", self._inner, "down")
        self.cuts += 1

    def mend(self) -> None:
        _run(*self.enter(), "ip", "link", "set", self._inner, "up")

    def close(self) -> None:
        self._holder.kill()
        self._holder.wait(10.0)  # the pair goes with the namespace


def _run(*command: str) -> None:
    subprocess.run(command, check=True, timeout=20.0)


@contextmanager
def network() -> Iterator[Network]:
    """Yield a network, and take it away."""
    made = Network()
    try:
        yield made
    finally:
        made.close()
