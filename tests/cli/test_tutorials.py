"""The commands of docs/tutorials run as they stand there, one after another, in a copy of the folder that they name."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PAGES = {
    "csv": ["calibration.json", "camera.yaml"],
    "summer": ["summer/report.html", "summer/calibrations/pictures/001.json"],
    "night": ["camera.json", "stars.csv", "night.csv"],
}
"""Tutorials that need no service, with files that a reader has at the end; `tests.release.first_hour` runs a mast's."""
ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"(?:^ {8}\S.*\n)+", re.MULTILINE)
COMMAND = re.compile(r"sunarc |printf |head |cp ")


@pytest.mark.parametrize("name", PAGES)
def test_a_tutorial_runs(name: str, tmp_path: Path) -> None:
    folder = shutil.copytree(ROOT / "docs" / "examples", tmp_path / "examples")
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "HOME": str(tmp_path)}
    page, printed = (ROOT / f"docs/tutorials/{name}.md").read_text("utf-8"), ""
    for indented in BLOCK.findall(page):
        block = re.sub(r"(?m)^ {8}", "", indented)
        if not COMMAND.match(block):  # what the command before prints
            assert _rounded(block) == _rounded(printed)
            continue
        shell = ["/bin/sh", "-ec", block]
        ran = subprocess.run(shell, check=False, cwd=folder, env=environment, capture_output=True, text=True)
        assert ran.returncode == 0, (block, ran.stdout, ran.stderr)
        printed = ran.stdout
    assert [file for file in PAGES[name] if not (folder / file).is_file()] == []


def _rounded(text: str) -> str:
    """Return a text with numbers to two decimals: the last digits are the processor's."""
    return re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.2f}", text)
