"""The first sightings of a camera: a pose with the error that it states, or a word on what is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.clear_day import SGP, simulate
from tests.fixtures.stored_answers import require_stored, said

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.lens_library.first_pose import (
    first_pose,
    level,
    levelling,
    north_sigma_deg,
)
from sunarc.calibration.lens_library.lens_type import LensType
from sunarc.calibration.model.options import CalibrationOptions, FirstPoseOptions
from sunarc.calibration.model.result import Calibration
from sunarc.changes.record import calibrate_with_lens
from sunarc.common.errors import InputError
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.mounting import top_azimuth_deg
from sunarc.optics.pose import rotation_matrix, rotation_vector

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated
    from tests.fixtures.lens_types import Units

SKY = hemisphere(200)
WHEN = {"morning": 0.15, "noon": 0.5, "low": 0.01}


def first(camera: Camera, count: int, *, when: str = "morning", seed: int = 0) -> Simulated:
    """Return the first `count` sightings from some time of a day on, one a minute, with 0.3 px of noise."""
    day = simulate(camera, cadence_s=60.0, sigma_px=0.3, seed=seed)
    begin = int(WHEN[when] * len(day.points))
    points = day.points.select(slice(begin, begin + count))
    return replace(day, points=replace(points, sigma_px=np.full(count, 0.3)))


def posed(seen: Simulated, lens: LensType, pose: FirstPoseOptions | None = None) -> Calibration:
    return first_pose(seen.points, lens=lens, site=SGP, options=CalibrationOptions(), pose=pose)


def codes(found: Calibration) -> list[str]:
    return [finding.code for finding in found.verdict.findings]


def require_as_stored(name: str, *found: Calibration) -> None:
    """Require the stored findings and errors of calibrations."""
    said_ = [said(one.verdict.findings) for one in found]
    errors = [x for one in found for x in (one.sky_rms_deg, one.sky_max_deg, north_sigma_deg(one))]
    answer = {
        "codes": [code for one in said_ for code in one["codes"]],
        "numbers": [*errors, *(x for one in said_ for x in one["numbers"])],
    }
    require_stored(Path(__file__).parent / "stored_answers.json", name, answer, relative=0.01)


def north_error_deg(found: Calibration, truth: Camera) -> float:
    turn = rotation_matrix(found.camera.rotation_cam_enu).T @ rotation_matrix(truth.rotation_cam_enu)
    return float(np.degrees(rotation_vector(turn)[2]))


def test_five_ten_and_twenty_sightings_give_a_pose_with_the_stated_error(unit: Units, lens: LensType) -> None:
    north, covered, every, sigma = [], [], [], {5: [], 10: [], 20: []}  # type: ignore[var-annotated]
    for number, when in enumerate((*WHEN, *WHEN)):
        for count in (5, 10, 20):
            truth = unit(20 + number)
            found = posed(first(truth, count, when=when, seed=number), lens)
            assert found.verdict.accepted, found.verdict.reasons
            pixels, covariance = project_with_covariance(found, SKY)
            error = pixels - project(truth, SKY)
            square = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
            covered.append(float(np.nanmean(square < 5.991)))
            north.append(north_error_deg(found, truth) / north_sigma_deg(found))
            sigma[count].append(found.sky_rms_deg)
            every.append(found)
    require_as_stored("first_sightings", *every)
    # 18 draws of one quantity each, and of the sky as a whole; the study has 100 a row
    assert 0.35 < np.mean(np.square(north)) < 1.9
    assert np.abs(north).max() < 4.0
    assert 0.8 < np.mean(covered) < 0.999
    means = [np.mean(sigma[count]) for count in (5, 10, 20)]
    assert 3.0 > means[0] > 1.15 * means[1] > 1.15 * means[2] > 0.2


def test_the_verdict_tells_the_north_and_how_sure_it_is(unit: Units, lens: LensType) -> None:
    truth = unit(3)
    found = posed(first(truth, 20), lens)
    finding = next(one for one in found.verdict.findings if one.code == "first_pose")
    assert finding.data["n"] == 20
    assert finding.data["north_sigma_deg"] == pytest.approx(north_sigma_deg(found))
    off = (float(finding.data["top_azimuth_deg"]) - top_azimuth_deg(truth) + 180.0) % 360.0 - 180.0
    assert abs(off) < 15.0
    assert found.evidence.options["free"] == "pose"
    assert "lens_prior" in found.evidence.options


def test_a_mirrored_image_is_said_and_not_served(unit: Units, lens: LensType) -> None:
    for number, when in enumerate(WHEN):
        seen = first(replace(unit(number), mirrored=True), 10, when=when)
        found = posed(seen, lens)
        assert not found.verdict.accepted
        assert codes(found)[0] == "first_pose_mirrored"
        require_as_stored(f"mirrored_{when}", found)


def test_a_camera_mounted_the_other_way_round_is_said_and_not_served(unit: Units, lens: LensType) -> None:
    truth = unit(4)
    seen, top = first(truth, 20), top_azimuth_deg(truth)
    wrong = posed(seen, lens, FirstPoseOptions(top_azimuth_deg=(top + 180.0) % 360.0))
    assert codes(wrong)[0] == "north_not_as_mounted"
    assert not wrong.verdict.accepted
    require_as_stored("north_not_as_mounted", wrong)
    assert posed(seen, lens, FirstPoseOptions(top_azimuth_deg=top)).verdict.accepted


def test_another_lens_is_refused(unit: Units, lens: LensType) -> None:
    truth = replace(unit(1), focal_length_px=(680.0, 680.0))
    day = simulate(truth, cadence_s=600.0, sigma_px=0.1)
    points = replace(day.points, sigma_px=np.full(len(day.points), 0.1))
    found = first_pose(points, lens=lens, site=SGP, options=CalibrationOptions())
    assert not found.verdict.accepted
    require_as_stored("another_lens", found)


def test_times_of_another_zone_are_refused(unit: Units, lens: LensType) -> None:
    seen = first(unit(2), 60, when="noon")
    found = posed(replace(seen, points=replace(seen.points, unix_s=seen.points.unix_s - 4.0 * 3600.0)), lens)
    assert not found.verdict.accepted


def test_outliers_do_not_pull(unit: Units, lens: LensType) -> None:
    truth = unit(6)
    seen = first(truth, 20)
    pixels = seen.points.pixels.copy()
    pixels[::5] += 60.0
    found = posed(replace(seen, points=replace(seen.points, pixels=pixels)), lens)
    assert found.left_out is not None
    assert found.left_out.tolist() == [0, 5, 10, 15]
    assert abs(north_error_deg(found, truth)) < 4.0 * north_sigma_deg(found)


def test_three_sightings_are_too_few(unit: Units, lens: LensType) -> None:
    assert codes(posed(first(unit(0), 3), lens)) == ["too_few_sightings"]


def test_one_place_for_all_is_no_pose(unit: Units, lens: LensType) -> None:
    seen = first(unit(0), 20)
    still = replace(seen.points, pixels=np.tile(seen.points.pixels[:1], (20, 1)))
    assert not posed(replace(seen, points=still), lens).verdict.accepted


def test_a_day_takes_the_fit_and_an_hour_the_pose(unit: Units, lens: LensType) -> None:
    options = CalibrationOptions(level_within_deg=12.0)
    hour = first(unit(8), 30)
    found = calibrate_with_lens(hour.points, lens=lens, site=SGP, options=options).calibration
    assert "first_pose" in codes(found)
    require_as_stored("an_hour", found)
    day = simulate(unit(8), cadence_s=600.0, sigma_px=0.1)
    whole = calibrate_with_lens(day.points, lens=lens, site=SGP, options=options).calibration
    assert codes(whole)[-1] == "lens_prior_used"
    assert "first_pose" not in codes(whole)
    assert whole.sky_rms_deg < 0.3 * found.sky_rms_deg


def test_a_level_camera_looks_at_the_zenith_and_its_top_at_the_azimuth(lens: LensType) -> None:
    ideal = replace(lens.camera, radial=(0.0,) * 8, decentering=(0.0,) * 4, skew_px=0.0)
    for azimuth in (0.0, 75.0, 200.0, 310.0):
        camera = level(ideal, np.radians(azimuth))
        assert rotation_matrix(camera.rotation_cam_enu)[2] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
        assert np.cos(np.radians(top_azimuth_deg(camera) - azimuth)) == pytest.approx(1.0, abs=1e-12)
        assert np.linalg.norm(levelling(camera)) < 1e-9
        assert rotation_matrix(camera.rotation_cam_enu) @ [0.0, 0.0, 1.0] == pytest.approx([0.0, 0.0, 1.0])
        # left and right exchanged, and the axis beside the middle: the top of the picture is above the axis still
        x, y = ideal.principal_point_px
        off = replace(camera, principal_point_px=(x + 40.0, y), mirrored=True)
        middle = project(off, rotation_matrix(off.rotation_cam_enu)[2])
        east, north, _ = unproject(off, middle - [0.0, 0.5 * off.focal_length_px[1]])
        assert np.cos(np.radians(top_azimuth_deg(off)) - np.arctan2(east, north)) == pytest.approx(1.0, abs=1e-9)
    # north at the top: east is at the left of an image of the sky
    east = project(level(ideal, 0.0), np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0))
    assert east[0] < ideal.principal_point_px[0] - 100.0


@pytest.mark.parametrize("options", [{"tilt_deg": 0.0}, {"tilt_deg": 16.0}, {"top_azimuth_deg": 400.0}])
def test_options_are_bounded(options: dict[str, float]) -> None:
    with pytest.raises(InputError) as refused:
        FirstPoseOptions(**options)
    assert refused.value.field == f"first_pose.{next(iter(options))}"
