"""Condition `tilt_unstated` of a served camera that was accepted before its tilt was asked about."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any

import pytest
from tests.fixtures.calibration import distinctive_calibration

from sunarc.common.errors import NotFoundError
from sunarc.imager.runtime.status import Reason
from sunarc.imager.workers.calibrating.refit import CalibrationIntegrityCheck
from sunarc.optics.pose import PoseAngles


class Board:
    """Status board that keeps the conditions that are set."""

    def __init__(self) -> None:
        self.conditions: dict[str, Reason | None] = {}

    def set_condition(self, code: str, reason: Reason | None) -> None:
        self.conditions[code] = reason

    def set_one_condition(self, codes: tuple[str, ...], reason: Reason | None) -> None:
        self.conditions |= dict.fromkeys(codes) | ({} if reason is None else {reason.code: reason})


@pytest.mark.parametrize(
    ("tilt_deg", "level_within_deg", "said"),
    [(12.0, None, True), (12.0, 15.0, False), (12.0, 5.0, True), (4.0, None, False)],
)
def test_a_served_camera_is_tilted_by_more_than_is_stated(
    tilt_deg: float, level_within_deg: float | None, *, said: bool
) -> None:
    served = replace(distinctive_calibration(), pose=PoseAngles(0.0, tilt_deg, 0.0))

    def without_evidence(_: str) -> None:
        raise NotFoundError(field="calibration", problem="has no sightings", remedy="none")

    calibrations: Any = SimpleNamespace(
        current=lambda _: SimpleNamespace(id="20240320T100000Z-abc123"),
        model=lambda _: served,
        damaged=lambda _: None,
        sightings_given_to=without_evidence,
    )
    camera: Any = SimpleNamespace(name="roof", archive=SimpleNamespace(calibrations=calibrations))
    board: Any = Board()
    check = CalibrationIntegrityCheck(
        camera, now=lambda: datetime(2024, 3, 20, tzinfo=UTC), board=board, level_within_deg=level_within_deg
    )
    check.check()
    reason = board.conditions["tilt_unstated"]
    assert (reason is not None) is said
    if reason is not None:
        assert reason.severity == "degraded"  # it is served on
        assert "level_within_deg = 15" in reason.remedy
