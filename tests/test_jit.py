"""Kernels whose cache on disk fails: they are compiled, and answer, all the same."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from tests.fixtures.kernels import damage_kernels

from sunarc import jit

KERNEL = """
import os, sys
from sunarc.jit import njit

@njit(nogil=True)
def twice(x: float) -> float:
    return 2.0 * x

for _ in range(2):
    assert twice(21.0) == 42.0
print(sum(twice.stats.cache_hits.values()), end="")
"""


def run(folder: Path, *, before: str = "", script: str = KERNEL) -> subprocess.CompletedProcess[str]:
    """Run a kernel in a process of its own, its cache in `folder`."""
    file = folder.parent / "kernel.py"
    file.write_text(before + script)
    environment = {"NUMBA_CACHE_DIR": str(folder), "PATH": "/usr/bin:/bin", "HOME": "/nonexistent"}
    return subprocess.run([sys.executable, file], env=environment, capture_output=True, text=True, check=False)


def test_a_kernel_is_compiled_once_and_then_read_from_the_disk(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    assert (run(folder).stdout, run(folder).stdout) == ("0", "1")


@pytest.mark.parametrize(("kind", "rest"), [("nbi", b""), ("nbc", b"torn")], ids=["empty index", "torn kernel"])
def test_a_cache_that_a_power_cut_damaged_is_written_anew(tmp_path: Path, kind: str, rest: bytes) -> None:
    folder = tmp_path / "cache"
    run(folder)
    (damaged,) = folder.rglob(f"*.{kind}")
    damaged.write_bytes(rest)
    done = run(folder)
    assert (done.returncode, done.stdout) == (0, "0"), done.stderr
    assert "cannot be read" in done.stderr
    assert run(folder).stdout == "1"


DEPLOY = Path(__file__).parents[1] / "deploy"
SERVING = KERNEL.replace("for _", "from sunarc.jit import set_aside_after_death\nset_aside_after_death()\nfor _")


def stop_post(unit: str, folder: Path, *, result: str, status: str) -> None:
    """Run what a unit runs after the end of its process, with what systemd says of that end."""
    text = (DEPLOY / unit).read_text().replace("\\\n", "")
    (script,) = re.findall(r"^ExecStopPost=-/bin/sh -c '(.*)'$", text, re.MULTILINE)
    environment = {"NUMBA_CACHE_DIR": str(folder), "SERVICE_RESULT": result, "EXIT_STATUS": status}
    subprocess.run(["/bin/sh", "-c", script], env=environment, check=True)


@pytest.mark.parametrize("unit", ["sunarc.service", "hub/sunarc-hub.service"])
def test_a_damaged_kernel_ends_one_life_and_the_next_compiles_it_anew(tmp_path: Path, unit: str) -> None:
    folder = tmp_path / "cache"
    run(folder, script=SERVING)
    for _ in range(2):  # the second time another folder is aside already
        assert damage_kernels(folder) == 1
        ended = run(folder, script=SERVING)
        assert ended.returncode in {-signal.SIGSEGV, -signal.SIGILL}
        stop_post(unit, folder, result="signal", status=signal.Signals(-ended.returncode).name.removeprefix("SIG"))
        healed = run(folder, script=SERVING)
        assert (healed.returncode, healed.stdout) == (0, "0"), healed.stderr
        assert f"set aside in {folder}.aside" in healed.stderr
        assert run(folder, script=SERVING).stdout == "1"
    assert {path.name for path in tmp_path.iterdir()} == {"cache", "cache.aside", "kernel.py"}


@pytest.mark.parametrize(
    ("result", "status"),
    [("signal", "KILL"), ("signal", "TERM"), ("watchdog", "ABRT"), ("exit-code", "3"), ("success", "0")],
)
def test_no_other_end_costs_the_compiled_kernels(tmp_path: Path, result: str, status: str) -> None:
    folder = tmp_path / "cache"
    run(folder, script=SERVING)
    stop_post("sunarc.service", folder, result=result, status=status)
    assert run(folder, script=SERVING).stdout == "1"


def test_a_folder_that_cannot_be_renamed_is_set_aside_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on an overlay, whose lower layer has the folder."""
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "kernel.nbc").touch()
    (tmp_path / "cache.died").write_text("SEGV")

    def refuse(*_: object) -> None:
        raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))

    monkeypatch.setattr(os, "rename", refuse)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    jit.set_aside_after_death()
    assert [str(path.relative_to(tmp_path)) for path in sorted(tmp_path.rglob("*"))] == [
        "cache.aside",
        "cache.aside/kernel.nbc",
    ]


