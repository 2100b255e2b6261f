"""Notices: everything that happens is stored once, in its order, and kept until every receiver has it."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import pytest
from tests.fixtures.stores import NOON
from tests.imager.archive.test_current import serve

from sunarc.imager.archive import notices
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.values import Event

DUSTY: dict[str, Any] = {"dusty": {"code": "dusty", "text": "the dome is dusty"}}


def happen(archive: Archive, kind: str, *, minutes: float = 1.0, camera: str | None = "roof") -> int:
    """Store an event so long after the first look, and return its number."""
    time = NOON + timedelta(minutes=minutes)
    return archive.events.add(Event(time=time, kind=kind, severity="info", text="it was", camera=camera)).id or 0


def look(archive: Archive, conditions: dict[str, Any] | None = None, **more: bool) -> list[str]:
    """Look at the camera, and return the codes that hold."""
    return sorted(archive.notices.record("roof", conditions or {}, now=NOON, **more))


def kinds(archive: Archive, sink: str = "a") -> list[str]:
    return [notice.kind for notice in archive.notices.after(sink, limit=1000)]


@pytest.fixture
def followed(archive: Archive) -> Archive:
    """Return an archive with one receiver, that was looked at once."""
    archive.notices.name_sinks(["a"])
    look(archive)
    return archive


def test_what_was_before_the_first_look_is_no_news(archive: Archive) -> None:
    happen(archive, "bump")
    serve(archive, "first", 0)
    archive.notices.name_sinks(["a"])
    look(archive, DUSTY)
    assert kinds(archive) == []
    look(archive)
    assert kinds(archive) == ["condition_cleared"]


def test_everything_is_stored_once_and_in_its_order(followed: Archive) -> None:
    number = happen(followed, "bump")
    happen(followed, "clock_step", camera=None)
    serve(followed, "first", 0)
    for _ in range(3):
        look(followed, DUSTY)
    assert kinds(followed) == ["bump", "event", "calibration", "condition_set"]
    bump, step, calibration, dusty = followed.notices.after("a", limit=9)
    assert (bump.data["id"], bump.data["text"], bump.time) == (number, "it was", NOON + timedelta(minutes=1))
    assert (step.camera, step.data["kind"]) == ("roof", "clock_step")
    assert calibration.data == {"calibration": "first", "previous": None}
    assert dusty.data == DUSTY["dusty"]
    assert len({notice.id for notice in (bump, step, calibration, dusty)}) == 4


def test_a_condition_keeps_the_data_that_it_was_set_with_and_is_not_told_again(followed: Archive) -> None:
    look(followed, DUSTY)
    assert followed.notices.record("roof", {"dusty": {"text": "dustier"}}, now=NOON) == DUSTY
    look(followed)
    assert kinds(followed) == ["condition_set", "condition_cleared"]
    assert followed.notices.after("a", limit=9)[1].data == DUSTY["dusty"]


def test_while_a_service_starts_no_condition_ends(followed: Archive) -> None:
    look(followed, DUSTY)
    assert look(followed, {"wet": {}}, clears=False) == ["dusty", "wet"]
    assert kinds(followed) == ["condition_set", "condition_set"]
    assert look(followed, {"wet": {}}) == ["wet"]
    assert kinds(followed)[2:] == ["condition_cleared"]


def test_events_of_before_a_camera_was_known_are_passed_over_however_many(
    followed: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notices, "_MOST_EVENTS", 3)
    for minute in range(8):
        happen(followed, "day", minutes=-minute - 1.0)
    happen(followed, "bump", minutes=0.0)
    for _ in range(4):
        look(followed)
    assert kinds(followed) == ["bump"]


class Meanwhile(dict[str, Any]):
    """Conditions; while they are compared for the first time, another process looks at the camera."""

    def __init__(self, other: Archive) -> None:
        super().__init__(DUSTY)
        self.other: Archive | None = other

    def items(self) -> Any:  # noqa: ANN401 - as in dict
        if self.other is not None:
            other, self.other = self.other, None
            look(other, DUSTY)
        return super().items()


def test_of_two_processes_that_look_at_once_one_tells(followed: Archive) -> None:
    happen(followed, "bump")
    look(followed, Meanwhile(followed))
    assert kinds(followed) == ["bump", "condition_set"]


def test_another_cameras_events_are_not_told(followed: Archive) -> None:
    followed.cameras.save(followed.cameras.all()[0].at(followed.cameras.all()[0].site, name="mast", width=4, height=4))
    happen(followed, "bump", camera="mast")
    look(followed)
    assert kinds(followed) == []


def test_each_receiver_has_its_own_place_and_what_all_have_is_removed(followed: Archive) -> None:
    for _ in range(4):
        happen(followed, "bump")
    look(followed)
    followed.notices.name_sinks(["a", "b"])
    assert (len(kinds(followed)), kinds(followed, "b")) == (4, [])
    happen(followed, "day")
    look(followed)
    first, second, *_ = followed.notices.after("a", limit=9)
    followed.notices.done("a", first.seq)
    followed.notices.done("a", second.seq, refused=True)
    followed.notices.done("a", first.seq)  # never back
    states = followed.notices.sink_states()
    assert (states["a"].waiting, states["a"].refused) == (3, 1)
    assert (states["b"].waiting, states["b"].refused) == (1, 0)
    assert followed.notices.drop(most=100) == 0
    assert [notice.seq for notice in followed.notices.after("a", limit=9)] == [second.seq + n for n in (1, 2, 3)]


def test_of_too_many_the_oldest_are_removed_and_counted(followed: Archive) -> None:
    for _ in range(9):
        happen(followed, "bump")
    look(followed)
    assert followed.notices.drop(most=5) == 4
    assert len(kinds(followed)) == 5
    assert followed.notices.drop(most=5) == 0


def test_without_receivers_nothing_stays(followed: Archive) -> None:
    happen(followed, "bump")
    look(followed)
    followed.notices.name_sinks([])
    assert followed.notices.sink_states() == {}
    followed.notices.name_sinks(["a"])
    assert kinds(followed) == []
    look(followed)  # anew
    assert kinds(followed) == []
