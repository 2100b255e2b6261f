"""Pose epochs after any sequence of changes, and times of sightings by their clocks."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import datetime, timedelta
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.stores import NOON, ROOF

from sunarc.common.errors import InputError, NotFoundError
from sunarc.common.findings import uncoded
from sunarc.imager.archive.values import SunPoint

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sunarc.imager.archive.archive import Archive

FOG = uncoded("fog")
POINT = SunPoint(
    camera="roof", pose_epoch="roof-1", time=NOON, method="disc", accepted=True, verdict="clear", x_px=1.0, y_px=2.0,
    exposure_us=20.0, peak_fraction=0.6, background_fraction=0.1,
)  # fmt: skip


def at(hours: float) -> datetime:
    return NOON + timedelta(hours=hours)


def require_rules(archive: Archive) -> None:
    """Epochs follow one another without a gap, the last one goes on, and every sighting lies in its own."""
    epochs = archive.epochs.find("roof")
    for before, after in pairwise(epochs):
        assert before.ended_at == after.started_at
    assert epochs[-1].ended_at is None
    limits = {epoch.id: (epoch.started_at, epoch.ended_at) for epoch in epochs}
    for point in archive.sightings.find("roof"):
        since, until = limits[point.pose_epoch]
        assert since <= point.time
        assert until is None or point.time < until


@pytest.mark.parametrize("seed", range(4))
def test_after_any_sequence_of_changes_epochs_partition_time(archive: Archive, seed: int) -> None:
    rng = np.random.default_rng(seed)
    archive.sightings.add(replace(POINT, time=at(h)) for h in range(24))
    for step in range(10):
        epochs = archive.epochs.find("roof")
        what = rng.choice(["open", "split", "close"])
        hours = float(rng.integers(0, 24)) + 0.5 + 0.01 * step
        if what == "open" and at(hours) > epochs[-1].started_at:
            archive.epochs.open("roof", at=at(hours), reason="moved")
        elif what == "split":
            archive.epochs.split("roof", at=at(hours), reason="moved")
        elif what == "close" and len(epochs) > 1:
            archive.calibrations.close_epoch(epochs[int(rng.integers(1, len(epochs)))].id, at=at(30), reason="wrong")
        require_rules(archive)
    assert len({epoch.id for epoch in archive.epochs.find("roof", include_closed=True)}) == len(
        archive.epochs.find("roof", include_closed=True)
    )


def test_a_split_at_a_sightings_time_gives_it_to_the_later_part(archive: Archive) -> None:
    archive.sightings.add(replace(POINT, time=at(h)) for h in (0, 1, 2))
    earlier, later = archive.epochs.split("roof", at=at(1), reason="moved")
    assert [p.pose_epoch for p in archive.sightings.find("roof")] == [earlier.id, later.id, later.id]
    assert (earlier.ended_at, later.started_at, later.ended_at) == (at(1), at(1), None)


@pytest.mark.parametrize("hours", [-24.0 * 400, -24.0 * 12 - 18.5])
def test_a_time_that_is_in_no_epoch_or_begins_one_is_not_split(archive: Archive, hours: float) -> None:
    with pytest.raises(InputError):
        archive.epochs.split("roof", at=at(hours), reason="moved")


@pytest.mark.parametrize("epoch", ["roof-1", "roof-9"])
def test_the_first_epoch_and_one_that_is_not_there_are_not_closed(archive: Archive, epoch: str) -> None:
    with pytest.raises(NotFoundError if epoch == "roof-9" else InputError):
        archive.calibrations.close_epoch(epoch, at=NOON, reason="wrong")


def test_of_threads_that_open_an_epoch_at_one_time_one_does(archive: Archive) -> None:
    together = threading.Barrier(6)

    def opened(number: int) -> bool:
        together.wait()
        try:
            archive.epochs.open("roof", at=at(1), reason=f"moved {number}")
        except InputError:
            return False
        return True

    with ThreadPoolExecutor(6) as pool:
        assert sum(pool.map(opened, range(6))) == 1
    require_rules(archive)


@pytest.mark.parametrize("method", ["add", "replace", "replace_stars"])
def test_a_sighting_is_stored_in_the_epoch_that_was_opened_just_before(archive: Archive, method: str) -> None:
    """Another thread may find that the camera moved between the moments a sighting is made and stored."""

    def made() -> Iterator[SunPoint]:
        yield replace(POINT, pose_epoch="", method="star", time=at(1))
        archive.epochs.open("roof", at=at(0.5), reason="moved")

    if method == "replace_stars":
        archive.sightings.replace_stars("roof", made())
    else:
        getattr(archive.sightings, method)(made())
    assert [p.pose_epoch for p in archive.sightings.find("roof")] == ["roof-2"]
    require_rules(archive)


def test_sightings_without_an_epoch_are_stored_in_those_of_their_times(archive: Archive) -> None:
    archive.epochs.open("roof", at=at(2), reason="moved")
    archive.cameras.save(replace(ROOF, name="attic"))
    camera, hours = ("roof", "attic", "roof", "roof", "attic"), (2, 5, 1, -9000, 1)
    assert archive.sightings.add(
        (replace(POINT, camera=c, pose_epoch="", time=at(h)) for c, h in zip(camera, hours, strict=True)),
        first_epoch="first frame",
    ) == len(hours)
    assert [p.pose_epoch for p in archive.sightings.find("roof")] == ["roof-1", "roof-1", "roof-2"]
    assert archive.epochs.find("roof")[0].started_at == at(-9000)
    assert [p.pose_epoch for p in archive.sightings.find("attic")] == ["attic-1", "attic-1"]
    assert [(e.started_at, e.reason) for e in archive.epochs.find("attic")] == [(at(1), "first frame")]
    require_rules(archive)


def test_excluded_sightings_are_those_within_the_times_and_no_others(archive: Archive) -> None:
    archive.sightings.add(replace(POINT, time=at(h)) for h in range(6))
    assert archive.sightings.exclude("roof", FOG, since=at(1), until=at(4)) == 3
    assert [p.accepted for p in archive.sightings.find("roof")] == [True, False, False, False, True, True]
    assert archive.sightings.exclude("roof", FOG, since=at(1), until=at(4)) == 0
    assert {(p.verdict, p.findings[0].code, p.x_px) for p in archive.sightings.find("roof", accepted=False)} == {
        ("set_aside", FOG.code, 1.0)
    }


def test_only_clean_discs_found_elsewhere_are_readmitted(archive: Archive) -> None:
    rejected = replace(POINT, accepted=False)
    archive.sightings.add(
        [
            replace(rejected, time=at(0), verdict="elsewhere"),
            replace(rejected, time=at(1), verdict="veiled"),
            replace(rejected, time=at(2), verdict="elsewhere", x_px=None),
            replace(rejected, time=at(9), verdict="elsewhere"),
        ]
    )
    assert archive.sightings.readmit("roof", since=at(0), until=at(9)) == 1
    assert [p.time for p in archive.sightings.find("roof", accepted=True)] == [at(0)]


@pytest.mark.parametrize(("error_s", "widened"), [(0.5, 2), (0.02, 1), (0.01, 1), (0.001, 1)])
def test_a_clocks_bound_is_widened_and_never_narrowed(archive: Archive, error_s: float, widened: int) -> None:
    archive.sightings.add(
        [replace(POINT, time=at(0), clock_error_s=None), replace(POINT, time=at(1), clock_error_s=0.02)]
    )
    assert archive.sightings.widen_clock_errors("roof", since=at(0), until=at(1), error_s=error_s) == widened
    found = [p.clock_error_s for p in archive.sightings.find("roof")]
    assert found == [error_s, max(error_s, 0.02)]


def test_sightings_of_a_doubtful_clock_are_left_out_where_a_limit_is_given(archive: Archive) -> None:
    bounds = (None, 0.02, 0.05, 5.0)
    archive.sightings.add(replace(POINT, time=at(k), clock_error_s=b) for k, b in enumerate(bounds))
    assert len(archive.sightings.find("roof", largest_clock_error_s=0.05)) == 3
    assert len(archive.sightings.columns("roof", largest_clock_error_s=0.02).unix_s) == 2
    assert archive.sightings.newest_time("roof", largest_clock_error_s=0.05) == at(2)
    assert archive.sightings.newest_time("roof", largest_clock_error_s=10.0) == at(3)
    assert archive.sightings.newest_time("attic", largest_clock_error_s=10.0) is None


def test_levels_are_those_of_accepted_discs_in_a_microsecond(archive: Archive) -> None:
    archive.sightings.add(
        [
            replace(POINT, time=at(0)),
            replace(POINT, time=at(1), peak_fraction=500.0, background_fraction=None),
            replace(POINT, time=at(2), peak_fraction=0.05),
            replace(POINT, time=at(3), exposure_us=0.0),
            replace(POINT, time=at(4), method="paper"),
            replace(POINT, time=at(5), accepted=False),
        ]
    )
    times, levels = archive.sightings.sun_levels("roof", since=at(-1), until=at(9))
    assert times.tolist() == [at(0).timestamp(), at(1).timestamp()]
    assert levels == pytest.approx([0.5 / 20.0, 100.0 / 20.0])


def test_observation_times_are_of_all_looks_but_frozen_ones(archive: Archive) -> None:
    hidden = replace(POINT, accepted=False, verdict="hidden", x_px=None, y_px=None)
    archive.sightings.add([POINT, replace(hidden, time=at(1)), replace(hidden, time=at(2), verdict="frozen")])
    found = archive.sightings.exposure_times("roof", since=at(0), until=at(9))
    assert found is not None
    assert sorted(found.tolist()) == [at(0).timestamp(), at(1).timestamp()]
    archive.sightings.add([replace(POINT, time=at(3), method="import")])
    assert archive.sightings.exposure_times("roof", since=at(0), until=at(9)) is None
    assert archive.sightings.exposure_times("roof", since=at(0), until=at(3)) is not None


def test_a_selection_of_columns_has_its_own_epochs(archive: Archive) -> None:
    archive.sightings.add(replace(POINT, time=at(h)) for h in range(4))
    archive.epochs.split("roof", at=at(2), reason="moved")
    columns = archive.sightings.columns("roof")
    later = columns.select(columns.unix_s >= at(2).timestamp())
    assert (len(columns.epoch_ids), columns.epoch.tolist()) == (2, [0, 0, 1, 1])
    assert (later.epoch_ids, later.epoch.tolist()) == (columns.epoch_ids[1:], [0, 0])
    assert later.ids.tolist() == columns.ids[2:].tolist()
