"""Bounds are declared once, beside the type, and hold for every number of the field."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Annotated, Literal

import pytest
from annotated_types import Ge, Gt, Le, Lt

from sunarc.common.bounds import bounds_text, declared_bounds, require_bounds
from sunarc.common.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Options:
    cadence_s: Annotated[float, Gt(0.0), Le(3600.0)] = 30.0
    attempts: Annotated[int, Ge(1)] = 2
    share: Annotated[float, Ge(0.0), Lt(1.0)] | None = None
    exposures_us: tuple[Annotated[float, Gt(0.0)], ...] = (3000.0,)
    name: str = "roof"
    transport: Literal["gige", "usb3"] | None = "gige"
    free: float = 0.0

    def __post_init__(self) -> None:
        require_bounds(self, section_path="capture")


@pytest.mark.parametrize(
    "given",
    [
        {"cadence_s": 3600.0},
        {"cadence_s": 1e-9},
        {"attempts": 1},
        {"share": 0.0},
        {"share": 0.999},
        {"share": None},
        {"exposures_us": ()},
        {"free": -1e9},
    ],
)
def test_what_is_within_the_bounds_is_taken(given: dict[str, object]) -> None:
    Options(**given)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "field", "allowed"),
    [
        ({"cadence_s": 0.0}, "capture.cadence_s", "above 0 and at most 3600"),
        ({"cadence_s": 3600.1}, "capture.cadence_s", "above 0 and at most 3600"),
        ({"cadence_s": math.nan}, "capture.cadence_s", "above 0 and at most 3600"),
        ({"cadence_s": math.inf}, "capture.cadence_s", "above 0 and at most 3600"),
        ({"attempts": 0}, "capture.attempts", "at least 1"),
        ({"share": 1.0}, "capture.share", "at least 0 and below 1"),
        ({"share": -0.1}, "capture.share", "at least 0 and below 1"),
        ({"exposures_us": (3.0, 0.0)}, "capture.exposures_us", "above 0"),
        ({"transport": "mail"}, "capture.transport", 'one of "gige", "usb3"'),
    ],
)
def test_what_is_beyond_them_is_refused_with_its_path_and_what_is_allowed(
    given: dict[str, object], field: str, allowed: str
) -> None:
    with pytest.raises(InputError) as refused:
        Options(**given)  # type: ignore[arg-type]
    assert (refused.value.field, refused.value.remedy) == (field, f"give {allowed}")


def test_fields_without_bounds_are_not_listed() -> None:
    assert sorted(declared_bounds(Options)) == ["attempts", "cadence_s", "exposures_us", "share", "transport"]
    assert re.findall(r"\d+", bounds_text(declared_bounds(Options)["share"])) == ["0", "1"]
    assert "finite" in bounds_text(())


def test_only_dataclasses_have_bounds() -> None:
    with pytest.raises(TypeError):
        require_bounds(object(), section_path="x")
