"""Which calibration answers when, against a list of intervals kept by the rules in words."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta
from itertools import pairwise

import numpy as np
import pytest

from sunarc.common.errors import ConflictError, NotFoundError
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.values import Refit

from .test_calibrations import MAY, document, served


def day(number: float) -> datetime:
    return MAY + timedelta(days=number)


def intervals(archive: Archive) -> list[tuple[datetime, datetime | None]]:
    """Return the validities of all that was served and lasted, in order."""
    records = [r for r in archive.calibrations.find("roof") if r.state in {"current", "retired"}]
    lasting = [(r.valid_from, r.valid_until) for r in records if r.valid_until is None or r.valid_until > r.valid_from]
    return sorted(lasting, key=lambda one: one[0])


def require_rules(archive: Archive) -> None:
    for (_, until), (since, _) in pairwise(intervals(archive)):
        assert until is not None
        assert until <= since
    assert sum(r.state == "current" for r in archive.calibrations.find("roof")) <= 1
    assert all(r.state == "current" for r in archive.calibrations.find("roof") if r.pinned)


@pytest.mark.parametrize("seed", range(4))
def test_after_any_sequence_of_changes_no_two_answer_at_once(archive: Archive, seed: int) -> None:
    rng, now, model = np.random.default_rng(seed), 0.0, dict[float, str | None]()
    times = [0.5 + k for k in range(30)]
    for number in range(14):
        now += float(rng.integers(1, 3))
        archive.calibrations.add(document(f"c{number}", day=int(now)))
        what = rng.choice(["activate", "back", "between", "retire"])
        begin = float(rng.integers(0, int(now) + 1))
        current = archive.calibrations.current("roof")
        if what == "activate":
            archive.calibrations.activate(f"c{number}")
            model |= {t: f"c{number}" for t in times if t >= now}
        elif what == "back":
            archive.calibrations.activate(f"c{number}", at=day(begin))
            model |= {t: f"c{number}" for t in times if t >= begin}
        elif what == "retire" and current is not None:
            archive.calibrations.retire(current.id, at=day(now))
            model |= {t: None for t in times if t >= now}
        elif what == "between":
            state = archive.calibrations.answer_between(f"c{number}", since=day(begin), until=day(begin + 1.0)).state
            if state == "retired":
                model |= {t: f"c{number}" for t in times if begin <= t < begin + 1.0}
        require_rules(archive)
    assert {t: served(archive, t) for t in times if t in model} == model


def test_a_moment_belongs_to_the_interval_that_begins_with_it(archive: Archive) -> None:
    for name, number in (("a", 0), ("b", 2)):
        archive.calibrations.add(document(name, day=number))
        archive.calibrations.activate(name)
    microsecond = 1.0 / 86_400e6
    assert [served(archive, t) for t in (-microsecond, 0.0, 2.0 - microsecond, 2.0)] == [None, "a", "a", "b"]


def test_between_two_that_answer_a_candidate_takes_only_its_part(archive: Archive) -> None:
    for name, number in (("a", 0), ("b", 4), ("between", 9)):
        archive.calibrations.add(document(name, day=number))
    archive.calibrations.activate("a")
    archive.calibrations.activate("b")
    assert archive.calibrations.answer_between("between", since=day(2), until=day(6)).valid_until == day(6)
    assert [served(archive, t) for t in (1.0, 2.0, 5.9, 6.0)] == ["a", "between", "between", "b"]
    assert archive.calibrations.get("b").state == "current"


@pytest.mark.parametrize(("since", "until"), [(1, 3), (-5, -4), (5, 9)])
def test_what_answers_from_before_until_after_is_not_cut_in_two(archive: Archive, since: int, until: int) -> None:
    archive.calibrations.add(document("a"))
    archive.calibrations.activate("a")
    archive.calibrations.add(document("b", day=10))
    state = archive.calibrations.answer_between("b", since=day(since), until=day(until)).state
    assert state == ("candidate" if since > 0 else "retired")
    assert served(archive, 2.0) == "a"


def test_a_pinned_one_is_not_replaced_by_a_candidate(archive: Archive) -> None:
    archive.calibrations.add(document("a"))
    archive.calibrations.activate("a")
    archive.calibrations.pin("a", at=day(1), reason="known good")
    archive.calibrations.add(document("b", day=2))
    assert archive.calibrations.activate("b").state == "candidate"
    assert archive.calibrations.answer_between("b", since=day(-3), until=day(4)).state == "candidate"
    archive.calibrations.unpin("a", at=day(3), reason="test is over")
    assert archive.calibrations.activate("b").state == "current"
    assert [event.kind for event in archive.events.find("roof", kind="calibration_pinned")] == ["calibration_pinned"]


@pytest.mark.parametrize("action", ["activate", "refuse", "retire", "answer_between"])
def test_a_state_that_does_not_allow_it_is_a_conflict(archive: Archive, action: str) -> None:
    archive.calibrations.add(document("a"))
    archive.calibrations.activate("a")
    archive.calibrations.add(document("b", day=1))
    archive.calibrations.activate("b")  # "a" is retired
    with pytest.raises(ConflictError):
        {
            "activate": lambda: archive.calibrations.activate("a"),
            "refuse": lambda: archive.calibrations.refuse("a", findings=()),
            "retire": lambda: archive.calibrations.retire("a", at=day(2)),
            "answer_between": lambda: archive.calibrations.answer_between("a", since=day(0), until=day(1)),
        }[action]()
    assert served(archive, 5.0) == "b"


@pytest.mark.parametrize("action", ["activate", "refuse", "retire", "pin", "reinstate"])
def test_a_calibration_that_is_not_there_is_not_found(archive: Archive, action: str) -> None:
    with pytest.raises(NotFoundError):
        {
            "activate": lambda: archive.calibrations.activate("x"),
            "refuse": lambda: archive.calibrations.refuse("x", findings=()),
            "retire": lambda: archive.calibrations.retire("x", at=day(2)),
            "pin": lambda: archive.calibrations.pin("x", at=day(1), reason="r"),
            "reinstate": lambda: archive.calibrations.reinstate("x", at=day(1), reason="r"),
        }[action]()


def test_of_threads_that_activate_at_once_one_is_current(archive: Archive) -> None:
    for number in range(8):
        archive.calibrations.add(document(f"c{number}", day=number))
    together = threading.Barrier(8)

    def activate(number: int) -> None:
        together.wait()
        archive.calibrations.activate(f"c{number}")

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(activate, range(8)))
    require_rules(archive)
    assert archive.calibrations.current("roof") is not None


def test_of_threads_that_ask_for_a_refit_at_once_one_is_written(archive: Archive) -> None:
    together = threading.Barrier(8)

    def request(number: int) -> str:
        together.wait()
        return archive.refits.request(Refit(id=f"r{number}", camera="roof", requested_at=day(1), reason="asked")).id

    with ThreadPoolExecutor(8) as pool:
        ids = set(pool.map(request, range(8)))
    assert len(ids) == 1
    assert [refit.id for refit in archive.refits.find("roof")] == list(ids)


def test_a_refit_may_be_asked_for_while_another_runs(archive: Archive) -> None:
    archive.refits.request(Refit(id="one", camera="roof", requested_at=day(1), reason="asked"))
    archive.refits.start("one", started_at=day(2))
    second = archive.refits.request(Refit(id="two", camera="roof", requested_at=day(3), reason="asked"))
    assert second.id == "two"
    assert [refit.id for refit in archive.refits.find("roof", unfinished=True)] == ["two", "one"]
    archive.refits.finish("one", state="failed", finished_at=day(4), message="m")
    assert [refit.id for refit in archive.refits.find("roof", unfinished=True)] == ["two"]
    assert [refit.id for refit in archive.refits.find("roof", until=day(3))] == ["one"]
