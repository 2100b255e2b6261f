from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING

import pytest

from sunarc.common.errors import InputError, NotFoundError
from sunarc.common.findings import Finding
from sunarc.common.utc import rfc3339

from .test_calibrations import MAY, document, served

if TYPE_CHECKING:
    from sunarc.imager.archive.archive import Archive


@pytest.fixture
def three(archive: Archive) -> Archive:
    """Three calibrations that followed each other on days 0, 10 and 20."""
    for day, calibration_id in enumerate("abc"):
        archive.calibrations.add(document(calibration_id, day=10 * day))
        archive.calibrations.activate(calibration_id)
    return archive


def test_rolling_back_serves_a_copy_and_rewrites_no_past_answer(three: Archive) -> None:
    copy = three.calibrations.reinstate("a", at=MAY + timedelta(days=25), reason="c was worse")
    assert (copy.id, copy.parent, copy.state) == ("a-r1", "a", "current")
    assert [served(three, day) for day in (0, 9, 10, 20, 24.9, 25, 1000)] == ["a", "a", "b", "c", "c", "a-r1", "a-r1"]
    assert copy == three.calibrations.get("a-r1") == three.calibrations.current("roof")
    assert copy.document["id"] == "a-r1"
    decided = {"reason": "c was worse", "decided_at": rfc3339(MAY + timedelta(days=25))}
    assert copy.findings[0] == Finding("activated_by_operator", decided)
    told = three.events.find("roof")[0]
    assert (told.kind, told.details["calibration"], told.details["copied"]) == ("calibration_reinstated", "a-r1", "a")
    data = {"calibration": "a-r1", "reason": "c was worse", "copied": "a"}
    assert told.findings == [{"code": "calibration_reinstated", "data": data}]


def test_a_second_roll_back_has_a_name_of_its_own(three: Archive) -> None:
    three.calibrations.reinstate("a", at=MAY + timedelta(days=25), reason="first")
    three.calibrations.reinstate("c", at=MAY + timedelta(days=26), reason="no")
    copy = three.calibrations.reinstate("a-r1", at=MAY + timedelta(days=27), reason="again")
    assert (copy.id, copy.parent) == ("a-r2", "a-r1")
    assert [served(three, day) for day in (24, 25, 26, 27)] == ["c", "a-r1", "c-r1", "a-r2"]


def test_rolling_back_into_the_past_corrects_the_answers_from_there_on(three: Archive) -> None:
    now = MAY + timedelta(days=25)
    copy = three.calibrations.reinstate("a", at=MAY + timedelta(days=15), decided_at=now, reason="b was worse")
    assert [served(three, day) for day in (5, 12, 15, 22)] == ["a", "b", "a-r1", "a-r1"]
    assert copy.decided_at == three.calibrations.get("a-r1").decided_at == three.events.find("roof")[0].time == now


def test_what_no_operator_activated_was_decided_when_it_was_made(three: Archive) -> None:
    record = three.calibrations.get("a")
    assert record.decided_at == record.created_at


def test_a_refused_one_takes_its_own_place_when_a_person_decides(three: Archive) -> None:
    three.calibrations.add(document("d", day=30, accepted=False))
    chosen = three.calibrations.reinstate("d", at=MAY + timedelta(days=31), reason="surveyed")
    assert (chosen.id, chosen.state, chosen.accepted) == ("d", "current", False)
    assert [served(three, day) for day in (30, 31)] == ["c", "d"]
    assert chosen == three.calibrations.get("d")


def test_the_current_one_is_not_copied_over_itself(three: Archive) -> None:
    with pytest.raises(InputError, check=lambda error: error.field == "id"):
        three.calibrations.reinstate("c", at=MAY + timedelta(days=25), reason="")
    with pytest.raises(NotFoundError):
        three.calibrations.reinstate("z", at=MAY, reason="")
    assert served(three, 25) == "c"
    assert three.events.find("roof") == ()


def test_a_pinned_one_stays_and_candidates_are_kept(three: Archive) -> None:
    assert three.calibrations.pin("c", at=MAY + timedelta(days=21), reason="a campaign").pinned
    three.calibrations.add(document("d", day=30))
    assert three.calibrations.activate("d").state == "candidate"
    assert served(three, 31) == "c"
    three.calibrations.unpin("c", at=MAY + timedelta(days=40), reason="over")
    assert three.calibrations.activate("d").state == "current"
    assert [event.kind for event in three.events.find("roof")] == ["calibration_unpinned", "calibration_pinned"]


def test_a_person_overrules_a_pin_and_it_ends(three: Archive) -> None:
    three.calibrations.pin("c", at=MAY + timedelta(days=21), reason="a campaign")
    three.calibrations.reinstate("b", at=MAY + timedelta(days=22), reason="better after all")
    assert served(three, 23) == "b-r1"
    assert not any(record.pinned for record in three.calibrations.find("roof"))


def test_only_the_current_one_is_pinned(three: Archive) -> None:
    with pytest.raises(InputError, check=lambda error: error.field == "id"):
        three.calibrations.pin("a", at=MAY, reason="")
