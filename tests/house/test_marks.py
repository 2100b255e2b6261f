"""The tests that follow one another are found by the text of their files: tests/run collects no others for them."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
APPLIED = re.compile(r"\bmark\.(?:gige|system|browser|waits)\b")


def test_marks_of_processes_stand_in_test_files_as_tests_run_looks_for_them() -> None:
    (pattern,) = re.findall(r"^marked='(.*)'$", (ROOT / "tests" / "run").read_text(), re.MULTILINE)
    files = [path for path in (ROOT / "tests").rglob("*.py") if APPLIED.search(path.read_text())]
    assert len(files) > 15
    assert [path.name for path in files if not path.name.startswith("test_")] == []
    assert [path.name for path in files if re.search(pattern, path.read_text()) is None] == []
