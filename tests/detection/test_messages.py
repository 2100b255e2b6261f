"""The sentence of a detection: its findings joined as they are stored."""

from __future__ import annotations

import ast
from pathlib import Path
from string import Formatter

import pytest
from tests.fixtures.finding_codes import codes

from sunarc import detection
from sunarc.common.findings import Finding, joined
from sunarc.common.messages import find_message
from sunarc.detection.disc.series import check_against_bracket, combine
from sunarc.detection.values import Detection, Verdict

FITTED = Finding("disc_found", {"chi2": 1.043})
SOURCES = sorted(Path(detection.__file__).parent.rglob("*.py"))


def disc(x_px: float, *findings: Finding, verdict: Verdict = "clear", snr: float = 100.0) -> Detection:
    return Detection(
        method="disc",
        accepted=verdict == "clear",
        verdict=verdict,
        findings=findings,
        x_px=x_px,
        y_px=5.0,
        sigma_px=0.003,
        snr=snr,
    )


def test_one_finding_is_its_own_sentence() -> None:
    assert disc(1.0, FITTED).reason == FITTED.text
    assert disc(1.0).reason == ""


def test_what_was_left_out_follows_after_a_comma_and_a_mean_after_a_semicolon() -> None:
    left_out = Finding("saturated_left_out", {"n": 12})
    mean = Finding("bracket_mean", {"frames": 3, "chi2": 2.345, "freedom": 4})
    assert joined([FITTED, left_out, mean]) == (
        "a disc was fitted, reduced chi² 1.04, 12 saturated pixels left out; mean of 3 frames (chi² 2.3, 4 degrees of "
        "freedom)"
    )


@pytest.mark.parametrize("code", ["sun_elsewhere", "bracket_covered"])
def test_what_explains_another_frame_stands_before_a_colon(code: str) -> None:
    alone = joined([Finding(code)])
    assert joined([Finding(code), FITTED]) == f"{alone}: {FITTED.text}"


def test_a_mean_keeps_the_finding_of_its_best_frame() -> None:
    mean = combine([disc(10.0, FITTED), disc(10.002, FITTED)])
    assert codes(mean.findings) == ["disc_found", "bracket_mean"]
    assert dict(mean.findings[1].data) == pytest.approx({"frames": 2, "chi2": 0.002**2 / (2 * 0.003**2), "freedom": 2})


def test_frames_that_contradict_each_other_give_one_finding() -> None:
    mean = combine([disc(10.0, FITTED), disc(11.0, FITTED)])
    assert (mean.verdict, codes(mean.findings)) == ("partly_covered", ["bracket_inconsistent"])


def test_a_frame_beside_a_covered_one_carries_its_findings() -> None:
    uneven = Finding("disc_uneven", {"uneven_px": 0.3, "chi2": 40.0})
    covered = disc(10.0, uneven, verdict="partly_covered", snr=200.0)
    latest = check_against_bracket([covered], disc(10.0, FITTED), shifts=None)
    assert latest.findings == (Finding("bracket_covered"), uneven)


def given_data() -> dict[str, set[str]]:
    """Return the names of the data that the sources of the room give to each code, as far as they are written out."""
    found = dict[str, set[str]]()
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if not (isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Finding"):
                continue
            code, data = node.args[0], node.args[1] if len(node.args) > 1 else ast.Dict([], [])
            if isinstance(code, ast.Constant) and isinstance(data, ast.Dict):
                found[str(code.value)] = {str(getattr(key, "value", "")) for key in data.keys}
    return found


@pytest.mark.parametrize("code", sorted(given_data()))
def test_the_data_of_a_code_are_those_of_its_sentence(code: str) -> None:
    message = find_message(code)
    assert message is not None
    fields = {name for _, name, _, _ in Formatter().parse(message.text) if name}
    assert given_data()[code] == fields
