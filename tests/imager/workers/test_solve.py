"""The process that a solve gets: where the unit refuses what it asks for, it solves all the same."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
from functools import partial

import numpy as np
import pytest

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.imager.runtime.child_process import answer_call
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.workers.calibrating.solver_process import ChildControl, SolveProblem, call_on, in_child
from sunarc.sky.site import Site


def refuse(increment: int) -> int:
    raise PermissionError(1, f"Operation not permitted: {increment}")


def test_a_solve_that_may_not_step_back_is_solved_as_an_equal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "nice", refuse)  # as the filter of deploy/sunarc.service does
    monkeypatch.setattr(
        "sunarc.imager.runtime.child_process.keep_freed_memory", lambda: None
    )  # this process is no child
    receiving, sending = multiprocessing.Pipe()
    nothing = Sightings.of(unix_s=np.empty(0), pixels=np.empty((0, 2)))
    site = Site(latitude=36.6, longitude=-97.5, altitude=318.0)
    problem = SolveProblem(points=nothing, site=site, image_size=(1748, 1748), options=CalibrationOptions())
    receiving.send(call_on(problem, calibrate))
    answer_call(sending)
    assert receiving.poll(1.0)
    assert isinstance(receiving.recv(), Calibration)  # refused, and told why; without it, a broken pipe


def test_the_process_of_a_solve_imports_the_core_and_neither_workers_nor_the_database() -> None:
    nothing = Sightings.of(unix_s=np.empty(0), pixels=np.empty((0, 2)))
    site = Site(latitude=36.6, longitude=-97.5, altitude=318.0)
    problem = SolveProblem(points=nothing, site=site, image_size=(1748, 1748), options=CalibrationOptions())
    call = call_on(problem, calibrate)
    listing = (
        "import pickle, sys; from sunarc.imager.runtime.child_process import answer_call;"
        "pickle.load(sys.stdin.buffer);"
        "print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", listing], input=pickle.dumps(call), capture_output=True, check=True)
    imported = set(done.stdout.decode().split())
    assert "sunarc.calibration.calibrate" in imported
    assert not imported & {
        "sunarc.imager.workers",
        "sunarc.imager.archive",
        "sqlalchemy",
        "sunarc.imager.runtime.status",
        "fastapi",
    }


def test_memory_that_is_kept_is_not_mapped_anew() -> None:
    def faults(first: str) -> int:
        script = (
            "from resource import getrusage, RUSAGE_SELF\n"
            "from sunarc.imager.runtime.child_process import keep_freed_memory\n"
            f"{first}\nbytearray(4_000_000); before = getrusage(RUSAGE_SELF).ru_minflt\n"
            "for _ in range(30): bytearray(4_000_000)\n"
            "print(getrusage(RUSAGE_SELF).ru_minflt - before)"
        )
        as_the_unit = {**os.environ, "MALLOC_MMAP_THRESHOLD_": "1048576"}
        return int(
            subprocess.run([sys.executable, "-c", script], capture_output=True, check=True, env=as_the_unit).stdout
        )

    anew = faults("")
    assert anew >= 30
    assert faults("keep_freed_memory()") < 0.1 * anew


@pytest.mark.parametrize("name", ["OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"])
def test_the_process_of_a_solve_computes_with_one_thread(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, "")  # so that it is unset again
    monkeypatch.delenv(name)
    control = ChildControl(SystemClock(), 60.0, threading.Event(), lambda: None)
    assert in_child(partial(os.getenv, name), control) == "1"
