from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import URL
from tests.fixtures.archive import make_empty
from tests.fixtures.postgresql import Server, postgresql

from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.imager.archive.values import CameraRecord

__all__ = ["postgresql"]

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
ROOF = CameraRecord(name="roof", latitude=36.604, longitude=-97.485, altitude=318.0, width=1748, height=1748)
ENGINES = ("sqlite", "postgresql")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run every test of an archive on both engines, but for those of SQLite's file."""
    names = metafunc.fixturenames
    if "hub" in names or ("archive" in names and "path" not in names):
        metafunc.parametrize("engine", ENGINES, indirect=True)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "state" / "sunarc.sqlite"


@pytest.fixture
def engine(request: pytest.FixtureRequest) -> str:
    """Name the engine of a test's archive; SQLite's where the test is not of both."""
    return str(getattr(request, "param", "sqlite"))


@pytest.fixture
def store(engine: str, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Path | URL]:
    """Yield where a new database of the head revision is."""
    if engine == "sqlite":
        path = tmp_path / "state" / "sunarc.sqlite"
        make_empty(path)
        yield path
        return
    server: Server = request.getfixturevalue("postgresql")
    yield server.emptied_database()


@pytest.fixture
def archive(store: Path | URL) -> Iterator[HubArchive]:
    archive = open_hub_archive(store)
    archive.cameras.save(ROOF)
    archive.epochs.open("roof", at=datetime(2013, 5, 1, tzinfo=UTC), reason="installed")
    yield archive
    archive.close()


@pytest.fixture
def hub(store: Path | URL) -> Iterator[HubArchive]:
    """Yield an archive that has no camera yet."""
    with open_hub_archive(store) as archive:
        yield archive
