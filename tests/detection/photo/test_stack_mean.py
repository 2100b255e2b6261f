"""The mean over a stack of exposures, by hand."""

from __future__ import annotations

import math

import pytest

from sunarc.detection.exposure_stack import agrees, weighted_mean
from sunarc.detection.photo.candidates import Candidate
from sunarc.detection.photo.rim import Rim
from sunarc.detection.values import Detection


def candidate(x: float, y: float, *, sigma_px: float, radius: float = 5.0) -> Candidate:
    rim = Rim(
        x,
        y,
        radius,
        scatter=0.1,
        share=1.0,
        spread=0.1,
        offset=0.0,
        ellipticity=0.02,
        level=250.0,
        flat=1.0,
        near=0.8,
        far=0.6,
        uneven=0.2,
        pull=0.0,
        lopsided=0.0,
        circles=3,
    )
    return Candidate(rim, sigma_px, off_glare_px=0.0, off_local_glare_px=0.0, size_px=200.0, other_area=0.0)


def anchor(x: float = 10.0, y: float = 5.0, *, sigma_px: float = 0.1, radius_px: float = 5.0) -> Detection:
    return Detection(
        method="paper",
        accepted=True,
        verdict="clear",
        findings=(),
        x_px=x,
        y_px=y,
        sigma_px=sigma_px,
        radius_px=radius_px,
    )


def test_the_mean_is_weighted_by_inverse_variances() -> None:
    """Weights of 100 and 25 per px²: 0.6 px apart the mean is 0.12 px from the first, and chi² is 7.2 of 2."""
    seen = [(candidate(10.0, 5.0, sigma_px=0.1, radius=4.0), 50.0), (candidate(10.6, 5.0, sigma_px=0.2), 800.0)]
    found = weighted_mean(anchor(), seen)
    assert (found.x_px, found.y_px) == pytest.approx((10.12, 5.0))
    assert found.findings[-1].data["chi2"] == pytest.approx(3.6)
    assert found.sigma_px == pytest.approx(0.1 * math.sqrt(3.6))
    assert (found.radius_px, found.exposure_us) == (4.0, 50.0)


def test_exposures_that_agree_better_than_they_state_are_no_better_than_the_best() -> None:
    found = weighted_mean(
        anchor(), [(candidate(10.0, 5.0, sigma_px=0.3), 50.0), (candidate(10.0, 5.0, sigma_px=0.2), 800.0)]
    )
    assert found.sigma_px == pytest.approx(0.2)


def test_one_exposure_alone_leaves_the_anchor() -> None:
    assert weighted_mean(anchor(), [(candidate(11.0, 5.0, sigma_px=0.1), 50.0)]) == anchor()


@pytest.mark.parametrize(("distance_px", "expected"), [(3.4, True), (3.6, False)])
@pytest.mark.parametrize("radii", [(10.0, 4.0), (4.0, 10.0)])
def test_places_within_a_third_of_the_larger_radius_agree(
    radii: tuple[float, float], distance_px: float, *, expected: bool
) -> None:
    seen = candidate(10.0 + 0.6 * distance_px, 5.0 - 0.8 * distance_px, sigma_px=0.01, radius=radii[0])
    assert agrees(seen, anchor(sigma_px=0.01, radius_px=radii[1])) == expected


@pytest.mark.parametrize(("distance_px", "expected"), [(19.9, True), (20.1, False)])
def test_places_within_four_sigmas_of_both_agree(distance_px: float, *, expected: bool) -> None:
    seen = candidate(10.0 + distance_px, 5.0, sigma_px=3.0, radius=1.0)
    assert agrees(seen, anchor(sigma_px=4.0, radius_px=1.0)) == expected
