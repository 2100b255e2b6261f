"""Over how much of the sky two calibrations contradict each other: five joint sigmas, from both sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures.calibration import ideal_camera, stated_calibration

from sunarc.calibration.acceptance import disagreement
from sunarc.calibration.model.result import Calibration

CENTRE = ("principal_point_x_px", "principal_point_y_px")


def centred(x_px: float, *, sigma_px: float) -> Calibration:
    """Return a calibration whose only doubt is that of its principal point."""
    camera = ideal_camera()
    moved = replace(camera, principal_point_px=(camera.principal_point_px[0] + x_px, camera.principal_point_px[1]))
    return stated_calibration(moved, names=CENTRE, covariance=sigma_px**2 * np.eye(2))


@pytest.mark.parametrize(("sigmas", "share"), [(0.0, 0.0), (4.95, 0.0), (5.05, 1.0), (-5.05, 1.0)])
def test_they_contradict_beyond_five_joint_sigmas(sigmas: float, share: float) -> None:
    joint = float(np.hypot(0.3, 0.4))
    found, worst_px = disagreement(centred(0.0, sigma_px=0.3), centred(sigmas * joint, sigma_px=0.4))
    assert found == share
    assert worst_px == pytest.approx(abs(sigmas) * joint, abs=1e-9)
