"""A start on the field computer's slow disk and cores is what an outage lasts; a process computes with one thread."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import typer

from sunarc.cli import main

HEAVY = ("numpy", "numba", "scipy", "cv2", "sqlalchemy", "rich", "fastapi", "uvicorn", "pandas", "matplotlib")
LISTED = {name: command for commands in main.houses().values() for name, command in commands.items()}
LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
MULTIPLIED = """
import os, sys
sys.argv = ["sunarc", "--version"]
from sunarc.cli.main import main
{call}
import cv2, numpy
a = numpy.ones((600, 600)); a @ a
cv2.GaussianBlur(numpy.ones((2000, 2000), dtype=numpy.float32), (0, 0), 5)
print(len(os.listdir("/proc/self/task")), cv2.getNumThreads())
"""


def _answer(code: str, **environment: str) -> str:
    """Return what a process prints that has no limits on threads but those stated."""
    unlimited = {name: value for name, value in os.environ.items() if name not in LIMITS}
    run = subprocess.run(
        [sys.executable, "-c", code], env={**unlimited, **environment}, capture_output=True, text=True, check=True
    )
    return run.stdout.strip()


@pytest.mark.parametrize("argument", ["--version", "--help"])
def test_what_computes_nothing_loads_no_library(argument: str) -> None:
    code = f"""
import sys
sys.argv = ["sunarc", {argument!r}]
from sunarc.cli.main import main
try:
    main()
except SystemExit as ended:
    print(ended.code, [name for name in {HEAVY} if name in sys.modules])
"""
    assert _answer(code).splitlines()[-1] == "0 []"


def test_a_command_loads_no_library_that_only_others_need() -> None:
    others = ("pandas", "matplotlib", "xarray", "scipy.stats", "scipy.signal", "alembic", "distributed")
    code = f"""
import sys
import sunarc.cli.main as main
for name in ("calibrate", "detect", "serve"):
    main.load_command(name)
print([name for name in {others} if name in sys.modules])
"""
    assert _answer(code) == "[]"


def test_a_fit_of_a_file_loads_neither_the_service_nor_the_settings() -> None:
    service = (
        "fastapi",
        "uvicorn",
        "prometheus_client",
        "sqlalchemy",
        "sunarc.imager.web",
        "sunarc.imager.archive.archive",
        "sunarc.imager.workers",
    )
    code = f"import sys, sunarc.cli.calibrate; print([name for name in {service} if name in sys.modules])"
    assert _answer(code) == "[]"


SIGHTINGS = Path(__file__).parents[2] / "docs/examples/front_door/sun.csv"


def test_a_fit_of_one_day_loads_numpy_and_no_other_library_of_arrays_or_images() -> None:
    heavy = (
        "scipy",
        "cv2",
        "PIL",
        "rich",
        "pandas",
        "matplotlib",
        "xarray",
        "sqlalchemy",
        "ephem",
        "numpy.f2py",
        "yaml",
    )
    code = f"""
sys.argv = ["sunarc", "calibrate", {str(SIGHTINGS)!r}, *"--latitude 36.604 --longitude -97.485".split()]
sys.argv += "--altitude 318 --image-size 1748,1748".split()
from sunarc.cli.main import main
try:
    main()
except SystemExit as ended:
    assert not ended.code
"""
    loaded = _loaded(code)
    assert "numpy" in loaded
    assert not {*heavy, "sunarc.formats.formats", "sunarc.sources.image_files"}.intersection(loaded)


FIT = tuple(f"sunarc.calibration.{name}" for name in ("calibrate", "fit", "noise", "paper", "pose", "solve", "start"))
SCIPY = ("scipy.linalg", "scipy.ndimage", "scipy.optimize", "scipy.spatial")


def _loaded(code: str) -> list[str]:
    """Return the modules that a process has loaded after some code."""
    return _answer(f"import sys\n{code}\nprint(*sys.modules)").splitlines()[-1].split()


@pytest.mark.parametrize("module", ["covariance", "direction_table", "error_model"])
def test_a_pixel_a_direction_and_a_map_are_answered_without_a_fit(module: str) -> None:
    loaded = _loaded(f"import sunarc.calibration.answers.{module}, sunarc.formats.calibration_document")
    assert len([name for name in loaded if name.startswith("sunarc.calibration")]) <= 15
    assert not {*FIT, *SCIPY, "pandas", "cv2", "sqlalchemy", "pydantic"}.intersection(loaded)


@pytest.mark.parametrize("command", ["codes", "project", "unproject", "compare", "export"])
def test_a_command_that_fits_nothing_loads_no_fit(command: str) -> None:
    code = f"""
sys.argv = ["sunarc", {command!r}, "--help"]
from sunarc.cli.main import main
try:
    main()
except SystemExit:
    pass
"""
    loaded = _loaded(code)
    assert not {*FIT, "sunarc.imager.web", "sunarc.imager.app.service", "sunarc.lab.simulation"}.intersection(loaded)
    assert not any(name.startswith("sunarc.lab.") for name in loaded)


def test_the_list_of_commands_says_what_each_says_of_itself() -> None:
    for name, listed in LISTED.items():
        found = getattr(import_module(listed.module), listed.name)
        said = str(found.info.help) if isinstance(found, typer.Typer) else str(inspect.getdoc(found))
        assert said.split("\n\n")[0].replace("\n", " ") == listed.help, name


def test_every_module_with_commands_is_in_the_list() -> None:
    listed = {command.module.removeprefix("sunarc.cli.") for command in LISTED.values()}
    shared = {"__init__", "main", "commands", "options", "owner"}
    assert {path.stem for path in Path(main.__file__).parent.glob("*.py")} - shared == listed


def test_a_command_that_is_not_there_is_refused_with_the_one_that_may_be_meant() -> None:
    run = subprocess.run([sys.executable, "-m", "sunarc", "calibate"], capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert re.search(r"\bcalibrate\b", run.stderr)


LIMITED = "try: main()\nexcept SystemExit: pass"


def test_a_command_computes_with_one_thread_in_blas_and_opencv() -> None:
    assert _answer(MULTIPLIED.format(call=LIMITED)).splitlines()[-1] == "1 1"


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one processor has one thread in any case")
def test_what_the_environment_says_of_threads_holds() -> None:
    assert _answer(MULTIPLIED.format(call=LIMITED), OPENCV_FOR_THREADS_NUM="2").splitlines()[-1].endswith(" 2")
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        threads = _answer(MULTIPLIED.format(call=LIMITED), OPENCV_FOR_THREADS_NUM="1", **{name: "2"})
        assert int(threads.splitlines()[-1].split()[0]) > 1
