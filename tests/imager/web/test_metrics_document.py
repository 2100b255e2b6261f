"""docs/metrics.md and deploy/prometheus-rules.yml name what is exported, and nothing else."""

from __future__ import annotations

import dataclasses
import os
import re
import types
import typing
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import AwareDatetime

from sunarc.imager.archive.values import Event
from sunarc.imager.runtime.status import ClockStatus, Notes, Reason

if TYPE_CHECKING:
    from tests.fixtures.served import Made

ROOT = Path(__file__).parents[3]
DOCUMENT = ROOT / "docs" / "metrics.md"
RULES = ROOT / "deploy" / "prometheus-rules.yml"
REGENERATE = "SUNARC_WRITE_METRICS=1 pytest tests/imager/web/test_metrics_document.py"
HEAD = "| metric | labels | kind | what it is |\n|---|---|---|---|\n"
PROMETHEUS_OWN = {"up"}
SUFFIXES = ("_total", "_created", "_bucket", "_sum", "_count")


def some(kind: Any, noon: datetime) -> Any:  # noqa: ANN401 - of any kind
    """Return some value of a kind."""
    if typing.get_origin(kind) in (types.UnionType, typing.Union):
        kind = next(one for one in typing.get_args(kind) if one is not type(None))
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        hints = typing.get_type_hints(kind)
        return kind(**{one.name: some(hints[one.name], noon) for one in dataclasses.fields(kind)})
    if typing.get_origin(kind) is tuple:
        return ()
    return noon if kind in (datetime, AwareDatetime) else kind(1)


def exported(made: Made) -> dict[str, tuple[str, str, str]]:
    """Return every family that a service exports of which all is known: labels, kind, help."""
    made.board.note(**{name: some(kind, made.noon) for name, kind in typing.get_type_hints(Notes).items()})
    made.board.set_condition("drift", Reason(code="drift", severity="degraded", text="it moved", remedy="wait"))
    made.archive.notices.name_sinks(["mqtt"])
    text = made.client.get("/metrics").text
    helps = dict(re.findall(r"^# HELP (\w+) (.*)$", text, re.MULTILINE))
    kinds = dict(re.findall(r"^# TYPE (\w+) (\w+)$", text, re.MULTILINE))
    labels = {name: re.findall(r"(\w+)=", inner) for name, inner in re.findall(r"^(\w+)\{(.*)\} ", text, re.MULTILINE)}
    return {name: (", ".join(labels.get(name, [])), kinds[name], told) for name, told in helps.items()}


def test_every_metric_is_documented_and_no_other(made: Made) -> None:
    found = exported(made)
    rows = "".join(f"| `{name}` | {' | '.join(found[name])} |\n" for name in sorted(found))
    text = DOCUMENT.read_text()
    before, _, after = text.partition(HEAD)
    rest = re.sub(r"\A(\|.*\n)*", "", after)
    wanted = f"{before}{HEAD}{rows}{rest}"
    if os.environ.get("SUNARC_WRITE_METRICS") == "1":
        DOCUMENT.write_text(wanted)
        text = wanted
    assert len(found) > 15
    assert text == wanted, f"the metrics have changed; see that this is meant, then run: {REGENERATE}"


def rules() -> list[dict[str, Any]]:
    groups: list[dict[str, Any]] = yaml.safe_load(RULES.read_text())["groups"]
    return [rule for group in groups for rule in group["rules"]]


def test_every_metric_that_a_rule_names_is_exported_with_its_labels(made: Made) -> None:
    found = exported(made)
    for rule in rules():
        named = re.findall(r"\b(sunarc_\w+|up)\b(?:\{([^}]*)\})?", rule["expr"])
        assert named, rule["alert"]
        for name, labels in named:
            known = next((name.removesuffix(s) for s in ("", *SUFFIXES) if name.removesuffix(s) in found), None)
            assert known or name in PROMETHEUS_OWN, (rule["alert"], name)
            used = set(re.findall(r"(\w+)\s*[=!]~?", labels)) - {"job"}
            assert used <= set(found.get(name, ("",))[0].split(", ")), (rule["alert"], name)


def test_every_rule_says_what_is_the_matter_and_what_to_do() -> None:
    names = [rule["alert"] for rule in rules()]
    assert len(names) == len(set(names)) >= 10
    for rule in rules():
        assert set(rule["annotations"]) == {"summary", "remedy"}, rule["alert"]
        assert rule["labels"]["severity"] in {"critical", "warning", "info"}, rule["alert"]
        assert re.fullmatch(r"\d+[smhd]", rule.get("for", "0s")), rule["alert"]


SOON = ("sunarc_clock_", "sunarc_disk_", "sunarc_worker_", "sunarc_reason", "sunarc_night_")
"""Written by a worker's first look, seconds after the start, only while something is the matter, or by night."""


def test_what_alerts_go_by_is_there_as_soon_as_the_service_answers(empty: Made) -> None:
    samples = re.findall(r"^(sunarc_\w+)(?:\{[^}]*\})? ", empty.client.get("/metrics").text, re.MULTILINE)
    for rule in rules():
        for name in re.findall(r"\bsunarc_\w+", rule["expr"]):
            there = name in samples or name.startswith(SOON) or f"({name} or sunarc_started_seconds)" in rule["expr"]
            there |= name == "sunarc_calibration_sky_rms_degrees"  # of the current calibration; there is none
            assert there, (rule["alert"], name)
    assert "sunarc_started_seconds" in samples


def test_a_camera_that_has_not_answered_yet_is_not_connected(empty: Made) -> None:
    text = empty.client.get("/metrics").text
    assert "sunarc_camera_connected 0.0" in text
    assert "sunarc_capture_cycles_total 0.0" in text


def test_a_step_of_the_clock_is_remembered_over_a_restart(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    def step_s(one: Made) -> list[str]:
        return re.findall(r"^sunarc_clock_last_step_seconds (\S+)", one.client.get("/metrics").text, re.MULTILINE)

    fresh: Made = make()
    assert step_s(fresh) == []
    stepped = Event(time=fresh.noon, kind="clock_step", severity="warning", text="stepped", camera="roof")
    fresh.archive.events.add(stepped)
    restarted = make(archive=fresh.archive)
    assert [float(value) for value in step_s(restarted)] == [fresh.noon.timestamp()]
    later = fresh.noon + timedelta(hours=1)
    restarted.board.note(clock=ClockStatus(synchronised=True, last_step_s=1.0, last_step_at=later))
    assert [float(value) for value in step_s(restarted)] == [later.timestamp()]


def test_counts_of_the_store_are_the_same_after_a_restart(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    first: Made = make(history="filled")

    def stored(one: Made) -> list[str]:
        return re.findall(
            r"^sunarc_(?:sightings|days|refits|last_day).*", one.client.get("/metrics").text, re.MULTILINE
        )

    numbers = stored(first)
    assert any(line.startswith('sunarc_sightings_last_day{verdict="clear"} ') for line in numbers)
    assert 'sunarc_refits{state="failed"} 0.0' in numbers
    assert stored(make(archive=first.archive)) == numbers


def test_requests_are_counted_by_status_and_by_how_long_they_took(made: Made) -> None:
    for path in ("/healthz", "/healthz", "/v1/nowhere"):
        made.client.get(path)
    text = made.client.get("/metrics").text
    assert 'sunarc_http_requests_total{status="200"} 2.0' in text
    assert 'sunarc_http_requests_total{status="404"} 1.0' in text
    assert 'sunarc_http_request_seconds_bucket{le="+Inf"} 3.0' in text
    assert re.search(r"^process_resident_memory_bytes [1-9]", text, re.MULTILINE)
