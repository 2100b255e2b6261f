"""The page of workers is true: its example runs under the supervisor, and its names and numbers are the code's."""

from __future__ import annotations

import inspect
import re
import textwrap
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sunarc.imager.app import serving
from sunarc.imager.app.service import Service
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime import loop, supervisor
from sunarc.imager.runtime.clock import SystemClock, VirtualClock
from sunarc.imager.runtime.loop import Attempts, DropOldestQueue, Loop, entries
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.runtime.supervisor import Supervised, Supervisor, SupervisorOptions, Worker
from sunarc.imager.workers.calibrating.watch import WatchWorker
from sunarc.imager.workers.compose import ComposeWorker
from sunarc.imager.workers.replay import ReplayWorker
from sunarc.imager.workers.upkeep import DiskWorker

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/architecture/workers.md").read_text("utf-8")
WORKERS = ROOT / "service/sunarc/imager/workers"
NOON = datetime(2026, 6, 1, 12, tzinfo=UTC)
PATIENCE_S = 30.0


def example() -> dict[str, Any]:
    """Return the names that the page's example defines."""
    blocks: list[str] = re.findall(r"(?:^ {4}.*\n|^\n)+", PAGE, re.MULTILINE)
    (source,) = [one for one in blocks if "def run" in one]
    # A string annotation would be looked up in a module: the example has none.
    found: dict[str, Any] = {"__name__": __name__}
    exec(compile(textwrap.dedent(source), "workers.md", "exec"), found)  # noqa: S102 - the page's own example
    return found


def frame(level: int, time: datetime) -> Frame:
    image = np.full((4, 4), level, dtype=np.uint16)
    return Frame(
        time=time, image=image, exposure_us=1000.0, gain_db=0.0, frame_id=1, pixel_format="Mono12", full_scale=4095
    )


def test_the_example_works_under_the_supervisor() -> None:
    clock = SystemClock()
    board = StatusRegistry(version="0", started_at=NOON, monotonic=clock.monotonic)
    queue: DropOldestQueue[Frame] = DropOldestQueue(capacity=2)
    for level, minute in ((4000, 0), (200, 1), (5, 2)):
        queue.put(frame(level, NOON.replace(minute=minute)))
    worker = example()["BrightnessWorker"](frames=queue, board=board)
    supervised = Supervisor([Supervised(name="brightness", make_worker=lambda: worker)], clock=clock, board=board)
    supervised.start()
    waited = threading.Event()
    for _ in range(int(PATIENCE_S / 0.05)):
        if not len(queue):
            break
        waited.wait(0.05)
    assert supervised.stop(within_s=PATIENCE_S) == ()
    assert board.snapshot().last_frame_at == NOON.replace(minute=1)
    assert queue.dropped == 1
    assert [(one.name, one.state, one.restarts) for one in board.snapshot().workers] == [("brightness", "stopped", 0)]


@pytest.mark.parametrize(
    ("thing", "names"),
    [
        (Worker, ["run"]),
        (Loop, ["every", "repeat", "wait"]),
        (DropOldestQueue, ["put", "get", "dropped", "full"]),
        (Service, ["workers"]),
        (WatchWorker, ["process_next"]),
        (DiskWorker, ["check"]),
        (ComposeWorker, ["compose"]),
    ],
)
def test_named_methods_exist(thing: type, names: list[str]) -> None:
    for name in names:
        assert hasattr(thing, name)
        assert re.search(rf"\b{name}\b", PAGE)


def test_named_things_exist() -> None:
    for thing in (Attempts, ReplayWorker, VirtualClock, StatusRegistry, Supervised, Supervisor):
        assert f"`{thing.__name__}`" in PAGE
    for field in ("max_restarts", "within_s", "stale_after_s"):
        assert field in SupervisorOptions.__dataclass_fields__
        assert f"`{field}`" in PAGE
    for field in ("make_worker", "essential", "optional"):
        assert field in Supervised.__dataclass_fields__
        assert f"`{field}`" in PAGE
    assert list(inspect.signature(Worker.run).parameters) == ["self", "stop", "heartbeat"]
    assert list(inspect.signature(entries).parameters) == ["queue", "stop", "heartbeat"]


def test_stated_numbers_are_those_of_the_code() -> None:
    pauses = supervisor._BACK_OFF
    assert f"after {pauses.every_s:g} s, doubled after each death, up to {pauses.longest_s:g} s" in PAGE
    assert f"every {supervisor._RETRY_FAILED_S:g} s" in PAGE
    assert serving._STOP_WITHIN_S == 4.0
    assert "within four seconds" in PAGE
    assert loop._HEARTBEAT_S == 1.0
    assert "at least once a second" in PAGE


def test_a_file_holds_one_worker_that_the_supervisor_runs() -> None:
    several = {}
    for file in WORKERS.rglob("*.py"):
        found = re.findall(r"^class (\w*Worker)\b", file.read_text("utf-8"), re.MULTILINE)
        if len(found) > 1:
            several[file.name] = found
    assert sorted(several) == ["push.py", "upkeep.py"]
    assert all(f"`{name}`" in PAGE for name in several)


def test_the_page_is_short() -> None:
    assert len(PAGE.split()) <= 600
