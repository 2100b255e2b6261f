"""Several units of a type against brute force: all lenses and the mean at once, and the density of what was seen."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.calibration.lens_library.joint import (
    Unit,
    estimate_lens_type,
    estimated_spread,
    further_unit,
    log_evidences,
)
from sunarc.calibration.lens_library.lens_type import Information, LensType, UnitSpread, lens_frame, usual_precision
from sunarc.calibration.solve.priors import N_LENS
from sunarc.common.errors import InputError

if TYPE_CHECKING:
    from tests.fixtures.clear_day import FloatArray
    from tests.fixtures.lens_types import Fitted

USUAL = usual_precision(2.0) + 1e-8


def seen(rng: np.random.Generator, lens: FloatArray, sigma: FloatArray) -> Information:
    """Sightings of a lens whose coordinates they tell to a sigma each."""
    return Information(np.diag(sigma**-2.0), (lens + sigma * rng.standard_normal(N_LENS)) / sigma**2)


def test_a_further_unit_is_what_the_equations_of_all_units_say() -> None:
    rng, scales = np.random.default_rng(3), np.linspace(0.3, 2.0, N_LENS)
    known = []
    for _ in range(3):
        root = rng.standard_normal((N_LENS, N_LENS))
        matrix = root @ np.diag(rng.uniform(0.0, 3.0, N_LENS) ** 2) @ root.T
        known.append(Information(matrix, matrix @ rng.standard_normal(N_LENS)))
    # unknowns: three lenses, a further one, the mean
    total = np.zeros((5 * N_LENS, 5 * N_LENS))
    right = np.zeros(5 * N_LENS)
    total[-N_LENS:, -N_LENS:] += np.diag(USUAL)
    for k in range(4):
        rows = np.zeros((N_LENS, 5 * N_LENS))
        rows[:, k * N_LENS : (k + 1) * N_LENS], rows[:, -N_LENS:] = np.eye(N_LENS), -np.eye(N_LENS)
        total += rows.T @ np.diag(scales**-2.0) @ rows
    for k, one in enumerate(known):
        part = slice(k * N_LENS, (k + 1) * N_LENS)
        total[part, part] += one.matrix
        right[part] += one.vector
    covariance, part = np.linalg.inv(total), slice(3 * N_LENS, 4 * N_LENS)
    found = further_unit(known, scales, radial_px=2.0)
    assert found.mean == pytest.approx((covariance @ right)[part], rel=1e-6, abs=1e-8)
    assert found.covariance == pytest.approx(covariance[part, part], rel=1e-6, abs=1e-9)


def test_the_evidence_of_a_spread_is_the_density_of_what_was_seen() -> None:
    rng, usual = np.random.default_rng(5), usual_precision(2.0) + 0.5
    sigma = rng.uniform(0.2, 2.0, N_LENS)
    lenses = rng.standard_normal((3, N_LENS))
    known = [Information(np.diag(sigma**-2.0), lens / sigma**2) for lens in lenses]
    spreads = np.array([[1.0, 2.0, 0.5, 0.7], [0.3, 4.0, 1.0, 0.2]])
    expected = []
    for focal, center, radial, decentering in spreads:
        scale = np.r_[focal, 1.0, 1.0, center, center, np.full(8, radial), decentering, decentering, 1.0, 1.0]
        # each coordinate by itself: seen = mean + unit + noise
        each = [
            np.eye(3) * (scale[i] ** 2 + sigma[i] ** 2) + np.full((3, 3), 1.0 / (usual[i] + 1e-8))
            for i in range(N_LENS)
        ]
        expected.append(
            sum(
                -0.5 * np.linalg.slogdet(c)[1] - 0.5 * lenses[:, i] @ np.linalg.solve(c, lenses[:, i])
                for i, c in enumerate(each)
            )
        )
    found = log_evidences(known, spreads, usual)
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], abs=1e-6)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_spread_between_eight_units_is_found(factor: float) -> None:
    stated = UnitSpread(focal_length=0.003, center_px=8.0, radial_px=0.4, decentering_px=0.3)
    true = factor * stated.scales(600.0)
    ratios = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        lenses = true * rng.standard_normal((8, N_LENS))
        found = estimated_spread([seen(rng, lens, np.full(N_LENS, 0.05)) for lens in lenses], stated, focal_px=600.0)
        ratios.append([found.focal_length / 0.003, found.center_px / 8.0, found.radial_px / 0.4])
    assert 0.7 * factor < np.mean(ratios) < 1.5 * factor


def test_one_calibration_gives_its_lens_and_the_stated_spread(fitted: Fitted) -> None:
    calibration = fitted(0)[1]
    spread = UnitSpread()
    found = estimate_lens_type([Unit("one", calibration)], spread=spread)
    assert (found.cameras, found.days, found.spread) == (("one",), ("2013-05-13",), spread)
    frame = lens_frame(calibration.camera)
    apart = frame.whitened(found.camera) - frame.whitened(calibration.camera)
    sigma = np.sqrt(np.diag(found.in_frame().covariance))
    assert np.abs(apart / sigma).max() < 0.8  # in what no sighting tells
    assert np.all(sigma >= 0.999 * spread.scales(calibration.camera.focal_length_px[0]))
    assert sigma[0] == pytest.approx(np.sqrt(2.0) * 0.01 * 601.0, rel=0.05)  # both units differ from the mean


def test_three_units_tell_more_than_one_and_their_spread(fitted: Fitted, lens: LensType) -> None:
    units = [Unit(str(k), fitted(k)[1]) for k in range(3)]
    one, three = estimate_lens_type(units[:1], spread=lens.spread), estimate_lens_type(units, spread=lens.spread)
    frame = lens_frame(lens.camera)
    true = frame.whitened(lens.camera)
    scales = lens.spread.scales(601.0)
    error = [np.linalg.norm((frame.whitened(found.camera) - true) / scales) for found in (one, three)]
    assert error[1] < error[0]
    assert 0.3 < three.spread.center_px / 8.0 < 3.0


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"projection": "equidistant"}, "projection"),
        ({"width": 1740}, "image size"),
        ({"mirrored": True}, "handedness"),
    ],
)
def test_cameras_of_other_types_are_refused_by_name(fitted: Fitted, change: dict[str, object], what: str) -> None:
    first = fitted(0)[1]
    other = replace(first, camera=replace(first.camera, **change))  # type: ignore[arg-type]
    with pytest.raises(InputError) as refused:
        estimate_lens_type([Unit("north", first), Unit("south", other)])
    assert refused.value.field == "south"
    assert what in refused.value.problem


def test_a_calibration_without_the_lens_s_covariance_is_refused(fitted: Fitted) -> None:
    calibration = fitted(0)[1]
    short = replace(
        calibration, parameter_names=calibration.parameter_names[:-1], covariance=calibration.covariance[:-1, :-1]
    )
    with pytest.raises(InputError) as refused:
        estimate_lens_type([Unit("short", short)])
    assert refused.value.field == "short"
    with pytest.raises(InputError):
        estimate_lens_type([])
