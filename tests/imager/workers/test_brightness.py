"""The service learns from its own sightings how bright the clear sun is."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from tests.fixtures.archive import new_archive

from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.sightings import SightingStore
from sunarc.imager.archive.values import SunPoint
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.sky.site import Site

SITE = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    opened = new_archive(tmp_path, name="sky")
    opened.epochs.at("sky", NOON - timedelta(days=30), reason="first")
    yield opened
    opened.close()


def add_day(archive: Archive, noon: datetime, *, level_per_us: float, accepted: bool = True) -> None:
    moments = [noon + timedelta(minutes=2 * k) for k in range(-60, 61)]
    seen = {"camera": "sky", "pose_epoch": "sky-1", "method": "disc", "verdict": "clear", "accepted": accepted}
    archive.sightings.add(
        SunPoint(**seen, time=at, exposure_us=20.0, x_px=1.0, y_px=1.0, peak_fraction=20.0 * level_per_us)  # type: ignore[arg-type]
        for at in moments
    )


def level(archive: Archive, moment: datetime) -> float:
    return SunPredictor(CameraArchive(archive, name="sky", site=SITE)).clear_level_per_us(moment)


def test_it_starts_with_none_and_survives_a_restart(archive: Archive) -> None:
    assert level(archive, NOON) == 0.0
    add_day(archive, NOON - timedelta(days=1), level_per_us=0.03)
    assert level(archive, NOON) == pytest.approx(0.03, rel=0.05)


def test_a_filter_is_learned_within_five_days_and_one_that_has_all_refused_is_not_for_ever(archive: Archive) -> None:
    for day in range(10, 5, -1):
        add_day(archive, NOON - timedelta(days=day), level_per_us=3.0)
    for day in range(5, 0, -1):
        add_day(archive, NOON - timedelta(days=day), level_per_us=3e-5, accepted=False)
    assert level(archive, NOON - timedelta(days=5)) == pytest.approx(3.0, rel=0.05)
    assert level(archive, NOON) == 0.0
    add_day(archive, NOON, level_per_us=3e-5)
    assert level(archive, NOON + timedelta(hours=2)) == pytest.approx(3e-5, rel=0.1)


def test_the_archive_is_asked_once_an_hour(archive: Archive, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []
    learned = archive.sightings.sun_levels

    def counted(
        _: SightingStore, camera: str, *, since: datetime, until: datetime, largest_clock_error_s: float | None
    ) -> object:
        asked.append(until)
        return learned(camera, since=since, until=until, largest_clock_error_s=largest_clock_error_s)

    monkeypatch.setattr(SightingStore, "sun_levels", counted)
    predictor = SunPredictor(CameraArchive(archive, name="sky", site=SITE))
    for minute in range(0, 121, 5):
        predictor.clear_level_per_us(NOON + timedelta(minutes=minute))
    assert len(asked) == 3
