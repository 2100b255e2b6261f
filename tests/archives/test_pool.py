"""Detection in processes: the same answers in the same order as without, and a process that dies is an answer."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from sunarc.archives import pool
from sunarc.archives.pool import ProcessRunner
from sunarc.common.findings import Finding
from sunarc.detection.values import Detection
from sunarc.sources.look import Answer, Chunk, Item, look_at

N_TASKS = 8
EXPECTED = ["hidden" if n % 5 else "file_size_differs" for n in range(N_TASKS)]


def chunks(folder: Path) -> list[Chunk]:
    made = []
    for number in range(N_TASKS):
        size = 40 if number % 5 else 41
        cv2.imwrite(str(folder / f"{number}.png"), np.zeros((size, size), dtype=np.uint8))
        made.append(Chunk("roof", str(folder), "auto", (40, 40), (Item(f"{number}.png", 0, 20.0),)))
    return made


def looked(given: list[Chunk], *, run: Callable[[Chunk], list[Answer]] = look_at) -> list[Answer]:
    answers: list[Answer] = []
    ProcessRunner(2).look(given, lambda _, found: answers.extend(found), run=run)
    return answers


def dying(chunk: Chunk) -> list[Answer]:
    """Do as a process does that the kernel ends on one image."""
    if chunk.items[0].file == "2.png":
        os.kill(os.getpid(), signal.SIGKILL)
    return look_at(chunk)


def blocking(chunk: Chunk) -> list[Answer]:
    """Answer which signals a process does not receive."""
    blocked = " ".join(str(int(one)) for one in signal.pthread_sigmask(signal.SIG_BLOCK, []))
    return [Answer(chunk.items[0].file, 0, Finding("blocked", {"signals": blocked}))]


def codes(answers: list[Answer]) -> list[str]:
    return [
        one.found.code if isinstance(one.found, Finding) else one.found.verdict
        for one in answers
        if isinstance(one.found, Finding | Detection)
    ]


def test_few_images_are_looked_at_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "ProcessPoolExecutor", None)
    here = looked(chunks(tmp_path)[:4])
    assert codes(here) == EXPECTED[:4]
    assert all(one.found.exposure_us == 20.0 for one in here if isinstance(one.found, Detection))


def test_answers_keep_the_order_and_an_image_that_kills_its_process_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool, "_AHEAD", 1)
    assert codes(looked(chunks(tmp_path), run=dying)) == [*EXPECTED[:2], "worker_died", *EXPECTED[3:]]


def test_an_interrupt_is_for_the_run_and_not_for_its_processes(tmp_path: Path) -> None:
    answers = [one.found for one in looked(chunks(tmp_path), run=blocking)]
    assert len(answers) == N_TASKS
    for found in answers:
        assert isinstance(found, Finding)
        assert str(int(signal.SIGINT)) in str(found.data["signals"]).split()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def faults_of_a_second_image() -> int:
    """Return how many pages a process has mapped anew for arrays as large as those that it has freed."""
    _ = [np.ones(2_500_000) for _ in range(5)]
    del _
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    _ = [np.ones(2_500_000) for _ in range(5)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


def test_a_process_keeps_the_memory_of_an_image_for_the_next_one() -> None:
    with pool._new_pool(1) as process:
        assert process.submit(faults_of_a_second_image).result(timeout=60.0) < 500
