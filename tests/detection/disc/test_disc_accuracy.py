"""How well microsecond frames are measured, on frames of an independent renderer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.detection.rendering import FULL_WELL_E, FloatArray, Image, Scene, equisolid_stretch, render

from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.values import Detection, Expectation, Sensor

FRAMES = 100


def measured(**scene: Any) -> dict[bool, tuple[FloatArray, FloatArray]]:  # noqa: ANN401 - the scene's own fields
    """Return errors and errors over sigma, (n, 2) each, with an expectation and without, of the same frames.

    Positions, directions and noise are drawn at random.
    """
    rng = np.random.default_rng(0)
    found: dict[bool, list[FloatArray]] = {True: [], False: []}
    for _ in range(FRAMES):
        stretch = equisolid_stretch(zenith_deg=rng.uniform(5, 80), azimuth_deg=rng.uniform(0, 360))
        x, y = 24 + rng.uniform(-1, 1, 2)
        frame = Scene(x=x, y=y, stretch=stretch, **scene)
        image = render(frame, rng)
        for asked, rows in found.items():
            rows.append(error_and_ratio(looked_at(image, frame, rng, asked=asked), x, y))
    return {asked: (np.array(rows)[:, 0], np.array(rows)[:, 1]) for asked, rows in found.items()}


def error_and_ratio(found: Detection, x: float, y: float) -> FloatArray:
    assert found.accepted, found.reason
    assert found.x_px is not None
    assert found.y_px is not None
    assert found.sigma_px is not None
    error = np.array([found.x_px - x, found.y_px - y])
    return np.array([error, error / found.sigma_px])


def seen(frame: Scene, rng: np.random.Generator, *, asked: bool = True) -> Detection:
    return looked_at(render(frame, rng), frame, rng, asked=asked)


def looked_at(image: Image, frame: Scene, rng: np.random.Generator, *, asked: bool) -> Detection:
    full = 2**frame.bits - 1
    sensor = Sensor(full_scale=full, gain_e_per_count=FULL_WELL_E / full, black_level=frame.black, bayer=frame.bayer)  # type: ignore[arg-type]
    expectation = Expectation(
        x_px=frame.x + rng.normal(), y_px=frame.y + rng.normal(), uncertainty_px=1.0, stretch_px_per_rad=frame.stretch
    )
    return detect_sun(image, sensor=sensor, expectation=expectation if asked else None)


def rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


@pytest.mark.parametrize(
    ("limit", "scene"),
    [
        pytest.param(0.012, {"peak": 0.1}, id="a tenth of full scale"),
        pytest.param(0.004, {"peak": 0.5}, id="half of full scale"),
        pytest.param(0.004, {"peak": 0.9}, id="nine tenths of full scale"),
        pytest.param(0.004, {"peak": 0.7, "bits": 10}, id="10 bits"),
        pytest.param(0.004, {"peak": 0.7, "bits": 8}, id="8 bits"),
        pytest.param(0.004, {"peak": 0.7, "bits": 16, "black": 800.0}, id="16 bits above a black level"),
        pytest.param(0.004, {"peak": 3.0}, id="3 times saturated"),
        pytest.param(0.004, {"peak": 30.0}, id="30 times saturated"),
        pytest.param(0.004, {"peak": 100.0}, id="100 times saturated"),
        pytest.param(0.005, {"peak": 0.7, "psf_px": 0.91}, id="blur 30 percent wider than told"),
        pytest.param(0.005, {"peak": 0.7, "psf_px": 0.49}, id="blur 30 percent narrower than told"),
        pytest.param(0.008, {"peak": 0.7, "bayer": "RGGB"}, id="raw Bayer"),
        pytest.param(0.008, {"peak": 20.0, "bayer": "GBRG"}, id="saturated raw Bayer"),
    ],
)
def test_error_is_within_the_limit_and_sigma_tells_it(limit: float, scene: dict[str, Any]) -> None:
    for errors, ratios in measured(**scene).values():
        assert rms(errors) < limit
        assert np.all(np.abs(errors.mean(axis=0)) < 4 * limit / np.sqrt(FRAMES))
        assert 0.8 < float(np.mean(ratios**2)) < 1.25  # ± 0.1 is one sigma of this mean itself


def test_a_hot_pixel_on_the_disc_is_left_out() -> None:
    rng = np.random.default_rng(4)
    scene = Scene(stretch=equisolid_stretch(), x=24.2, y=23.7, peak=0.5)
    image = render(scene, rng)
    image[23, 26] = 4000
    found = detect_sun(
        image,
        sensor=Sensor.from_full_well(full_scale=4095),
        expectation=Expectation(x_px=24, y_px=24, uncertainty_px=1, stretch_px_per_rad=scene.stretch),
    )
    assert found.accepted
    assert found.x_px == pytest.approx(24.2, abs=0.02)
    assert found.y_px == pytest.approx(23.7, abs=0.02)


def test_the_level_of_a_saturated_disc_is_extrapolated() -> None:
    rng = np.random.default_rng(5)
    found = seen(Scene(stretch=equisolid_stretch(), peak=30.0), rng)
    assert found.peak_fraction == pytest.approx(30.0, rel=0.05)
    assert found.saturated_px > 20


def test_the_radius_is_found_without_an_expectation() -> None:
    rng = np.random.default_rng(6)
    scene = Scene(stretch=equisolid_stretch(zenith_deg=80.0), peak=0.7)
    found = seen(scene, rng, asked=False)
    expected = np.sqrt(abs(np.linalg.det(np.array(scene.stretch)))) * np.radians(0.2666)
    assert found.radius_px == pytest.approx(expected, rel=0.02)
