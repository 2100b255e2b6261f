"""A day's fit with its type of lens: better and honest where the type is right, refused or left out where it is not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.clear_day import SGP

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.lens_library import conditioning
from sunarc.calibration.lens_library.conditioning import (
    LENS_MISFIT_PX,
    apply_lens_prior,
    conditioned_lens,
    is_met_as_well,
)
from sunarc.calibration.lens_library.lens_type import (
    LensType,
    UnitSpread,
    infer_prior_precision,
    lens_frame,
    lens_gaussian,
    sighting_information,
)
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.common.errors import InputError
from sunarc.imager.commands.calibrate_archive import reproduce_calibration
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project

if TYPE_CHECKING:
    from tests.fixtures.lens_types import Fitted, Units

SKY = hemisphere(300)
OPTIONS = CalibrationOptions(level_within_deg=15.0)


def error_px(found: Calibration, truth: Camera) -> tuple[float, float]:
    """Return the RMS error over the sky, px, and the share of it within the stated 95 %."""
    pixels, covariance = project_with_covariance(found, SKY)
    error = pixels - project(truth, SKY)
    square = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=-1)))), float(np.nanmean(square < 5.991))


def test_a_part_of_a_day_is_better_with_the_type_and_its_errors_as_stated(
    fitted: Fitted, unit: Units, lens: LensType
) -> None:
    rows = []
    for number in range(3):
        points = fitted(number)[0]
        half = points.select(slice(0, len(points) // 2))
        alone = calibrate(half, site=SGP, image_size=(1748, 1748), options=OPTIONS)
        found = apply_lens_prior(alone, lens, points=half, options=OPTIONS)
        assert found.verdict.accepted == alone.verdict.accepted
        assert found.sky_rms_deg < alone.sky_rms_deg
        rows.append([error_px(alone, unit(number))[0], *error_px(found, unit(number))])
    before, after, covered = np.array(rows).T
    # of 16 units the ratio is 0.98: a half-day of a unit alone is nearly as good
    assert 0.1 < np.median(after) / np.median(before) < 1.1
    assert 0.8 < np.mean(covered) <= 1.0


def test_the_lens_is_the_product_of_sightings_and_type(fitted: Fitted, lens: LensType) -> None:
    calibration = fitted(1)[1]
    frame, prior = lens.frame, lens.in_frame()
    known = sighting_information(lens_gaussian(calibration, frame), calibration.evidence.radial_px)
    covariance = np.linalg.inv(known.matrix + np.linalg.inv(prior.covariance))
    found = apply_lens_prior(calibration, lens, points=fitted(1)[0], options=OPTIONS)
    assert lens_gaussian(found, frame).covariance == pytest.approx(covariance, abs=1e-5)
    to = conditioned_lens(calibration, lens).lens
    changed = conditioning.moved_to_lens(calibration, lens, to, OPTIONS)
    assert frame.whitened(changed.camera) == pytest.approx(to.mean, abs=1e-6)
    sigma = np.sqrt(np.diag(to.covariance))
    assert np.abs((frame.whitened(found.camera) - to.mean) / sigma).max() < 1.0  # solved again, not linearised
    assert found.evidence.options["lens_prior"] == lens.as_evidence()


def test_a_type_that_says_nothing_changes_nothing(fitted: Fitted, lens: LensType) -> None:
    points, calibration = fitted(1)
    frame = lens_frame(lens.camera)
    precision = infer_prior_precision(lens_gaussian(calibration, frame), calibration.evidence.radial_px) + 1e-8
    vague = replace(lens, covariance=frame.basis @ np.diag(1.0 / precision) @ frame.basis.T)
    centred = replace(vague, camera=replace(lens.camera, radial=(0.0,) * 8, decentering=(0.0,) * 4, skew_px=0.0))
    found = apply_lens_prior(calibration, centred, points=points, options=OPTIONS)
    moved = project(found.camera, SKY) - project(calibration.camera, SKY)
    assert np.sqrt(np.nanmean(moved**2)) < 0.06
    assert found.sky_rms_deg == pytest.approx(calibration.sky_rms_deg, rel=0.15)


def test_information_adds_the_prior_back_to_the_posterior(fitted: Fitted, lens: LensType) -> None:
    calibration = fitted(2)[1]
    posterior = lens_gaussian(calibration, lens.frame)
    precision = infer_prior_precision(posterior, calibration.evidence.radial_px)
    known = sighting_information(posterior, calibration.evidence.radial_px)
    assert np.linalg.eigvalsh(known.matrix)[0] > -1e-6
    again = np.linalg.inv(known.matrix + np.diag(precision + 1e-9))
    assert np.sqrt(np.diag(again)) == pytest.approx(np.sqrt(np.diag(posterior.covariance)), rel=0.15)


def test_another_lens_is_refused_with_its_size(fitted: Fitted, lens: LensType) -> None:
    points, calibration = fitted(0)
    other = replace(lens, camera=replace(lens.camera, focal_length_px=(630.0, 630.0)))
    found = apply_lens_prior(calibration, other, points=points, options=OPTIONS)
    finding = found.verdict.findings[0]
    assert not found.verdict.accepted
    assert finding.code == "lens_prior_contradicted"
    assert finding.data["part"] == "focal length"
    assert float(finding.data["departure"]) > float(finding.data["limit"]) > 1.0
    assert apply_lens_prior(calibration, lens, points=points, options=OPTIONS).verdict.accepted


def test_a_type_that_makes_a_good_fit_worse_is_left_out(
    fitted: Fitted, lens: LensType, monkeypatch: pytest.MonkeyPatch
) -> None:
    points, calibration = fitted(0)
    shifted = conditioned_lens(calibration, lens)
    away = shifted.lens._replace(mean=shifted.lens.mean + np.r_[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, np.zeros(11)])
    monkeypatch.setattr(conditioning, "conditioned_lens", lambda *_: shifted._replace(lens=away))
    far = replace(calibration.camera, focal_length_px=(605.0, 605.0))
    monkeypatch.setattr(conditioning, "_most_probable", lambda *_: far)
    found = apply_lens_prior(calibration, lens, points=points, options=OPTIONS)
    assert found.verdict.accepted
    assert found.verdict.findings[-1].code == "lens_prior_left_out"
    assert found.camera == calibration.camera


def test_it_is_not_solved_again_without_its_type(fitted: Fitted, lens: LensType) -> None:
    points, calibration = fitted(0)
    found = apply_lens_prior(calibration, lens, points=points, options=OPTIONS)
    with pytest.raises(InputError) as refused:
        reproduce_calibration(found, points)
    assert refused.value.field == "evidence.options.lens_prior"


def test_the_default_spread_is_wider_than_the_stated_one() -> None:
    assert np.all(UnitSpread().scales(600.0) >= UnitSpread(focal_length=0.003, center_px=8.0).scales(600.0))


def test_without_a_field_a_camera_meets_sightings_as_well_within_the_ratio_alone() -> None:
    distance = np.abs(np.random.default_rng(1).normal(0.0, 0.2, 500))
    assert is_met_as_well(distance, distance, sigma=0.2, field_px=0.0, ratio=1.02)
    assert is_met_as_well(0.5 * distance, distance, sigma=0.2, field_px=0.0, ratio=1.02)
    assert not is_met_as_well(1.1 * distance, distance, sigma=0.2, field_px=0.0, ratio=1.02)


@pytest.mark.parametrize(("missed", "reached"), [(1.6, True), (3.0, False)])
def test_a_proven_field_lets_the_camera_miss_by_twice_as_much(missed: float, *, reached: bool) -> None:
    rng = np.random.default_rng(1)
    noise = rng.normal(0.0, 0.03, (3000, 2))
    distance, off = np.hypot(*noise.T), np.hypot(*(noise + rng.normal(0.0, 0.3 * missed, noise.shape)).T)
    assert is_met_as_well(off, distance, sigma=0.03, field_px=0.3, ratio=1.02) is reached
    assert not is_met_as_well(off, distance, sigma=0.03, field_px=0.0, ratio=1.02)


def test_no_field_lets_the_camera_miss_by_pixels() -> None:
    distance = np.abs(np.random.default_rng(2).normal(0.0, 0.3, 500))
    for field_px in (LENS_MISFIT_PX, 7.0):
        assert is_met_as_well(distance + 1.0, distance, sigma=0.3, field_px=field_px, ratio=1.1)
        assert not is_met_as_well(distance + 3.0, distance, sigma=0.3, field_px=field_px, ratio=1.1)
