"""Detection in processes: the same answers in the same order as without, and a process that dies is an answer."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import cv2
import numpy as np
import pytest

from sunarc.detection.values import Detection
from sunarc.findings import Finding
from sunarc.reanalysis import ingest as run
from sunarc.reanalysis.ingest import Answers, detect_in_files, detect_in_pool
from sunarc.reanalysis.look import LookTask

N_TASKS = 8
EXPECTED = ["hidden" if n % 5 else "file_size_differs" for n in range(N_TASKS)]


def tasks(folder: Path) -> list[LookTask]:
    made = []
    for number in range(N_TASKS):
        path = f"{number}.png"
        size = 40 if number % 5 else 41
        cv2.imwrite(str(folder / path), np.zeros((size, size), dtype=np.uint8))
        made.append(LookTask(path=folder / path, exposure_us=20.0, method="auto", size=(40, 40)))
    return made


def dying(task: LookTask) -> Answers:
    """Do as a process does that the kernel ends on one image."""
    if task.path.name == "2.png":
        os.kill(os.getpid(), signal.SIGKILL)
    return detect_in_files(task)


def blocking(_task: LookTask) -> Answers:
    """Answer which signals a process does not receive."""
    return (Finding("blocked", {"signals": " ".join(map(str, signal.pthread_sigmask(signal.SIG_BLOCK, [])))}),)


def codes(answers: list[Answers]) -> list[str]:
    return [one.code if isinstance(one, Finding) else one.verdict for answered in answers for one in answered]


def test_few_images_are_looked_at_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "_pool", None)
    here = list(detect_in_pool(tasks(tmp_path), n_tasks=4, processes=2))
    assert codes(here) == EXPECTED
    assert all(one.exposure_us == 20.0 for (one,) in here if isinstance(one, Detection))


def test_answers_keep_the_order_and_an_image_that_kills_its_process_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "detect_in_files", dying)
    monkeypatch.setattr(run, "_AHEAD", 1)
    answers = list(detect_in_pool(tasks(tmp_path), n_tasks=N_TASKS, processes=2))
    assert codes(answers) == [*EXPECTED[:2], "worker_died", *EXPECTED[3:]]


def test_an_interrupt_is_for_the_run_and_not_for_its_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "detect_in_files", blocking)
    (answer,) = run.answered_alone(tasks(tmp_path)[0])
    assert isinstance(answer, Finding)
    assert str(signal.SIGINT) in str(answer.data["signals"]).split()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
