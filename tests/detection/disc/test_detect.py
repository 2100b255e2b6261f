"""The way of a frame through the detector: what is looked at, and what is refused before and after the fit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.detection.rendering import (
    SOLAR_RADIUS,
    FloatArray,
    Image,
    Scene,
    disc_image,
    equisolid_stretch,
    read_out,
    render,
)

from sunarc.common.errors import InputError
from sunarc.detection.disc import detect
from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.values import Detection, DiscOptions, Expectation, Sensor, Verdict

SENSOR = Sensor.from_full_well(full_scale=4095)
STRETCH = equisolid_stretch()
FRAME = render(Scene(stretch=STRETCH, peak=0.5), np.random.default_rng(0))
PREDICTED = Expectation(x_px=24.0, y_px=24.0, uncertainty_px=1.0, stretch_px_per_rad=STRETCH)


def detected(
    image: Image = FRAME,
    *,
    expectation: Expectation | None = None,
    options: DiscOptions | None = None,
    exposure_us: float | None = None,
) -> Detection:
    return detect_sun(
        image, sensor=SENSOR, expectation=expectation, options=options or DiscOptions(), exposure_us=exposure_us
    )


def result(found: Detection) -> tuple[Verdict, bool]:
    return found.verdict, found.accepted


@pytest.mark.parametrize("expectation", [None, PREDICTED])
def test_the_sun_is_found_with_its_exposure(expectation: Expectation | None) -> None:
    found = detected(expectation=expectation, exposure_us=12.5)
    assert result(found) == ("clear", True)
    assert (found.x_px, found.y_px) == pytest.approx((24.0, 24.0), abs=0.01)
    assert (found.method, found.exposure_us) == ("disc", 12.5)
    assert found.peak_fraction == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize(("zenith_deg", "verdict"), [(89.59, "clear"), (89.61, "below_horizon")])
def test_the_limit_of_the_zenith_angle(zenith_deg: float, verdict: Verdict) -> None:
    assert detected(expectation=replace(PREDICTED, apparent_zenith=math.radians(zenith_deg))).verdict == verdict


@pytest.mark.parametrize(
    ("x", "y", "outside"),
    [
        (-0.5, 24.0, False),
        (-0.51, 24.0, True),
        (47.49, 24.0, False),
        (47.5, 24.0, True),
        (24.0, -0.5, False),
        (24.0, -0.51, True),
        (24.0, 47.49, False),
        (24.0, 47.5, True),
    ],
)
def test_a_prediction_beyond_the_outer_pixels_edges_is_not_searched(x: float, y: float, *, outside: bool) -> None:
    image = np.full((48, 48), 3, np.uint16)
    found = detected(image, expectation=replace(PREDICTED, x_px=x, y_px=y))
    assert found.verdict == "hidden"
    assert (found.peak_fraction is None) == outside  # a search that finds no spot reports the brightest pixel


@pytest.mark.parametrize(("exposure_us", "accepted"), [(5050.0, True), (4950.0 * 1.1, False)])
def test_without_a_prediction_a_faint_disc_is_rejected_by_its_level_in_a_microsecond(
    exposure_us: float, *, accepted: bool
) -> None:
    found = detected(exposure_us=exposure_us)
    expected = (found.peak_fraction or 0.0) >= 1e-4 * exposure_us
    assert found.accepted == expected
    assert found.accepted == accepted or abs((found.peak_fraction or 0.0) / 1e-4 - exposure_us) < 60.0


@pytest.mark.parametrize(("factor", "verdict"), [(0.9, "veiled"), (1.1, "hidden")])
def test_a_disc_of_less_than_the_faintest_share_of_the_clear_level_is_rejected(factor: float, verdict: Verdict) -> None:
    clear = factor * 0.502 / 1e-4
    by_prediction = detected(expectation=replace(PREDICTED, clear_peak_fraction=clear))
    by_option = detected(options=DiscOptions(clear_level_per_us=clear / 20.0), exposure_us=20.0)
    assert by_prediction.verdict == verdict
    assert by_option.accepted == (verdict == "veiled")


def test_a_predictions_own_clear_level_comes_before_the_options() -> None:
    expectation = replace(PREDICTED, clear_peak_fraction=0.5)
    found = detected(expectation=expectation, options=DiscOptions(clear_level_per_us=1e6), exposure_us=20.0)
    assert result(found) == ("clear", True)


def test_without_an_exposure_no_level_is_compared() -> None:
    assert detected(options=DiscOptions(clear_level_per_us=1e6)).accepted


@pytest.mark.parametrize(("level", "accepted"), [(0.2, True), (0.4, False)])
def test_a_second_disc_of_a_third_of_the_light_makes_both_reflections(level: float, *, accepted: bool) -> None:
    scene = Scene(shape=(160, 160), x=40.0, y=40.0, stretch=STRETCH)
    light = 0.7 * disc_image(scene) + 0.7 * level * disc_image(replace(scene, x=120.0, y=118.0))
    found = detected(read_out(light, scene, np.random.default_rng(7)))
    assert found.accepted == accepted
    assert accepted or found.verdict == "reflection"


def test_a_small_bright_spot_beside_the_sun_is_no_reflection() -> None:
    image = render(Scene(shape=(160, 160), x=40.0, y=40.0, stretch=STRETCH), np.random.default_rng(8))
    image[119:123, 89:93] = 0
    image[120:122, 90:92] = 1500
    assert result(detected(image)) == ("clear", True)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_disc_of_another_size_than_predicted_is_not_accepted(factor: float) -> None:
    (a, b), (c, d) = STRETCH
    other = (factor * a, factor * b), (factor * c, factor * d)
    assert not detected(expectation=replace(PREDICTED, stretch_px_per_rad=other)).accepted


def test_a_disc_without_limb_darkening_is_rejected_where_nothing_is_predicted() -> None:
    image = render(Scene(stretch=STRETCH, peak=0.7, limb=0.0), np.random.default_rng(9))
    assert result(detected(image)) == ("hidden", False)


def test_a_long_bright_region_is_no_disc() -> None:
    image = np.full((128, 128), 20, np.uint16)
    image[60:66, 20:110] = 2500
    assert result(detected(image)) == ("hidden", False)


def test_a_glow_that_hardly_stands_out_is_no_disc() -> None:
    rows, columns = np.mgrid[:128, :128]
    glow = 1500.0 + 900.0 * np.exp(-0.5 * ((columns - 60.0) ** 2 + (rows - 62.0) ** 2) / 25.0**2)
    assert result(detected(glow.astype(np.uint16))) == ("hidden", False)


def test_a_window_that_is_all_saturated_is_called_so() -> None:
    rows, columns = np.mgrid[:128, :128]
    image = np.where(np.hypot(columns - 64.0, rows - 64.0) < 50.0, 4095, 50).astype(np.uint16)
    found = detected(image, expectation=replace(PREDICTED, x_px=64.0, y_px=64.0))
    assert result(found) == ("saturated", False)
    assert found.peak_fraction == 1.0
    assert found.saturated_px > 50
    assert result(detected(image)) == ("hidden", False)


@pytest.mark.parametrize("level", [0, 19, 4095])
@pytest.mark.parametrize("shape", [(1, 1), (7, 7), (8, 8), (1, 300), (300, 1), (64, 64)])
@pytest.mark.parametrize("asked", [True, False])
def test_an_even_image_of_any_size_has_no_sun(level: int, shape: tuple[int, int], *, asked: bool) -> None:
    expectation = replace(PREDICTED, x_px=shape[1] / 2 - 0.5, y_px=shape[0] / 2 - 0.5) if asked else None
    found = detected(np.full(shape, level, np.uint16), expectation=expectation)
    assert not found.accepted
    assert found.x_px is None or asked


def test_one_bright_pixel_is_no_sun() -> None:
    image = np.zeros((64, 64), np.uint16)
    image[30, 31] = 4095
    found = detected(image)
    assert result(found) == ("hidden", False)
    assert found.peak_fraction == 1.0


@pytest.mark.parametrize("place", [(2.0, 24.0), (24.0, 2.0), (45.5, 24.0), (24.0, 45.5), (0.0, 0.0)])
def test_a_disc_at_the_border_is_exact_or_not_accepted(place: tuple[float, float]) -> None:
    scene = Scene(stretch=STRETCH, x=place[0], y=place[1], peak=0.6)
    found = detected(
        render(scene, np.random.default_rng(3)), expectation=replace(PREDICTED, x_px=place[0], y_px=place[1])
    )
    if found.accepted:
        assert (found.x_px, found.y_px) == pytest.approx(place, abs=6.0 * (found.sigma_px or 0.0))


@pytest.mark.parametrize("dtype", [np.float64, np.int32, np.int16, np.bool_, np.uint32])
def test_counts_of_another_type_are_refused(dtype: type[np.generic]) -> None:
    with pytest.raises(InputError) as error:
        detect_sun(np.zeros((32, 32), dtype), sensor=SENSOR)
    assert error.value.field == "image"


def test_an_image_with_holes_in_memory_is_the_same_image() -> None:
    wide = np.zeros((48, 96), np.uint16)
    wide[:, ::2] = FRAME
    holes: Image = wide[:, ::2]
    assert detected(holes) == detected(FRAME)


def test_a_mirrored_frame_has_the_mirrored_sun() -> None:
    scene = Scene(stretch=STRETCH, x=22.3, y=25.1, peak=0.5)
    image = render(scene, np.random.default_rng(4))
    found, mirrored = detected(image), detected(np.fliplr(image).astype(np.uint16))
    assert mirrored.x_px == pytest.approx(47.0 - (found.x_px or 0.0), abs=2e-3)
    assert mirrored.y_px == pytest.approx(found.y_px, abs=2e-3)


def test_the_frame_is_not_changed() -> None:
    image = FRAME.copy()
    detected(image, expectation=PREDICTED)
    assert (image == FRAME).all()


def test_a_black_level_is_no_light() -> None:
    scene = Scene(stretch=STRETCH, peak=0.5, black=200.0)
    sensor = replace(SENSOR, black_level=200.0)
    found = detect_sun(render(scene, np.random.default_rng(0)), sensor=sensor, expectation=PREDICTED)
    assert found.peak_fraction == pytest.approx(0.5, rel=0.02)
    assert found.background_fraction == pytest.approx(0.002, abs=0.001)


def covered(share: float) -> FloatArray:
    """Return an edge that leaves this share of the disc's width free, in the renderer's terms."""
    return np.array([1.0, 0.0, 2.0 * share - 1.0, 0.02, 0.0])


def test_half_a_disc_is_not_accepted_and_a_grazed_one_not_misplaced() -> None:
    scene = Scene(stretch=STRETCH, peak=0.7)
    half = detected(render(scene, np.random.default_rng(5), covered(0.5)), expectation=PREDICTED)
    assert (half.verdict, half.accepted) == ("partly_covered", False)
    grazed = detected(render(scene, np.random.default_rng(5), covered(0.99)), expectation=PREDICTED)
    assert not grazed.accepted or abs((grazed.x_px or 0.0) - 24.0) < 0.03


def test_a_faint_disc_is_refused_with_its_share_of_the_clear_sun() -> None:
    found = detected(expectation=replace(PREDICTED, clear_peak_fraction=1e5))
    assert (found.accepted, found.verdict) == (False, "hidden")
    (finding,) = found.findings
    assert finding.code == "disc_below_clear_sun"
    assert finding.data["share"] == pytest.approx((found.peak_fraction or 0.0) / 1e5)


def test_an_unpredicted_faint_disc_is_refused_with_its_level_per_microsecond() -> None:
    found = detected(exposure_us=1e6)
    (finding,) = found.findings
    assert finding.code == "disc_below_faintest"
    assert finding.data["level"] == pytest.approx((found.peak_fraction or 0.0) / 1e6)


@pytest.mark.parametrize("uncertainty_px", [1.0, 4.0])
def test_the_search_reaches_two_pixels_five_sigmas_and_the_discs_diameter(
    monkeypatch: pytest.MonkeyPatch, uncertainty_px: float
) -> None:
    reaches: list[float] = []

    def search(reach: float, *_: object, **__: object) -> Detection:
        reaches.append(reach)
        return Detection(method="disc", accepted=False, verdict="hidden", findings=())

    def dark(*_: object, reach_px: float, **__: object) -> None:
        reaches.append(reach_px)

    monkeypatch.setattr(detect, "_search_near", search)
    monkeypatch.setattr(detect, "obstruction", dark)
    expectation = replace(PREDICTED, uncertainty_px=uncertainty_px)
    detected(expectation=expectation)
    radius = np.linalg.svd(np.array(STRETCH) * SOLAR_RADIUS, compute_uv=False).max()
    assert reaches == pytest.approx(
        [2.0 + 5.0 * uncertainty_px + 2.0 * radius, 2.0 * radius + 2.0 * uncertainty_px], rel=1e-6
    )
