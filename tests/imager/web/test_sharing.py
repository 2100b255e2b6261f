"""Slots and memory are shared among addresses; who holds the most gives way."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from functools import partial
from typing import Any

import numpy as np
import pytest
from starlette.types import Message

from sunarc.imager.web.arrays import Rows, rows_response
from sunarc.imager.web.bulk import ComputeSlots
from sunarc.imager.web.middleware.shared_quota import QuotaUse, SharedQuota
from sunarc.imager.web.problems import RefusedError


def run(scenario: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(scenario, 10.0))


async def settle() -> None:
    """Let every task do what it can."""
    for _ in range(10):
        await asyncio.sleep(0)


def test_no_more_are_computed_at_once_than_there_are_places() -> None:
    async def scenario() -> None:
        slots, running, most = ComputeSlots(3), 0, 0

        async def computing(client: str) -> None:
            nonlocal running, most
            async with slots.slot(client):
                running += 1
                most = max(most, running)
                await asyncio.sleep(0)
                running -= 1

        await asyncio.gather(*(computing(str(number % 4)) for number in range(40)))
        assert (most, running) == (3, 0)

    run(scenario())


@pytest.mark.parametrize(("places", "at_once"), [(1, 1), (2, 2), (8, 3)])
def test_a_large_request_is_computed_on_as_many_cores_as_there_are_places_and_three_at_most(
    places: int, at_once: int
) -> None:
    together, lock, running, sent, threads = threading.Barrier(at_once), threading.Lock(), [0, 0], [], set()

    def answer(rows: Rows) -> Rows:
        with lock:
            running[0] += 1
            running[1] = max(running)
            threads.add(threading.get_ident())
        together.wait(5.0)  # goes on when so many compute
        with lock:
            running[0] -= 1
        return rows + 1.0

    async def send(message: Message) -> None:
        sent.append(message.get("body", b""))

    async def receive() -> Message:
        raise AssertionError

    async def scenario() -> None:
        rows, slots = np.arange(6.0 * 65_536 * 2).reshape(-1, 2), ComputeSlots(places)
        response = rows_response(rows, [answer], draws=0, width=2, headers={}, slot=partial(slots.slot, "client"))
        await response({"type": "http"}, receive, send)
        np.testing.assert_array_equal(np.frombuffer(b"".join(sent)[128:]).reshape(-1, 2), rows + 1.0)

    run(scenario())
    assert (running[1], len(threads) >= at_once) == (at_once, True)


def test_addresses_that_wait_take_turns() -> None:
    async def scenario() -> None:
        slots, order, go = ComputeSlots(1), [], asyncio.Event()

        async def computing(client: str) -> None:
            async with slots.slot(client):
                await go.wait()
                order.append(client)

        tasks = [asyncio.create_task(computing(client)) for client in "aaaab"]
        await settle()
        go.set()
        await asyncio.gather(*tasks)
        assert "".join(order) in {"aabaa", "abaaa"}

    run(scenario())


def test_of_an_address_no_more_wait_than_there_are_places_and_another_still_may() -> None:
    async def scenario() -> None:
        slots, go = ComputeSlots(2), asyncio.Event()

        async def computing(client: str) -> None:
            slots.require_room(client)
            async with slots.slot(client):
                await go.wait()

        tasks = []
        for _ in range(4):  # two run, two wait
            tasks.append(asyncio.create_task(computing("a")))
            await settle()
        with pytest.raises(RefusedError) as refused:
            slots.require_room("a")
        assert (refused.value.status, refused.value.headers) == (429, {"retry-after": "1"})
        slots.require_room("b")
        go.set()
        await asyncio.gather(*tasks)

    run(scenario())


def test_who_goes_away_while_waiting_leaves_no_place_taken() -> None:
    async def scenario() -> None:
        slots = ComputeSlots(1)

        async def computing() -> None:
            async with slots.slot("a"):
                await asyncio.sleep(3600.0)

        tasks = [asyncio.create_task(computing()) for _ in range(5)]
        await settle()
        for task in tasks:
            task.cancel()
            await settle()
        async with slots.slot("b"):
            assert all(task.cancelled() for task in tasks)

    run(scenario())


def test_the_address_that_holds_the_most_loses_its_oldest_to_one_that_holds_less() -> None:
    async def scenario() -> None:
        quota = SharedQuota(100)

        async def holding(client: str, amount: int, made: list[QuotaUse]) -> None:
            with quota.open(client) as mine:
                made.append(mine)
                mine.grow(amount)
                async with asyncio.timeout(None) as until:
                    mine.ends(until)
                    await asyncio.sleep(3600.0)

        made: list[QuotaUse] = []
        tasks = [asyncio.create_task(holding(client, 30, made)) for client in ("a", "a", "b")]
        await settle()
        with quota.open("a") as more, pytest.raises(RefusedError) as refused:
            more.grow(11)  # it would hold the most itself
        assert refused.value.status == 429
        with quota.open("c") as other:
            other.grow(11)
            await settle()
            assert [one.ended for one in made] == [True, False, False]
            with pytest.raises(TimeoutError):
                await tasks[0]
        for task in tasks[1:]:
            task.cancel()
        await asyncio.wait(tasks)
        with quota.open("d") as all_of_it:
            all_of_it.grow(100)  # what was held was given back, once

    run(scenario())


def test_equals_do_not_end_one_another() -> None:
    async def scenario() -> None:
        quota = SharedQuota(2)
        with quota.open("a") as one, quota.open("b") as two, quota.open("c") as three:
            one.grow(1)
            two.grow(1)
            with pytest.raises(RefusedError):
                three.grow(1)
            assert not one.ended

    run(scenario())
