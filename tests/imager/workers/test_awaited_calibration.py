"""What is said of a camera without a calibration: collecting, fitted and refused, or calibrated before."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from tests.fixtures.archive import new_archive, store_sun_point
from tests.fixtures.served import document

from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.values import Refit
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.calibrating.refit import CalibrationIntegrityCheck
from sunarc.sky.site import Site

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)


class Bench:
    """A check over an archive, at a time that a test sets."""

    def __init__(self, archive: Archive) -> None:
        self.archive, self.now = archive, NOON
        self.board = StatusRegistry(version="1", started_at=NOON, monotonic=lambda: 0.0)
        camera = CameraArchive(archive, name="roof", site=Site(latitude=36.6, longitude=-97.5))
        self.check = CalibrationIntegrityCheck(camera, now=lambda: self.now, board=self.board)

    def shown(self) -> dict[str, tuple[str, str]]:
        """Return state and sentence of each reason, after the check followed the archive."""
        self.check.follow()
        return {one.code: (one.state, one.text) for one in self.board.snapshot().reasons}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    archive = new_archive(tmp_path)
    archive.epochs.open("roof", at=NOON - timedelta(days=30), reason="first frame")
    yield Bench(archive)
    archive.close()


def test_a_fresh_camera_collects_and_counts_its_sightings(bench: Bench) -> None:
    text = "collecting: first calibration after the first clear day, 0 sightings so far"
    assert bench.shown() == {"no_calibration": ("starting", text)}
    for minutes in range(212):
        store_sun_point(bench.archive, NOON + timedelta(minutes=minutes))
    store_sun_point(bench.archive, NOON + timedelta(hours=5), accepted=False, verdict="hidden")
    store_sun_point(bench.archive, NOON + timedelta(hours=6), body="moon")
    bench.now += timedelta(seconds=59)
    assert "0 sightings" in bench.shown()["no_calibration"][1]  # counted once a minute
    bench.now += timedelta(seconds=2)
    assert bench.shown()["no_calibration"][1].endswith("212 sightings so far")
    assert bench.board.snapshot().state == "starting"
    assert bench.board.snapshot().state_text.startswith("collecting")


def test_fits_that_were_refused_ask_for_attention_with_the_remedy(bench: Bench) -> None:
    refit = Refit.asked("roof", "after a day", at=NOON)
    bench.archive.refits.add(refit)
    assert "no_fit_accepted" not in bench.shown()
    finding = Finding("arc_too_short", {"arc_deg": 5.0, "least_deg": 10.0})
    bench.archive.refits.finish(refit.id, state="refused", finished_at=NOON, message=finding.text, findings=(finding,))
    bench.now += timedelta(minutes=2)
    state, text = bench.shown()["no_fit_accepted"]
    assert (state, bench.board.snapshot().state) == ("attention", "attention")
    assert text.endswith(f"refused: {finding.text}")
    (reason,) = [one for one in bench.board.snapshot().reasons if one.code == "no_fit_accepted"]
    assert reason.remedy == finding.remedy


def test_of_a_camera_that_was_calibrated_it_is_not_said_that_it_was_not(bench: Bench) -> None:
    bench.archive.calibrations.add(document("first", valid_from=NOON - timedelta(days=2)))
    bench.archive.calibrations.activate("first")
    assert bench.shown() == {}
    bench.archive.calibrations.retire("first", at=NOON)
    _, text = bench.shown()["no_calibration"]
    assert "collecting" not in text
    assert "2013-05-13T18:30Z" in text
    assert "2013-05-12T02:30Z" in text
    assert "no_fit_accepted" not in bench.shown()
