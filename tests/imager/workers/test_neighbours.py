"""Cross-checks from a fleet's archive: one camera of four is wrong, and the stored rows show it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.rotated_cameras import FIRST_NOON, Neighbour, Wrong, neighbours

from sunarc.formats.calibration_document import to_document
from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.hub.nightly import cross_check_fleet
from sunarc.hub.nightly_store import CrossCheck
from sunarc.imager.archive.values import CameraRecord, SunPoint
from sunarc.sky.days import solar_date
from sunarc.sky.site import Site

BEGIN = datetime.fromtimestamp(FIRST_NOON, UTC) - timedelta(days=1)
NAMES = ("gate", "mast", "roof", "yard")
DAYS = 36


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[HubArchive]:
    make_empty(tmp_path / "hub.sqlite")
    with open_hub_archive(tmp_path / "hub.sqlite") as opened:
        yield opened


def save(archive: HubArchive, name: str, site: Site) -> None:
    record = CameraRecord(
        name=name, latitude=site.latitude, longitude=site.longitude, altitude=318.0, width=9, height=9
    )
    archive.cameras.save(record)


def install(archive: HubArchive, name: str, one: Neighbour) -> None:
    """Store a camera, its calibrations and its days; a site that is stated anew is in a calibration from then on."""
    save(archive, name, one.site)
    archive.epochs.open(name, at=BEGIN, reason="installed")
    for number, day in enumerate((0, one.wrong.day)):
        created = BEGIN + timedelta(days=day + 0.6)
        document = to_document(
            replace(one.calibration, site=one.stated_site(day)),
            id=f"{name}-{number}",
            camera=name,
            state="candidate",
            created_at=created,
            valid_from=created,
            valid_until=None,
            pose_epoch=f"{name}-1",
            software_version="1",
        )
        archive.calibrations.add(document)
    archive.calibrations.activate(f"{name}-0", at=BEGIN)
    save(archive, name, one.stated_site(one.wrong.day))
    rng = np.random.default_rng(len(name))
    for day in range(DAYS):
        seen = one.sightings(day, rng, n=40)
        archive.sightings.add(
            point(name, time, (x, y)) for time, (x, y) in zip(seen.unix_s.tolist(), seen.pixels.tolist(), strict=True)
        )


def point(name: str, unix_s: float, pixel: tuple[float, float] | None) -> SunPoint:
    return SunPoint(
        camera=name,
        pose_epoch=f"{name}-1",
        time=datetime.fromtimestamp(unix_s, UTC),
        method="disc",
        accepted=pixel is not None,
        verdict="clear" if pixel else "hidden",
        exposure_us=47.0,
        x_px=pixel[0] if pixel else None,
        y_px=pixel[1] if pixel else None,
        sigma_px=0.03,
        clock_error_s=0.01,
    )


def checked(archive: HubArchive, *wrong: Wrong, days: int = DAYS) -> dict[str, CrossCheck]:
    for name, one in zip(NAMES, neighbours(*wrong), strict=False):
        install(archive, name, one)
    return {one.camera: one for one in cross_check_fleet(archive, now=BEGIN + timedelta(days=days + 2))}


def test_a_longitude_that_was_stated_anew_is_named_with_its_size(archive: HubArchive) -> None:
    found = checked(archive, Wrong(), Wrong(east_deg=0.01), Wrong(), Wrong())
    mast = found.pop("mast")
    assert (mast.found, mast.agreeing) == (("longitude",), 3)
    assert mast.confidence is not None
    assert 0.94 < mast.confidence <= 0.95
    assert {name: one.found for name, one in found.items()} == {"gate": (), "roof": (), "yard": ()}
    assert mast.longitude_deg is not None
    assert mast.longitude_sigma_deg is not None
    assert abs(mast.longitude_deg - 0.01) < 3.0 * mast.longitude_sigma_deg < 0.003
    assert mast.since == solar_date(FIRST_NOON + 25 * 86_400.0, longitude=-97.5)
    assert set(mast.neighbours) == {"gate", "roof", "yard"}
    assert mast.n_days == DAYS
    assert mast.cloud_clock_s is None  # every exposure shows the sun


def test_a_clock_is_named_by_three_others_and_by_two_is_not(archive: HubArchive) -> None:
    save(archive, "island", Site(latitude=30.0, longitude=-60.0))  # far away: it has no neighbours
    found = checked(archive, Wrong(clock_s=2.0), Wrong(), Wrong())
    assert {name: one.found for name, one in found.items()} == {"gate": ("unconfirmed",), "mast": (), "roof": ()}
    assert found["gate"].alarms == ()
    install(archive, "yard", neighbours(Wrong(), Wrong(), Wrong(), Wrong())[3])
    found = {one.camera: one for one in cross_check_fleet(archive, now=BEGIN + timedelta(days=DAYS + 2))}
    assert {name: one.found for name, one in found.items()} == {"gate": ("clock",), "mast": (), "roof": (), "yard": ()}
    gate = found["gate"]
    assert gate.clock_s is not None
    assert gate.clock_sigma_s is not None
    assert abs(gate.clock_s - 2.0) < 3.0 * gate.clock_sigma_s < 1.0


def test_a_clock_that_was_always_wrong_shows_by_the_clouds(archive: HubArchive) -> None:
    rng = np.random.default_rng(3)
    for number, name in enumerate(NAMES):
        save(archive, name, Site(latitude=36.6 + 0.0003 * number, longitude=-97.5 + 0.0002 * number**2))
        archive.epochs.open(name, at=BEGIN, reason="installed")
    for day in range(4):
        noon = FIRST_NOON + 86_400.0 * day
        edges = noon - 9000.0 + np.cumsum(rng.uniform(120.0, 900.0, 60))
        for number, name in enumerate(NAMES):
            true_s = noon + np.arange(-9000.0, 9000.0, 30.0) + 3.0 * number
            clock_s = 45.0 if name == "mast" else 0.0
            shown = (np.searchsorted(edges, true_s) % 2 == 0).tolist()
            archive.sightings.add(
                point(name, time + clock_s, (1.0, 2.0) if seen else None)
                for time, seen in zip(true_s.tolist(), shown, strict=True)
            )
    found = {one.camera: one for one in cross_check_fleet(archive, now=BEGIN + timedelta(days=7))}
    assert {name: one.found for name, one in found.items()} == {
        name: ("clock_by_clouds",) if name == "mast" else () for name in NAMES
    }
    mast = found["mast"]
    assert mast.cloud_clock_s is not None
    assert mast.cloud_clock_sigma_s is not None
    assert abs(mast.cloud_clock_s - 45.0) < 3.0 * mast.cloud_clock_sigma_s < 30.0
