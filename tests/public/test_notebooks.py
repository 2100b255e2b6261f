"""The notebooks of the front door run, with the outputs that are stored, where `sunarc[plots]` alone is installed."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = ("front_door.ipynb", "pictures.ipynb")
MOST_LINES = 20
OF_OTHER_EXTRAS = ("xarray", "fastapi", "h5netcdf", "yaml", "pandas", "dask")


def cells(name: str) -> list[dict[str, Any]]:
    notebook = json.loads((ROOT / "docs" / "examples" / name).read_text("utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_is_short_and_stored_with_its_outputs(name: str) -> None:
    code = cells(name)
    assert sum(bool(line.strip()) for cell in code for line in "".join(cell["source"]).splitlines()) <= MOST_LINES
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert any("accepted" in "".join(output.get("text", [])) for output in outputs)


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the interpreter of a clean environment with the package and its extra `plots`."""
    if "plots" not in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]:
        pytest.skip("the package has no extra `plots`")
    folder = tmp_path_factory.mktemp("plots")
    build: list[str | Path] = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    subprocess.run(["/usr/bin/python3", "-m", "venv", "--without-pip", folder / "venv"], check=True)
    found = folder / "venv" / "bin" / "python"
    uv = Path(sys.executable).with_name("uv")
    lock = ROOT / "requirements.lock"
    install: list[str | Path] = [
        uv,
        "pip",
        "install",
        "--quiet",
        "--python",
        found,
        "--constraint",
        lock,
        f"{wheel}[plots]",
    ]
    subprocess.run(install, check=True, capture_output=True)
    return found


@pytest.mark.system
@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_runs_where_the_extra_of_plots_alone_is_installed(python: Path, name: str, tmp_path: Path) -> None:
    missing = "import importlib.util, sys; print(*[one for one in sys.argv[1:] if importlib.util.find_spec(one)])"
    found = subprocess.run([python, "-c", missing, *OF_OTHER_EXTRAS], check=True, capture_output=True, text=True)
    assert found.stdout.split() == []
    script = ROOT / "docs" / "examples" / "notebooks.py"
    done = subprocess.run([python, script, name], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_the_pictures_of_the_explanation_are_drawn_by_its_script(tmp_path: Path) -> None:
    folder = ROOT / "docs" / "explanation"
    subprocess.run([sys.executable, folder / "draw.py", tmp_path], check=True, capture_output=True)
    drawn = {path.name for path in tmp_path.iterdir()}
    assert drawn == {path.name for path in folder.glob("*.png")}
    assert all(f"(explanation/{name})" in (ROOT / "docs" / "explanation.md").read_text("utf-8") for name in drawn)
