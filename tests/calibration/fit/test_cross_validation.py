"""Days left out in turn: the linear prediction against a refit, and the stated error against what is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import chdtri
from tests.fixtures.calibration import observed, small_camera, small_problem, spread_directions
from tests.fixtures.clear_day import SGP, SIZE, simulate

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.fit.cross_validation import Doubts, HeldOut, chi_square_limit, doubts, held_out, without_parts
from sunarc.calibration.fit.marginal_likelihood import PriorScales, marginal_fit, scale_grid
from sunarc.calibration.fit.normal_equations import linear_system, most_probable_with_field
from sunarc.calibration.fit.robust_fit import FitState
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.noise import Noise, NoiseGroups
from sunarc.calibration.solve.problem import Bins
from sunarc.common.robust_statistics import INFORMATION_PER_WEIGHT

FloatArray = NDArray[np.float64]

PER_DAY = 40
SCALES = PriorScales(0.002, 120.0, 2.0, 0.7)


def _fit(
    n_days: int, *, sigma_px: float = 0.2, stated_px: float = 0.2, seed: int = 1, with_field: bool = False
) -> tuple[FitState, Sightings]:
    """Return a fit of days whose sightings are spread over the sky, with known scales."""
    n = n_days * PER_DAY
    camera = replace(small_camera(), focal_length_px=(220.5, 220.5), skew_px=0.0)  # as the prior expects
    problem = small_problem(camera)
    seen = observed(camera, spread_directions(n, seed=seed), sigma_px=sigma_px, seed=seed)
    grid = scale_grid(width=640, height=480, floor_px=0.002, radial_px=2.0, decentering_px=0.7)
    together = 1 if with_field else 2
    bins = Bins(member=np.arange(n) // together, count=n // together)
    information = np.full(n, stated_px**-2)
    at = problem.unknowns([camera])
    system = linear_system(problem, seen, bins, at, information=information, basis=grid.basis)
    unknowns = most_probable_with_field(problem, system, SCALES).unknowns
    system = linear_system(problem, seen, bins, unknowns, information=information, basis=grid.basis)
    noise = Noise(
        scale=np.full(n, stated_px),
        weight=np.ones(n),
        inflation=np.ones(n),
        information=seen.information * INFORMATION_PER_WEIGHT * information,
        sigma_px=stated_px,
    )
    usable = Sightings(
        index=np.arange(n),
        unix_s=np.arange(n, dtype=np.float64),
        pixels=seen.pixels,
        directions=seen.directions,
        sigma_px=np.ones(n),
        epoch=np.zeros(n, dtype=np.int64),
        day=np.repeat(np.arange(n_days), PER_DAY),
        refraction_sd=np.zeros((n, 1)),
    )
    robust = FitState(
        problem=problem,
        observed=seen,
        groups=NoiseGroups.of(usable)._replace(bins=bins),
        unknowns=unknowns,
        scales=SCALES,
        grid=grid,
        noise=noise,
        last_round=system,
        scatter=problem.residuals(unknowns, seen),
        field_odds=1.0 if with_field else -1.0,
    )
    return robust, usable


def _with(fit: FitState, **derived: object) -> FitState:
    """Return a fit of which something that follows from it is another one."""
    other = replace(fit)
    vars(other).update({name: getattr(fit, name) for name in ("system", "residual", "field_mean")} | derived)
    return other


def _held_out(fit: FitState, usable: Sightings) -> HeldOut | None:
    return held_out(fit, usable, without_parts(fit, usable))


def _doubts(fit: FitState, usable: Sightings) -> Doubts:
    return doubts(fit, usable, without_parts(fit, usable))


def test_one_day_cannot_be_left_out() -> None:
    assert _held_out(*_fit(1)) is None


def test_days_left_out_are_met_as_expected() -> None:
    found = [_held_out(*_fit(4, seed=seed)) for seed in range(8)]
    ratios = [one.rmse_px / one.expected_px for one in found if one is not None]
    assert len(ratios) == 8
    # 320 numbers each: the relative error of one is about 4 %
    assert 0.93 < np.median(ratios) < 1.08
    # both axes together: the noise of 0.2 px per axis and a little of the fit's own error
    for one in found:
        assert one is not None
        assert 0.2 * np.sqrt(2.0) < one.expected_px < 0.2 * np.sqrt(2.0) * 1.4


def test_noise_that_is_larger_than_stated_shows() -> None:
    found = _held_out(*_fit(4, sigma_px=0.6, stated_px=0.2))
    assert found is not None
    assert 2.5 < found.rmse_px / found.expected_px < 3.5


def test_two_days_are_each_predicted_by_a_fit_of_the_other() -> None:
    fit, usable = _fit(2)
    found = _held_out(fit, usable)
    assert found is not None
    squares = 0.0
    for day in (0, 1):
        other = usable.day != day
        which = np.isin(np.arange(PER_DAY), fit.member[other])
        without = marginal_fit(fit.system.sum_bins(which), fit.grid.basis, SCALES)
        rows = np.flatnonzero(usable.day == day)
        shift = fit.system.rows[fit.member[rows]] @ (without.unknowns - fit.system.at)
        squares += float(np.sum((fit.residual[rows] - shift) ** 2))
    # a field of 0.002 px is left out
    assert found.rmse_px == pytest.approx(np.sqrt(squares / (2 * PER_DAY)), rel=1e-4)


def test_sightings_without_weight_do_not_count() -> None:
    fit, usable = _fit(3)
    weight = np.ones(len(usable))
    weight[::3] = 0.0
    wild = fit.residual.copy()
    wild[::3] = 1e3
    found = _held_out(_with(replace(fit, noise=replace(fit.noise, weight=weight)), residual=wild), usable)
    assert found is not None
    assert found.rmse_px < 1.0


def test_a_pose_that_no_other_day_has_is_not_predicted() -> None:
    fit, usable = _fit(3)
    alone = replace(usable, epoch=np.where(usable.day == 2, 1, 0))
    found, plain = _held_out(fit, alone), _held_out(fit, usable)
    assert found is not None
    assert plain is not None
    assert found.rmse_px != plain.rmse_px
    each = replace(usable, epoch=usable.day)
    assert _held_out(fit, each) is None


def test_more_than_five_days_are_left_out_in_five_parts() -> None:
    fit, usable = _fit(7)
    found = _held_out(fit, usable)
    assert found is not None
    assert found.rmse_px / found.expected_px == pytest.approx(1.0, abs=0.15)


def test_the_field_of_the_other_days_is_part_of_the_prediction() -> None:
    fit, usable = _fit(4, with_field=True)
    larger = PriorScales(0.5, 120.0, 2.0, 0.7)
    bent = 0.6 * np.stack([np.sin(usable.pixels[:, 0] / 90.0), np.cos(usable.pixels[:, 1] / 90.0)], axis=-1)
    moved = replace(fit.system, residual=fit.system.residual + bent)
    fit = _with(replace(fit, scales=larger), system=moved, residual=fit.residual + bent)
    with_field, camera_alone = _held_out(fit, usable), _held_out(_with(fit, field_mean=None), usable)
    assert with_field is not None
    assert camera_alone is not None
    # 0.28 px are the noise; 120 sightings tell most of the field
    assert 0.28 < with_field.rmse_px < 0.6 * camera_alone.rmse_px
    assert with_field.rmse_px / with_field.expected_px == pytest.approx(1.0, abs=0.15)


def test_parts_are_predicted_within_chance_and_a_part_from_elsewhere_is_not() -> None:
    fit, usable = _fit(4)
    found = _doubts(fit, usable)
    assert found.n == PER_DAY
    assert found.excess < 0.9
    assert found.widening < 1.2
    assert found.rmse_px == pytest.approx(found.stated_px, rel=0.3)
    last = usable.day == 3
    moved = fit.system.residual + np.where(np.bincount(fit.member[last], minlength=80) > 0, 5.0, 0.0)[:, None]
    elsewhere = _doubts(_with(fit, system=replace(fit.system, residual=moved)), usable)
    assert elsewhere.excess > 3.0
    assert elsewhere.rmse_px > 5.0
    assert elsewhere.rmse_px > elsewhere.stated_px


def test_a_part_that_is_missed_by_less_than_is_stated_widens_and_contradicts_nothing() -> None:
    # its noise is a tenth of what is stated, and its camera is turned by several times what the others leave open
    fit, usable = _fit(4, sigma_px=0.01, stated_px=0.1)
    pose, last = fit.problem.pose_slice(0), usable.day == 3
    of_turn = fit.system.rows[..., pose] @ np.radians([0.03, 0.0, 0.0])
    moved = np.where((np.bincount(fit.member[last], minlength=80) > 0)[:, None], of_turn, 0.0)
    found = _doubts(_with(fit, system=replace(fit.system, residual=fit.system.residual + moved)), usable)
    assert found.rmse_px < found.stated_px
    assert found.excess == 0.0
    assert 1.5 < found.widening < 5.0
    assert _doubts(fit, usable).widening < 1.2


def test_a_part_that_says_nothing_of_the_camera_is_not_judged() -> None:
    """As where the bins of a part lie beyond what the fitted camera shows: their rows are 0."""
    fit, usable = _fit(4)
    silent = (np.arange(len(usable)) < PER_DAY)[np.unique(fit.member, return_index=True)[1]]
    system = replace(fit.system, rows=np.where(silent[:, None, None], 0.0, fit.system.rows))
    of_others = _with(fit, system=system)
    found = doubts(of_others, usable, without_parts(of_others, usable))
    assert found.n > 0
    assert found.excess < 0.9
    nothing = _with(fit, system=replace(fit.system, rows=0.0 * fit.system.rows))
    assert doubts(nothing, usable, without_parts(nothing, usable)) == doubts(fit, usable, [])


def test_a_day_whose_camera_is_turned_shows_by_how_much() -> None:
    fit, usable = _fit(4)
    pose, last = fit.problem.pose_slice(0), usable.day == 3
    of_turn = fit.system.rows[..., pose] @ np.radians([0.3, 0.0, 0.0])
    moved = np.where((np.bincount(fit.member[last], minlength=80) > 0)[:, None], of_turn, 0.0)
    turned = _doubts(_with(fit, system=replace(fit.system, residual=fit.system.residual + moved)), usable)
    assert turned.turned > 30.0
    assert turned.excess > 1.0
    plain = _doubts(fit, usable)
    assert plain.turned < 15.0
    assert plain.turn_deg < 0.1 < turned.turn_deg < 0.6


def test_one_day_is_left_out_in_thirds_and_a_pose_of_its_own_is_not_left_out() -> None:
    fit, usable = _fit(1)
    assert _doubts(fit, usable).n == pytest.approx(PER_DAY / 3, abs=1)
    fit, usable = _fit(3)
    assert _doubts(fit, replace(usable, epoch=usable.day)).n == 0


@pytest.mark.parametrize("chance", [1e-9, 1e-4, 0.5, 0.99])
def test_the_limit_of_a_chi_square_is_scipys_inverse(chance: float) -> None:
    counts = [*range(1, 60), 150, 151, 1501]
    found = [chi_square_limit(count, chance) for count in counts]
    np.testing.assert_allclose(found, chdtri(counts, chance), rtol=1e-12)


@pytest.mark.parametrize("beside", [-2, -1, 1, 2])
def test_a_pose_that_another_day_hardly_shows_is_judged_alike_to_the_last_digits(beside: int) -> None:
    points = simulate(days=(0.0, 1.0), sigma_px=0.3).points.select(slice(None, None, 4))
    second_day = int(np.argmax(np.diff(points.unix_s))) + 1
    # one or two sightings of the one day are of the other one's pose
    points = replace(points, epoch=(np.arange(len(points)) >= second_day + beside).astype(np.int64))
    rounding = 1e-9 * np.random.default_rng(1).standard_normal(points.pixels.shape)
    stated = CalibrationOptions(projection="equisolid", mirrored="no")
    one, other = (
        calibrate(replace(points, pixels=pixels), site=SGP, image_size=SIZE, options=stated).evidence.held_out
        for pixels in (points.pixels, points.pixels + rounding)
    )
    assert one["n"] > 0
    assert one == pytest.approx(other, rel=1e-3, abs=1e-5)
