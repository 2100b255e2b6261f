"""A fit is refused for a scatter beyond the limit, and beyond what its sightings state."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import population as pop
import pytest
from tests.fixtures.calibration import SGP, filtered_sightings, small_camera, stated_calibration, sun_arc
from tests.fixtures.finding_codes import codes

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Filtering, Sightings, filter_sightings
from sunarc.calibration.verdict import before_fit, fit_verdict
from sunarc.optics.pose import rotation_matrix, rotation_vector

NOON = 1_368_469_800.0  # 2013-05-13T18:30:00Z


@pytest.mark.parametrize(
    ("rmse_px", "stated_px", "refused"),
    [
        (2.9, np.nan, False),
        (3.1, np.nan, True),
        (3.1, 0.5, True),  # nothing states a scatter of 3 px
        (4.2, 3.0, False),  # 3 px an axis are an RMSE of 4.2 px
        (6.2, 3.0, False),
        (6.6, 3.0, True),
    ],
)
def test_a_scatter_is_refused_beyond_the_limit_and_what_is_stated(
    rmse_px: float,
    stated_px: float,
    refused: bool,  # noqa: FBT001
) -> None:
    arc = sun_arc(40)
    usable = replace(
        filtered_sightings(NOON + 60.0 * np.arange(40.0), np.zeros((40, 2)), arc),
        filtering=Filtering(stated_sigma_px=stated_px),
    )
    calibration = stated_calibration(small_camera())
    calibration = replace(
        calibration,
        metrics=replace(calibration.metrics, rmse_px=rmse_px),
        evidence=replace(calibration.evidence, n_used=40),
    )
    verdict = fit_verdict(calibration, usable, CalibrationOptions())
    assert ("rmse_too_large" in codes(verdict.findings)) is refused


@pytest.mark.parametrize(("rmse_px", "said_px"), [(700.0, 700.0), (1e7, math.hypot(640.0, 480.0))])
def test_no_distance_of_a_refusal_is_larger_than_the_image(rmse_px: float, said_px: float) -> None:
    usable = filtered_sightings(NOON + 60.0 * np.arange(40.0), np.zeros((40, 2)), sun_arc(40))
    calibration = stated_calibration(small_camera())
    held_out = {"n": 20, "rmse_px": rmse_px, "stated_px": 3.0, "excess": 9.0, "turned": 0.0, "turn_deg": 0.0}
    calibration = replace(
        calibration,
        metrics=replace(calibration.metrics, rmse_px=rmse_px),
        evidence=replace(calibration.evidence, n_used=40, held_out=held_out),
    )
    found = {one.code: one.data for one in fit_verdict(calibration, usable, CalibrationOptions()).findings}
    for code in ("rmse_too_large", "held_out_contradicts"):
        assert found[code]["rmse_px"] == pytest.approx(said_px)
    assert found["held_out_contradicts"]["stated_px"] == 3.0


def test_the_stated_sigma_is_its_root_mean_square() -> None:
    times = NOON + 60.0 * np.arange(4.0)
    pixels = np.arange(8.0).reshape(4, 2) * 30.0
    stated = np.array([3.0, 4.0, np.nan, 5.0])
    usable = filter_sightings(Sightings.of(unix_s=times, pixels=pixels, sigma_px=stated), site=SGP)
    assert usable.filtering.stated_sigma_px == pytest.approx(np.sqrt((9.0 + 16.0 + 25.0) / 3.0))
    assert np.isnan(filter_sightings(Sightings.of(unix_s=times, pixels=pixels), site=SGP).filtering.stated_sigma_px)


def test_a_sigma_that_cannot_be_computed_is_said_to_be_unknown() -> None:
    usable = filtered_sightings(NOON + 60.0 * np.arange(40.0), np.zeros((40, 2)), sun_arc(40))
    calibration = stated_calibration(small_camera())
    calibration = replace(
        calibration, sky_rms_deg=float("nan"), evidence=replace(calibration.evidence, n_used=40, days=())
    )
    verdict = fit_verdict(calibration, usable, CalibrationOptions())
    assert not verdict.accepted
    assert "direction_sigma_unknown" in codes(verdict.findings)
    assert "direction_sigma_too_large" not in codes(verdict.findings)


@pytest.mark.parametrize(
    ("range_deg", "around_deg", "free", "refused"),
    [
        (2.0, 359.0, "all", True),
        (2.0, 100.0, "all", True),
        (2.0, 80.0, "all", False),
        (4.0, 359.0, "all", False),
        (2.0, 359.0, "pose", False),  # the lens is known
    ],
)
def test_sightings_of_one_radius_are_refused_where_the_lens_is_sought(
    range_deg: float, around_deg: float, free: str, *, refused: bool
) -> None:
    camera = small_camera()
    theta = np.radians(40.0 + range_deg * (np.arange(50) % 7) / 6.0)
    azimuth = np.radians(np.linspace(10.0, 10.0 + around_deg, 50))
    rays = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
    seen = filtered_sightings(
        NOON + 60.0 * np.arange(50.0), np.zeros((50, 2)), rays @ rotation_matrix(camera.rotation_cam_enu)
    )
    calibration = stated_calibration(camera)
    evidence = replace(calibration.evidence, n_used=50, options={"free": free})
    verdict = fit_verdict(replace(calibration, evidence=evidence), seen, CalibrationOptions())
    assert ("sightings_of_one_radius" in codes(verdict.findings)) is refused
    assert not (refused and verdict.accepted)


@pytest.mark.parametrize(
    ("arc_deg", "days", "refused"), [(9.8, 1, True), (10.2, 1, False), (4.9, 2, True), (5.1, 2, False)]
)
def test_arcs_of_several_days_count_together_and_gaps_between_them_do_not(
    arc_deg: float, days: int, *, refused: bool
) -> None:
    angle = np.radians(np.linspace(0.0, arc_deg, 21))
    arc = np.stack([np.sin(angle), np.zeros(21), np.cos(angle)], axis=-1)
    rays = np.concatenate([arc, -arc[:, [1, 0, 2]]])[: 21 * days]  # the second day's far from the first one's
    day = np.repeat(np.arange(days), 21)
    times = NOON + 60.0 * np.arange(21.0 * days) + 86400.0 * day
    seen = filtered_sightings(times, np.arange(42.0 * days).reshape(-1, 2) * 20.0, rays, day=day)
    found = before_fit(seen, CalibrationOptions())
    assert ("arc_too_short" in codes(found)) is refused
    if refused:
        assert {one.code: one for one in found}["arc_too_short"].data["arc_deg"] == pytest.approx(arc_deg * days)


@pytest.mark.parametrize(("share", "refused"), [(0.5, True), (0.35, True), (0.15, False)])
def test_rows_of_two_cameras_are_not_fitted_as_one(share: float, *, refused: bool) -> None:
    rng = np.random.default_rng(4)
    camera = pop.random_camera(rng)
    turn = rotation_matrix((0.0, 0.0, math.radians(0.5)))
    other = replace(camera, rotation_cam_enu=rotation_vector(rotation_matrix(camera.rotation_cam_enu) @ turn))
    times = pop.sun_track(np.zeros(1), cadence_s=60.0)
    noise = pop.white_noise(rng, times.size, 0.2)
    own, others = (pop.sightings(one, times, noise) for one in (camera, other))
    mixed = replace(own, pixels=np.where((rng.random(times.size) < share)[:, None], others.pixels, own.pixels))
    options = CalibrationOptions(projection="equisolid")
    found = calibrate(mixed, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE), options=options)
    assert found.verdict.accepted != refused, found.verdict.reasons
    assert ("epoch_does_not_explain_its_days" in codes(found.verdict.findings)) == refused
    assert "half_days_deviate" not in codes(found.verdict.findings)  # row by row: there are none