ARRAYS = """
import math, sys
import numpy as np
from sunarc.jit import njit

@njit()
def total(values: object) -> float:
    raised = np.zeros_like(values)
    for row in range(len(values)):
        raised[row] = math.expm1(values[row])
    if len(values) > 5:
        raise ValueError("too many")
    return raised.sum()

assert abs(total(np.arange(3.0)) - math.expm1(1.0) - math.expm1(2.0)) < 1e-12
read = total.stats.cache_hits
print(len(read), "numba.np.polynomial.polynomial_core" in sys.modules, end=" ")
try:
    total(np.arange(6.0))
except ValueError:
    print("refused", end=" ")
print(abs(total(np.arange(3.0, dtype=np.float32)) - 8.1073) < 1e-3, end="")
"""


def test_a_kernel_is_read_without_what_numba_compiles_with(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    assert run(folder, script=ARRAYS).stdout.split() == ["0", "True", "refused", "True"]
    for stored in folder.rglob("*.2.nbc"):  # of the other type: compiled once more
        stored.unlink()
    assert run(folder, script=ARRAYS).stdout.split() == ["1", "False", "refused", "True"]


CALLED = """
from sunarc.jit import njit

@njit(nogil=True)
def factor() -> float:
    return {factor}
"""
CALLING = """
from called import factor
from sunarc.jit import njit

@njit(nogil=True)
def scaled(x: float) -> float:
    return between(x)

@njit(nogil=True)
def between(x: float) -> float:
    return factor() * x

print(scaled(21.0), sum(scaled.stats.cache_hits.values()), end="")
"""


def test_a_kernel_is_compiled_again_where_one_that_it_calls_has_changed(tmp_path: Path) -> None:
    """In another file, by way of a kernel that is defined below; unchanged, both are read from the disk."""
    (tmp_path / "calling.py").write_text(CALLING)
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PATH": "/usr/bin:/bin", "HOME": "/nonexistent"}
    for factor, expected in ((2.0, "42.0 0"), (2.0, "42.0 1"), (3.0, "63.0 0"), (3.0, "63.0 1")):
        (tmp_path / "called.py").write_text(CALLED.format(factor=factor))
        command = [sys.executable, "-B", str(tmp_path / "calling.py")]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (0, expected), done.stderr


OUT_OF_REACH = """
import os
os.chmod(os.environ["NUMBA_CACHE_DIR"], 0)
if os.geteuid() == 0:
    os.seteuid(65534)
print(scaled(21.0), sum(scaled.stats.cache_hits.values()), end="")
"""


def test_a_cache_out_of_reach_since_the_start_leaves_kernels_in_memory(tmp_path: Path) -> None:
    """Also one that calls another: its files are read, its folder is not."""
    folder = tmp_path / "cache"
    (tmp_path / "called.py").write_text(CALLED.format(factor=2.0))
    done = run(folder, script=CALLING.rsplit("print", 1)[0] + OUT_OF_REACH)
    assert (done.returncode, done.stdout) == (0, "42.0 0"), done.stderr


FULL = """
import errno, os, numba.core.caching as caching
def full(self, name, data):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
caching.IndexDataCacheFile._save_data = full
"""


def test_a_full_disk_leaves_a_kernel_in_memory(tmp_path: Path) -> None:
    done = run(tmp_path / "cache", before=FULL)
    assert (done.returncode, done.stdout) == (0, "0"), done.stderr
    assert "No space left on device; kernels are compiled again at the next start" in done.stderr


def test_a_cache_folder_that_cannot_be_made_leaves_a_kernel_in_memory(tmp_path: Path) -> None:
    unusable = "import os; os.environ['NUMBA_CACHE_DIR'] = '/dev/null/cache'\n"
    for locator in (
        "InTreeCacheLocator",
        "InTreeCacheLocatorFsAgnostic",
        "UserWideCacheLocator",
    ):  # as in /usr, for a user without a home
        unusable += f"import numba.core.caching as c; c.{locator}.from_function = classmethod(lambda *_: None)\n"
    done = run(tmp_path / "cache", before=unusable)
    assert (done.returncode, done.stdout) == (0, "0"), done.stderr
    assert "no locator available" in done.stderr
