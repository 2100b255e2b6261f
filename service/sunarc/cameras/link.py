"""The way from camera to host: whether packets fit the network, and a frame the socket's buffer."""

from __future__ import annotations

import contextlib
import socket
from dataclasses import dataclass
from pathlib import Path

PREFERRED_BUFFER_BYTES = 32 << 20
PASSED_EVERYWHERE_BYTES = 1500
"""Ethernet's MTU without jumbo frames (IEEE 802.3, 3.2.7)."""

_IP_MTU = 14  # linux/in.h
_CAP_NET_RAW = 13  # linux/capability.h
_MORE_THAN_ANY_BYTES = 1 << 30
_SELF = Path("/proc/self/status")


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """How a stream is received.

    Attributes
    ----------
    packet_bytes : of a stream packet, IP and UDP headers included.
    frame_bytes : of one frame.
    mtu : of the route to the camera, bytes; None where the kernel does not tell.
    packet_socket : a ring that the kernel fills without a socket's buffer (needs CAP_NET_RAW).
    buffer_limit_bytes : `net.core.rmem_max`, up to which the kernel grants a UDP socket's buffer.
    """

    packet_bytes: int
    frame_bytes: int
    mtu: int | None
    packet_socket: bool
    buffer_limit_bytes: int

    @property
    def text(self) -> str:
        """What was chosen and why, for one line of the log."""
        way = (
            "a packet socket (CAP_NET_RAW)"
            if self.packet_socket
            else f"UDP with a socket buffer of up to {_mb(self.buffer_limit_bytes)}"
        )
        route = "" if self.mtu is None else f" (the route takes {self.mtu})"
        return f"packets of {self.packet_bytes} bytes{route}, frames of {_mb(self.frame_bytes)} through {way}"

    @property
    def complaints(self) -> tuple[str, ...]:
        """What will lose packets, each with its remedy."""
        complaints = []
        if self.mtu is not None and self.packet_bytes > self.mtu:
            complaints.append(
                f"packets of {self.packet_bytes} bytes do not fit the network's MTU of {self.mtu}; set "
                f"camera.packet_size = {self.mtu - self.mtu % 4}, or a larger MTU all the way from the camera"
            )
        limit = self.buffer_limit_bytes
        if not self.packet_socket and limit < 2 * self.frame_bytes:
            preferred = max(PREFERRED_BUFFER_BYTES, 1 << (2 * self.frame_bytes - 1).bit_length())
            complaints.append(
                f"a socket may buffer {_mb(limit)} and a frame has {_mb(self.frame_bytes)}: packets are lost when the "
                f"host is busy; run: sysctl -w net.core.rmem_max={preferred}, or give the service CAP_NET_RAW"
            )
        return tuple(complaints)


def link_to(address: str, *, packet_bytes: int, frame_bytes: int, packet_socket: bool) -> Link:
    """Return how a stream from an address will be received; `packet_socket`: whether to use one."""
    return Link(
        packet_bytes=packet_bytes,
        frame_bytes=frame_bytes,
        mtu=route_mtu(address),
        packet_socket=packet_socket and may_open_packet_sockets(),
        buffer_limit_bytes=buffer_limit(),
    )


def route_mtu(address: str) -> int | None:
    """Return the MTU of the route to an address, by the kernel's routing table; nothing is sent."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((address, 9))
        return probe.getsockopt(socket.IPPROTO_IP, _IP_MTU)
    return None


def may_open_packet_sockets() -> bool:
    """Return whether this process has CAP_NET_RAW."""
    with contextlib.suppress(OSError):
        for line in _SELF.read_text(encoding="ascii").splitlines():
            if line.startswith("CapEff:"):
                return bool(int(line.split()[1], 16) >> _CAP_NET_RAW & 1)
    return False


def buffer_limit() -> int:
    """Return the largest receive buffer that the kernel grants a socket, bytes: `net.core.rmem_max`.

    A socket of our own is asked, for the unit hides the file that tells it; the kernel answers with twice the number.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _MORE_THAN_ANY_BYTES)
        return probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def _mb(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:.3g} MB"
