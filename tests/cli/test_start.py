"""A start on the field computer's slow disk and cores is what an outage lasts."""

from __future__ import annotations

import subprocess
import sys

HEAVY = ("pandas", "matplotlib", "xarray", "scipy.stats", "scipy.signal", "alembic")


def test_the_command_line_starts_without_what_only_some_answers_need() -> None:
    asked = f"import sys, sunarc.cli.main; print([name for name in {HEAVY} if name in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
