"""The disc's image against its definition: limb-darkened sources, a Gaussian point spread, integrated over pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm
from tests.detection.rendering import SOLAR_RADIUS, FloatArray, Scene, disc_image, equisolid_stretch

from sunarc.detection.disc import model as template
from sunarc.detection.disc.model import Sources, disc_sources, render_disc, sun_sources

STRETCH = np.array([[2.9, 0.25], [0.25, 2.4]])
SOURCES = disc_sources(radius_px=2.7, psf_px=0.7, limb_darkening=0.6)


def rendered(  # noqa: PLR0917 - as the kernel
    x: float = 10.3,
    y: float = 9.6,
    psf: float = 0.7,
    stretch: FloatArray = STRETCH,
    sources: Sources = SOURCES,
    shape: tuple[int, int] = (20, 22),
) -> FloatArray:
    return np.asarray(render_disc(shape, x, y, psf, stretch, sources))


def darkened(radius: float, limb: float) -> float:
    return 1.0 - limb * (1.0 - math.sqrt(1.0 - radius**2))


@pytest.mark.parametrize("limb", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("power", [0, 2, 4])
def test_moments_of_the_sources_are_those_of_a_limb_darkened_disc(limb: float, power: int) -> None:
    sources = disc_sources(radius_px=4.0, psf_px=0.7, limb_darkening=limb)
    radius = np.hypot(*sources.positions.T)
    moment, flux = (quad(lambda r, k=k: r ** (k + 1) * darkened(r, limb), 0.0, 1.0)[0] for k in (power, 0))
    assert float(sources.weights @ radius**power) == pytest.approx(moment / flux, rel=2e-3)
    assert sources.mean_level == pytest.approx(2.0 * flux)


def test_sources_have_their_centre_at_zero_and_no_direction() -> None:
    u, v = SOURCES.positions.T
    assert SOURCES.weights.sum() == pytest.approx(1.0)
    assert SOURCES.weights @ np.stack([u, v, u * v, u * u - v * v], axis=-1) == pytest.approx(np.zeros(4), abs=1e-12)


@pytest.mark.parametrize(("radius_px", "rings"), [(0.1, 4), (3.5, 7), (10.0, 21), (12.0, 24), (60.0, 24)])
def test_the_number_of_rings_grows_with_the_radius_between_its_bounds(radius_px: float, rings: int) -> None:
    sources = disc_sources(radius_px=radius_px, psf_px=0.7, limb_darkening=0.6)
    assert np.unique(np.round(np.hypot(*sources.positions.T), 9)).size == rings


def test_neighbouring_sources_of_a_ring_are_nearer_than_one_point_spread() -> None:
    sources = disc_sources(radius_px=3.5, psf_px=0.7, limb_darkening=0.6)
    radius = np.hypot(*sources.positions.T)
    outer = sources.positions[radius > radius.max() - 1e-9] * 3.5
    gaps = np.hypot(*(outer - np.roll(outer, 1, axis=0)).T)
    assert 0.9 * 0.7 < gaps.max() < 1.1 * 0.7
    assert gaps.max() == pytest.approx(gaps.min())


def test_sources_are_made_once_and_cannot_be_changed() -> None:
    again = disc_sources(radius_px=2.70001, psf_px=0.7, limb_darkening=0.6)
    assert again.positions is SOURCES.positions
    with pytest.raises(ValueError, match="read-only"):
        again.weights[0] = 1.0


def test_the_wings_are_the_same_disc_through_three_times_the_point_spread() -> None:
    both = sun_sources(radius_px=4.0, psf_px=0.7, limb_darkening=0.6)
    assert both.core.weights is disc_sources(radius_px=4.0, psf_px=0.7, limb_darkening=0.6).weights
    assert both.wings.weights is disc_sources(radius_px=4.0, psf_px=2.1, limb_darkening=0.6).weights


def test_one_source_is_a_gaussian_integrated_over_pixels() -> None:
    point = Sources(np.zeros((1, 2)), np.ones(1), 1.0)
    image = rendered(x=5.2, y=4.9, psf=0.8, sources=point, shape=(11, 12))[template.VALUE]
    across, down = (
        norm.cdf(np.arange(n) + 0.5, center, 0.8) - norm.cdf(np.arange(n) - 0.5, center, 0.8)
        for n, center in ((12, 5.2), (11, 4.9))
    )
    assert image == pytest.approx(np.outer(down, across), abs=1e-6)  # the tail beyond 5 widths is 3e-7


@pytest.mark.parametrize("psf", [0.5, 0.7, 1.0])
def test_the_image_is_that_of_the_supersampled_renderer(psf: float) -> None:
    stretch = equisolid_stretch(zenith_deg=60.0, azimuth_deg=35.0)
    scene = Scene(x=24.2, y=23.6, stretch=stretch, psf_px=psf, over=21)
    true = disc_image(scene)
    a = np.array(stretch) * SOLAR_RADIUS
    sources = disc_sources(radius_px=math.sqrt(abs(np.linalg.det(a))), psf_px=psf, limb_darkening=scene.limb)
    image = rendered(24.2, 23.6, psf, a, sources, scene.shape)[template.VALUE]
    flux = math.pi * sources.mean_level * abs(np.linalg.det(a))
    assert np.abs(flux * image - true).max() < 0.003
    assert flux == pytest.approx(float(true.sum()), rel=1e-3)


def test_the_image_has_unit_flux_and_its_centre_at_the_disc() -> None:
    image = rendered()[template.VALUE]
    assert image.sum() == pytest.approx(1.0, abs=1e-5)
    assert image.sum(axis=0) @ np.arange(22) == pytest.approx(10.3, abs=1e-4)
    assert image.sum(axis=1) @ np.arange(20) == pytest.approx(9.6, abs=1e-4)


def test_its_second_moments_are_those_of_disc_point_spread_and_pixel() -> None:
    image = rendered()[template.VALUE]
    rows, columns = np.mgrid[:20, :22]
    dx, dy = columns - 10.3, rows - 9.6
    found = np.array([[np.sum(image * a * b) for a in (dx, dy)] for b in (dx, dy)])
    source = float(SOURCES.weights @ SOURCES.positions[:, 0] ** 2)
    expected = source * STRETCH @ STRETCH + (0.7**2 + 1.0 / 12.0) * np.eye(2)
    assert found == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize(
    ("plane", "by"),
    [
        (template.BY_X, (1, 0, 0, 0, 0, 0)),
        (template.BY_Y, (0, 1, 0, 0, 0, 0)),
        (template.BY_PSF, (0, 0, 1, 0, 0, 0)),
        (template.BY_S11, (0, 0, 0, 1, 0, 0)),
        (template.BY_S12, (0, 0, 0, 0, 1, 0)),
        (template.BY_S22, (0, 0, 0, 0, 0, 1)),
    ],
)
def test_derivatives_are_those_of_finite_differences(plane: int, by: tuple[int, ...]) -> None:
    step = 1e-4

    def at(sign: float) -> FloatArray:
        dx, dy, dpsf, d11, d12, d22 = (sign * step * one for one in by)
        stretch = STRETCH + np.array([[d11, d12], [d12, d22]])
        return np.asarray(rendered(10.3 + dx, 9.6 + dy, 0.7 + dpsf, stretch)[template.VALUE])

    slope = (at(1.0) - at(-1.0)) / (2.0 * step)
    assert rendered()[plane] == pytest.approx(slope, abs=2e-5)
    assert np.abs(slope).max() > 5e-3


@pytest.mark.parametrize(
    ("plane", "factor"),
    [
        (template.SLOPE_U, lambda u, v: u + 0.0 * v),
        (template.SLOPE_V, lambda u, v: v + 0.0 * u),
        (template.BEND_UU, lambda u, v: u * u - v * v),
        (template.BEND_UV, lambda u, v: u * v),
    ],
)
def test_uneven_discs_are_sources_of_other_weight(plane: int, factor: object) -> None:
    assert callable(factor)
    u, v = SOURCES.positions.T
    uneven = SOURCES._replace(weights=SOURCES.weights * factor(u, v))
    assert rendered()[plane] == pytest.approx(rendered(sources=uneven)[template.VALUE], abs=1e-12)


def test_a_disc_at_the_edge_is_the_part_of_a_whole_one() -> None:
    whole = rendered(x=10.3, y=9.6)
    part = rendered(x=10.3 - 9.0, y=9.6 - 8.0, shape=(6, 7))
    assert part == pytest.approx(whole[:, 8:14, 9:16], abs=1e-12)


@pytest.mark.parametrize(("x", "y"), [(-20.0, 9.0), (9.0, -20.0), (60.0, 9.0), (9.0, 60.0)])
def test_a_disc_beyond_the_window_is_dark(x: float, y: float) -> None:
    assert not rendered(x=x, y=y).any()


def test_a_source_is_dark_beyond_five_point_spreads_and_half_a_pixel() -> None:
    point = Sources(np.zeros((1, 2)), np.ones(1), 1.0)
    row = rendered(x=20.45, y=3.0, psf=1.0, sources=point, shape=(7, 42))[template.VALUE][3]
    assert np.flatnonzero(row).tolist() == list(range(15, 26))  # |i - 20.45| <= 5.5


@pytest.mark.parametrize("radius_px", [0.1, 0.7, 2.7, 6.0])
def test_sources_of_a_ring_are_as_few_as_their_distance_allows_and_six_at_least(radius_px: float) -> None:
    u, v = disc_sources(radius_px=radius_px, psf_px=0.7, limb_darkening=0.6).positions.T
    in_psf = math.ceil(8.0 * radius_px / 0.7) / 8.0
    radii, counts = np.unique(np.round(np.hypot(u, v), 9), return_counts=True)
    around = 2.0 * math.pi * radii * in_psf
    assert np.all(around / counts <= 1.1 + 1e-9)
    assert np.all((counts == 6) | (around / (counts - 1) > 1.1))
    assert counts.min() == 6


def test_every_other_ring_is_turned_by_half_a_step() -> None:
    u, v = SOURCES.positions.T
    ring = np.unique(np.round(np.hypot(u, v), 9), return_inverse=True)[1].ravel()
    for k in range(ring.max() + 1):
        angle = np.sort(np.mod(np.arctan2(v, u)[ring == k] + 1e-9, 2.0 * math.pi))
        step = 2.0 * math.pi / angle.size
        assert angle == pytest.approx(step * (np.arange(angle.size) + 0.5 * (k % 2)), abs=1e-6)
