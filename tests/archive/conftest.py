from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from sunarc.archive import Archive, CameraRecord, open_archive, upgrade

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
ROOF = CameraRecord(name="roof", latitude=36.604, longitude=-97.485, altitude=318.0, width=1748, height=1748)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "state" / "sunarc.sqlite"


@pytest.fixture
def archive(path: Path) -> Iterator[Archive]:
    upgrade(path)
    archive = open_archive(path)
    archive.save_camera(ROOF)
    archive.open_epoch("roof", at=datetime(2013, 5, 1, tzinfo=UTC), reason="installed")
    yield archive
    archive.close()
