"""A clock that is far off: at boot, by a step that the kernel does not mind, by many small steps."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from sunarc.common.errors import InputError, NotFoundError
from sunarc.imager.archive.epochs import LENS_CHANGED
from sunarc.imager.archive.sightings import MOVED
from sunarc.imager.archive.values import Day, SunPoint
from sunarc.imager.workers.clock_watch import UNKNOWN_ERROR_S

from .clock_faults import START, TRUTH, UNSYNCHRONISED, Imager, moved_by, outcome_of

YEAR_S = 400 * 86_400.0


@pytest.mark.parametrize(
    ("fault", "jump_s"),
    [("boot", YEAR_S), ("boot", 7200.0), ("boot", -60.0), ("synchronised", YEAR_S), ("synchronised", -7200.0)],
)
def test_a_clock_that_was_off_changes_nothing_that_is_served_and_a_move_is_noticed_afterwards(
    tmp_path: Path, fault: str, jump_s: float
) -> None:
    outcome = outcome_of(tmp_path, fault=fault, jump_s=jump_s, seed=1)
    assert outcome.kept
    assert outcome.alarms == ()
    assert outcome.trusted_wrong == 0
    assert outcome.noticed_after is not None
    assert outcome.noticed_after <= 6
    assert outcome.error_deg < 0.1


def test_many_small_steps_are_one_event_a_minute_and_the_clock_is_distrusted(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    imager.run(10.0)
    imager.run(5.0, creep=0.045)
    steps = [event for event in imager.archive.events.find("roof") if event.kind == "clock_step"]
    assert 4 <= len(steps) <= 6
    assert all(event.details["gradual"] for event in steps)
    assert sum(event.details["step_s"] for event in steps) == pytest.approx(5 * 60 * 0.045, rel=0.25)
    assert not imager.service.clock_watch.trusted()
    assert imager.trusted_wrong() == 0
    assert [event.kind for event in imager.alarms()] == []
    imager.run(11.0)
    assert imager.service.clock_watch.trusted()


def test_a_slew_within_what_a_time_service_does_is_no_step(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    imager.run(10.0, creep=450e-6)
    assert imager.service.clock_watch.trusted()
    assert [event for event in imager.archive.events.find("roof") if event.kind == "clock_step"] == []


def test_a_clock_a_year_ahead_stays_distrusted_for_a_day_also_after_a_restart_and_no_image_is_removed(
    tmp_path: Path,
) -> None:
    imager = Imager(tmp_path)
    imager.run(5.0)
    for age_days in range(30):
        imager.service.images.write(START - timedelta(days=age_days), b"composite", kind="hdr.png")
    imager.clock.step(YEAR_S)
    imager.run(1.0)
    imager.boot()
    imager.clock.advance(3600.0)
    watch = imager.service.clock_watch
    watch.check()
    assert not watch.trusted()
    assert watch.cleaning_time() is None
    assert "clock_settling" in imager.codes()
    assert watch.error_s(imager.clock.now()) == UNKNOWN_ERROR_S
    imager.clock.advance(86_400.0)
    watch.check()
    assert watch.trusted()
    imager.service.disk_worker().check()
    assert imager.service.images.usage().oldest_image_at == START.replace(microsecond=0) - timedelta(days=29)


def test_images_are_not_removed_by_age_within_an_hour_of_a_step_or_a_start(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    watch = imager.service.clock_watch
    imager.clock.advance(3590.0)
    watch.check()
    assert watch.cleaning_time() is None
    imager.clock.advance(20.0)
    watch.check()
    assert watch.cleaning_time() == imager.clock.now()
    imager.clock.step(1.0)
    watch.check()
    assert watch.trusted()
    assert watch.cleaning_time() is None
    imager.clock.advance(3600.0)
    watch.check()
    assert watch.cleaning_time() == imager.clock.now()


def test_a_sighting_taken_before_the_clock_was_right_and_stored_after_has_no_bound(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    imager.clock.set_state(UNSYNCHRONISED)
    imager.clock.step(40.0)
    imager.boot()
    imager.clock.advance(10.0)
    imager.service.clock_watch.check()
    taken = imager.clock.now()
    imager.clock.advance(5.0)
    imager.service.clock_watch.check()
    imager.clock.step(-40.0)
    imager.synchronise()
    for _ in range(5):
        imager.clock.advance(2.0)
        imager.service.clock_watch.check()
    assert imager.service.clock_watch.error_s(taken) == UNKNOWN_ERROR_S
    assert imager.service.clock_watch.error_s(imager.clock.now()) < 0.1


def test_a_day_judged_by_a_clock_that_was_ahead_is_judged_again(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    imager.run(1.0)
    wrong = Day(
        camera="roof",
        date=START.date(),
        verdict="unusable",
        findings=(),
        n=0,
        n_possible=1200,
        decided_at=START + timedelta(days=400),
    )
    imager.archive.days.save(wrong)
    imager.clock.advance(86_400.0)
    judged = imager.service.days.judge_ended_days()
    assert [day.date for day in judged] == [START.date()]
    assert imager.service.days.judge_ended_days() == []


def test_doubtful_sightings_are_left_out_of_a_day_and_do_not_condemn_it(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    imager.run(60.0)
    (good,) = judged_after(imager)
    imager.clock.step(-86_400.0)
    midnight = START - timedelta(hours=9)
    imager.archive.sightings.add(
        SunPoint(
            camera="roof",
            pose_epoch="roof-1",
            time=midnight + timedelta(hours=8, minutes=n),
            method="disc",
            accepted=True,
            verdict="clear",
            x_px=100.0,
            y_px=100.0,
            clock_error_s=UNKNOWN_ERROR_S,
        )
        for n in range(30)
    )
    again = imager.service.days._measure_day(good.date)
    assert again.n == good.n
    assert again.sd_px == good.sd_px
    assert again.doubtful_clock == pytest.approx(30.0 / (30.0 + good.n), abs=0.01)


def judged_after(imager: Imager) -> list[Day]:
    imager.clock.advance(86_400.0)
    return imager.service.days.judge_ended_days()


def test_what_is_dated_in_the_future_says_nothing_of_how_bright_the_sun_is(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    point = SunPoint(
        camera="roof",
        pose_epoch="roof-1",
        time=START,
        method="disc",
        accepted=True,
        verdict="clear",
        exposure_us=10.0,
        x_px=100.0,
        y_px=100.0,
        peak_fraction=0.5,
        clock_error_s=UNKNOWN_ERROR_S,
    )
    imager.archive.sightings.add([point])
    until = START + timedelta(hours=1)
    assert imager.archive.sightings.sun_levels("roof", since=START, until=until)[0].size == 1
    assert imager.archive.sightings.sun_levels("roof", since=START, until=until, largest_clock_error_s=2.0)[0].size == 0


def retired_in_the_future(imager: Imager) -> datetime:
    """Leave behind what a clock that was 400 days ahead made of a good record."""
    later = START + timedelta(days=400)
    imager.archive.calibrations.retire("full", at=later)
    imager.archive.epochs.open("roof", at=later, reason=LENS_CHANGED)
    return later


def test_an_operator_closes_an_epoch_of_the_future_and_the_calibration_is_served_as_before(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    later = retired_in_the_future(imager)
    imager.boot()
    assert imager.served() is None
    assert "epoch_in_future" in imager.codes()
    imager.run(5.0)
    assert (
        imager.archive.calibrations.close_epoch("roof-2", at=imager.clock.now(), reason="the clock was ahead") == "full"
    )
    record = imager.archive.calibrations.current("roof")
    assert record is not None
    assert (record.id, record.valid_until, record.state) == ("full", None, "current")
    assert imager.archive.calibrations.current("roof", at=later) == record
    (epoch,) = imager.archive.epochs.find("roof")
    assert (epoch.id, epoch.ended_at) == ("roof-1", None)
    assert len(imager.archive.epochs.find("roof", include_closed=True)) == 2
    imager.run(10.0)
    assert "epoch_in_future" not in imager.codes()
    imager.camera = moved_by((0.6, 0.6, 0.5))
    imager.run(15.0)
    assert [event.kind for event in imager.alarms()] == ["bump"]
    assert [epoch.id for epoch in imager.archive.epochs.find("roof")] == ["roof-1", "roof-3"]
    assert imager.error_deg() < 0.1


def test_closing_a_false_move_serves_a_copy_from_then_on_and_rewrites_no_past_answer(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    imager.run(10.0)
    imager.camera = moved_by((0.6, 0.6, 0.5))
    imager.run(10.0)
    wrong = imager.served()
    assert wrong is not None
    assert wrong != "full"
    during = imager.clock.now() - timedelta(minutes=2)
    imager.camera = TRUTH
    closed_at = imager.clock.now()
    copy = imager.archive.calibrations.close_epoch("roof-2", at=closed_at, reason="someone leaned on the mast")
    assert copy is not None
    assert imager.archive.calibrations.get(copy).parent == "full"
    served_then = imager.archive.calibrations.current("roof", at=during)
    assert served_then is not None
    assert served_then.pose_epoch == "roof-2"
    assert all(point.pose_epoch == "roof-1" for point in imager.archive.sightings.find("roof"))
    imager.run(10.0)
    assert imager.served() == copy
    assert [event.kind for event in imager.alarms()] == ["bump"]  # is not found again in the same sightings
    assert not any(point.findings == MOVED for point in imager.archive.sightings.find("roof", accepted=True))


def test_the_first_epoch_an_unknown_and_a_closed_one_cannot_be_closed(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    retired_in_the_future(imager)
    now = datetime(2013, 5, 14, 17, tzinfo=UTC)
    with pytest.raises(InputError, check=lambda error: error.field == "id"):
        imager.archive.calibrations.close_epoch("roof-1", at=now, reason="test")
    imager.archive.calibrations.close_epoch("roof-2", at=now, reason="test")
    for name in ("roof-2", "roof-9"):
        with pytest.raises(NotFoundError, check=lambda error: error.field == "id"):
            imager.archive.calibrations.close_epoch(name, at=now, reason="test")


def test_an_epoch_of_the_future_is_not_used_before_it_is_closed(tmp_path: Path) -> None:
    imager = Imager(tmp_path)
    imager.run(5.0)
    imager.archive.epochs.open("roof", at=START + timedelta(days=400), reason="bump")
    imager.boot()
    imager.run(5.0)
    assert imager.served() == "full"
    assert {point.pose_epoch for point in imager.archive.sightings.find("roof")} == {"roof-1"}
