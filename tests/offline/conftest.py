from __future__ import annotations

from pathlib import Path

import pytest
from tests.fixtures.command_line import sunarc

__all__ = ["sunarc"]


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "sunarc.toml"
    path.write_text(
        f'name = "roof"\nstate = "{tmp_path}/state"\n'
        "[site]\nlatitude = 36.604043\nlongitude = -97.484856\naltitude = 318.0\n"
    )
    (tmp_path / "images").mkdir()
    return path
