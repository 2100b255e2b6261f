"""Findings: the sentence of a code and its data, and their JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from sunarc.common import messages
from sunarc.common.findings import Finding, from_json, parse_findings, uncoded
from sunarc.common.messages import all_messages, counted, filled, find_message, significant

HOT = '[common_room.too_hot]\ntext = "{what}:{value:.1f}>{limit:g}"\nmeaning = "Hot."\naction = "cool {what}"\n'


@pytest.fixture
def houses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return a package of the library alone, with one message."""
    tmp_path.joinpath("common").mkdir()
    tmp_path.joinpath("common", "messages.toml").write_text(HOT)
    monkeypatch.setattr(messages, "files", lambda _package: tmp_path)
    forget()
    yield tmp_path
    forget()


def forget() -> None:
    for kept in (messages._find_houses, messages._load_messages):
        kept.cache_clear()


def test_a_house_has_messages_where_it_is_installed_and_is_read_when_it_is_needed(houses: Path) -> None:
    house = houses / "observatory"
    house.mkdir()
    house.joinpath("__init__.py").touch()
    assert [code for code, _ in all_messages()] == ["too_hot"]
    house.joinpath("messages.toml").write_text("no table of messages")
    forget()
    assert find_message("too_hot") is not None
    house.joinpath("messages.toml").write_text(HOT.replace("too_hot", "too_cold").replace("common_room", "dome"))
    assert [(code, one.room) for code, one in all_messages()] == [
        ("too_hot", "common_room"), ("too_cold", "observatory/dome")
    ]  # fmt: skip


def test_no_code_has_two_messages() -> None:
    codes = [code for code, _ in all_messages()]
    assert len(codes) == len(set(codes)) > 0


@pytest.mark.usefixtures("houses")
def test_the_sentence_and_the_remedy_are_made_of_the_data() -> None:
    finding = Finding("too_hot", {"what": "sensor", "value": 61.26, "limit": 60.0})
    assert finding.text == "sensor:61.3>60"
    assert finding.remedy == "cool sensor"


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
    template = "{n:sighting}, {days:day}, {sigma:~2}, {rmse:.3f}"
    text = filled(template, {"n": 434, "days": 1, "sigma": 0.27849, "rmse": math.nan})
    assert str(text).split(", ") == ["434 sightings", "1 day", "0.28", "unknown"]
    assert "inf" not in str(filled(template, {"n": 434, "days": 1, "sigma": math.inf, "rmse": -math.inf}))


@pytest.mark.usefixtures("houses")
@pytest.mark.parametrize("data", [{}, {"what": "sensor", "value": "hot", "limit": 1.0}])
def test_data_of_another_version_give_the_code_and_the_data(data: dict[str, float | str]) -> None:
    assert Finding("too_hot", data).text == f"too_hot {data}"
    assert Finding("unknown", data).text == f"unknown {data}"
    assert Finding("unknown", data).remedy == "none"


def test_json_keeps_numbers_and_words_and_writes_null_for_what_is_not_finite() -> None:
    finding = Finding("too_hot", {"what": "sensor", "value": math.nan, "limit": 60.0, "n": 3})
    written = json.loads(json.dumps(finding.as_json(), allow_nan=False))
    assert written == {"code": "too_hot", "data": {"what": "sensor", "value": None, "limit": 60.0, "n": 3}}
    again = from_json(written)
    assert math.isnan(float(again.data["value"]))
    assert again.data["limit"] == 60.0


def test_sentences_of_version_0_2_become_findings_without_a_code() -> None:
    assert parse_findings({"reasons": ["it fits"]}) == (uncoded("it fits"),)
    assert parse_findings({"reasons": ["it fits"], "findings": [{"code": "mirrored"}]}) == (Finding("mirrored"),)
    assert uncoded("it fits").text == "it fits"
