"""The tilt that is stated: asked of a first camera alone, written for one that was accepted before, contradicted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.calibration import SGP, small_camera, stated_calibration
from tests.fixtures.settings import new_settings

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.common.findings import Finding
from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import Archive, CameraArchive, open_archive
from sunarc.imager.archive.database.schema import downgrade, upgrade
from sunarc.imager.archive.values import CameraRecord, SunPoint
from sunarc.imager.commands import calibrate_archive as module
from sunarc.imager.runtime.status import Reason
from sunarc.imager.settings.model import Settings
from sunarc.imager.workers.calibrating.refit import CalibrationIntegrityCheck, RefitTask, RefitWorker, next_task
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

MORNING = datetime(2013, 5, 13, 14, 0, tzinfo=UTC)
NOW = datetime(2013, 6, 1, tzinfo=UTC)
TILTED = replace(small_camera(), rotation_cam_enu=rotation_from_pose_angles(PoseAngles(20.0, 12.0, 80.0)))
SERVED = stated_calibration(TILTED)
REVISION_BEFORE = "0019"
"""Revision of databases that were written before a tilt was asked about."""


def stored(archive: Archive, calibration: Calibration = SERVED) -> str:
    """Store a calibration, and let it be served since the morning; return its identity."""
    document = to_document(
        calibration, id="20130513T140000Z-abc123", camera="roof", state="candidate", created_at=MORNING,
        valid_from=MORNING, valid_until=None, pose_epoch=archive.epochs.find("roof")[-1].id, software_version="0.3.0",
    )  # fmt: skip
    identity = archive.calibrations.add(document).id
    archive.calibrations.reinstate(identity, at=MORNING, reason="of a test")
    return identity


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """Return settings whose archive has forty sightings of a camera that is tilted by 12 degrees."""
    settings = new_settings(tmp_path)
    make_empty(settings.database)
    with open_archive(settings.database) as archive:
        archive.cameras.save(CameraRecord.at(SGP, name="roof", width=TILTED.width, height=TILTED.height))
        add_day(archive, MORNING)
    return settings


def add_day(archive: Archive, begin: datetime) -> None:
    epoch = archive.epochs.at("roof", begin, reason="first image").id
    times = [begin + timedelta(minutes=10 * n) for n in range(40)]
    pixels = project(TILTED, sun_directions([time.timestamp() for time in times], SGP)).tolist()
    archive.sightings.add(
        SunPoint(camera="roof", pose_epoch=epoch, time=time, method="paper", accepted=True, verdict="clear",
                 x_px=x, y_px=y, sigma_px=0.5)
        for time, (x, y) in zip(times, pixels, strict=True)
    )  # fmt: skip


def is_tilt_known(archive: Archive, site: Site = SGP) -> bool:
    camera = CameraArchive(archive, name="roof", site=site)
    task = next_task(camera, cadence_s=600.0, options=CalibrationOptions(), circle=None, now=NOW)
    assert isinstance(task, RefitTask)
    return task.problem.tilt_known


def test_a_camera_that_was_accepted_at_its_site_is_not_asked_again_after_a_move(settings: Settings) -> None:
    with open_archive(settings.database) as archive:
        assert not is_tilt_known(archive)
        stored(archive)
        archive.epochs.open("roof", at=MORNING + timedelta(days=1), reason="moved")
        add_day(archive, MORNING + timedelta(days=1))
        assert is_tilt_known(archive)
        assert not is_tilt_known(archive, replace(SGP, longitude=SGP.longitude + 1.0))


def test_a_camera_that_is_served_without_having_been_accepted_is_asked_about(settings: Settings) -> None:
    refused = Verdict(accepted=False, marginal=True, findings=(Finding("direction_sigma_too_large"),))
    with open_archive(settings.database) as archive:
        stored(archive, replace(SERVED, verdict=refused, sigma_limit_deg=1.0))
        assert not is_tilt_known(archive)


class Board:
    """Status board that keeps the conditions that are set."""

    def __init__(self) -> None:
        self.conditions: dict[str, Reason | None] = {}

    def set_condition(self, code: str, reason: Reason | None) -> None:
        self.conditions[code] = reason

    def set_one_condition(self, codes: tuple[str, ...], reason: Reason | None) -> None:
        self.conditions |= dict.fromkeys(codes) | ({} if reason is None else {reason.code: reason})


def test_a_tilted_camera_of_an_older_database_is_served_on_with_the_line_to_write(settings: Settings) -> None:
    with open_archive(settings.database) as archive:
        served = stored(archive)
    downgrade(settings.database, REVISION_BEFORE)
    upgrade(settings.database)
    board: Any = Board()
    with open_archive(settings.database) as archive:
        camera = CameraArchive(archive, name="roof", site=settings.site)
        CalibrationIntegrityCheck(camera, now=lambda: NOW, board=board).check()
        current = archive.calibrations.current("roof")
        assert current is not None
        assert current.id == served
        assert archive.calibrations.current_model("roof") is not None
    reason = board.conditions["tilt_unstated"]
    assert reason.severity == "degraded"
    assert "level_within_deg = 15" in reason.remedy


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> list[float | None]:
    """Let the refit's solve answer with the tilted camera, and return the list of the limits that it is asked for."""
    limits: list[float | None] = []

    def answer(problem: Any, *_: object, **__: object) -> Calibration:  # noqa: ANN401
        limits.append(problem.options.level_within_deg)
        return SERVED

    known: Callable[..., RefitWorker] = partial(RefitWorker, solve=answer, search=lambda *_, **__: ())
    monkeypatch.setattr(module, "RefitWorker", known)
    return limits


def ingest(settings: Settings, folder: Path) -> tuple[str, ...]:
    images, config = folder / "images", folder / "sunarc.toml"
    images.mkdir()
    cv2.imwrite(str(images / "20130513T230000Z.png"), np.zeros((TILTED.height, TILTED.width), dtype=np.uint8))
    config.write_text(
        f'name = "roof"\nstate = "{settings.state}"\n'
        f"[site]\nlatitude = {SGP.latitude}\nlongitude = {SGP.longitude}\naltitude = {SGP.altitude}\n"
    )
    return "ingest", str(images), "--config", str(config), "--calibrate"


def test_ingest_states_the_limit_of_the_tilt_to_the_fit(
    settings: Settings, sunarc: Sunarc, solved: list[float | None], tmp_path: Path
) -> None:
    answer = sunarc(*ingest(settings, tmp_path), "--level-within", "15")
    assert answer.code == 0, answer.err
    assert solved == [15.0]


def test_a_limit_below_the_stored_tilt_is_one_error_that_names_both(
    settings: Settings, sunarc: Sunarc, solved: list[float | None], tmp_path: Path
) -> None:
    with open_archive(settings.database) as archive:
        served = stored(archive)
    answer = sunarc(*ingest(settings, tmp_path), "--level-within", "5")
    assert answer.code == 2
    assert "calibration.level_within_deg" in answer.err
    assert f"calibration {served} is tilted by 12.0°" in answer.err
    assert "give 15" in answer.err
    assert solved == []
