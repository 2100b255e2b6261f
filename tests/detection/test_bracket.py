"""The frames of a bracket as one sighting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sunarc.detection import Detection, beside, combine
from sunarc.errors import InputError


def sighting(x: float, y: float, sigma: float, *, accepted: bool = True, snr: float = 100.0) -> Detection:
    return Detection(
        method="disc",
        accepted=accepted,
        verdict="clear" if accepted else "hidden",
        reason="a disc",
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
    assert not beside([first], second, shifts=[(0.0, 0.0)]).accepted
    assert beside([first], second, shifts=[(0.6, 0.0)]) == second
    assert beside([first], second, shifts=None) == second


def test_frames_nearer_than_a_tenth_of_a_pixel_agree() -> None:
    assert beside([sighting(10.0, 5.0, 0.003)], sighting(10.06, 5.0, 0.003), shifts=[(0.0, 0.0)]).accepted


def test_what_told_more_and_saw_a_covered_disc_is_believed() -> None:
    covered = replace(sighting(10.0, 5.0, 0.003, accepted=False, snr=900.0), verdict="partly_covered")
    faint = sighting(10.0, 5.0, 0.01, snr=100.0)
    assert beside([covered], faint, shifts=None).verdict == "partly_covered"
    assert beside([faint], sighting(10.0, 5.0, 0.003, snr=900.0), shifts=None).accepted
