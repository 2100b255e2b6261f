from __future__ import annotations

import threading
from datetime import UTC, datetime, timedelta

from sunarc.imager.runtime.clock import SystemClock, VirtualClock, host_clock_state

START = datetime(2026, 5, 1, 12, tzinfo=UTC)
PATIENCE_S = 20.0


def test_the_system_clock_says_utc_and_goes_on() -> None:
    clock = SystemClock()
    first, first_s = clock.now(), clock.monotonic()
    assert first.utcoffset() == timedelta(0)
    assert clock.now() >= first
    assert clock.monotonic() >= first_s


def test_the_system_clock_waits_as_long_as_it_was_asked() -> None:
    clock = SystemClock()
    before_s = clock.monotonic()
    assert not clock.wait(threading.Event(), 0.05)
    assert clock.monotonic() - before_s >= 0.05


def test_a_wait_ends_when_it_is_stopped() -> None:
    clock, stop = SystemClock(), threading.Event()
    threading.Timer(0.01, stop.set).start()
    before_s = clock.monotonic()
    assert clock.wait(stop, PATIENCE_S)
    assert clock.monotonic() - before_s < PATIENCE_S / 2


def test_waiting_for_what_is_past_does_not_wait() -> None:
    assert not SystemClock().wait(threading.Event(), -1.0)


def test_virtual_time_moves_by_waiting_and_by_hand_only() -> None:
    clock = VirtualClock(START)
    assert (clock.now(), clock.monotonic()) == (START, 0.0)
    assert not clock.wait(threading.Event(), 3600.0)
    clock.advance(0.5)
    assert (clock.now(), clock.monotonic()) == (START + timedelta(seconds=3600.5), 3600.5)
    assert not clock.wait(threading.Event(), -1.0)
    assert clock.monotonic() == 3600.5


def test_virtual_time_stands_still_once_stopped() -> None:
    clock, stop = VirtualClock(START), threading.Event()
    stop.set()
    assert clock.wait(stop, 3600.0)
    assert clock.monotonic() == 0.0


def test_no_virtual_second_is_lost_between_threads() -> None:
    clock = VirtualClock(START)
    threads = [
        threading.Thread(target=lambda: [clock.wait(threading.Event(), 1.0) for _ in range(1000)]) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert clock.monotonic() == 4000.0


def test_the_kernel_says_how_far_its_clock_can_be_trusted() -> None:
    state = host_clock_state()
    assert 0.0 <= state.error_bound_s < 3600.0
    if state.synchronised:
        assert (
            state.error_bound_s < 16.0
        )  # beyond that the kernel itself calls the clock unsynchronised (NTP_PHASE_LIMIT)
