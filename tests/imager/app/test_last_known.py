"""What a service that has just started says of the time before."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from tests.fixtures.archive import HIDDEN, make_empty, store_sun_point

from sunarc.imager.app.service import Service, restore_last_known
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.archive.values import CameraRecord
from sunarc.imager.cameras.frame import SkyCamera
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.settings.model import Settings
from sunarc.sky.site import Site

NOON = datetime(2026, 5, 1, 18, 30, tzinfo=UTC)


def no_camera() -> SkyCamera:
    raise AssertionError("no camera is asked for")


@pytest.fixture
def start(tmp_path: Path) -> Callable[[], Service]:
    """Return what starts a service on one state folder."""
    make_empty(tmp_path / "sunarc.sqlite")
    settings = Settings(
        site=Site(latitude=36.6, longitude=-97.5, altitude=318.0),
        state=tmp_path,
        camera=AravisOptions(address="127.0.0.9", timestamps="host"),
    )

    def started() -> Service:
        archive = open_archive(settings.database)
        archive.cameras.save(
            CameraRecord(name="imager", latitude=36.6, longitude=-97.5, altitude=318.0, width=8, height=6)
        )
        return Service(settings, archive=archive, clock=VirtualClock(NOON), open_camera=no_camera)

    return started


def look(service: Service, time: datetime, *, accepted: bool, clock_error_s: float = 0.01) -> None:
    result: dict[str, Any] = {"sigma_px": 0.1} if accepted else HIDDEN
    store_sun_point(service.archive, time, camera="imager", clock_error_s=clock_error_s, **result)


def test_a_new_service_knows_of_nothing(start: Callable[[], Service]) -> None:
    snapshot = start().board.snapshot()
    assert (snapshot.last_frame_at, snapshot.last_sighting_at) == (None, None)


def test_after_a_restart_the_last_sighting_and_the_last_frame_are_the_stores(start: Callable[[], Service]) -> None:
    first = start()
    look(first, NOON - timedelta(hours=3), accepted=True)
    for hours in (2, 1):
        look(first, NOON - timedelta(hours=hours), accepted=False)
    first.archive.close()
    second = start()
    snapshot = second.board.snapshot()
    assert snapshot.last_sighting_at == NOON - timedelta(hours=3)
    assert snapshot.last_frame_at == NOON - timedelta(hours=1)
    second.images.write(NOON - timedelta(minutes=1), b"png", kind="hdr.png")
    assert start().board.snapshot().last_frame_at == NOON - timedelta(minutes=1)


def test_times_of_a_clock_that_was_ahead_or_doubtful_are_not_shown(start: Callable[[], Service]) -> None:
    first = start()
    look(first, NOON - timedelta(hours=3), accepted=True)
    look(first, NOON - timedelta(hours=1), accepted=True, clock_error_s=1e9)
    look(first, NOON + timedelta(days=400), accepted=True)
    first.images.write(NOON + timedelta(days=400), b"png", kind="hdr.png")
    first.archive.close()
    snapshot = start().board.snapshot()
    assert snapshot.last_sighting_at == snapshot.last_frame_at == NOON - timedelta(hours=3)


def test_a_store_that_cannot_be_read_hinders_no_start(start: Callable[[], Service], tmp_path: Path) -> None:
    service = start()
    look(service, NOON, accepted=True)
    with closing(sqlite3.connect(tmp_path / "sunarc.sqlite", isolation_level=None)) as other:
        other.execute("ALTER TABLE sun_point RENAME TO hidden")
    board = StatusRegistry(version="1", started_at=NOON, monotonic=VirtualClock(NOON).monotonic)
    restore_last_known(
        board,
        archive=service.archive,
        images=ImageStore(tmp_path / "images"),
        camera="imager",
        until=None,
    )
    assert board.snapshot().last_sighting_at is None
