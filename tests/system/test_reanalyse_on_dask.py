"""Workers on Dask: a chunk that kills them is divided; whatever else is killed, the tables stay as they were."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import pytest
from tests.archives.made import MADE, analysed, indexed_in, tables_in
from tests.fixtures.ports import free_port

from sunarc.archives.cluster import Workers, open_cluster
from sunarc.common.findings import Finding
from sunarc.detection.values import Detection
from sunarc.imager.runtime.clock import SystemClock
from sunarc.sources.look import Answer, Chunk, Item

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]
WITHIN_S = 240.0
QUIET = {**os.environ, "PYTHONWARNINGS": "ignore", "OPENBLAS_NUM_THREADS": "1"}


def deadly(chunk: Chunk) -> list[Answer]:
    """Answer for images, and die of one of them."""
    if any(item.file == "deadly" for item in chunk.items):
        os.kill(os.getpid(), signal.SIGKILL)
    sun = Detection(method="paper", accepted=False, verdict="hidden", findings=())
    return [Answer(item.file, item.number, sun) for item in chunk.items]


@pytest.mark.filterwarnings("ignore")
def test_a_chunk_that_kills_its_workers_is_divided_until_the_one_image_is_set_apart() -> None:
    chunks = [
        Chunk("roof", "", "auto", (9, 9), tuple(Item(name, 0, None) for name in names))
        for names in (("a", "b"), ("c", "deadly"), ("d",))
    ]
    found: dict[str, str] = {}

    def done(_: Chunk, answers: list[Answer]) -> None:
        assert not {one.file for one in answers} & set(found)
        found.update({one.file: one.found.code if isinstance(one.found, Finding) else "" for one in answers})

    with open_cluster(Workers(None, 1, deaths=1), clock=SystemClock()) as cluster:
        assert cluster.dashboard.startswith("http://127.0.0.1:")
        cluster.look(chunks, done, run=deadly)
        assert cluster.each(len, [(), (1, 2)]) == [0, 2]  # the workers go on
    assert found == {"a": "", "b": "", "c": "", "d": "", "deadly": "image_kills_workers"}


@contextmanager
def process(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(
        [sys.executable, *command],
        env=QUIET,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as started:
        try:
            yield started
        finally:
            kill(started)


def kill(started: subprocess.Popen[bytes]) -> None:
    if started.poll() is None:
        os.killpg(started.pid, signal.SIGKILL)
    started.wait(30)


def until(condition: Callable[[], bool]) -> None:
    clock, never = SystemClock(), threading.Event()
    deadline = clock.monotonic() + WITHIN_S
    while not condition():
        assert clock.monotonic() < deadline
        clock.wait(never, 0.02)


def chunks_in(target: Path) -> int:
    """Return how many chunks a run has finished, without a hold on its ledger."""
    try:
        with closing(sqlite3.connect(f"file:{target / 'ledger.sqlite'}?mode=ro", uri=True)) as ledger:
            return int(ledger.execute("select count(*) from chunk").fetchone()[0])
    except sqlite3.OperationalError:
        return 0


def test_killed_workers_schedulers_and_drivers_change_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    undisturbed, target = tmp_path / "undisturbed", tmp_path / "out"
    analysed(indexed_in(tmp_path), undisturbed, monkeypatch)
    address = f"tcp://127.0.0.1:{free_port()}"
    site = [f"--{name}={getattr(MADE.site, name)}" for name in ("latitude", "longitude", "altitude")]
    scheduler = ("-m", "distributed.cli.dask_scheduler", "--host", address, "--dashboard-address", "127.0.0.1:0")
    worker = (
        "-m",
        "distributed.cli.dask_worker",
        address,
        "--nthreads",
        "1",
        "--no-dashboard",
        "--death-timeout",
        "60",
    )
    driver = ("-m", "sunarc", "reanalyse", f"--cameras={tmp_path / 'cameras.toml'}", *site, f"--output={target}",
              f"--scheduler={address}", "--yes", "--no-exports")  # fmt: skip
    with ExitStack() as stack:
        first_scheduler = stack.enter_context(process(*scheduler))
        first_worker = stack.enter_context(process(*worker))
        first_driver = stack.enter_context(process(*driver))
        until(lambda: chunks_in(target) >= 1)
        kill(first_worker)
        stack.enter_context(process(*worker))
        until(lambda: chunks_in(target) >= 3)
        kill(first_scheduler)
        stack.enter_context(process(*scheduler))
        stack.enter_context(process(*worker))
        until(lambda: chunks_in(target) >= 6)
        kill(first_driver)
        before = chunks_in(target)
        second_driver = stack.enter_context(process(*driver))
        until(lambda: second_driver.poll() is not None)
        assert second_driver.returncode in {0, 1}  # 1: the fits of so few images may be refused
    assert before < chunks_in(target)
    assert tables_in(target) == tables_in(undisturbed)
