"""Conditions of a changed lens: what they say of a calibration that is served from before the change."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.calibrations import SITE
from tests.fixtures.served import LENS, NOON, fill, new_archive

from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.values import TO_ACKNOWLEDGE, Event
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imager.workers.calibrating.moves import MoveConditions, largest_scale_error_deg
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.projections import Projection

MOVED_AT = NOON - timedelta(minutes=25)


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    made = new_archive(tmp_path / "moves.sqlite")
    fill(made)
    yield made
    made.close()


def lens_condition(archive: Archive, kind: str, *, retired: bool) -> Reason:
    """Return the condition after a change of the lens, with the calibration before it retired or served on."""
    archive.epochs.open("roof", at=MOVED_AT, reason="lens changed")
    details = {"size": 0.8, "sigma": 0.1, TO_ACKNOWLEDGE: True}
    archive.events.add(Event(time=MOVED_AT, kind=kind, severity="alarm", text="", camera="roof", details=details))
    if retired:
        archive.calibrations.retire("second", at=MOVED_AT)
    board = StatusRegistry(version="1", started_at=NOON, monotonic=VirtualClock(NOON).monotonic)
    MoveConditions(camera=CameraArchive(archive, name="roof", site=SITE), board=board).follow()
    (found,) = board.snapshot().notes
    assert found.code == "lens_changed"
    return found


def test_a_calibration_from_before_a_change_of_focus_states_its_error(archive: Archive) -> None:
    assert "wrong by up to 0.9°" in str(lens_condition(archive, "refocus", retired=False).data["since"])


def test_after_another_lens_its_error_is_not_known(archive: Archive) -> None:
    assert "of the lens before" in str(lens_condition(archive, "lens", retired=False).data["since"])


def test_a_calibration_that_is_not_served_has_no_error(archive: Archive) -> None:
    assert lens_condition(archive, "refocus", retired=True).data["since"] == "no calibration since"


@pytest.mark.parametrize("projection", ["equidistant", "equisolid", "stereographic"])
def test_the_error_of_the_scale_is_that_of_a_camera_with_the_other_focal_length(projection: Projection) -> None:
    def lens(focal_px: float) -> Camera:
        flat = replace(LENS, projection=projection, radial=(0.0,) * 8, decentering=(0.0,) * 4)
        return replace(flat, focal_length_px=(focal_px, focal_px), rotation_cam_enu=(0.0, 0.0, 0.0))

    horizon = np.array([1.0, 0.0, 0.0])
    seen = unproject(lens(400.0), project(lens(400.0 * 0.999), horizon))
    error_deg = math.degrees(math.acos(min(float(horizon @ seen), 1.0)))
    assert largest_scale_error_deg(lens(400.0), 0.001) == pytest.approx(error_deg, rel=0.01)
