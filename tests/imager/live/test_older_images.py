"""Many older images are analysed by `ingest`, in a process of its own, behind the live ones."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from tests.imager.live.followed import Followed
from tests.imager.live.test_folder import allsky, shot

from sunarc.common.errors import OutsideError
from sunarc.imager.live import folder_archive, folder_worker
from sunarc.imager.workers.calibrating.solver_process import ChildControl

MORNING = datetime(2025, 5, 13, 15, 0, tzinfo=UTC)

pytestmark = [pytest.mark.slow]


def test_many_older_images_wait_for_the_archive_and_live_ones_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder_worker, "_MANY", 5)
    followed = Followed(tmp_path, MORNING)
    older = [MORNING - timedelta(days=1, minutes=-10 * n) for n in range(8)]
    for time in older:
        path = followed.write(allsky(time), shot(time))
        os.utime(path, (time.timestamp(), time.timestamp()))
    followed.turn()
    behind = followed.service.folder_archive
    assert behind is not None
    assert [behind.is_busy] == [True]
    live = followed.clock.now().replace(microsecond=0)
    followed.write(allsky(live), shot(live))
    followed.turn()
    assert [point.time for point in followed.points()] == [live]
    followed.service.judge_completed_days()
    assert followed.service.archive.days.find("roof") == ()  # yesterday's images are still to come
    assert behind.step(threading.Event(), lambda: None)
    assert [point.time for point in followed.points()] == [*older, live]
    assert followed.codes() == set()
    assert [behind.is_busy] == [False]
    followed.service.judge_completed_days()
    (day,) = followed.service.archive.days.find("roof")
    assert day.n_observed == 8
    followed.close()
    again = Followed(tmp_path, followed.clock.now())
    again.turn()
    assert again.service.folder_archive is not None
    assert not again.service.folder_archive.is_busy
    assert len(again.points()) == 9
    again.close()


def test_the_newest_portion_comes_first_and_its_days_are_judged_before_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder_worker, "_MANY", 5)
    monkeypatch.setattr(folder_archive, "_PORTION", 6)
    looked_at = list[tuple[str, ...]]()

    def in_this_process(call: Callable[[], object], _: object) -> object:
        looked_at.append(tuple(sorted(call.keywords["only"])))  # type: ignore[attr-defined]
        return call()

    monkeypatch.setattr(folder_archive, "in_child", in_this_process)
    followed = Followed(tmp_path, MORNING)
    older = [MORNING - timedelta(days=days, minutes=-10 * n) for days in (3, 2, 1) for n in range(3)]
    for time in older:
        os.utime(followed.write(allsky(time), shot(time)), (time.timestamp(), time.timestamp()))
    followed.turn()
    live = followed.clock.now().replace(microsecond=0)
    followed.write(allsky(live), shot(live))
    followed.turn()
    behind = followed.service.folder_archive
    assert behind is not None
    assert behind.step(threading.Event(), lambda: None)
    followed.service.judge_completed_days()
    assert [(day.date.day, day.n_observed) for day in followed.service.archive.days.find("roof")] == [(12, 3), (11, 3)]
    assert behind.step(threading.Event(), lambda: None)
    assert looked_at == [tuple(map(allsky, older[3:])), tuple(map(allsky, older[:3]))]
    followed.service.judge_completed_days()
    assert [day.date.day for day in followed.service.archive.days.find("roof")] == [12, 11, 10]
    assert [point.time for point in followed.points()] == [*older, live]
    assert not behind.is_busy
    followed.close()


def test_an_analysis_that_fails_does_not_keep_days_from_being_judged_and_is_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder_worker, "_MANY", 5)
    monkeypatch.setattr(folder_archive, "in_child", died)
    followed = Followed(tmp_path, MORNING)
    for n in range(8):
        time = MORNING - timedelta(days=1, minutes=-10 * n)
        os.utime(followed.write(allsky(time), shot(time)), (time.timestamp(), time.timestamp()))
    followed.turn()
    behind = followed.service.folder_archive
    assert behind is not None
    assert [behind.is_busy] == [True]
    behind.step(threading.Event(), lambda: None)
    assert followed.codes() == {"archive_failed"}
    assert [behind.is_busy] == [False]
    followed.clock.advance(59.0)
    assert not behind.step(threading.Event(), lambda: None)
    followed.clock.advance(2.0)
    shown: list[set[str]] = []

    def look_and_die(_: object, control: ChildControl) -> object:
        control.heartbeat()
        shown.append(followed.codes())
        return died()

    monkeypatch.setattr(folder_archive, "in_child", look_and_die)
    assert behind.step(threading.Event(), lambda: None)
    assert shown == [{"archive_in_work"}]
    assert followed.codes() == {"archive_failed"}
    followed.clock.advance(61.0)  # the second pause is longer
    assert not behind.step(threading.Event(), lambda: None)
    followed.clock.advance(60.0)
    monkeypatch.setattr(folder_archive, "in_child", lambda call, _: call())
    assert behind.step(threading.Event(), lambda: None)
    assert followed.codes() == set()
    assert len(followed.points()) == 8
    followed.close()


def died(*_: object) -> object:
    raise OutsideError("killed")
