"""What systemd starts: exposure and memory of the units, and the check of the compiled module before it is loaded."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from configparser import ConfigParser
from pathlib import Path
from types import ModuleType

import pytest

DEPLOY = Path(__file__).parents[2] / "deploy"
UNITS = {path.name: path for path in sorted(DEPLOY.rglob("*.service"))}
EXPOSURE = {
    "sunarc.service": 14,
    "sunarc-hub.service": 14,
    "sunarc-backup.service": 29,
    "sunarc-failed.service": 35,  # runs the operator's own scripts
}
"""Tenths of `systemd-analyze security`."""
SERVING = ("sunarc.service", "sunarc-hub.service")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
@pytest.mark.parametrize("name", UNITS)
def test_every_unit_has_a_bound_of_its_exposure(name: str) -> None:
    command = ["systemd-analyze", "security", "--offline=true", f"--threshold={EXPOSURE[name]}", str(UNITS[name])]
    judged = subprocess.run(command, capture_output=True, text=True, check=False)
    assert judged.returncode == 0, judged.stdout[-200:]


@pytest.mark.parametrize("name", SERVING)
def test_a_service_that_answers_clients_has_a_limit_of_memory_and_is_started_again(name: str) -> None:
    unit = ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(UNITS[name])
    assert unit["Service"]["MemoryMax"] == "2G"
    assert unit["Service"]["Restart"] == "always"


@pytest.fixture
def launcher() -> ModuleType:
    spec = importlib.util.spec_from_file_location("launch", DEPLOY / "debian" / "launch.py")
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def test_a_compiled_module_that_is_changed_or_missing_is_found(launcher: ModuleType, tmp_path: Path) -> None:
    module = tmp_path / "sunarc" / "_kernels.cpython-311-x86_64-linux-gnu.so"
    module.parent.mkdir()
    whole = bytes(range(256)) * 8
    module.write_bytes(whole)
    assert launcher.damaged(tmp_path) is None  # of a version that states no sum
    stated = subprocess.run(["sha256sum", module], capture_output=True, text=True, check=True).stdout.split()[0]
    module.with_name(f"{module.name}.sha256").write_text(f"{stated}\n")
    assert launcher.damaged(tmp_path) is None
    for place in (0, 1, 700, len(whole) - 1):
        module.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        assert launcher.damaged(tmp_path) == module
    module.unlink()
    assert launcher.damaged(tmp_path) == module
