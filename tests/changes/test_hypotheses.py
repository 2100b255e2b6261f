"""What changed: hypotheses whose residuals and evidences are known in closed form."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal
from tests.fixtures.calibration import SGP, small_camera, stated_calibration

from sunarc.calibration.answers.error_model import predicted, rotated
from sunarc.calibration.evidence import Weighed, most_probable
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration
from sunarc.changes import online as module
from sunarc.changes.online import (
    ResidualModel,
    best_hypothesis,
    change_details,
    describe_change,
    errors_at,
    make_residual_model,
    rarity,
)
from sunarc.changes.values import ChangeKind, SightingWindow, WatchOptions
from sunarc.common.array_types import picked, stacked
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.site import Site, pole_enu
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]

NOON = 1_368_403_200.0 + 43_200.0 + 97.484856 * 240.0
"""13 May 2013 at SGP."""
N, FIRST = 24, 14
TIMES: FloatArray = NOON + 300.0 * (np.arange(N, dtype=np.float64) - 12.0)
OPTIONS = WatchOptions()


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return stated_calibration(small_camera(), sigma_px=0.05)


@pytest.fixture(scope="module")
def directions() -> FloatArray:
    return np.asarray(sun_directions(TIMES, SGP))


def window(
    calibration: Calibration, directions: FloatArray, pixels: FloatArray, *, trusted: int = FIRST
) -> ResidualModel:
    noise = np.random.default_rng(1).normal(0.0, 0.05, pixels.shape)
    watch = SightingWindow(
        unix_s=TIMES,
        pixels=pixels + noise,
        directions=directions,
        sigma_px=np.full(N, 0.05),
        trusted=np.arange(N) < trusted,
        surprise=np.zeros((N, 2)),
    )
    return make_residual_model(watch, calibration, OPTIONS)


def changed(calibration: Calibration, directions: FloatArray, after: Camera) -> ResidualModel:
    """Return the sightings of a camera that is another one from the 15th sighting on."""
    before = project(calibration.camera, directions)
    pixels = np.where(np.arange(N)[:, None] < FIRST, before, project(after.at_every_angle(), directions))
    return window(calibration, directions, pixels)


def found(
    model: ResidualModel, *, site: Site = SGP, clock_stepped: bool = False, small: bool = False
) -> PoseChange | None:
    return best_hypothesis(model, site=site, small=small, clock_stepped=clock_stepped, posed_from_few=False)


def test_the_pole_stands_at_the_latitude_in_the_north() -> None:
    np.testing.assert_allclose(pole_enu(replace(SGP, latitude=90.0)), [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(pole_enu(replace(SGP, latitude=0.0)), [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(pole_enu(replace(SGP, latitude=-30.0)), [0.0, math.sqrt(0.75), -0.5], atol=1e-12)


@pytest.mark.parametrize("size_deg", [1.0, 3.0, 30.0])
def test_a_rotation_is_a_bump_of_its_size(calibration: Calibration, directions: FloatArray, size_deg: float) -> None:
    turn = np.radians(size_deg) * np.array([0.48, -0.6, 0.64])
    change = found(changed(calibration, directions, rotated(calibration.camera, turn)))
    assert change is not None
    assert (change.cause, change_details(change)["unit"]) == ("bump", "degrees")
    assert change.time == TIMES[FIRST]
    assert change.bracket[0] < change.time <= change.bracket[1]
    assert (change_details(change)["agreeing"], change_details(change)["of"]) == (10, 10)
    assert abs(change_details(change)["size"] - size_deg) < 4.0 * change_details(change)["size_sigma"]
    assert 1e-3 < change_details(change)["size_sigma"] < 0.2 + 0.02 * size_deg
    assert change.gain > 20.0


def test_nothing_that_changed_is_no_change(calibration: Calibration, directions: FloatArray) -> None:
    model = window(calibration, directions, project(calibration.camera, directions))
    assert found(model) is None
    assert found(model, small=True) is None


@pytest.mark.parametrize("seconds", [600.0, -900.0])
def test_a_clock_that_jumped_is_named_with_its_seconds(calibration: Calibration, seconds: float) -> None:
    said = np.asarray(sun_directions(TIMES, SGP))
    true_times = TIMES + np.where(np.arange(N) < FIRST, 0.0, seconds)  # the size is true minus stated time
    pixels = project(calibration.camera, np.asarray(sun_directions(true_times, SGP)))
    change = found(window(calibration, said, pixels), clock_stepped=True)
    assert change is not None
    assert (change.cause, change_details(change)["unit"]) == ("clock", "s")
    assert change_details(change)["size"] == pytest.approx(seconds, abs=4.0 * change_details(change)["size_sigma"])
    assert 1.0 < change_details(change)["size_sigma"] < 40.0


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_image_is_named(calibration: Calibration, directions: FloatArray, axis: int) -> None:
    pixels = project(calibration.camera, directions)
    flipped = pixels.copy()
    flipped[FIRST:, axis] = [639.0, 479.0][axis] - flipped[FIRST:, axis]
    change = found(window(calibration, directions, flipped))
    assert change is not None
    assert change.cause == "mirrored"
    assert (change_details(change)["size"], change_details(change)["size_sigma"]) == (0.0, 0.0)


def test_a_site_of_the_wrong_sign_is_named(calibration: Calibration) -> None:
    """The sightings are those of the true site; the directions are computed for its mirror image."""
    wrong = replace(SGP, latitude=-SGP.latitude)
    said = np.where(np.arange(N)[:, None] < FIRST, sun_directions(TIMES, SGP), sun_directions(TIMES, wrong))
    pixels = project(calibration.camera, np.asarray(sun_directions(TIMES, SGP)))
    change = found(window(calibration, said, pixels), site=wrong)
    assert change is not None
    assert change.cause == "site"


def test_sightings_that_drift_away_are_no_change(calibration: Calibration, directions: FloatArray) -> None:
    drift = np.clip(np.arange(N) - FIRST + 1, 0, None)[:, None] ** 1.5 * np.array([0.1, 0.05])
    model = window(calibration, directions, project(calibration.camera, directions) + drift)
    change = found(model)
    assert change is None or change.cause == "bump"


def test_too_few_that_agree_are_no_change(calibration: Calibration, directions: FloatArray) -> None:
    turn = np.radians([1.0, 0.0, 0.0])
    pixels = project(calibration.camera, directions)
    pixels[-3:] = project(rotated(calibration.camera, turn), directions[-3:])
    assert found(window(calibration, directions, pixels, trusted=N - 3)) is None


def test_the_evidence_of_a_rotation_is_the_gaussian_integral_over_it(
    calibration: Calibration, directions: FloatArray
) -> None:
    """The rotation's free numbers are marginalised: the density of all residuals under the widened covariance."""
    turn = np.radians([0.3, -0.2, 0.1])
    model = changed(calibration, directions, rotated(calibration.camera, turn))
    scored = module.rotation_from(model, FIRST, least=4)
    assert scored is not None
    assert np.all(scored.mixture.inlier)
    of = scored.of
    after = predicted(model.error_model, of.camera, of.sightings.directions)
    residual = model.sightings.residual.copy()
    residual[FIRST:] = of.sightings.pixels - after.pixels - after.rows @ of.mean
    at = stacked([picked(model.at, np.arange(FIRST)), after])
    free = np.zeros((2 * N, 3))
    free[2 * FIRST :] = (after.rows @ of.free).reshape(-1, 3)
    noise = np.diag(np.repeat(model.sightings.variance, 2))
    covariance = errors_at(model, at) + free @ free.T + noise
    expected = multivariate_normal(np.zeros(2 * N), covariance, allow_singular=False).logpdf(residual.ravel())
    assert scored.evidence == pytest.approx(float(expected) + N * math.log(0.8), rel=1e-9)
    assert scored.agreeing == N - FIRST


