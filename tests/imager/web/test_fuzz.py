"""A short form of `python -m tests.imager.web.fuzz`: whether answers keep to the OpenAPI document."""

from __future__ import annotations

import argparse
import re
import subprocess
from pathlib import Path

import pytest
from tests.imager.web.fuzz import command, environment, served


@pytest.mark.slow
@pytest.mark.timeout(420)
def test_every_answer_is_one_that_the_document_describes(tmp_path: Path) -> None:
    with served(tmp_path) as address:
        asked = command(address, argparse.Namespace(examples=1, seed=1, only=None))
        asked += ["--phases", "examples,coverage,fuzzing", "--no-color"]
        done = subprocess.run(
            asked, capture_output=True, text=True, timeout=400, check=False, cwd=tmp_path, env=environment()
        )
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    assert int(re.findall(r"(\d+) generated", done.stdout)[0]) > 1000
