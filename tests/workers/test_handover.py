from __future__ import annotations

import threading

from sunarc.workers.loop import DropOldestQueue


def test_things_come_out_in_the_order_they_went_in() -> None:
    queue: DropOldestQueue[int] = DropOldestQueue(capacity=3)
    for thing in (1, 2, 3):
        queue.put(thing)
    assert [queue.get(timeout_s=0.0) for _ in range(3)] == [1, 2, 3]


def test_a_full_queue_drops_its_oldest_and_counts_it() -> None:
    queue: DropOldestQueue[int] = DropOldestQueue(capacity=2)
    for thing in (1, 2, 3):
        queue.put(thing)
    assert queue.dropped == 1
    assert [queue.get(timeout_s=0.0), queue.get(timeout_s=0.0)] == [2, 3]


def test_an_empty_queue_answers_none_in_time() -> None:
    assert DropOldestQueue[int](capacity=1).get(timeout_s=0.01) is None


def test_a_waiting_reader_is_woken_by_a_writer() -> None:
    queue: DropOldestQueue[str] = DropOldestQueue(capacity=1)
    got: list[str | None] = []
    reader = threading.Thread(target=lambda: got.append(queue.get(timeout_s=10.0)))
    reader.start()
    queue.put("frame")
    reader.join(timeout=5.0)
    assert got == ["frame"]
