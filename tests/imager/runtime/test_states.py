"""Every set of conditions has one state, and the pages list the table that decides it."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import get_args

import pytest

from sunarc.common.messages import find_message
from sunarc.imager.runtime.states import CONDITIONS, WORDS, Severity, State, condition_state, state_and_text, worst
from sunarc.imager.runtime.status import Reason, StatusRegistry

PAGE = Path(__file__).parents[3] / "docs" / "operating" / "alerts.md"
OF_THE_HUB = {"silent", "uncalibrated"}


def reason(code: str, severity: Severity = "degraded") -> Reason:
    return Reason(code=code, severity=severity, text=f"text of {code}", remedy="none")


def test_without_a_condition_the_service_is_ready() -> None:
    assert state_and_text([]) == ("ready", "ready")


@pytest.mark.parametrize(
    ("severity", "state"), [("note", "ready_with_note"), ("degraded", "attention"), ("not_ready", "not_serving")]
)
def test_a_condition_that_is_not_listed_has_the_state_of_its_severity(severity: Severity, state: State) -> None:
    assert condition_state("of_a_later_version", severity) == state


@pytest.mark.parametrize("code", [code for codes in CONDITIONS.values() for code in codes])
def test_what_is_not_ready_does_not_serve_whatever_its_code(code: str) -> None:
    assert condition_state(code, "not_ready") == "not_serving"


def test_a_note_of_a_move_asks_for_attention_and_leaves_the_health() -> None:
    board = StatusRegistry(version="1", started_at=datetime(2026, 1, 1, tzinfo=UTC), monotonic=float)
    board.set_condition("camera_moved", reason("camera_moved", "note"))
    snapshot = board.snapshot()
    assert (snapshot.health, snapshot.state, snapshot.state_text) == ("ready", "attention", "text of camera_moved")
    assert (snapshot.reasons, [one.code for one in snapshot.notes]) == ((), ["camera_moved"])


def test_the_worst_condition_decides_and_the_listed_one_is_said_first() -> None:
    conditions = [
        reason("clock_stepped"),
        reason("no_calibration"),
        reason("a_first_by_name"),
        reason("camera_moved", "note"),
    ]
    assert state_and_text(conditions) == ("attention", "text of camera_moved")
    assert state_and_text(conditions[:2]) == ("starting", "text of no_calibration")
    assert state_and_text(conditions[:1]) == ("ready_with_note", "text of clock_stepped")
    lost = reason("camera_refused", "not_ready")
    assert state_and_text([*conditions, lost]) == ("not_serving", "text of camera_refused")


def test_the_order_of_the_conditions_does_not_matter() -> None:
    conditions = [reason("camera_lost"), reason("disk_low"), reason("no_frame_yet")]
    assert state_and_text(conditions) == state_and_text(conditions[::-1]) == ("attention", "text of camera_lost")


def test_the_worst_of_some_states() -> None:
    assert [worst(get_args(State)[n:]) for n in range(5)] == [*get_args(State)]
    assert worst([]) == "ready"


def test_a_code_is_listed_once_and_has_a_message() -> None:
    codes = [code for listed in CONDITIONS.values() for code in listed]
    assert len(codes) == len(set(codes))
    assert [code for code in codes if code not in OF_THE_HUB and find_message(code) is None] == []


def test_the_page_has_the_table() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| [^|]+ \|([^|]*)\|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE))
    assert rows.keys() >= WORDS.keys() == set(get_args(State))
    for state, codes in CONDITIONS.items():
        assert set(codes) <= set(re.findall(r"`(\w+)`", rows[state])), state
        other = {code for one, listed in CONDITIONS.items() if one != state for code in listed}
        assert not other & set(re.findall(r"`(\w+)`", rows[state])), state
