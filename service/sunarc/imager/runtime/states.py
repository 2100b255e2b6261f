"""States of a service: one word of five for its conditions, the same on the page, in the fleet and over MQTT."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, Protocol, get_args

State = Literal["not_serving", "attention", "starting", "ready_with_note", "ready"]
"""How a service is, the worst first."""
Severity = Literal["note", "degraded", "not_ready"]
"""Meaning of a condition for the health: a `note` means nothing."""

WORDS: Mapping[State, str] = {
    "not_serving": "not serving",
    "attention": "attention",
    "starting": "starting",
    "ready_with_note": "ready with a note",
    "ready": "ready",
}
"""The states as people read them."""

CONDITIONS: Mapping[State, tuple[str, ...]] = {
    "not_serving": ("silent",),
    "attention": ("camera_replaced", "lens_changed", "camera_moved"),
    "starting": ("no_frame_yet", "no_calibration", "uncalibrated", "first_sun", "first_pose_provisional"),
    "ready_with_note": (
        *("camera_replaced_fitted", "lens_changed_fitted", "camera_moved_fitted"),
        *("provisional_pose", "provisional_calibration", "evidence_changed"),
        *("clock_stepped", "clock_settling", "refit_waiting", "packets_too_large"),
        *("warm_pixels_unread", "warm_pixels_other_sensor", "warm_pixels_unwritten"),
    ),
    "ready": (),
}
"""States by the conditions that make them, those that are said first at the beginning.

A condition that is not listed has the state of its severity: most of them are `attention`. One of severity `not_ready`
is `not_serving`, whatever its code.
"""

_OF_SEVERITY: Mapping[Severity, State] = {
    "note": "ready_with_note",
    "degraded": "attention",
    "not_ready": "not_serving",
}
_RANKS = {code: (state, rank) for state, codes in CONDITIONS.items() for rank, code in enumerate(codes)}
_UNLISTED = 1000


class _Condition(Protocol):
    """Code, severity and text of a condition."""

    @property
    def code(self) -> str: ...

    @property
    def severity(self) -> Severity: ...

    @property
    def text(self) -> str: ...


def condition_state(code: str, severity: Severity) -> State:
    """Return the service state to which a condition leads."""
    if severity == "not_ready" or code not in _RANKS:
        return _OF_SEVERITY[severity]
    return _RANKS[code][0]


def worst(states: Iterable[State]) -> State:
    """Return the worst of some states; `ready` without any."""
    return min(states, key=get_args(State).index, default="ready")


def state_and_text(conditions: Iterable[_Condition]) -> tuple[State, str]:
    """Return the state of a service with its conditions, and the sentence of the condition that decides it."""
    ordered = sorted(conditions, key=_rank_condition)
    if not ordered:
        return "ready", WORDS["ready"]
    first = ordered[0]
    return condition_state(first.code, first.severity), first.text


def _rank_condition(condition: _Condition) -> tuple[int, int, str]:
    state = condition_state(condition.code, condition.severity)
    _, rank = _RANKS.get(condition.code, (state, _UNLISTED))
    return get_args(State).index(state), rank, condition.code
