"""Which detection is which star: right predictions match, wrong ones are refused, whatever else is in the sky."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.stored_answers import require_stored, said

from sunarc.detection.stars.matching import (
    StarMatches,
    match_stars,
    noise_floor,
    on_cloud,
    share_where_clear,
    sky_motion,
    standing_still,
)
from sunarc.detection.values import PredictedStars, Stars

FloatArray = NDArray[np.float64]
RADIUS = 850.0


def sky(seed: int = 1, count: int = 1300) -> PredictedStars:
    """Return stars over a disc of 850 px, as many of each magnitude as the sky has (three times more each)."""
    rng = np.random.default_rng(seed)
    magnitude = np.sort(5.5 + np.log(rng.uniform(size=count)) / math.log(3.0))
    angle, far = rng.uniform(0.0, 2.0 * np.pi, count), RADIUS * np.sqrt(rng.uniform(size=count))
    return PredictedStars(
        names=np.array([f"star:HIP{k}" for k in range(count)]),
        pixels=874.0 + far[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=-1),
        sigma_px=np.full(count, 0.2),
        magnitude=magnitude,
        azimuth_deg=np.degrees(angle),
    )


def seen(predicted: PredictedStars, *, seed: int = 2, seen_of: NDArray[np.bool_] | None = None) -> Stars:
    """Return detections of the stars, 5 % of them lost, row by row in the order of brightness."""
    rng = np.random.default_rng(seed)
    which = rng.uniform(size=len(predicted)) > 0.05
    which &= True if seen_of is None else seen_of
    magnitude = predicted.magnitude[which]
    flux = 10.0 ** (-0.4 * (magnitude + rng.normal(0.0, 0.15, magnitude.size)))
    stars = detections(predicted.pixels[which] + rng.normal(0.0, 0.2, (magnitude.size, 2)), flux)
    return stars.select(np.argsort(-flux))


def detections(pixels: FloatArray, flux: FloatArray) -> Stars:
    one = np.ones(flux.size)
    return Stars(
        pixels=pixels, sigma_px=0.2 * one, flux=flux, snr=50.0 * one, peak_fraction=0.5 * one, width_px=1.2 * one,
        ellipticity=0.0 * one, saturated=one < 0.0,
    )  # fmt: skip


def with_others(stars: Stars, pixels: FloatArray, flux: FloatArray) -> Stars:
    other = detections(pixels, flux)
    both = Stars(**{name: np.concatenate([getattr(stars, name), getattr(other, name)]) for name in Stars.__slots__})
    return both.select(np.argsort(-both.flux, kind="stable"))


def false_matches(matched: StarMatches, stars: Stars, truth: PredictedStars) -> int:
    """Return how many matches are further than 1.5 px from where the star is."""
    apart = np.linalg.norm(stars.pixels[matched.detection] - truth.pixels[matched.star], axis=-1)
    return int(np.sum(apart > 1.5))


def codes(matched: StarMatches) -> set[str]:
    return {one.code for one in matched.findings}


def test_a_clear_night_is_matched_and_no_match_is_false() -> None:
    predicted = sky()
    stars = seen(predicted)
    matched = match_stars(stars, predicted)
    assert matched.accepted
    assert codes(matched) == {"stars_matched"}
    assert 700 < matched.star.size < 1300
    assert np.unique(matched.star).size == np.unique(matched.detection).size == matched.star.size
    assert false_matches(matched, stars, predicted) == 0
    assert matched.explained > 0.95
    assert 0.85 < matched.found <= 1.0
    assert 0.1 < matched.scatter_px < 0.3


def test_a_smooth_error_of_the_prediction_within_its_sigma_is_followed() -> None:
    truth = sky()
    shift = np.stack([3.0 + 4e-6 * (truth.pixels[:, 0] - 874.0) ** 2, -2.0 + 2e-3 * truth.pixels[:, 0]], axis=-1)
    predicted = replace(truth, pixels=truth.pixels + shift, sigma_px=np.full(len(truth), 3.0))
    stars = seen(truth)
    matched = match_stars(stars, predicted)
    assert matched.accepted
    assert false_matches(matched, stars, truth) <= 1
    assert matched.star.size > 700
    # the same error beyond what is stated is refused
    assert not match_stars(stars, replace(predicted, sigma_px=np.full(len(truth), 0.2))).accepted


def wrong(name: str, truth: PredictedStars) -> PredictedStars:
    out = truth.pixels - 874.0
    turn = {"90 degrees": np.pi / 2.0, "5 degrees": np.radians(5.0)}.get(name, 0.0)
    turned = out @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    turned = turned * {"10 % larger": 1.1, "3 % smaller": 0.97}.get(name, 1.0)
    turned = turned * np.array([-1.0, 1.0]) if name == "mirrored" else turned
    turned = turned + np.array([26.0, 0.0]) if name == "10 minutes" else turned
    return replace(truth, pixels=874.0 + turned)


@pytest.mark.parametrize("sigma_px", [0.2, 2.0])
@pytest.mark.parametrize("name", ["90 degrees", "5 degrees", "10 % larger", "3 % smaller", "mirrored", "10 minutes"])
def test_a_wrong_prediction_is_refused(name: str, sigma_px: float) -> None:
    for seed in range(3):
        truth = sky(seed)
        predicted = wrong(name, replace(truth, sigma_px=np.full(len(truth), sigma_px)))
        matched = match_stars(seen(truth, seed=seed), predicted)
        assert not matched.accepted
        assert matched.star.size == matched.detection.size == 0
        assert codes(matched) & {"stars_not_explained", "stars_not_found", "stars_few", "stars_scattered"}


def test_a_prediction_that_matches_anything_is_refused_before_it_is_tried() -> None:
    predicted = replace(sky(), sigma_px=np.full(1300, 40.0))
    assert codes(match_stars(seen(sky()), predicted)) == {"stars_prediction_uncertain"}


def test_half_a_sky_of_cloud_is_enough_and_three_quarters_are_not() -> None:
    predicted = sky()
    for cloud, accepted in ((0.4, True), (0.75, False)):
        stars = seen(predicted, seen_of=predicted.azimuth_deg > 360.0 * cloud)
        matched = match_stars(stars, predicted)
        assert matched.accepted is accepted
        assert accepted or codes(matched) == {"stars_one_sided"}
        assert false_matches(matched, stars, predicted) == 0


def broken(predicted: PredictedStars, *, seed: int = 5) -> Stars:
    """Return detections through clouds of 60 px that hide half of the sky, and their edges: bright and uncertain."""
    rng = np.random.default_rng(seed)
    clouds = 874.0 + rng.uniform(-RADIUS, RADIUS, (140, 2))
    apart = np.linalg.norm(predicted.pixels[:, None] - clouds, axis=-1).min(axis=1)
    stars = seen(predicted, seen_of=apart > 60.0)
    stars = replace(stars, snr=6.0 * stars.flux * 10.0 ** (0.4 * 6.0))
    angle = rng.uniform(0.0, 2.0 * np.pi, 400)
    edges = clouds[rng.integers(0, 140, 400)] + 60.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    cloudy = with_others(stars, edges, 10.0 ** (-0.4 * rng.uniform(1.0, 4.5, 400)))
    rough = np.isin(cloudy.pixels[:, 0], edges[:, 0])
    return replace(cloudy, snr=np.where(rough, rng.uniform(5.0, 12.0, len(cloudy)), cloudy.snr))


def test_broken_clouds_leave_what_is_clear_and_wrong_predictions_are_refused_through_them() -> None:
    predicted = sky()
    stars = broken(predicted)
    matched = match_stars(stars, predicted)
    assert matched.accepted
    assert 250 < matched.star.size < 800
    assert false_matches(matched, stars, predicted) <= 1
    # as many bright points are cloud as are stars
    assert np.sum(on_cloud(stars)) > 300
    off = predicted.pixels - 874.0
    for pixels in (off * [-1.0, 1.0], off * 1.1, off @ np.array([[0.996, 0.087], [-0.087, 0.996]])):
        for sigma_px in (0.2, 2.0, 6.0):
            wrong = replace(predicted, pixels=874.0 + pixels, sigma_px=np.full(len(predicted), sigma_px))
            assert not match_stars(stars, wrong).accepted


def test_clear_is_the_sky_about_a_star_and_not_the_star() -> None:
    x, y = np.meshgrid(np.arange(12.0), np.arange(12.0))
    pixels = np.stack([x.ravel(), y.ravel()], axis=-1)
    assert share_where_clear(pixels, np.ones(144, dtype=bool)) == 1.0
    assert share_where_clear(pixels, np.zeros(144, dtype=bool)) == 0.0
    # a cloud over half of it is left out, a star that alone is not seen counts
    half = x.ravel() > 5.5
    assert share_where_clear(pixels, half) == 1.0
    half[pixels.tolist().index([9.0, 6.0])] = False
    assert 0.97 < share_where_clear(pixels, half) < 1.0
    # 15 % by chance leave nowhere clear
    chance = np.random.default_rng(3).uniform(size=144) < 0.15
    assert share_where_clear(pixels, chance) == 0.0
    assert share_where_clear(pixels[:8], np.ones(8, dtype=bool)) == 0.0


def test_an_image_of_lamps_and_noise_is_refused() -> None:
    rng = np.random.default_rng(5)
    place = 874.0 + rng.uniform(-600.0, 600.0, (500, 2))
    stars = detections(place, np.sort(10.0 ** (-0.4 * rng.uniform(0.0, 5.5, 500)))[::-1])
    for sigma_px in (0.2, 3.0):
        assert not match_stars(stars, replace(sky(), sigma_px=np.full(1300, sigma_px))).accepted
    assert codes(match_stars(stars.select(np.arange(0)), sky())) == {"stars_few"}


def test_detections_at_the_stars_places_without_their_brightness_are_refused() -> None:
    predicted = sky()
    stars = seen(predicted, seen_of=predicted.magnitude < 4.5)
    # half ten magnitudes too bright, half too faint: none is as bright as any line says
    flux = stars.flux[0] * 10.0 ** np.where(np.arange(len(stars)) % 2 == 0, 4.0, -4.0)
    unlike = replace(stars, flux=flux).select(np.argsort(-flux, kind="stable"))
    matched = match_stars(unlike, predicted)
    assert not matched.accepted
    assert codes(matched) >= {"stars_few"}
    assert np.isfinite(matched.explained)


def test_satellites_do_not_disturb_and_a_star_beside_another_is_left_out() -> None:
    rng = np.random.default_rng(6)
    predicted = sky()
    trails = 874.0 + rng.uniform(-500.0, 500.0, (30, 2))
    stars = with_others(seen(predicted), trails, np.full(30, 10.0 ** (-0.4 * 2.0)))
    matched = match_stars(stars, predicted)
    assert matched.accepted
    assert false_matches(matched, stars, predicted) == 0
    apart = np.linalg.norm(predicted.pixels[:, None] - predicted.pixels[None], axis=-1) + 1e9 * np.eye(len(predicted))
    nearest = np.argmin(apart, axis=1)
    close = (apart.min(axis=1) < 3.0) & (predicted.magnitude[nearest] < predicted.magnitude + 1.0)
    assert np.count_nonzero(close) > 3
    assert not np.any(close[matched.star])


def test_what_stands_still_while_the_sky_turns_is_no_star() -> None:
    first, later = sky(), sky()
    later = replace(later, pixels=later.pixels + np.array([12.0, 0.0]))
    hot = 874.0 + np.random.default_rng(8).uniform(-550.0, 550.0, (400, 2))
    flux = np.full(400, 10.0 ** (-0.4 * 1.0))
    one, two = (with_others(seen(sky_, seed=s), hot, flux) for s, sky_ in ((3, first), (4, later)))
    assert "stars_not_explained" in codes(match_stars(one, first))
    still = standing_still(one, two, moved_px=sky_motion(one, first, later))
    assert 395 <= np.count_nonzero(still) < 420
    assert match_stars(one.select(~still), first).accepted
    # near the pole nothing moves, and nothing is said
    assert not np.any(standing_still(one, two, moved_px=np.zeros(len(one))))
    assert not np.any(standing_still(one, one.select(np.arange(0)), moved_px=np.full(len(one), 9.0)))
    assert np.all(sky_motion(one, first, later.select(np.arange(0))) == 0.0)


@pytest.mark.parametrize(("beside_px", "least", "most"), [(0.0, 0.0, 0.075), (0.3, 0.26, 0.36)])
def test_the_scatter_of_neighbours_gives_the_floor_whatever_bends_them_alike(
    beside_px: float, least: float, most: float
) -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform(0.0, 1500.0, (600, 2))
    sigma = rng.uniform(0.03, 0.2, 600)
    noise = np.hypot(sigma, beside_px)[:, None] * rng.standard_normal((600, 2))
    floor = noise_floor(places, noise + 0.8 * np.sin(places / 500.0), sigma)
    assert least <= floor <= most
    within = np.abs(noise) <= 1.96 * np.hypot(sigma, floor)[:, None]
    assert 0.93 < np.mean(within) < 0.98
    assert noise_floor(places[:29], noise[:29], sigma[:29]) == 0.0


def test_matches_say_by_how_much_their_sigma_is_too_small() -> None:
    truth = sky()
    exact, rough = (match_stars(replace(seen(truth), sigma_px=np.full(len(seen(truth)), s)), truth) for s in (0.2, 0.1))
    assert exact.floor_px < 0.06
    assert rough.floor_px == pytest.approx(math.sqrt(0.2**2 - 0.1**2), abs=0.03)


def test_the_floor_is_the_least_with_which_95_percent_are_within_1_96_sigmas() -> None:
    rng = np.random.default_rng(9)
    for count, beside_px in ((30, 0.1), (41, 0.25), (80, 0.0), (60, 0.6)):
        places, sigma = rng.uniform(0.0, 500.0, (count, 2)), rng.uniform(0.02, 0.1, count)
        off = np.hypot(sigma, beside_px)[:, None] * rng.standard_normal((count, 2))
        apart = np.linalg.norm(places[:, None] - places, axis=-1) + 1e9 * np.eye(count)
        nearest = np.argmin(apart, axis=1)
        tried = 0.8 * np.arange(4097.0) / 4096.0
        variance = sigma**2 + sigma[nearest] ** 2
        within = [
            np.mean(np.abs(off - off[nearest]) <= 1.96 * np.sqrt(variance + 2.0 * one**2)[:, None]) >= 0.95
            for one in tried
        ]
        assert noise_floor(places, off, sigma) == pytest.approx(tried[int(np.argmax(within))], abs=1e-9)
        assert noise_floor(places[:29], off[:29], sigma[:29]) == 0.0


def test_what_is_matched_and_refused_in_the_course_of_a_sweep_is_the_stored_one() -> None:
    """Ever more of the sky is lost, the prediction ever less sure or more wrong, brightness ever less told."""
    truth = sky(count=700)
    codes_, numbers = [], []
    for name, values in (
        ("lost", np.linspace(0.0, 0.75, 7)),
        ("sigma", np.geomspace(0.3, 30.0, 8)),
        ("shift", np.linspace(0.2, 3.0, 6)),
        ("scatter", np.linspace(0.1, 2.0, 6)),
        ("faint", np.linspace(0.2, 3.0, 6)),
        ("gamma", np.linspace(0.2, 1.5, 5)),
        ("side", np.linspace(60.0, 330.0, 6)),
        ("lamps", np.linspace(0.0, 500.0, 4)),
    ):
        for value in values.tolist():
            rng, by = np.random.default_rng(3), {name: value}
            which = (rng.uniform(size=700) > by.get("lost", 0.05)) & (truth.azimuth_deg < by.get("side", 361.0))
            noise = rng.normal(0.0, 0.15, 700) + rng.normal(0.0, 1.0, 700) * by.get("faint", 0.0)
            flux = 10.0 ** (-0.4 * by.get("gamma", 1.0) * (truth.magnitude + noise))
            places = truth.pixels + rng.normal(0.0, by.get("scatter", 0.2), (700, 2))
            lamps = 874.0 + rng.uniform(-600.0, 600.0, (int(by.get("lamps", 0)), 2))
            stars = with_others(
                detections(places[which], flux[which]), lamps, np.quantile(flux, rng.uniform(size=len(lamps)))
            )
            far = ((truth.pixels - 874.0) / RADIUS) ** 2
            predicted = replace(
                truth,
                pixels=truth.pixels + by.get("shift", 0.0) * np.array([1.0, -0.6]) * (0.3 + far),
                sigma_px=np.full(700, by.get("sigma", 0.5)) * (1.0 + far[:, 0]),
            )
            matched = match_stars(stars, predicted, trail_px=0.2)
            answer = said(matched.findings)
            codes_ += [matched.accepted, matched.star.size, int(matched.detection.sum()), *answer["codes"]]
            measured = [matched.explained, matched.found, matched.scatter_px, matched.floor_px]
            numbers += [x for x in measured if math.isfinite(x)] + answer["numbers"]
    found = {"codes": codes_, "numbers": numbers}
    require_stored(Path(__file__).parents[1] / "stored_answers.json", "matching_sweep", found, relative=2e-3)
