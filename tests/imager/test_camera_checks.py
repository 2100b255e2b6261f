"""What `sunarc check --camera` says of a camera, by the outcome of each check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.cameras import INFO
from tests.fixtures.settings import new_settings

from sunarc.common.errors import CameraError, CameraLostError, CameraSilentError, CameraTimeoutError
from sunarc.imager import checks as camera_checks
from sunarc.imager.cameras.frame import CameraCondition, CameraInfo, Frame
from sunarc.imager.checks import check_exposures, check_frames, survey
from sunarc.imager.runtime.clock import VirtualClock

NOW = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)


class TrialCamera:
    """A camera whose exposures fail as listed; those beyond the list succeed."""

    def __init__(self, *faults: CameraError | None, info: CameraInfo = INFO) -> None:
        self.info = info
        self.asked_us: list[float] = []
        self.closed = False
        self._faults = list(faults)

    def expose(self, exposure_us: float) -> Frame:
        self.asked_us.append(exposure_us)
        fault = self._faults.pop(0) if self._faults else None
        if fault is not None:
            raise fault
        return Frame(
            image=np.zeros((6, 8), dtype=np.uint16), time=NOW, exposure_us=exposure_us, gain_db=0.0,
            pixel_format="Mono12", full_scale=4095, frame_id=len(self.asked_us),
        )  # fmt: skip

    def distrust(self) -> None:
        raise AssertionError

    def check(self) -> CameraCondition:
        raise AssertionError

    def close(self) -> None:
        self.closed = True


def outcome(camera: TrialCamera, exposures_us: Sequence[float] = (50.0, 600.0)) -> str:
    what, found, _ = check_frames(camera, exposures_us)
    assert what == "frames"
    return found


def test_twelve_frames_are_taken_with_the_exposures_in_turn() -> None:
    camera = TrialCamera()
    assert outcome(camera, (50.0, 600.0, 9000.0)) == "ok"
    assert camera.asked_us == [50.0, 600.0, 9000.0] * 4


@pytest.mark.parametrize(
    "fault", [CameraTimeoutError("late"), CameraSilentError("silent"), CameraError("another size")]
)
def test_one_frame_that_fails_is_a_warning_and_all_are_a_failure(fault: CameraError) -> None:
    assert outcome(TrialCamera(fault)) == "warn"
    assert outcome(TrialCamera(*[fault] * 11)) == "warn"
    assert outcome(TrialCamera(*[fault] * 12)) == "fail"


def test_only_a_camera_without_any_packet_is_a_case_for_the_firewall() -> None:
    silent = check_frames(TrialCamera(*[CameraSilentError("silent")] * 12), (50.0,))
    mixed = check_frames(TrialCamera(*[CameraSilentError("silent")] * 11, CameraTimeoutError("late")), (50.0,))
    assert camera_checks.SILENT in silent[2]
    assert camera_checks.SILENT not in mixed[2]


@pytest.mark.parametrize(
    ("bounds_us", "wanted_us", "expected"),
    [
        ((5.0, 1e6), (5.0, 1e6), "ok"),
        ((5.0, 1e6), (4.9, 600.0), "fail"),
        ((5.0, 1e6), (600.0, 1.1e6), "fail"),
        ((100.0, 1e6), (600.0,), "ok"),
        ((100.1, 1e6), (600.0,), "warn"),
    ],
)
def test_exposures_are_held_against_the_cameras_bounds(
    bounds_us: tuple[float, float], wanted_us: tuple[float, ...], expected: str
) -> None:
    info = replace(INFO, exposure_min_us=bounds_us[0], exposure_max_us=bounds_us[1])
    assert check_exposures(TrialCamera(info=info), wanted_us)[:2] == ("exposures", expected)


def test_a_survey_opens_the_camera_once_and_closes_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = TrialCamera()
    monkeypatch.setattr(camera_checks, "camera_opener", lambda *_: lambda: camera)
    checks = list(survey(new_settings(tmp_path), clock=VirtualClock(NOW)))
    assert [(what, found) for what, found, _ in checks] == [("camera", "ok"), ("exposures", "ok"), ("frames", "ok")]
    assert camera.closed


def test_a_camera_that_cannot_be_opened_is_the_only_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing() -> TrialCamera:
        raise CameraLostError("no answer")

    monkeypatch.setattr(camera_checks, "camera_opener", lambda *_: failing)
    checks = list(survey(new_settings(tmp_path), clock=VirtualClock(NOW)))
    assert [(what, found) for what, found, _ in checks] == [("camera", "fail")]
