"""The pages of the booted set and of the campaign, of the files that their runs leave."""

from __future__ import annotations

import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest
from tests.release import last_run

XML = """<testsuites><testsuite>
<testcase classname="tests.booted.test_power" name="test_a_cut" time="90.0" />
<testcase classname="tests.booted.test_power" name="test_many_cuts[1|2]" time="30.0">
<failure message="two&#10;lines | of it">long</failure></testcase>
<testcase classname="tests.booted.test_upgrade" name="test_old" time="0"><skipped message="no package" /></testcase>
</testsuite></testsuites>"""


def test_the_booted_sets_page_has_every_test_with_its_outcome() -> None:
    lines = last_run.booted(XML)
    assert lines[0] == "1 passed, 1 failed, 1 skipped, in 2 minutes."
    assert "| test_power | test_a_cut | 90 | passed |" in lines
    assert "| test_upgrade | test_old | 0 | skipped: no package |" in lines
    (failed,) = [line for line in lines if "**failed**" in line]
    assert failed == "| test_power | test_many_cuts[1\\|2] | 30 | **failed**: two lines \\| of it |"


def test_the_campaigns_page_has_every_fault_and_what_was_found() -> None:
    window = {"number": 3, "faults": ["kill", "late"], "found": ["lost 5"], "singly": {"kill": ["lost 6"], "late": []}}
    bad = {"source": "gige", "seed": 22, "faults": {"kill": 30, "full_disk": 12}, "windows": 4, "good": False}
    bad |= {"lost": ["5", "6"], "worst": 0.03125, "recovered_s": [2, 4, 90], "failed": [window]}
    good = {"source": "folder", "seed": 23, "faults": {"kill": 1, "late": 2}, "windows": 1, "lost": [], "good": True}
    lines = last_run.campaign([bad, good], repairs="- Mended.\n")
    assert lines[0] == "45 faults of 3 kinds in 5 windows, 2 runs by source and seed: **1 not good**."
    assert "| fault | gige 22 | folder 23 | all |" in lines
    assert "| kill | 30 | 1 | 31 |" in lines
    assert "| lost | 5, 6 | 0 |" in lines
    assert "| worst | 0.0312 |  |" in lines
    assert "| recovered_s | 4, at most 90 |  |" in lines
    assert "gige 22, window 3: kill, late: lost 5" in lines
    assert "Singly: kill: lost 6, late: good" in lines
    assert lines[-1] == "- Mended."


def test_a_page_says_when_and_of_which_commit() -> None:
    text = last_run.page("campaign", ["a"], commit="abc-dirty", moment=datetime(2026, 11, 26, 3, 4, tzinfo=UTC))
    assert "2026-11-26 03:04 UTC, commit abc-dirty" in text


@pytest.mark.parametrize(("kind", "content"), [("booted", "<testsuites />"), ("booted", "x"), ("campaign", "{}")])
def test_a_run_that_left_nothing_gives_no_page(root: Path, tmp_path: Path, kind: str, content: str) -> None:
    (tmp_path / "file").write_text(content)
    command: list[str | Path] = [
        sys.executable,
        "-m",
        "tests.release.last_run",
        kind,
        tmp_path / "file",
        tmp_path / "page.md",
    ]
    assert subprocess.run(command, cwd=root, capture_output=True, check=False).returncode == 1
    assert not (tmp_path / "page.md").exists()