def test_a_rotation_that_fewer_agree_with_is_not_weighed(calibration: Calibration, directions: FloatArray) -> None:
    rng = np.random.default_rng(3)
    pixels = project(calibration.camera, directions)
    pixels[FIRST:] = rng.uniform([0.0, 0.0], [640.0, 480.0], (N - FIRST, 2))
    assert module.rotation_from(window(calibration, directions, pixels), FIRST, least=8) is None


def test_the_clock_s_hypothesis_is_the_rotation_about_the_pole(
    calibration: Calibration, directions: FloatArray
) -> None:
    pole = rotation_matrix(calibration.camera.rotation_cam_enu) @ pole_enu(SGP)
    model = changed(calibration, directions, rotated(calibration.camera, 0.01 * pole))
    best = module.rotation_from(model, FIRST, least=4)
    assert best is not None
    clock = module.clock_hypothesis(model, best, SGP)
    rotation = -clock.mean[model.error_model.rotation]
    assert rotation @ pole == pytest.approx(0.01, rel=0.15)
    np.testing.assert_allclose(np.cross(rotation, pole), 0.0, atol=1e-12)
    assert clock.free.shape[1] == 1


@pytest.mark.parametrize(("kind", "count"), [("refocus", 1), ("shift", 2), ("lens", 5)])
def test_another_lens_has_its_free_numbers(
    calibration: Calibration, directions: FloatArray, kind: ChangeKind, count: int
) -> None:
    model = changed(calibration, directions, calibration.camera)
    still = module.rotation_hypothesis(model, FIRST, np.zeros(3), np.zeros((3, 0)), kind="bump")
    other = module.lens_hypothesis(model, still, kind=kind)
    assert other.kind == kind
    assert other.free.shape[1] == count
    names = list(model.error_model.selected)
    if kind == "refocus":  # 5 % of the focal length, on both axes alike
        np.testing.assert_allclose(other.free[[names.index(0), names.index(1)], 0], 0.05 * 220.0)
    if kind == "shift":  # 3 % of width and height
        np.testing.assert_allclose(np.diag(other.free[[names.index(3), names.index(4)]]), [0.03 * 640.0, 0.03 * 480.0])


