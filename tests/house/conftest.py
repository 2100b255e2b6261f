from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def root() -> Path:
    """Return the repository's root."""
    return Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def tracked_files(root: Path) -> list[Path]:
    """Return what git knows of, relative to the root, without what is deleted but not yet committed."""
    answer = subprocess.run(["git", "-C", root, "ls-files", "-z"], capture_output=True, text=True, check=True)
    return [Path(name) for name in answer.stdout.split("\0") if name and (root / name).is_file()]


@pytest.fixture(scope="session")
def checkout(root: Path, tracked_files: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the tracked files, as a fresh clone would have them, at a path with a space in it."""
    folder = tmp_path_factory.mktemp("a checkout")
    for name in tracked_files:
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(root / name, target)
    return folder
