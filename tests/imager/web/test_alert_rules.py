"""Each rule of deploy/prometheus-rules.yml fires on its fault and is silent without it, by Prometheus's promtool."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[3]
RULES = ROOT / "deploy" / "prometheus-rules.yml"
LABELS = 'instance="imager:8080",job="sunarc"'


class Case(NamedTuple):
    """An alert, series that make it fire (promtool's notation, one value a minute), and ones that do not."""

    alert: str
    faulty: dict[str, str]
    good: dict[str, str]
    minutes: int = 60


def reason(code: str, severity: str = "degraded") -> str:
    return f'sunarc_reason{{code="{code}",severity="{severity}",{LABELS}}}'


def gauge(name: str, **labels: str) -> str:
    inner = "".join(f'{key}="{value}",' for key, value in labels.items())
    return f"{name}{{{inner}{LABELS}}}"


DAY = 1440
CASES = [
    Case("SunarcDown", {gauge("up"): "0x60"}, {gauge("up"): "1x60"}),
    Case("SunarcRestarts", {gauge("sunarc_started_seconds"): "0+60x60"}, {gauge("sunarc_started_seconds"): "5x60"}),
    Case(
        "SunarcNotReady",
        {gauge("sunarc_health", state="not_ready"): "1x60"},
        {gauge("sunarc_health", state="not_ready"): "0x60", gauge("sunarc_health", state="degraded"): "1x60"},
    ),
    Case("SunarcDegraded", {reason("drift"): "1x60"}, {reason("no_calibration"): "1x60"}),
    Case("SunarcCameraLost", {gauge("sunarc_camera_connected"): "0x60"}, {gauge("sunarc_camera_connected"): "1x60"}),
    Case(
        "SunarcNoFrames",
        {gauge("sunarc_last_frame_seconds"): "0x60"},
        {gauge("sunarc_last_frame_seconds"): "0+60x60", gauge("sunarc_started_seconds"): "0x60"},
    ),
    Case(
        "SunarcNoSightings",
        {gauge("sunarc_last_sighting_seconds"): f"0x{15 * DAY}"},
        {gauge("sunarc_last_sighting_seconds"): f"0+60x{15 * DAY}"},
        minutes=15 * DAY,
    ),
    Case(
        "SunarcClockUnsynchronised",
        {reason("clock_unsynchronised"): "1x60"},
        # an assumed bound of the error: the kernel calls the clock unsynchronised, and nothing waits
        {gauge("sunarc_clock_synchronised"): "0x60", gauge("sunarc_clock_error_seconds"): "1.5x60"},
    ),
    Case("SunarcClockUnsynchronised", {reason("camera_clock_offset"): "1x60"}, {reason("clock_stepped"): "1x60"}),
    Case(
        "SunarcClockStepped",
        {gauge("sunarc_clock_last_step_seconds"): "1200x60"},
        {gauge("sunarc_clock_last_step_seconds"): "-9000x60"},
    ),
    # images fill the disk down to disk.keep_free_mb, and then the oldest ones go: that is no fault
    Case("SunarcDiskLow", {reason("disk_low"): "1x60"}, {gauge("sunarc_disk_free_bytes"): "9e9-2e8x40 1.2e9x20"}),
    Case("SunarcDiskLow", {reason("disk_no_inodes"): "1x60"}, {reason("images_unreadable"): "1x60"}),
    Case(
        "SunarcWorkerRestarts",
        {gauge("sunarc_worker_restarts", worker="capture"): "0+0.2x60"},
        {gauge("sunarc_worker_restarts", worker="capture"): "7x60"},
    ),
    Case(
        "SunarcWorkerStuck",
        {gauge("sunarc_worker_heartbeat_age_seconds", worker="capture"): "301x60"},
        {gauge("sunarc_worker_heartbeat_age_seconds", worker="capture"): "299x60"},
    ),
    Case(
        "SunarcNotCalibrated",
        {gauge("sunarc_calibration_present"): f"0x{8 * DAY}"},
        {gauge("sunarc_calibration_present"): f"1x{8 * DAY}"},
        minutes=8 * DAY,
    ),
    *(
        Case(alert, {gauge(metric): "3x50 4x10"}, {gauge(metric): "3x50 2x10"})  # a copy put back has fewer
        for alert, metric in (
            ("SunarcCameraMoved", "sunarc_camera_moves_total"),
            ("SunarcLensChanged", "sunarc_camera_lens_changes_total"),
            ("SunarcCameraReplaced", "sunarc_camera_replaced_total"),
        )
    ),
    Case(
        "SunarcToAcknowledge",
        {gauge("sunarc_events_to_acknowledge"): f"1x{4 * DAY}"},
        {gauge("sunarc_events_to_acknowledge"): f"0x{4 * DAY}"},
        minutes=4 * DAY,
    ),
    Case(
        "SunarcCalibrationDoubtful",
        {gauge("sunarc_calibration_sky_rms_degrees"): f"0.21x{2 * DAY}"},
        {gauge("sunarc_calibration_sky_rms_degrees"): f"0.19x{2 * DAY}"},
        minutes=2 * DAY,
    ),
    Case(
        "SunarcDomeDark",
        {gauge("sunarc_night_zero_point"): f"10.9x{30 * DAY} 10.1x{5 * DAY}"},
        {gauge("sunarc_night_zero_point"): f"10.9x{30 * DAY} 10.4x{5 * DAY}"},
        minutes=35 * DAY,
    ),
]


def firing(case: Case, series: dict[str, str], folder: Path) -> list[str]:
    """Return the alerts that promtool sees after a case's minutes."""
    test = {
        "rule_files": [str(RULES)],
        "evaluation_interval": "1m" if case.minutes <= 60 else "30m",
        "tests": [
            {
                "interval": "1m",
                "input_series": [{"series": name, "values": values} for name, values in series.items()],
                "alert_rule_test": [{"eval_time": f"{case.minutes}m", "alertname": case.alert, "exp_alerts": []}],
            }
        ],
    }
    file = folder / "test.yml"
    file.write_text(json.dumps(test), encoding="utf-8")  # JSON is YAML
    done = subprocess.run(["promtool", "test", "rules", file], capture_output=True, text=True, check=False)
    text = done.stdout + done.stderr
    assert "SUCCESS" in text or "got:[" in text, text  # not a test file or a rule that cannot be read
    return re.findall(r'alertname="(\w+)"', text) if done.returncode else []


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed: apt-get install prometheus")
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.alert}-{next(iter(case.faulty)).partition('{')[0]}")
def test_an_alert_fires_on_its_fault_and_is_silent_without_it(case: Case, tmp_path: Path) -> None:
    assert case.alert in firing(case, case.faulty, tmp_path)
    assert firing(case, case.good, tmp_path) == []


def test_every_rule_has_a_case() -> None:
    named = re.findall(r"alert: (\w+)", RULES.read_text(encoding="utf-8"))
    assert sorted(named) == sorted({case.alert for case in CASES})


def test_the_codes_of_the_rules_are_those_of_the_table() -> None:
    table = (ROOT / "docs" / "codes.md").read_text(encoding="utf-8")
    documented = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    patterns = re.findall(r'code=~"([^"]+)"', RULES.read_text(encoding="utf-8"))
    assert len(patterns) == 2
    for pattern in patterns:
        matching = [code for code in documented if re.fullmatch(pattern, code)]
        assert len(matching) == pattern.count("|") + 1, pattern
