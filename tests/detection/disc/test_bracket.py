"""The frames of a bracket as one sighting."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.detection.disc.series import check_against_bracket, combine
from sunarc.detection.values import Detection


def sighting(x: float, y: float, sigma: float, *, accepted: bool = True, snr: float = 100.0) -> Detection:
    return Detection(
        method="disc",
        accepted=accepted,
        verdict="clear" if accepted else "hidden",
        findings=(Finding("disc_found", {"chi2": 1.0}),),
        x_px=x,
        y_px=y,
        sigma_px=sigma,
        snr=snr,
    )


def test_the_mean_weighs_by_inverse_variance() -> None:
    joined = combine([sighting(10.000, 5.0, 0.003), sighting(10.005, 5.0, 0.006)])
    assert joined.accepted
    assert joined.x_px == pytest.approx(10.001)
    assert joined.y_px == pytest.approx(5.0)
    assert joined.sigma_px == pytest.approx(0.003 * np.sqrt(0.8))


def test_error_over_sigma_of_the_mean_is_one() -> None:
    rng = np.random.default_rng(0)
    sigmas, ratios, accepted = (0.003, 0.004, 0.009), [], 0
    for _ in range(2000):
        joined = combine([sighting(rng.normal(7.0, sigma), rng.normal(9.0, sigma), sigma) for sigma in sigmas])
        accepted += joined.accepted
        assert joined.x_px is not None
        assert joined.sigma_px is not None
        ratios.append((joined.x_px - 7.0) / joined.sigma_px)
    assert accepted >= 1998
    assert 0.75 < float(np.mean(np.square(ratios))) < 1.05  # below 1: the sigma is widened, never narrowed, by scatter


def test_shifts_bring_the_frames_to_one_moment() -> None:
    frames = [sighting(10.0, 5.0, 0.01), sighting(10.4, 4.8, 0.01)]
    assert not combine(frames).accepted
    joined = combine(frames, shifts=[(0.0, 0.0), (0.4, -0.2)])
    assert joined.accepted
    assert joined.x_px == pytest.approx(10.0)
    assert joined.y_px == pytest.approx(5.0)


def test_what_was_not_accepted_takes_no_part() -> None:
    assert combine([sighting(10.0, 5.0, 0.01), sighting(50.0, 5.0, 0.01, accepted=False)]).x_px == 10.0


def test_of_none_accepted_the_strongest_tells_why() -> None:
    frames = [sighting(1.0, 1.0, 1.0, accepted=False, snr=snr) for snr in (2.0, 8.0, 3.0)]
    assert combine(frames) == frames[1]


@pytest.mark.parametrize(("count", "shifts"), [(0, None), (1, [])])
def test_a_bracket_without_frames_or_shifts_is_refused(count: int, shifts: list[tuple[float, float]] | None) -> None:
    with pytest.raises(InputError, match="detections"):
        combine([sighting(1.0, 1.0, 0.1)] * count, shifts=shifts)


def test_a_frame_is_not_believed_where_its_bracket_is_elsewhere() -> None:
    first, second = sighting(10.0, 5.0, 0.004), sighting(10.6, 5.0, 0.004)
    assert not check_against_bracket([first], second, shifts=[(0.0, 0.0)]).accepted
    assert check_against_bracket([first], second, shifts=[(0.6, 0.0)]) == second
    assert check_against_bracket([first], second, shifts=None) == second


def test_frames_nearer_than_a_tenth_of_a_pixel_agree() -> None:
    assert check_against_bracket(
        [sighting(10.0, 5.0, 0.003)], sighting(10.06, 5.0, 0.003), shifts=[(0.0, 0.0)]
    ).accepted


def test_what_told_more_and_saw_a_covered_disc_is_believed() -> None:
    covered = replace(sighting(10.0, 5.0, 0.003, accepted=False, snr=900.0), verdict="partly_covered")
    faint = sighting(10.0, 5.0, 0.01, snr=100.0)
    assert check_against_bracket([covered], faint, shifts=None).verdict == "partly_covered"
    assert check_against_bracket([faint], sighting(10.0, 5.0, 0.003, snr=900.0), shifts=None).accepted


@pytest.mark.parametrize(("chi2", "accepted"), [(0.99, True), (1.01, False)])
def test_frames_scatter_beyond_chance_from_scipys_quantile_on(chi2: float, *, accepted: bool) -> None:
    limit = float(scipy.stats.chi2.isf(1e-4, 4))
    off = 0.02 * math.sqrt(chi2 * limit / 2.0)  # three frames at -off, 0 and off: chi² is 2 off² / sigma²
    joined = combine([sighting(10.0 + k * off, 5.0, 0.02) for k in (-1, 0, 1)])
    assert joined.accepted == accepted
    assert joined.sigma_px == pytest.approx(0.02 / math.sqrt(3.0) * math.sqrt(chi2 * limit / 4.0))


def test_frames_that_agree_too_well_are_not_more_certain_than_their_sigmas() -> None:
    joined = combine([sighting(10.0, 5.0, 0.02)] * 4)
    assert joined.sigma_px == pytest.approx(0.01)


def test_one_accepted_frame_stays_as_it_is_but_moved() -> None:
    one = sighting(10.0, 5.0, 0.02)
    assert combine([one]) == one
    assert combine([one], shifts=[(0.5, -0.25)]) == replace(one, x_px=9.5, y_px=5.25)


def test_the_most_certain_frame_gives_the_rest() -> None:
    frames = [replace(sighting(10.0, 5.0, sigma), exposure_us=1e3 * sigma) for sigma in (0.02, 0.005, 0.03)]
    assert combine(frames).exposure_us == 5.0


def test_a_frame_without_a_sigma_takes_no_part() -> None:
    blind = replace(sighting(80.0, 5.0, 0.02), sigma_px=None)
    assert combine([blind, sighting(10.0, 5.0, 0.02)]).x_px == 10.0


@pytest.mark.parametrize(("apart", "accepted"), [(0.099, True), (0.101, False)])
def test_frames_a_tenth_of_a_pixel_apart_are_compared_by_chance(apart: float, *, accepted: bool) -> None:
    earlier, latest = sighting(10.0, 5.0, 0.003), sighting(10.0 + apart, 5.0, 0.003)
    assert check_against_bracket([earlier], latest, shifts=[(0.0, 0.0)]).accepted == accepted
    assert check_against_bracket(
        [earlier], replace(latest, sigma_px=0.05), shifts=[(0.0, 0.0)]
    ).accepted  # by chance: 2 sigma


def test_a_rejected_detection_stays_as_it_is() -> None:
    rejected = sighting(10.0, 5.0, 0.003, accepted=False)
    assert check_against_bracket([sighting(90.0, 5.0, 0.003)], rejected, shifts=[(0.0, 0.0)]) == rejected


def test_an_earlier_frame_without_a_position_is_not_compared() -> None:
    nothing = replace(sighting(10.0, 5.0, 0.003), x_px=None, y_px=None)
    latest = sighting(90.0, 5.0, 0.003)
    assert check_against_bracket([nothing], latest, shifts=[(0.0, 0.0)]) == latest


@pytest.mark.parametrize(("snr", "accepted"), [(100.0, True), (101.0, False)])
def test_only_a_stronger_frame_overrules(snr: float, *, accepted: bool) -> None:
    covered = replace(sighting(10.0, 5.0, 0.003, accepted=False, snr=snr), verdict="partly_covered")
    assert check_against_bracket([covered], sighting(10.0, 5.0, 0.01, snr=100.0), shifts=None).accepted == accepted
