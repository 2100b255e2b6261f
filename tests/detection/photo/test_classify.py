"""Classification of candidates: every limit from both sides, and which one is chosen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sunarc.detection.photo.candidates import Candidate, sigma_px
from sunarc.detection.photo.ordinary_image import Judged, choose_candidate
from sunarc.detection.photo.rim import Rim
from sunarc.detection.values import Expectation

RIM = Rim(
    x=100.0,
    y=90.0,
    radius=12.0,
    scatter=0.6,
    share=0.9,
    spread=0.2,
    offset=1.0,
    ellipticity=0.05,
    level=4095.0,
    flat=0.95,
    near=0.8,
    far=0.66,
    uneven=0.3,
    pull=0.0,
    lopsided=0.0,
    circles=3,
)
SEEN = Candidate(
    RIM, sigma_px=0.6, off_glare_px=2.0, off_local_glare_px=2.0, size_px=200.0, other_area=0.0, sky=0.5, lighter=0.05
)


def judged(seen: Candidate, expectation: Expectation | None = None) -> Judged:
    return choose_candidate([seen], expectation)


def code(sigma: float = 0.6, off_glare_px: float = 2.0, **changes: Any) -> str:  # noqa: ANN401 - the rim's own fields
    rim = Rim(**{**RIM._asdict(), **changes})
    return judged(SEEN._replace(rim=rim, sigma_px=sigma, off_glare_px=off_glare_px)).finding.code


def test_a_round_clipped_rim_in_its_glare_is_the_suns() -> None:
    assert judged(SEEN).verdict == "clear"
    assert code() == "blob_found"


@pytest.mark.parametrize(
    ("field", "bad", "good", "expected"),
    [
        ("near", 0.693, 0.695, "blob_edged"),
        ("far", 0.499, 0.501, "blob_edged"),
        ("near", 0.916, 0.914, "blob_flat"),
        ("share", 0.499, 0.501, "blob_one_sided"),
        ("scatter", 1.93, 1.91, "blob_uneven"),
        ("flat", 0.599, 0.601, "blob_not_clipped"),
        ("ellipticity", 0.351, 0.349, "blob_elongated"),
    ],
)
def test_the_limits_of_a_rim(field: str, bad: float, good: float, expected: str) -> None:
    assert code(**{field: bad}) == expected
    assert code(**{field: good}) == "blob_found"


@pytest.mark.parametrize(("far", "expected"), [(0.861, "blob_flat"), (0.859, "blob_found")])
def test_light_that_hardly_falls_does_not_stand_out(far: float, expected: str) -> None:
    assert code(near=0.91, far=far) == expected


@pytest.mark.parametrize(("sigma", "expected"), [(2.01, "blob_centre_uncertain"), (1.99, "blob_found")])
def test_a_sigma_is_at_most_a_share_of_the_image(sigma: float, expected: str) -> None:
    assert code(sigma) == expected


@pytest.mark.parametrize(("sigma", "expected"), [(0.81, "blob_centre_uncertain"), (0.79, "blob_found")])
def test_a_sigma_is_at_most_a_share_of_the_radius(sigma: float, expected: str) -> None:
    assert code(sigma, off_glare_px=1.0, radius=4.0, scatter=0.1) == expected


@pytest.mark.parametrize(
    ("off", "radius", "good"), [(1.7, 4.0, True), (1.9, 4.0, False), (3.7, 12.0, False), (4.4, 15.0, True)]
)
def test_a_sun_is_in_the_middle_of_its_glare(off: float, radius: float, *, good: bool) -> None:
    assert (code(off_glare_px=off, radius=radius) == "blob_found") == good


@pytest.mark.parametrize(("off", "verdict"), [(12.2, "clear"), (12.7, "reflection")])
def test_a_plateau_far_from_the_prediction_is_a_reflection(off: float, verdict: str) -> None:
    expectation = Expectation(x_px=100.0 + 0.6 * off, y_px=90.0 + 0.8 * off, uncertainty_px=2.0)
    assert judged(SEEN, expectation).verdict == verdict


def test_a_prediction_stands_for_some_of_the_clipping() -> None:
    expectation = Expectation(x_px=101.0, y_px=91.0, uncertainty_px=2.0)
    for flat, verdict in ((0.21, "clear"), (0.19, "veiled")):
        dull = SEEN._replace(rim=RIM._replace(flat=flat))
        assert judged(dull).verdict == "veiled"
        assert judged(dull, expectation).verdict == verdict
    assert judged(SEEN._replace(off_glare_px=50.0), expectation).verdict == "clear"
    assert judged(SEEN._replace(off_local_glare_px=4.0), expectation).verdict == "veiled"


@pytest.mark.parametrize(
    ("radius", "area", "expected"),
    [
        (17.9, 0.0, "blob_found"),
        (18.1, 0.0, "blob_wide"),
        (12.0, 0.0226, "blob_found"),  # twice the plateau's area of pi * 0.06²
        (12.0, 0.0227, "blob_not_alone"),
        (2.0, 0.00099, "blob_found"),
        (2.0, 0.00101, "blob_not_alone"),
    ],
)
def test_without_a_prediction_a_sun_is_narrow_and_alone(radius: float, area: float, expected: str) -> None:
    seen = SEEN._replace(rim=RIM._replace(radius=radius, scatter=0.02), sigma_px=0.3, other_area=area)
    seen = seen._replace(off_glare_px=0.0, off_local_glare_px=0.0)
    assert judged(seen).finding.code == expected
    assert judged(seen, Expectation(x_px=101.0, y_px=91.0, uncertainty_px=2.0)).verdict == "clear"


def test_the_most_sun_like_is_chosen() -> None:
    smaller = SEEN._replace(rim=RIM._replace(x=20.0, radius=4.0, scatter=0.2))
    box = SEEN._replace(rim=RIM._replace(x=180.0, radius=20.0, near=0.1))
    assert choose_candidate([smaller, box, SEEN], None).seen is SEEN
    near_the_smaller = Expectation(x_px=21.0, y_px=90.0, uncertainty_px=1.0)
    assert choose_candidate([smaller, box, SEEN], near_the_smaller).seen is smaller


@pytest.mark.parametrize(
    "worse", [{"flat": 0.3}, {"far": 0.8}, {"share": 0.5}, {"scatter": 1.5}, {"spread": 3.0}, {"radius": 6.0}]
)
def test_the_score_falls_with_what_is_unlike_a_sun(worse: dict[str, Any]) -> None:
    assert SEEN._replace(rim=RIM._replace(**worse)).score < 0.8 * SEEN.score


def test_the_score_falls_off_the_glare() -> None:
    assert SEEN._replace(off_glare_px=5.4).score == pytest.approx(SEEN.score * math.exp(-1.0 + (2.0 / 5.4) ** 2))


def test_sigma_is_the_root_of_the_sum_of_its_parts() -> None:
    parts = (0.2, 0.015 * 12.0, 7.0 * (0.6 / 0.9) ** 2 / 12.0, 0.5 * 0.2, 0.45 * 1.0, 0.25 * 12.0 * 0.1)
    assert sigma_px(RIM) == pytest.approx(math.sqrt(sum(part**2 for part in parts)))


@pytest.mark.parametrize(
    "worse", [{"scatter": 2.0}, {"spread": 3.0}, {"offset": 6.0}, {"share": 0.3}, {"radius": 60.0, "scatter": 3.0}]
)
def test_sigma_grows_with_what_makes_a_centre_uncertain(worse: dict[str, Any]) -> None:
    assert sigma_px(RIM._replace(**worse)) > 1.3 * sigma_px(RIM)


EDGED = RIM._replace(near=0.48, far=0.44, edged=True)
IN_AUREOLE = SEEN._replace(rim=EDGED, sky=0.3, lighter=0.05)


def test_a_sun_with_an_edge_in_its_aureole_is_the_suns() -> None:
    assert judged(IN_AUREOLE).verdict == "clear"
    assert judged(SEEN._replace(rim=EDGED)).finding.code == "blob_edged"  # the sky is as light


@pytest.mark.parametrize(("lighter", "expected"), [(0.121, "blob_flat"), (0.119, "blob_found")])
def test_the_sky_is_lighter_than_the_aureole_hardly_anywhere(lighter: float, expected: str) -> None:
    assert judged(SEEN._replace(lighter=lighter)).finding.code == expected
    assert judged(SEEN._replace(lighter=lighter), Expectation(x_px=RIM.x, y_px=RIM.y)).finding.code == "blob_found"


@pytest.mark.parametrize(
    ("field", "bad", "good"), [("sky", 0.39, 0.38), ("sky", 0.149, 0.151), ("lighter", 0.121, 0.119)]
)
def test_an_edge_without_an_aureole_is_a_roofs_or_a_lamps(field: str, bad: float, good: float) -> None:
    for value, expected in ((bad, "blob_edged"), (good, "blob_found")):
        changed: dict[str, Any] = {**IN_AUREOLE._asdict(), field: value}
        assert judged(Candidate(**changed)).finding.code == expected


@pytest.mark.parametrize(
    ("field", "bad", "good"), [("far", 0.329, 0.331), ("near", 0.439, 0.441), ("edged", False, True)]
)
def test_the_limits_of_a_rim_with_an_edge(field: str, bad: float, good: float) -> None:
    seen = IN_AUREOLE._replace(sky=0.2, off_glare_px=0.0, sigma_px=0.3, rim=EDGED._replace(scatter=0.1))
    for value, expected in ((bad, "blob_edged"), (good, "blob_found")):
        changed: dict[str, Any] = {**seen.rim._asdict(), field: value}
        assert judged(seen._replace(rim=Rim(**changed))).finding.code == expected


def test_where_the_sun_is_predicted_an_edge_needs_no_aureole() -> None:
    here = Expectation(x_px=RIM.x, y_px=RIM.y)
    assert judged(SEEN._replace(rim=EDGED), here).verdict == "clear"
    assert judged(SEEN._replace(rim=EDGED._replace(edged=False)), here).finding.code == "blob_edged"


def test_a_small_light_with_an_edge_in_the_dark_is_a_lamp_even_where_the_sun_is_predicted() -> None:
    here = Expectation(x_px=RIM.x, y_px=RIM.y)
    for radius, sky, expected in ((1.9, 0.14, "blob_edged"), (1.9, 0.16, "blob_found"), (2.1, 0.14, "blob_found")):
        seen = SEEN._replace(rim=EDGED._replace(radius=radius, scatter=0.1), sky=sky, sigma_px=0.3)
        assert judged(seen._replace(off_local_glare_px=0.0), here).finding.code == expected


@pytest.mark.parametrize("radius", [0.5, 2.0, 12.0])
def test_a_sun_is_accepted_at_every_strength_of_its_glare(radius: float) -> None:
    """The light beside the rim rises; the flag of an edge goes at 0.52, the least of a glare without one is 0.65."""
    for near in np.arange(0.45, 0.9, 0.01).tolist():
        rim = EDGED._replace(near=near, far=0.9 * near, edged=near < 0.54, radius=radius, scatter=0.05 * radius)
        seen = IN_AUREOLE._replace(rim=rim, sigma_px=0.1 * radius, off_glare_px=0.0)
        assert judged(seen).verdict == "clear", near


def test_the_sigma_of_a_rim_with_an_edge_grows_with_what_does_not_follow_it() -> None:
    whole, covered = EDGED._replace(share=1.0, uneven=0.0), EDGED._replace(share=0.6, uneven=0.0)
    assert sigma_px(whole) == pytest.approx(
        math.hypot(0.2, 0.04 * 12.0, 7.0 * 0.6**2 / 12.0, 0.5 * 0.2, 0.45), rel=1e-6
    )
    assert sigma_px(covered) > 0.4 * 0.25 * 12.0
    assert sigma_px(covered) > 1.5 * sigma_px(whole)
    assert sigma_px(whole._replace(uneven=0.8)) > 2.0 * sigma_px(whole)