def test_refocus_and_shift_are_read_back(calibration: Calibration) -> None:
    """Over a whole day's arc a changed focal length is no rotation."""
    times = NOON + 1500.0 * (np.arange(N, dtype=np.float64) - 12.0)
    arc = np.asarray(sun_directions(times, SGP))
    camera = calibration.camera
    grown = replace(camera, focal_length_px=(camera.focal_length_px[0] * 1.01, camera.focal_length_px[1] * 1.01))
    pixels = np.where(np.arange(N)[:, None] < 6, project(camera, arc), project(grown, arc))
    watch = SightingWindow(
        unix_s=times,
        pixels=pixels + np.random.default_rng(1).normal(0.0, 0.05, pixels.shape),
        directions=arc,
        sigma_px=np.full(N, 0.05),
        trusted=np.arange(N) < 6,
        surprise=np.zeros((N, 2)),
    )
    change = found(make_residual_model(watch, calibration, OPTIONS))
    assert change is not None
    assert (change.cause, change_details(change)["unit"]) == ("refocus", "%")
    assert change_details(change)["size"] == pytest.approx(1.0, abs=4.0 * change_details(change)["size_sigma"])
    assert change_details(change)["size_sigma"] < 0.3


@pytest.mark.parametrize(
    ("rival", "lead", "clock_stepped", "expected"),
    [
        ("lens", 5.9, False, "bump"),
        ("lens", 6.1, False, "lens"),
        ("clock", 4.9, False, "bump"),
        ("clock", 5.1, False, "clock"),
        ("clock", -5.9, True, "clock"),
        ("clock", -6.1, True, "bump"),
        ("clock", -0.1, None, "bump"),
        ("clock", 0.1, None, "clock"),
        ("lens", 5.9, None, "bump"),
    ],
)
def test_a_rarer_change_must_be_clearly_more_probable(
    rival: ChangeKind, lead: float, *, clock_stepped: bool | None, expected: str
) -> None:
    """Prior odds as Bayes factors in natural logarithms (Kass and Raftery 1995: 5 is very strong)."""
    other = Weighed(rival, 100.0 + lead, rarity(rival, clock_stepped=clock_stepped))
    turn: ChangeKind = "bump"
    assert most_probable([Weighed(turn, 100.0), other]).explanation == expected


@pytest.mark.parametrize(("small", "expected"), [(True, [0, 3, 6, 9, *range(12, 21)]), (False, [*range(14, 21)])])
def test_a_change_may_begin_lately_or_at_every_third_or_at_what_is_not_trusted(
    calibration: Calibration,
    directions: FloatArray,
    monkeypatch: pytest.MonkeyPatch,
    expected: list[int],
    *,
    small: bool,
) -> None:
    """Each of the last twelve is tried, four sightings being left to agree; of those before, every third."""
    tried: list[int] = []

    def none(_: ResidualModel, first: int, *, least: int) -> None:
        assert least == 4
        tried.append(first)

    monkeypatch.setattr(module, "rotation_from", none)
    model = window(calibration, directions, project(calibration.camera, directions))
    assert module.best_rotations(model, small=small, least=4) == []
    assert tried == expected


def test_a_change_is_dated_by_the_first_sightings_that_explain_as_likely(
    calibration: Calibration, directions: FloatArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    noted: list[list[int]] = []

    def spy(*arguments: Any, alike: list[int], **named: Any) -> PoseChange:  # noqa: ANN401 - passed on
        noted.append(alike)
        return describe_change(*arguments, alike=alike, **named)

    monkeypatch.setattr(module, "describe_change", spy)
    model = changed(calibration, directions, rotated(calibration.camera, np.radians([1.0, 0.0, 0.0])))
    change = found(model, small=True)
    assert change is not None
    rotations = module.best_rotations(model, small=True, least=4)
    best = max(one.evidence for one in rotations)
    assert noted == [[one.of.first for one in rotations if best - one.evidence < 5.0]]
    assert FIRST in noted[0]
    assert len(noted[0]) < len(rotations)
