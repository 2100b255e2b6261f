"""The moon's centre by its lit limb, against a brute-force rendering with seas and another point spread."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.detection.moon.rendering import FloatArray, Moon, render

from sunarc.detection.moon import MoonExpectation, brightest_cutouts, cutout_around, detect_moon
from sunarc.detection.values import Detection, Sensor

PX_PER_DEG = 600.0 * math.radians(1.0)


def expectation(moon: Moon, *, off: FloatArray | None = None, uncertainty_px: float = 1.0) -> MoonExpectation:
    x, y = (moon.x, moon.y) + (np.zeros(2) if off is None else off)
    phase = math.cos(math.radians(moon.phase_deg))
    return MoonExpectation(
        x_px=float(x), y_px=float(y), uncertainty_px=uncertainty_px, edges_px=moon.edges, cos_phase=phase
    )


def look(moon: Moon, *, seed: int = 0, off: FloatArray | None = None) -> Detection:
    sensor: Any = Sensor.from_full_well(full_scale=2**moon.bits - 1, bayer=moon.bayer)  # type: ignore[arg-type]
    return detect_moon(render(moon, seed=seed), expectation(moon, off=off), sensor=sensor)


def error(moon: Moon, found: Detection) -> FloatArray:
    assert found.x_px is not None
    assert found.y_px is not None
    return np.array([found.x_px - moon.x, found.y_px - moon.y])


def drawn(rng: np.random.Generator, **fixed: Any) -> Moon:  # noqa: ANN401 - fields of `Moon`
    x, y, limb, north = 24 + rng.uniform(-0.5, 0.5), 24 + rng.uniform(-0.5, 0.5), *rng.uniform(0.0, 360.0, 2)
    free = {"psf_px": rng.uniform(0.6, 1.1), "peak": rng.uniform(0.2, 0.8)}
    return Moon(**{"x": x, "y": y, "limb_deg": limb, "north_deg": north, "stretch": (0.9, 1.05), **free, **fixed})


@pytest.mark.parametrize("bayer", [None, "RGGB", "GBRG"])
@pytest.mark.parametrize("phase_deg", [5.0, 60.0, 90.0, 125.0, 150.0])
def test_the_centre_is_within_its_stated_sigma_at_every_phase(phase_deg: float, bayer: str | None) -> None:
    rng, over_sigma = np.random.default_rng(7), []
    for number, law in enumerate(("mixed", "seeliger", "lambert", "mixed")):
        moon = drawn(rng, phase_deg=phase_deg, law=law, bayer=bayer)
        found = look(moon, seed=number, off=rng.normal(0.0, 1.0, 2))
        assert (found.accepted, found.findings[0].code) == (True, "moon_found")
        assert found.sigma_px is not None
        assert 0.01 < found.sigma_px < 0.12
        over_sigma.append(error(moon, found) / found.sigma_px)
    assert 0.1 < float(np.sqrt(np.mean(np.square(over_sigma)))) < 1.6


def test_a_half_moon_s_light_lies_a_tenth_of_a_degree_off_and_its_fit_does_not() -> None:
    moon = Moon(phase_deg=90.0, radius_px=0.26 * PX_PER_DEG, law="seeliger")
    middle = np.linalg.norm(moon.centroid_px - [moon.x, moon.y]) / PX_PER_DEG
    assert 0.10 < middle < 0.16
    assert float(np.linalg.norm(error(moon, look(moon)))) / PX_PER_DEG < 0.01


def test_a_large_moon_s_seas_do_not_pull_it() -> None:
    moon = Moon(phase_deg=30.0, radius_px=9.0, side=64, x=31.7, y=32.2, peak=0.6)
    found = look(moon)
    assert found.accepted
    assert float(np.linalg.norm(error(moon, found))) < min(3.0 * (found.sigma_px or 0.0), 0.25)


@pytest.mark.parametrize("halo_px", [4.0, 8.0])
def test_thin_haze_is_named_and_makes_the_sigma_larger(halo_px: float) -> None:
    clear, hazy = Moon(phase_deg=60.0), Moon(phase_deg=60.0, halo=0.1, halo_px=halo_px)
    found = look(hazy)
    assert found.findings[0].code == "moon_hazy"
    assert found.accepted
    assert (found.sigma_px or 0.0) > 1.5 * (look(clear).sigma_px or 1.0)
    assert float(np.max(np.abs(error(hazy, found)))) < 3.0 * (found.sigma_px or 0.0)


@pytest.mark.parametrize(
    ("moon", "code"),
    [
        (Moon(halo=0.6, halo_px=8.0), "moon_in_cloud"),
        (Moon(peak=1.3), "moon_saturated"),
        (Moon(peak=5.0), "moon_saturated"),
        (Moon(peak=0.004), "moon_not_found"),
        (Moon(phase_deg=168.0), "moon_thin"),
    ],
    ids=["cloud", "clipped", "widely clipped", "too dark", "a thin crescent"],
)
def test_what_gives_no_centre_is_refused_with_its_reason(moon: Moon, code: str) -> None:
    found = look(moon)
    assert not found.accepted
    assert found.findings[0].code == code


def test_another_light_beside_the_predicted_place_is_no_moon() -> None:
    moon = Moon(x=24.0, y=24.0)
    sensor = Sensor.from_full_well(full_scale=4095)
    far = expectation(moon, off=np.array([9.0, 0.0]))
    assert detect_moon(render(moon), far, sensor=sensor).findings[0].code in {"moon_displaced", "moon_not_found"}
    lamp = Moon(phase_deg=0.0, radius_px=0.4, law="seeliger", wings=0.0)  # a point, where a moon is expected
    expected = expectation(Moon(phase_deg=0.0))
    found = detect_moon(render(lamp), expected, sensor=sensor)
    assert not found.accepted
    outside = expectation(moon, off=np.array([400.0, 0.0]))
    assert detect_moon(render(moon), outside, sensor=sensor).findings[0].code == "moon_not_found"


def test_the_moon_flattened_by_the_horizon_is_fitted_as_predicted() -> None:
    moon = Moon(phase_deg=40.0, stretch=(1.0, 0.83))
    assert float(np.linalg.norm(error(moon, look(moon)))) < 0.12


def test_the_brightest_places_are_cut_out_and_found_again() -> None:
    moon = Moon(x=24.4, y=23.7)
    image = np.full((300, 401), 4, dtype=np.uint16)
    image[101:149, 250:298] = render(moon)
    image[20:23, 30:33] = 4095
    cutouts = brightest_cutouts(image, full_scale=4095)
    assert len(cutouts) == 2
    found = cutout_around(cutouts, 250 + moon.x, 101 + moon.y, within_px=4.0)
    assert found is not None
    assert (found.x % 2, found.y % 2) == (0, 0)
    expected = expectation(moon, off=np.array([250.0 - found.x, 101.0 - found.y]))
    detection = detect_moon(found.image, expected, sensor=Sensor.from_full_well(full_scale=4095))
    assert detection.accepted
    assert np.allclose([(detection.x_px or 0) + found.x, (detection.y_px or 0) + found.y], [274.4, 124.7], atol=0.15)
    assert cutout_around(cutouts, 60.0, 290.0, within_px=4.0) is None
    assert brightest_cutouts(np.full((50, 50), 7, dtype=np.uint16), full_scale=4095) == ()


@pytest.mark.parametrize("radius_px", [6.0, 9.0])
def test_the_seas_that_no_law_of_brightness_has_are_in_the_sigma(radius_px: float) -> None:
    found = look(Moon(phase_deg=30.0, radius_px=radius_px, side=64, x=31.7, y=32.2, peak=0.6))
    assert 0.008 * radius_px < (found.sigma_px or 0.0) < 0.014 * radius_px
