"""What is said of the way from camera to host."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from sunarc.imager.cameras.features import Link, buffer_limit, link_to, route_mtu

WELL = Link(packet_bytes=8000, frame_bytes=8_000_000, mtu=9000, packet_socket=False, buffer_limit_bytes=33_554_432)


def test_what_was_chosen_stands_in_one_line() -> None:
    assert WELL.text == (
        "packets of 8000 bytes (the route takes 9000), frames of 8 MB through UDP with a socket buffer of up to 33.6 MB"
    )
    assert WELL.complaints == ()
    assert "packet socket (CAP_NET_RAW)" in replace(WELL, packet_socket=True).text


def test_debian_s_own_buffer_is_too_small_and_the_command_is_named() -> None:
    (said,) = replace(WELL, buffer_limit_bytes=212_992).complaints
    assert "sysctl -w net.core.rmem_max=33554432" in said
    assert replace(WELL, buffer_limit_bytes=212_992, packet_socket=True).complaints == ()


def test_packets_larger_than_the_network_takes_are_told() -> None:
    (said,) = replace(WELL, mtu=1500).complaints
    assert "camera.packet_size = 1500" in said


def test_a_route_tells_its_mtu_and_an_impossible_one_nothing() -> None:
    assert (route_mtu("127.0.0.1") or 0) >= 1500
    assert route_mtu("no address") is None


def test_the_kernel_s_limit_is_told_without_its_file() -> None:
    told = Path("/proc/sys/net/core/rmem_max")
    if not told.exists():  # as in a network namespace, or under the unit's ProcSubset=pid
        assert 100_000 < buffer_limit() <= 1 << 30
    else:
        assert buffer_limit() == int(told.read_text())


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become someone without privileges")
def test_someone_without_privileges_gets_no_packet_socket() -> None:
    link = link_to("127.0.0.1", packet_bytes=1400, frame_bytes=1000, packet_socket=True)
    script = "from sunarc.imager.cameras.features import may_open_packet_sockets as may; print(may())"
    told = subprocess.run(
        ["setpriv", "--bounding-set=-net_raw", "--inh-caps=-net_raw", sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout.strip() == "False"
    assert link.packet_bytes == 1400
