"""The scripts of docs/studies still run: a renamed import, or a broken table of options, is found without measuring."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[3] / "docs" / "studies"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py"))
LIBRARIES = {
    "coverage_statistics",
    "independent_world",
    "nights",
    "obstruction_world",
    "one_image_world",
    "population",
    "real_like_tracks",
}
"""Imported by other scripts and run by nobody."""


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_is_imported_and_describes_its_options(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = importlib.import_module(name)
    assert Path(script.__file__ or "") == FOLDER / f"{name}.py"
    if name in LIBRARIES:
        assert not hasattr(script, "main")
        return
    monkeypatch.setattr(sys, "argv", [f"{name}.py", "--help"])
    with pytest.raises(SystemExit) as ended:
        script.main()
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: {name}.py")
