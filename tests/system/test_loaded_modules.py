"""What a field computer imports, and what the package therefore has not."""

from __future__ import annotations

import re
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from tests.fixtures.ports import free_port

from .test_restart import CONFIG, answers, sunarc, wait_for

pytestmark = [pytest.mark.system, pytest.mark.timeout(170)]

NOT_SERVED = {"numba", "llvmlite", "pandas", "pvlib", "pytz", "matplotlib", "xarray", "dask", "astropy", "fsspec"}
NOT_SERVED |= {"h5netcdf", "h5py"}
PAGES = ("healthz", "metrics", "v1/status", "openapi.json", "")

EVERY_IMPORT = """
import ast, importlib.util, pathlib, sys
left_out, wanted, asked = set(sys.argv[1:]), set(), set()
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name in left_out:
            asked.add(name)
sys.meta_path.insert(0, Watch())
for file in pathlib.Path(importlib.util.find_spec("sunarc").origin).parent.rglob("*.py"):
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            wanted |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            wanted |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
for name in sorted(wanted):
    if name.partition(".")[0] in {"scipy", "sqlalchemy", "alembic", "numpy", "cv2", "PIL"}:
        try:
            importlib.import_module(name)
        except ImportError:
            pass
print(*sorted(asked))
"""


@pytest.fixture
def left_out() -> set[str]:
    """Return the modules that deploy/build-deb removes."""
    script = (Path(__file__).parents[2] / "deploy" / "build-deb").read_text()
    parts = re.search(r'^left_out="([^"]+)"', script, re.MULTILINE)
    assert parts is not None
    return {part.replace("/", ".") for part in parts[1].split()}


def test_no_import_of_any_command_asks_for_what_the_package_leaves_out(left_out: set[str]) -> None:
    command = [sys.executable, "-c", EVERY_IMPORT, *left_out]
    done = subprocess.run(command, capture_output=True, text=True, timeout=150.0, check=True)
    assert done.stdout.split() == []


def test_a_running_service_has_loaded_nothing_that_it_does_not_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, left_out: set[str]
) -> None:
    monkeypatch.setenv(
        "PYTHONPROFILEIMPORTTIME", "1"
    )  # every import of the service and of its children is a line of its log
    port, log = free_port(), tmp_path / "log"
    config = tmp_path / "sunarc.toml"
    config.write_text(CONFIG.format(state=tmp_path / "state", address="127.0.0.77", port=port))
    with sunarc("serve", "--config", str(config), log=log) as service:
        wait_for(lambda: answers(port), within_s=100.0, log=log)
        for page in PAGES:
            urllib.request.urlopen(f"http://127.0.0.1:{port}/{page}", timeout=20.0).close()
        service.terminate()
        service.wait(timeout=20.0)
    loaded = set(re.findall(r"^import time:[\s\d|]+([\w.]+)$", log.read_text(), re.MULTILINE))
    assert "sunarc.imager.app.service" in loaded
    assert loaded & (NOT_SERVED | left_out) == set()
