"""The search of a long record for steps of the pose, its fits replaced by known ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import SGP, small_camera, stated_calibration

from sunarc.calibration.answers.error_model import rotated
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.pose_change import PoseChange, turn_between
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes import record as module
from sunarc.changes.daily_rotations import DailyRotations
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.days import solar_days
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]

NOON = 1_368_403_200.0 + 43_200.0 + 97.484856 * 240.0
"""13 May 2013, local mean solar noon at SGP."""
SEARCH = module.StepSearch(site=SGP, image_size=(640, 480), options=CalibrationOptions(), circle=None)


def test_each_step_is_dated_by_the_poses_on_its_two_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    first = small_camera()
    second = rotated(first, np.radians([0.5, 0.3, 0.0]))
    third = rotated(second, np.radians([-0.5, 0.4, 0.2]))
    times = NOON + 300.0 * np.arange(-30.0, 30.0)
    row = np.arange(60)[:, None]
    sun = sun_directions(times, SGP)
    at_last = np.where(row < 40, project(second, sun), project(third, sun))
    points = Sightings.of(unix_s=times, pixels=np.where(row < 20, project(first, sun), at_last))
    moves = (
        _move(times[15], times[25], first, second),
        _move(times[33], times[44], second, third),
    )
    solved = stated_calibration(third)
    solved = replace(solved, evidence=replace(solved.evidence, moves=moves))
    monkeypatch.setattr(module, "calibrate_moved", lambda *_, **__: (solved, None))
    found = SEARCH._verified(points, points)
    assert [step.time for step in found] == [float(times[20]), float(times[40])]
    assert [step.bracket for step in found] == [
        (float(times[19]), float(times[20])),
        (float(times[39]), float(times[40])),
    ]


def test_the_days_about_a_jump_are_fitted_and_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    times = (NOON + 86_400.0 * np.arange(9.0)[:, None] + 300.0 * np.arange(-15.0, 15.0)).ravel()
    camera = small_camera()
    points = Sightings.of(unix_s=times, pixels=project(camera, sun_directions(times, SGP)))
    first = int(solar_days(times[:1], longitude=SGP.longitude)[0])
    fitted: list[list[int]] = []

    def verified(_: module.StepSearch, whole: Sightings, some: Sightings) -> list[PoseChange]:
        assert len(whole) == len(points)
        fitted.append(np.unique(solar_days(some.unix_s, longitude=SGP.longitude)).tolist())
        return []

    def spans(daily: DailyRotations) -> list[tuple[int, int]]:
        assert daily.day.tolist() == list(range(first, first + 9))
        return [(first + 4, first + 6), (first, first + 1)]

    monkeypatch.setattr(module.StepSearch, "_verified", verified)
    monkeypatch.setattr(module, "step_spans", spans)
    assert SEARCH.steps(points, _known_lens()) == []
    assert fitted == [[first + 4, first + 5, first + 6], [first, first + 1]]


def _move(last: float, first: float, before: Camera, after: Camera) -> PoseChange:
    turn = turn_between(before.rotation_cam_enu, after.rotation_cam_enu)
    return PoseChange(time=first, bracket=(last, first), rotation_deg=turn, cause="moved")


def _known_lens() -> Calibration:
    return stated_calibration(small_camera())
