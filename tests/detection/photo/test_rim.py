"""The circle through a plateau's rim: places to a fraction of a pixel, and what is beside the sun left out."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.detection.photo.suns import glare_image
from tests.fixtures.stored_answers import require_stored

from sunarc.common.array_types import FloatArray, Image
from sunarc.detection.photo.candidates import sigma_px
from sunarc.detection.photo.plateau import Plateau
from sunarc.detection.photo.rim import Rim, fit_rim

SUN = Plateau(100.0, 90.0, 9.0, 4095.0)


def rim(image: NDArray[np.uint16], plateau: Plateau = SUN, static: NDArray[np.bool_] | None = None) -> Rim:
    found = fit_rim(image, plateau, static=static)
    assert found is not None
    return found


def distance(found: Rim, place: tuple[float, float] = (100.0, 90.0)) -> float:
    return math.hypot(found.x - place[0], found.y - place[1])


@pytest.mark.parametrize("place", [(100.0, 90.0), (60.3, 120.7), (140.5, 55.2)])
@pytest.mark.parametrize("radius", [5.0, 9.0, 25.0])
def test_a_round_sun_is_placed_to_a_tenth_of_a_pixel(place: tuple[float, float], radius: float) -> None:
    plateau = Plateau(round(place[0]), round(place[1]), radius, 4095.0)
    found = rim(glare_image(*place, radius=radius), plateau)
    assert distance(found, place) < 0.15
    assert found.radius == pytest.approx(radius, abs=1.3)
    assert found.share > 0.95
    assert found.scatter < max(0.05 * radius, 0.31)
    assert found.ellipticity < 0.05
    assert found.circles == 3


@pytest.mark.parametrize("offset", [3.0, 6.0])
def test_the_centre_does_not_hang_on_where_the_search_began(offset: float) -> None:
    found = rim(glare_image(radius=12.0), Plateau(100.0 + offset, 90.0, 10.0, 4095.0))
    assert distance(found) < 0.2
    assert found.offset == pytest.approx(offset, abs=0.3)


@pytest.mark.parametrize("angle_deg", [0.0, 70.0, 200.0])
def test_a_bright_cloud_over_a_quarter_of_the_rim_is_left_out(angle_deg: float) -> None:
    image = glare_image(radius=15.0)
    rows, columns = np.mgrid[:200, :200]
    x, y = (c + 28.0 * f(math.radians(angle_deg)) for c, f in ((100.0, math.cos), (90.0, math.sin)))
    image[np.hypot(columns - x, rows - y) < 16.0] = 4095
    found = rim(image, Plateau(100.0, 90.0, 15.0, 4095.0))
    assert distance(found) < 0.6
    assert 0.6 < found.share < 0.95


def test_a_streak_across_the_sun_is_left_out() -> None:
    image = glare_image(radius=15.0)
    image[86:95, :] = 4095
    assert distance(rim(image, Plateau(100.0, 90.0, 15.0, 4095.0))) < 0.4


def test_a_hidden_quarter_is_left_out() -> None:
    image = glare_image(radius=20.0)
    image[:, 112:] = 300
    found = rim(image, Plateau(97.0, 90.0, 15.0, 4095.0))
    assert distance(found) < 1.5
    assert found.share < 0.9


@pytest.mark.parametrize("squeeze", [0.0, 0.1, 0.2])
def test_the_ellipticity_is_that_of_the_rim(squeeze: float) -> None:
    rows, columns = np.mgrid[:200, :200]
    far = np.hypot((columns - 100.0) * math.sqrt(1.0 - squeeze), (rows - 90.0) / math.sqrt(1.0 - squeeze))
    image = np.clip(4095.0 * (0.4 + 1.0 / (1.0 + np.exp((far - 20.0) / 1.5))), 0, 4095).astype(np.uint16)
    found = rim(image, Plateau(100.0, 90.0, 17.0, 4095.0))
    assert found.ellipticity == pytest.approx(squeeze, abs=0.03)
    assert distance(found) < 0.1


def test_a_disc_on_a_dark_sky_is_taken_at_half_its_light() -> None:
    rows, columns = np.mgrid[:200, :200]
    far = np.hypot(columns - 100.4, rows - 90.2)
    limb = np.clip(1.0 - (far / 6.0) ** 2, 0.0, 1.0) ** 0.25
    image = np.clip(3000.0 * limb + 40.0, 0, 4095).astype(np.uint16)
    found = rim(image, Plateau(100.0, 90.0, 4.0, 3000.0))
    assert distance(found, (100.4, 90.2)) < 0.15
    assert found.radius == pytest.approx(5.5, abs=0.6)
    assert found.near < 0.1


def test_what_stands_still_is_not_taken_for_a_rim() -> None:
    image, static = glare_image(radius=15.0), np.zeros((200, 200), np.bool_)
    image[70:110, 108:] = 0
    static[70:110, 108:] = True
    hidden = rim(image, Plateau(100.0, 90.0, 12.0, 4095.0), static)
    assert distance(hidden) < 0.3
    assert hidden.share < rim(glare_image(radius=15.0), Plateau(100.0, 90.0, 15.0, 4095.0)).share


def test_light_that_never_falls_has_no_rim() -> None:
    assert fit_rim(np.full((200, 200), 4095, np.uint16), SUN) is None


def test_a_rim_far_from_the_plateau_is_none() -> None:
    assert fit_rim(glare_image(), Plateau(150.0, 90.0, 4.0, 4095.0)) is None


def test_at_the_corner_the_part_within_the_image_counts() -> None:
    found = fit_rim(glare_image(4.0, 5.0, radius=12.0), Plateau(6.0, 7.0, 7.0, 4095.0))
    assert found is None or (distance(found, (4.0, 5.0)) < 2.0 and found.share < 0.8)


def test_near_and_far_are_the_light_at_their_radii() -> None:
    image = glare_image(radius=15.0)
    found = rim(image, Plateau(100.0, 90.0, 15.0, 4095.0))
    expected = [0.08 + 0.85 / (1.0 + (ratio * found.radius / 45.0) ** 2) for ratio in (1.7, 2.6)]
    assert (found.near, found.far) == pytest.approx(expected, abs=0.02)


def test_a_clipped_plateau_is_flat_and_a_rounded_one_is_not() -> None:
    rows, columns = np.mgrid[:200, :200]
    far = np.hypot(columns - 100.0, rows - 90.0)
    rounded = (4095.0 * np.exp(-0.5 * (far / 40.0) ** 2)).astype(np.uint16)
    assert rim(glare_image(radius=15.0), Plateau(100.0, 90.0, 15.0, 4095.0)).flat > 0.99
    assert rim(rounded, Plateau(100.0, 90.0, 10.0, 4095.0)).flat < 0.3


@pytest.mark.parametrize(("slope", "low", "high"), [(0.0, 0.0, 0.1), (0.002, 0.6, 1.1)])
def test_unevenness_is_the_width_of_the_light_beside_over_its_fall(slope: float, low: float, high: float) -> None:
    rows, columns = np.mgrid[:200, :200]
    far = np.hypot(columns - 100.0, rows - 90.0)
    light = np.where(far < 15.0, 2.0, 0.7 + 0.25 / (1.0 + (far / 45.0) ** 2)) + slope * (columns - 100.0)
    found = rim(np.clip(4095.0 * light, 0, 4095).astype(np.uint16), Plateau(100.0, 90.0, 14.0, 4095.0))
    assert low <= found.uneven <= high
    across = slope * 1.7 * found.radius * np.cos(np.linspace(0.0, 2.0 * math.pi, 1000))
    width = np.quantile(across, 0.85) - np.quantile(across, 0.15)
    assert found.uneven == pytest.approx(width / (1.0 - found.near), abs=0.08)


def edged_image(*, longer: float = 1.0, angle_deg: float = 30.0, covered_deg: float = 0.0) -> NDArray[np.uint8]:
    """Return a sun that clips at 158 with ringing of 161 at its edge, drawn out, and cloud over a part of its rim."""
    rows, columns = np.mgrid[:200, :200].astype(np.float64)
    dx, dy, ray = columns - 100.0, rows - 90.0, math.radians(angle_deg)
    along, across = dx * math.cos(ray) + dy * math.sin(ray), dy * math.cos(ray) - dx * math.sin(ray)
    far = np.hypot(along / math.sqrt(longer), across * math.sqrt(longer)) / 25.0
    image = np.interp(far, (0.0, 1.0, 1.25, 1.7, 2.6, 8.0), (158.0, 158.0, 80.0, 76.0, 70.0, 45.0))
    image[(far > 0.9) & (far < 0.98)] = 161.0
    image[(np.abs(np.degrees(np.arctan2(dy, dx))) < covered_deg) & (far > 0.75)] = 40.0
    return np.asarray(np.round(image), dtype=np.uint8)


def edged_rim(image: NDArray[np.uint8]) -> Rim:
    found = fit_rim(image, Plateau(101.0, 89.0, 20.0, 160.0))
    assert found is not None
    return found


@pytest.mark.parametrize("longer", [1.0, 1.2, 1.5])
@pytest.mark.parametrize("angle_deg", [0.0, 50.0, 110.0])
def test_a_sun_with_an_edge_is_placed_however_it_is_drawn_out(longer: float, angle_deg: float) -> None:
    found = edged_rim(edged_image(longer=longer, angle_deg=angle_deg))
    assert distance(found) < 0.3
    assert found.edged
    assert found.share > 0.9
    assert found.ellipticity == pytest.approx(1.0 - 1.0 / longer, abs=0.08)


def test_the_level_is_that_within_the_plateau_and_not_of_the_ringing_at_its_edge() -> None:
    found = edged_rim(edged_image())
    assert found.level == pytest.approx(158.0, abs=0.5)
    assert found.flat > 0.9


@pytest.mark.parametrize("covered_deg", [30.0, 60.0])
def test_cloud_before_a_part_of_an_edge_is_left_out(covered_deg: float) -> None:
    found = edged_rim(edged_image(covered_deg=covered_deg))
    assert distance(found) < 0.08 * 25.0
    assert found.share < 1.05 - 2.0 * covered_deg / 360.0


def test_a_glare_without_an_edge_is_round() -> None:
    assert not rim(glare_image()).edged


def glare_on(around: Callable[[FloatArray, FloatArray], FloatArray], radius: float) -> NDArray[np.uint16]:
    """Return a plateau without an edge whose light differs around it, by the radius and the angle."""
    rows, columns = np.mgrid[:200, :200]
    far, angle = np.hypot(columns - 100.0, rows - 90.0), np.arctan2(rows - 90.0, columns - 100.0)
    light = 0.55 + 1.25 / (1.0 + (far / (1.6 * radius)) ** 1.7)
    return np.asarray(np.clip(4095.0 * (light + around(far, angle)) / 1.11, 0, 4095)).astype(np.uint16)


@pytest.mark.parametrize("radius", [9.0, 15.0])
@pytest.mark.parametrize("slope", [5e-4, 2e-3])
@pytest.mark.parametrize("towards", [0.0, 2.0, 4.0])
def test_light_that_rises_to_one_side_moves_a_sun_by_no_more_than_is_stated(
    radius: float, slope: float, towards: float
) -> None:
    """The circles themselves are off by .75 to .96 of the pull."""
    image = glare_on(lambda far, angle: slope * far * np.cos(angle - towards), radius)
    found = rim(image, Plateau(100.0, 90.0, radius, 4095.0))
    assert found.pull > 3.0 * slope * radius
    assert distance(found) < 0.6 * found.pull
    assert distance(found) < 1.7 * sigma_px(found)


def test_light_that_varies_in_other_ways_too_is_no_pull() -> None:
    image = glare_on(lambda far, angle: 4e-4 * far * (np.cos(angle) + 2.0 * np.cos(3.0 * angle)), 15.0)
    assert rim(image, Plateau(100.0, 90.0, 15.0, 4095.0)).pull < 1e-6


@pytest.mark.parametrize("radius", [9.0, 15.0])
def test_the_lopsidedness_is_the_light_three_times_around_over_its_fall_and_a_lens_has_none(radius: float) -> None:
    def found(times: int) -> Rim:
        image = glare_on(lambda far, angle: 0.01 * np.cos(times * angle) + 0.0 * far, radius)
        return rim(image, Plateau(100.0, 90.0, radius, 4095.0))

    at = 1.15 * found(3).radius
    light = (0.55 + 1.25 / (1.0 + (at / (1.6 * radius)) ** 1.7)) / 1.11
    assert found(3).lopsided == pytest.approx(0.01 / 1.11 / (1.0 - light), rel=0.2)
    assert found(2).lopsided < 0.1 * found(3).lopsided


@pytest.mark.parametrize("towards", [0.0, 2.0, 4.0])
@pytest.mark.parametrize("width", [2.0, 8.0])
@pytest.mark.parametrize("past", [-8.0, 0.0, 8.0])
def test_the_symmetry_of_the_glare_shows_a_cloud_whose_edge_moves_a_sun(
    towards: float, width: float, past: float
) -> None:
    def cloud(far: FloatArray, angle: FloatArray) -> FloatArray:
        hidden = 0.12 / (1.0 + np.exp((past - far * np.cos(angle - towards)) / width))
        return np.asarray(-hidden * (0.55 + 1.25 / (1.0 + (far / 24.0) ** 1.7)))

    image = glare_on(cloud, 15.0)
    near = rim(image, Plateau(100.0, 90.0, 14.0, 4095.0))
    found = rim(image, Plateau(near.x, near.y, 0.95 * near.radius, 4095.0))
    assert distance(found) < 4.0 * sigma_px(found)
    assert distance(found) > 4.5 * sigma_px(found._replace(lopsided=0.0, share=1.0))


def test_the_dark_beyond_the_rim_of_the_field_makes_the_light_about_a_low_sun_no_more_uneven() -> None:
    whole = glare_image(radius=15.0)
    cut = whole.copy()
    cut[:, 122:] = 40
    found, uncut = (rim(image, Plateau(100.0, 90.0, 15.0, 4095.0)) for image in (cut, whole))
    assert found.uneven == pytest.approx(uncut.uneven, abs=0.1)
    assert found.near == pytest.approx(uncut.near, abs=0.01)
    assert sigma_px(found) < 1.2 * sigma_px(uncut)


def test_every_number_of_a_rim_is_the_stored_one() -> None:
    """Round and drawn out, with and without an edge, covered, near a corner, of 8 and 12 bits, from tiny to large."""
    rows, columns = np.mgrid[:200, :200]
    cloudy, half, hidden = glare_image(radius=15.0), glare_image(radius=11.0, seed=2), np.zeros((200, 200), np.bool_)
    cloudy[np.hypot(columns - 124.0, rows - 80.0) < 16.0] = 4095
    half[:, 108:] = 300
    hidden[70:110, 106:] = True
    slope = np.clip(glare_image(radius=8.0, seed=3) + 6.0 * (columns - 100.0), 0.0, 4095.0).astype(np.uint16)
    rounded = (4095.0 * np.exp(-0.5 * (np.hypot(columns - 100.0, rows - 90.0) / 40.0) ** 2)).astype(np.uint16)
    cases: list[tuple[Image, Plateau, NDArray[np.bool_] | None]] = [
        (glare_image(radius=radius, seed=4), Plateau(101.0, 89.0, 0.8 * radius, 4095.0), None)
        for radius in (2.0, 3.5, 5.0, 9.0, 14.0, 25.0)
    ]
    cases += [(image, Plateau(100.0, 90.0, 9.0, 4095.0), None) for image in (cloudy, half, slope, rounded)]
    cases += [(glare_image(radius=13.0), Plateau(100.0, 90.0, 10.0, 4095.0), hidden)]
    cases += [(glare_image(6.0, 9.0, radius=10.0), Plateau(8.0, 10.0, 8.0, 4095.0), None)]
    cases += [(glare_image(radius=9.0), Plateau(100.0 + far, 90.0, 6.0, 4095.0), None) for far in (5.0, 6.5, 8.0, 11.0)]
    for longer, covered in ((1.0, 0.0), (1.15, 20.0), (1.3, 45.0), (1.5, 75.0)):
        edged = edged_image(longer=longer, covered_deg=covered)
        cases += [(edged, Plateau(101.0, 89.0, radius, 160.0), None) for radius in (12.0, 20.0)]
    for light in (0.3, 0.5, 0.55, 0.7):
        far = np.hypot(columns - 100.0, rows - 90.0) / 12.0
        step = np.interp(far, (0.0, 1.0, 1.15, 4.0), (1.0, 1.0, light, 0.8 * light))
        cases += [((200.0 * step).round().astype(np.uint16), Plateau(100.0, 90.0, 10.0, 200.0), None)]
    known, numbers = [], []
    for image, plateau, static in cases:
        found = fit_rim(image, plateau, static=static)
        known.append([found is not None, found.edged, found.circles] if found else [False])
        numbers += [] if found is None else [float(x) for x in found[:13]]
    answer: dict[str, list[object]] = {"codes": [*known], "numbers": [*numbers]}
    require_stored(Path(__file__).parents[1] / "stored_answers.json", "rims", answer, relative=2e-3)
