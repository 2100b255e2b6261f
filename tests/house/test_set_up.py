from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from time import perf_counter

import pytest

pytestmark = [pytest.mark.system, pytest.mark.slow]


@pytest.fixture(scope="module")
def fresh(checkout: Path) -> Path:
    """Return a checkout that was set up, after a first attempt that was cut off half-way."""
    remains = checkout / ".venv" / "lib" / "remains"
    remains.mkdir(parents=True)
    assert "making" in set_up(checkout / "deploy" / "demo")
    assert not remains.exists()
    return checkout


def set_up(command: Path) -> str:
    """Run a command as far as its set-up, from a folder that is not the checkout."""
    answer = subprocess.run([command, "--setup-only"], cwd="/", capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    return answer.stdout


def ask(checkout: Path, code: str) -> str:
    python = checkout / ".venv" / "bin" / "python"
    answer = subprocess.run([python, "-c", code], cwd="/", capture_output=True, text=True, check=True)
    return answer.stdout.strip()


def test_the_venv_is_on_debians_python_and_sees_only_gi_of_its_packages(fresh: Path) -> None:
    assert ask(fresh, "import sys; print(sys.base_prefix)") == "/usr"
    assert ask(fresh, "import sys; print([p for p in sys.path if 'dist-packages' in p])") == "[]"
    assert ask(fresh, "import gi; gi.require_version('Aravis', '0.8'); from gi.repository import Aravis") == ""


def test_the_package_is_the_checkouts_own(fresh: Path) -> None:
    assert ask(fresh, "import sunarc; print(sunarc.__file__)") == str(fresh / "service" / "sunarc" / "__init__.py")


@pytest.mark.parametrize("command", ["deploy/demo", "tests/run", ".ci/run"])
def test_a_second_run_finds_everything_done(fresh: Path, command: str) -> None:
    before_s = perf_counter()
    said = set_up(fresh / command)
    assert perf_counter() - before_s < 3.0
    assert said.count("\n") == 1
    assert f"{fresh}/.venv" in said


def test_a_venv_on_another_interpreter_is_made_anew(fresh: Path) -> None:
    python = fresh / ".venv" / "bin" / "python"
    python.unlink()
    python.write_text("#!/bin/sh\necho /opt/other 3.99\n")
    python.chmod(0o755)
    assert "making" in set_up(fresh / "deploy" / "demo")
    assert ask(fresh, "import sunarc; print('here')") == "here"


HOLDER = """
import fcntl, sys, time
with open(sys.argv[1], "w") as lock:
    fcntl.lockf(lock, fcntl.LOCK_EX)
    print("held", flush=True)
    time.sleep(float(sys.argv[2]))
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="apt's locks are root's")
@pytest.mark.parametrize("lock", ["lists/lock", "dpkg/lock-frontend"])
def test_a_lock_of_apt_is_waited_for_and_said(root: Path, tmp_path: Path, lock: str) -> None:
    """With Debian's own apt-get, in folders of its own, where it finds no package."""
    for folder in ("lists/partial", "dpkg", "archives/partial"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "dpkg" / "status").touch()
    (tmp_path / "apt.conf").write_text(
        f'Dir::State::Lists "{tmp_path}/lists"; Dir::State::status "{tmp_path}/dpkg/status";'
        f'Dir::Cache::archives "{tmp_path}/archives";'
        'Dir::Etc::sourcelist "/dev/null"; Dir::Etc::sourceparts "/dev/null";'
    )
    environment = {**os.environ, "APT_CONFIG": str(tmp_path / "apt.conf")}
    command = [sys.executable, "-c", HOLDER, str(tmp_path / lock), "2.5"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        before_s = perf_counter()
        setup = [str(root / "deploy" / "setup"), "sunarc-no-such-package"]
        answer = subprocess.run(setup, env=environment, capture_output=True, text=True, check=False)
        assert perf_counter() - before_s > 2.0
    assert f"process {holder.pid} (" in answer.stdout
    assert "Could not get lock" not in answer.stderr
    assert "Unable to locate package sunarc-no-such-package" in answer.stderr


def test_a_checkout_without_its_lock_is_told_so_in_one_line(checkout: Path, tmp_path: Path) -> None:
    script = tmp_path / "deploy" / "setup"
    script.parent.mkdir()
    script.write_bytes((checkout / "deploy" / "setup").read_bytes())
    answer = subprocess.run(["sh", script], capture_output=True, text=True, check=False)
    assert answer.returncode == 1
    assert answer.stderr.count("\n") == 1
    assert f"{tmp_path}/requirements.lock" in answer.stderr
