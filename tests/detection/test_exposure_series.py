"""Series of thirteen exposures: the short ones say where the sun is, and nothing else is taken for it."""

from __future__ import annotations

import math
from itertools import islice

import numpy as np
import pytest
from tests.detection.photo.stack_series import EXPOSURES_US, Series, series
from tests.fixtures.finding_codes import codes

from sunarc.detection.exposure_stack import detect_disc_in_colours, detect_sun_in_stack, is_short
from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_photo

SUN = (301.3, 212.6)


def stack(what: Series, *, seed: int = 1, of: tuple[int, ...] = EXPOSURES_US) -> list[Photo]:
    return [Photo(image, 255, float(us)) for us, image in series(what, seed).items() if us in of]


@pytest.mark.parametrize("radius", [1.2, 2.1, 3.4])
def test_short_exposures_in_colours_show_the_disc(radius: float) -> None:
    short = [one for one in stack(Series(sun=SUN, radius=radius)) if is_short(one)]
    assert len(short) >= 5
    for one in islice(short, 4):
        found = detect_disc_in_colours(one)
        assert (found.x_px, found.y_px) == pytest.approx(SUN, abs=0.3)
        assert 0.1 <= (found.sigma_px or math.inf) < 0.5
        assert not detect_sun_in_photo(one).accepted


@pytest.mark.parametrize(
    ("what", "of", "chi2"),
    [
        (Series(sun=SUN), EXPOSURES_US[2:9], (1.0, 1.06)),
        (Series(sun=SUN, dimmed=0.3), EXPOSURES_US, (1.0, 1.06)),
        (Series(sun=SUN, radius=1.6, haze=0.02, aside=1.0), EXPOSURES_US[2:11], (1.06, 2.0)),
    ],
)
def test_a_series_is_one_sighting_at_the_disc(what: Series, of: tuple[int, ...], chi2: tuple[float, float]) -> None:
    """A glare beside the disc moves wide dots by more (0.06 px): the small ones rule, and what is stated grows."""
    found = detect_sun_in_stack(stack(what, of=of))
    assert found.accepted
    assert codes(found.findings) == ["blob_found", "stack_mean"]
    assert (found.x_px, found.y_px) == pytest.approx(SUN, abs=0.05)
    assert 0.1 <= (found.sigma_px or math.inf) <= 0.13
    assert chi2[0] <= float(found.findings[1].data["chi2"]) <= chi2[1]


def test_a_series_of_which_no_exposure_is_accepted_alone_is_a_sighting() -> None:
    frames = stack(Series(sun=SUN), of=EXPOSURES_US[:9])
    assert not any(detect_sun_in_photo(one).accepted for one in frames)
    found = detect_sun_in_stack(frames)
    assert found.accepted
    assert (found.x_px, found.y_px) == pytest.approx(SUN, abs=0.2)


@pytest.mark.parametrize(
    "what",
    [
        Series(sun=None, glint=(150.2, 330.7)),
        Series(sun=None, cloud=1.5),
        Series(sun=None, lamp=(420.0, 100.0), night=True),
    ],
)
def test_reflections_cloud_and_lamps_are_no_sun(what: Series) -> None:
    assert not detect_sun_in_stack(stack(what)).accepted


def test_a_lamp_by_day_as_bright_as_the_sun_is_none() -> None:
    what = Series(sun=None, lamp=(399.0, 135.0), cloud=0.5, lamp_level=0.6, lamp_radius=1.2)
    found = detect_sun_in_stack(stack(what, seed=7))  # a long exposure has a round glare about it
    assert (found.accepted, codes(found.findings)) == (False, ["disc_without_glare"])


@pytest.mark.parametrize(
    ("what", "seed"),
    [
        (Series(sun=None, lamp=(236.3, 179.9), cloud=0.8, lamp_level=0.73, lamp_radius=1.1), 11),
        (Series(sun=None, lamp=(399.0, 135.0), cloud=0.5, lamp_level=0.0, lamp_radius=2.7, frosted=0.3), 7),
    ],
)
def test_a_bright_cloud_behind_a_lamp_and_frosted_glass_are_no_halo(what: Series, seed: int) -> None:
    assert not detect_sun_in_stack(stack(what, seed=seed)).accepted


@pytest.mark.parametrize("haze", [0.0, 0.3])
def test_a_steep_halo_needs_no_round_glare_where_the_sky_is_clipped(haze: float) -> None:
    frames = stack(Series(sun=SUN, haze=haze), of=EXPOSURES_US[:5])
    day = frames[0]._replace(image=np.full_like(frames[0].image, 255), exposure_us=None)
    found = detect_sun_in_stack([*(one._replace(exposure_us=None) for one in frames), day])
    assert found.accepted is (haze > 0.0)
    assert (found.x_px, found.y_px) == pytest.approx(SUN, abs=0.3)


def test_short_exposures_alone_are_not_believed() -> None:
    found = detect_sun_in_stack(stack(Series(sun=SUN), of=EXPOSURES_US[:4]))
    assert (found.accepted, codes(found.findings)) == (False, ["disc_without_glare"])
    assert (found.x_px, found.y_px) == pytest.approx(SUN, abs=0.2)


def test_an_accepted_cloud_beside_the_disc_is_a_contradiction() -> None:
    frames = stack(Series(sun=SUN))
    shifted = [one if is_short(one) else one._replace(image=np.roll(one.image, 60, axis=1)) for one in frames]
    found = detect_sun_in_stack(shifted)
    assert not found.accepted
