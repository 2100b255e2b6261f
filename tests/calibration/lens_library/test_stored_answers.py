"""A first pose, a day with its type of lens and a fit of two cameras, compared with stored_answers.json."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tests.fixtures.clear_day import SGP, SIZE, simulate
from tests.fixtures.stored_answers import require_stored, said

from sunarc.calibration.lens_library.conditioning import apply_lens_prior
from sunarc.calibration.lens_library.first_pose import first_pose, north_sigma_deg
from sunarc.calibration.lens_library.joint import Entry, calibrate_jointly
from sunarc.calibration.lens_library.lens_type import LensType
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.mounting import top_azimuth_deg

if TYPE_CHECKING:
    import pytest
    from tests.fixtures.lens_types import Fitted, Units

_STORED = Path(__file__).parent / "stored_answers.json"
_RELATIVE = 0.01


def _of(found: Calibration) -> dict[str, list[object]]:
    sigma = np.sqrt(np.maximum(np.diag(found.covariance), 0.0)).tolist()
    answer = said(found.verdict.findings)
    return {"codes": answer["codes"], "numbers": [found.sky_rms_deg, found.sky_max_deg, *sigma, *answer["numbers"]]}


def test_a_first_pose_is_the_stored_one(unit: Units, lens: LensType) -> None:
    points = simulate(unit(0), cadence_s=60.0, sigma_px=0.3, seed=0).points.select(slice(100, 112))
    points = replace(points, sigma_px=np.full(12, 0.3))
    found = first_pose(points, lens=lens, site=SGP, options=CalibrationOptions())
    answer = _of(found)
    answer["numbers"] += [north_sigma_deg(found), top_azimuth_deg(found.camera)]
    require_stored(_STORED, "first_pose", answer, relative=_RELATIVE)


def test_a_day_with_its_type_is_the_stored_one(lens: LensType, fitted: Fitted) -> None:
    points, solved = fitted(0)
    found = apply_lens_prior(solved, lens, points=points, options=CalibrationOptions(level_within_deg=15.0))
    require_stored(_STORED, "with_lens", _of(found), relative=_RELATIVE)


def test_two_cameras_of_a_type_are_the_stored_ones(fitted: Fitted, monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [
        Entry(camera=f"{k}", epoch="", points=fitted(k)[0], site=SGP, image_size=SIZE, options=CalibrationOptions())
        for k in range(2)
    ]

    def already(points: Sightings, **_: object) -> Calibration:
        return next(fit for known, fit in map(fitted, range(2)) if np.array_equal(known.pixels, points.pixels))

    monkeypatch.setattr("sunarc.calibration.lens_library.joint.calibrate", already)
    joint = calibrate_jointly(entries)
    assert joint.lens is not None
    scales = np.sqrt(np.diag(joint.lens.covariance))[:8].tolist()
    answers = [_of(one) for one in joint.calibrations]
    both = {key: [x for each in answers for x in each[key]] for key in ("codes", "numbers")}
    both["numbers"] += scales
    require_stored(_STORED, "joint", both, relative=_RELATIVE)
