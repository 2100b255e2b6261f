"""Findings: the sentence of a code and its data, and their JSON."""

from __future__ import annotations

import json
import math

import pytest

from sunarc.calibration import messages
from sunarc.common.findings import Finding, Message, Messages, counted, findings_of, from_json, significant, uncoded

ROOM = Messages(too_hot=Message("{what}:{value:.1f}>{limit:g}", "Hot.", "cool {what}"))


def test_the_sentence_and_the_remedy_are_made_of_the_data() -> None:
    finding = Finding("too_hot", {"what": "sensor", "value": 61.26, "limit": 60.0})
    assert ROOM.text_of(finding) == "sensor:61.3>60"
    assert ROOM.remedy_of(finding) == "cool sensor"


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.23456, "1.2"), (0.0058123, "0.0058"), (1234.56, "1235"), (12.34, "12"), (-0.999, "-1.0"), (0.0, "0.0"),
     (math.nan, "unknown"), (None, "unknown")],
)  # fmt: skip
def test_a_number_is_shown_with_its_significant_digits(value: float | None, text: str) -> None:
    assert significant(value, 2) == text


def test_one_thing_has_no_plural() -> None:
    assert [counted(n, "new sighting") for n in (0, 1, 2)] == ["0 new sightings", "1 new sighting", "2 new sightings"]


def test_counts_take_a_plural_and_what_is_not_finite_is_unknown() -> None:
    room = Messages(fit=Message("{n:sighting}, {days:day}, {sigma:~2}, {rmse:.3f}", "Fit."))
    text = room.text_of(Finding("fit", {"n": 434, "days": 1, "sigma": 0.27849, "rmse": math.nan}))
    assert text.split(", ") == ["434 sightings", "1 day", "0.28", "unknown"]
    assert "inf" not in room.text_of(Finding("fit", {"n": 434, "days": 1, "sigma": math.inf, "rmse": -math.inf}))


@pytest.mark.parametrize("data", [{}, {"what": "sensor", "value": "hot", "limit": 1.0}])
def test_data_of_another_version_give_the_code_and_the_data(data: dict[str, float | str]) -> None:
    assert ROOM.text_of(Finding("too_hot", data)) == f"too_hot {data}"
    assert ROOM.text_of(Finding("unknown", data)) == f"unknown {data}"
    assert ROOM.remedy_of(Finding("unknown", data)) == "none"


def test_json_keeps_numbers_and_words_and_writes_null_for_what_is_not_finite() -> None:
    finding = Finding("too_hot", {"what": "sensor", "value": math.nan, "limit": 60.0, "n": 3})
    written = json.loads(json.dumps(finding.as_json(), allow_nan=False))
    assert written == {"code": "too_hot", "data": {"what": "sensor", "value": None, "limit": 60.0, "n": 3}}
    again = from_json(written)
    assert math.isnan(float(again.data["value"]))
    assert again.data["limit"] == 60.0


def test_sentences_of_version_0_2_become_findings_without_a_code() -> None:
    assert findings_of({"reasons": ["it fits"]}) == (uncoded("it fits"),)
    assert findings_of({"reasons": ["it fits"], "findings": [{"code": "mirrored"}]}) == (Finding("mirrored"),)
    assert messages.text_of(uncoded("it fits")) == "it fits"
