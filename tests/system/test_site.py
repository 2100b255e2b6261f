"""The documentation is built as a site, without a warning, and asks no other host for anything."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FROM_OUTSIDE = re.compile(r"<(?:script|img|link)\b[^>]*\b(?:src|href)=\"(?:https?:)?//")

pytestmark = [pytest.mark.system, pytest.mark.slow]


def test_the_site_is_built_whole_and_needs_no_network(tmp_path: Path) -> None:
    out = tmp_path / "site"
    built = subprocess.run([ROOT / "docs" / "build", out], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    pages = {str(page.relative_to(out)): page.read_text("utf-8") for page in out.rglob("*.html")}
    assert {"index.html", "api.html", "commands.html", "routes.html", "troubleshooting.html"} <= set(pages)
    assert 'id="sunarc.calibrate"' in pages["api.html"]
    assert [name for name, text in pages.items() if FROM_OUTSIDE.search(text)] == []
    terms = (out / "searchindex.js").read_text("utf-8")
    assert all(f'"{word}"' in terms or f"{word}:" in terms for word in ("horizon", "bump", "tai"))
