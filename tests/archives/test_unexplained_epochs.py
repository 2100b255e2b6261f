"""An epoch of two lenses is split or refused, where the search for states took it for one; one of one lens is not.

The sightings are made by a formula of the projection that is written here, and by nothing of the simulator.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fixtures.finding_codes import codes

from sunarc.archives.fit import (
    CameraSightings,
    FittedPose,
    assign_lenses,
    final_analysis,
    first_analysis,
    kept_provisional,
)
from sunarc.archives.states import ArchiveCamera, Epoch, State, alternation, surely_held
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.epoch_changes import EpochCause, agreeing_days, change_within, estimate_daily_noise, is_lens_change
from sunarc.common.array_types import FloatArray, stacked
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

SITE = Site(latitude=47.1, longitude=8.4, altitude=500.0)
SIZE = (640, 600)
CODE = "epoch_does_not_explain_its_days"
FIRST, SECOND = 168.0, 181.5
"""px/rad of a lens, and of the one that it was changed for."""
START = 17_361 * 86_400.0
OPTIONS = CalibrationOptions(mirrored="yes", projection="equidistant")
UNJUDGED = CalibrationOptions(mirrored="yes", projection="equidistant", max_unexplained=1.0)


def equidistant(times: FloatArray, focal: FloatArray, *, turn_deg: float) -> FloatArray:
    """Return where the sun is in images of an equidistant lens that looks up, (n, 2) px."""
    angles = sun_angles(times, SITE)
    zenith, azimuth = np.radians(angles.apparent_zenith), np.radians(angles.azimuth - turn_deg)
    return np.stack([322.0 + focal * zenith * np.sin(azimuth), 297.0 - focal * zenith * np.cos(azimuth)], axis=-1)


def archive(
    seed: int, *, days: int, per_day: int, first_share: float, second: float = SECOND, sigma_px: float = 0.6
) -> Sightings:
    """Return sightings of every third day, the lens being changed after a share of them."""
    rng = np.random.default_rng(seed)
    times = []
    for day in range(days):
        noon = START + 86_400.0 * 3 * day + 43_200.0 - SITE.longitude * 240.0
        of_day = noon + np.arange(-21_600.0, 21_600.0, 300.0)
        of_day = of_day[sun_angles(of_day, SITE).apparent_zenith < 82.0]
        times.append(np.sort(rng.choice(of_day, per_day, replace=False)))
    unix_s = np.concatenate(times)
    focal = np.where(np.arange(unix_s.size) < round(first_share * unix_s.size), FIRST, second)
    pixels = equidistant(unix_s, focal, turn_deg=float(rng.uniform(0.0, 360.0)))
    noise = rng.normal(0.0, sigma_px, pixels.shape)
    return Sightings.of(unix_s=unix_s, pixels=pixels + noise, sigma_px=np.full(unix_s.size, sigma_px))


def fitted(points: Sightings, options: CalibrationOptions = OPTIONS) -> Calibration:
    return calibrate(points, site=SITE, image_size=SIZE, options=options)


@pytest.mark.parametrize(
    ("days", "per_day", "first_share"), [(14, 4, 0.35), (14, 4, 0.65), (7, 8, 0.35), (4, 14, 0.65), (6, 40, 0.34)]
)
def test_an_epoch_of_two_lenses_is_refused(days: int, per_day: int, first_share: float) -> None:
    points = archive(0, days=days, per_day=per_day, first_share=first_share)
    assert fitted(points, UNJUDGED).verdict.accepted
    verdict = fitted(points).verdict
    assert not verdict.accepted
    assert CODE in codes(verdict.findings)


@pytest.mark.parametrize(("days", "per_day"), [(3, 16), (10, 26), (4, 40)])
def test_suns_at_the_edges_of_clouds_do_not_refuse_an_epoch(days: int, per_day: int) -> None:
    """A third of the sightings lie 2 to 3 px off, each half-hour in a direction of its own."""
    points = archive(3, days=days, per_day=per_day, first_share=1.0, sigma_px=0.15)
    block, rng = np.floor(points.unix_s / 1800.0), np.random.default_rng(5)
    way = rng.uniform(0.0, 2.0 * np.pi, 10_000)[(block - block[0]).astype(np.int64)]
    aside = rng.uniform(2.0, 3.0, len(points))[:, None] * np.stack([np.cos(way), np.sin(way)], axis=-1)
    aside[(block % 3 != 0) | (rng.random(len(points)) < 0.1)] = 0.0
    cloudy = replace(points, pixels=points.pixels + aside)
    found = fitted(cloudy)
    assert found.left_out is not None
    assert len(found.left_out) > 0.25 * len(points)
    assert CODE not in codes(found.verdict.findings)


@pytest.mark.parametrize(("days", "per_day"), [(14, 4), (7, 8), (4, 14), (2, 90)])
def test_an_epoch_of_one_lens_is_not(days: int, per_day: int) -> None:
    points = archive(1, days=days, per_day=per_day, first_share=1.0)
    assert not {CODE, "half_days_deviate"} & set(codes(fitted(points).verdict.findings))


def test_a_half_day_of_another_lens_is_found_though_it_is_a_tenth_of_the_sightings() -> None:
    points = archive(2, days=5, per_day=100, first_share=0.9)
    findings = fitted(points).verdict.findings
    assert CODE not in codes(findings)  # a tenth is left out at most
    (found,) = [one for one in findings if one.code == "half_days_deviate"]
    assert (found.data["n_far"], found.data["n_half_days"]) == (1, 10)


def test_days_of_false_sightings_do_not_count_against_a_fit() -> None:
    clear = archive(3, days=4, per_day=60, first_share=1.0)
    rng = np.random.default_rng(0)
    false = rng.random(60) < 0.9
    pixels = clear.pixels.copy()
    pixels[:60][false] = rng.uniform(100.0, 500.0, (int(false.sum()), 2))
    pixels[60:120][false] = rng.uniform(100.0, 500.0, (int(false.sum()), 2))
    of_clouds = Sightings.of(unix_s=clear.unix_s, pixels=pixels, sigma_px=clear.sigma_px)
    fit = fitted(of_clouds)
    assert fit.evidence.n_used < 0.65 * len(of_clouds)
    assert fit.verdict.accepted, fit.verdict.reasons


def test_a_state_that_was_taken_for_two_lenses_is_split_between_them() -> None:
    points = archive(0, days=14, per_day=4, first_share=0.35)
    camera = ArchiveCamera(SITE, SIZE, OPTIONS)
    state = State(fitted(points, UNJUDGED), lens=0, pose=0, clock_offset_s=0.0, sigma_px=0.6)
    final = final_analysis(CameraSightings(points, camera, (state,)))
    assert [(one.cause, one.first, one.last) for one in final.epochs] == [("start", 0, 19), ("lens", 20, 55)]
    for epoch, focal in zip(final.epochs, (FIRST, SECOND), strict=True):
        fit = final.fitted[final.states[epoch.state].pose].calibration
        sigma = float(np.sqrt(fit.covariance[0, 0]))
        assert abs(fit.camera.focal_length_px[0] - focal) < 3.0 * max(sigma, 0.5)


def test_an_epoch_of_one_lens_is_not_split() -> None:
    points = archive(1, days=14, per_day=8, first_share=1.0)
    camera = ArchiveCamera(SITE, SIZE, OPTIONS)
    state = State(fitted(points), lens=0, pose=0, clock_offset_s=0.0, sigma_px=0.6)
    final = final_analysis(CameraSightings(points, camera, (state,)))
    assert [(one.first, one.last) for one in final.epochs] == [(0, len(points) - 1)]
    assert final.fitted[0].calibration.verdict.accepted


@pytest.mark.parametrize(
    ("scale", "turn_deg", "of_lens"), [(1.0, 0.6, False), (1.0, 3.0, False), (0.988, 0.6, True), (1.012, 3.0, True)]
)
def test_a_change_of_scale_is_told_from_a_turn_though_one_camera_was_fitted_to_both(
    *, scale: float, turn_deg: float, of_lens: bool
) -> None:
    before = archive(5, days=5, per_day=25, first_share=1.0, sigma_px=0.4)
    camera = fitted(before).camera
    pose = Rotation.from_euler("xy", [turn_deg, -turn_deg], degrees=True) * Rotation.from_rotvec(
        camera.rotation_cam_enu
    )
    after_focal, between = camera.focal_length_px[0] * scale, camera.focal_length_px[0] * (1.0 + scale) / 2.0
    turned = replace(camera, rotation_cam_enu=tuple(pose.as_rotvec().tolist()))
    true = replace(turned, focal_length_px=(after_focal, after_focal))
    later = replace(before, unix_s=before.unix_s + 16 * 86_400.0)
    noise = np.random.default_rng(6).normal(0.0, 0.4, later.pixels.shape)
    later = replace(later, pixels=project(true, sun_directions(later.unix_s, SITE)) + noise)
    first, second = (
        (points, replace(of, focal_length_px=(between, between)), estimate_daily_noise(points, SITE))
        for points, of in ((before, camera), (later, turned))
    )
    assert is_lens_change((first, second), SITE) is of_lens


@pytest.mark.parametrize(("scale", "said"), [(1.0, (0, 0)), (1.0, (0, 1)), (1.03, (0, 0)), (1.03, (0, 1))])
def test_lenses_are_those_of_the_evidence_whatever_the_search_took_them_for(
    scale: float, said: tuple[int, int]
) -> None:
    points = archive(8, days=6, per_day=30, first_share=0.5, second=scale * FIRST, sigma_px=0.3)
    late = np.arange(len(points)) >= len(points) // 2
    center = np.array([322.0, 297.0])
    turned = center + (points.pixels - center) @ Rotation.from_euler("z", 2.0, degrees=True).as_matrix()[:2, :2]
    points = replace(points, pixels=np.where(late[:, None], turned, points.pixels))
    rows = [np.flatnonzero(late == side) for side in (False, True)]
    fits = {pose: FittedPose(fitted(points.select(of)), of) for pose, of in enumerate(rows)}
    states = [
        State(one.calibration, lens=said[pose], pose=pose, clock_offset_s=0.0, sigma_px=0.3)
        for pose, one in fits.items()
    ]
    named = assign_lenses(points, late.astype(np.int64), states, fits, ArchiveCamera(SITE, SIZE, OPTIONS))
    assert (named[0].lens == named[1].lens) is (scale == 1.0)


@pytest.mark.parametrize(("second", "certain"), [(FIRST * 1.004, False), (SECOND, True)])
def test_an_epoch_ends_where_its_state_is_told_from_the_next(*, second: float, certain: bool) -> None:
    points = archive(7, days=6, per_day=20, first_share=0.5, second=second, sigma_px=0.3)
    calibration = fitted(archive(7, days=6, per_day=20, first_share=1.0, sigma_px=0.3))
    share = second / FIRST
    focal = (share * calibration.camera.focal_length_px[0], share * calibration.camera.focal_length_px[1])
    other = replace(calibration, camera=replace(calibration.camera, focal_length_px=focal))
    states = [
        State(one, lens=n, pose=n, clock_offset_s=0.0, sigma_px=0.3) for n, one in enumerate((calibration, other))
    ]
    times, last = points.unix_s.tolist(), len(points) - 1
    for late in (0, 2):  # the change is said to be some sightings late
        ends = ((0, 59 + late), (60 + late, last))
        causes: tuple[EpochCause, EpochCause] = ("start", "lens")
        epochs = [Epoch(n, causes[n], a, b, times[a], times[b]) for n, (a, b) in enumerate(ends)]
        before, after = surely_held(epochs, points, states, ArchiveCamera(SITE, SIZE, OPTIONS))
        assert times[0] <= before.end_unix_s <= times[59]
        assert times[60] <= after.start_unix_s <= times[last]
        assert (before.end_unix_s >= times[57] and after.start_unix_s <= times[62]) is certain
        assert (before.start_unix_s, after.end_unix_s) == (times[0], times[last])


def test_a_few_suns_of_a_morning_have_an_epoch_that_may_be_kept_as_provisional() -> None:
    of_day = archive(8, days=1, per_day=60, first_share=1.0, sigma_px=0.5)
    points = of_day.select(np.flatnonzero(sun_angles(of_day.unix_s, SITE).azimuth < 180.0)[:22])
    camera = ArchiveCamera(SITE, SIZE, replace(OPTIONS, max_sky_deg=0.5))
    given = CameraSightings(points, camera)
    final = final_analysis(given._replace(states=first_analysis(given).states))
    (fit,) = (one.calibration for one in final.fitted.values())
    assert "sightings_determine" in codes(fit.verdict.findings)
    (kept,) = (one.calibration for one in kept_provisional(final, camera).fitted.values())
    assert (kept.verdict.accepted, kept.verdict.marginal, kept.sigma_limit_deg) == (False, True, 0.5)


@pytest.mark.parametrize(
    ("until_deg", "level_within_deg", "doubted"), [(180.0, None, True), (180.0, 20.0, False), (360.0, None, True)]
)
def test_a_tilt_that_nobody_stated_is_doubted_by_a_morning_and_by_a_day(
    until_deg: float, level_within_deg: float | None, *, doubted: bool
) -> None:
    """A latitude that is wrong by 7 degrees is a camera that is tilted by as much."""
    of_day = archive(8, days=1, per_day=60, first_share=1.0, sigma_px=0.5)
    points = of_day.select(np.flatnonzero(sun_angles(of_day.unix_s, SITE).azimuth < until_deg))
    camera = ArchiveCamera(
        replace(SITE, latitude=SITE.latitude - 7.0), SIZE, replace(OPTIONS, level_within_deg=level_within_deg)
    )
    given = CameraSightings(points, camera)
    final = final_analysis(given._replace(states=first_analysis(given).states))
    (fit,) = (one.calibration for one in final.fitted.values())
    assert fit.verdict.accepted is not doubted
    assert ("tilt_in_doubt" in codes(fit.verdict.findings)) is doubted


@pytest.mark.parametrize(("turn_deg", "cause"), [(0.0, "start"), (0.4, "moved")])
def test_a_small_turn_is_found_by_the_noise_of_the_days(turn_deg: float, cause: str) -> None:
    points = archive(4, days=8, per_day=20, first_share=1.0, sigma_px=0.3)
    camera = fitted(points).camera
    late = np.arange(len(points)) >= 75
    directions = sun_directions(points.unix_s, SITE)
    turned = Rotation.from_euler("xy", [turn_deg, -turn_deg], degrees=True).apply(directions)
    shift = project(camera, turned) - project(camera, directions)
    moved = replace(points, pixels=points.pixels + np.where(late[:, None], shift, 0.0))
    found = change_within(moved, camera, SITE, estimate_daily_noise(moved, SITE))
    assert (cause if found is None else found.cause) == cause
    assert found is None or abs(int(np.searchsorted(moved.unix_s, found.time)) - 75) <= 2


def test_days_that_agree_are_the_longest_run_of_those_by_the_camera() -> None:
    points = archive(5, days=8, per_day=20, first_share=1.0, sigma_px=0.3)
    noise = estimate_daily_noise(points, SITE)
    assert np.median(noise) == pytest.approx(0.3, rel=0.35)
    residual = np.random.default_rng(0).normal(0.0, 0.3, points.pixels.shape)
    residual[40:60] += (3.0, 0.0)
    longest, shorter = agreeing_days(residual, noise, points.unix_s, SITE)
    assert (longest[0], longest[-1], longest.size) == (60, 159, 100)
    assert (shorter[0], shorter[-1]) == (0, 39)


def test_images_of_two_cameras_under_one_name_are_said_to_be_that() -> None:
    each = [archive(seed, days=6, per_day=20, first_share=1.0, sigma_px=0.3) for seed in (6, 7)]
    mixed = stacked(each)
    mixed = mixed.select(np.argsort(mixed.unix_s, kind="stable"))
    camera = ArchiveCamera(SITE, SIZE, OPTIONS)
    states = [State(fitted(one), lens=n, pose=n, clock_offset_s=0.0, sigma_px=0.3) for n, one in enumerate(each)]
    found = alternation(mixed, states, camera)
    assert found is not None
    assert found.code == "sightings_alternate"
    assert 60 < int(found.data["changes"]) < int(found.data["n"]) <= 234
    for one in each:
        assert alternation(one, states, camera) is None
    rough = first_analysis(CameraSightings(mixed, camera, tuple(states)))
    assert (rough.states, [one.code for one in rough.findings]) == ((), ["sightings_alternate"])


def test_two_lenses_one_after_the_other_are_two_epochs() -> None:
    points = archive(6, days=8, per_day=20, first_share=0.43, sigma_px=0.3)
    rough = first_analysis(CameraSightings(points, ArchiveCamera(SITE, SIZE, OPTIONS)))
    assert [one.cause for one in rough.epochs] == ["start", "lens"]
    assert rough.findings == ()


@pytest.mark.parametrize("count", [0, 1, 8, 16, 17, 20])
def test_few_sightings_have_no_change_within(count: int) -> None:
    points = archive(8, days=1, per_day=20, first_share=1.0)
    camera = fitted(archive(8, days=3, per_day=40, first_share=1.0)).camera
    some = points.select(slice(0, count))
    noise = np.full(count, 0.6)
    found = change_within(some, camera, SITE, noise)
    assert found is None or 8 <= int(np.searchsorted(some.unix_s, found.time)) <= count - 8


@pytest.mark.parametrize("count", [16, 24, 48, 120])
@pytest.mark.parametrize("sigma_px", [0.3, 5.0])
def test_few_sightings_of_a_day_show_its_noise_too(count: int, sigma_px: float) -> None:
    times = START + 6.0 * 3600.0 + np.linspace(0.0, 9.0 * 3600.0, count)
    true = equidistant(times, np.full(count, FIRST), turn_deg=20.0)
    found = []
    for seed in range(20):
        noise = sigma_px * np.random.default_rng(seed).standard_normal((count, 2))
        found.append(float(np.median(estimate_daily_noise(Sightings.of(unix_s=times, pixels=true + noise), SITE))))
    assert 0.75 * sigma_px < float(np.median(found)) < 1.25 * sigma_px
    assert min(found) > 0.3 * sigma_px


@pytest.mark.parametrize("per_day", [5, 8])
@pytest.mark.parametrize("sigma_px", [0.1, 0.5])
def test_days_of_few_sightings_show_their_noise_together(per_day: int, sigma_px: float) -> None:
    noon = START + 11.0 * 3600.0
    times = np.concatenate(
        [noon + 86_400.0 * day + 3600.0 * np.linspace(-4.0, 4.0, per_day) for day in range(-(-50 // per_day))]
    )
    true = equidistant(times, np.full(times.size, FIRST), turn_deg=20.0)
    found = []
    for seed in range(20):
        pixels = true + sigma_px * np.random.default_rng(seed).standard_normal((times.size, 2))
        found.append(float(np.median(estimate_daily_noise(Sightings.of(unix_s=times, pixels=pixels), SITE))))
    assert 0.7 * sigma_px < float(np.median(found)) < 1.3 * sigma_px
    few = Sightings.of(unix_s=times[:20], pixels=true[:20])
    assert np.all(estimate_daily_noise(few, SITE) == 1.0)
