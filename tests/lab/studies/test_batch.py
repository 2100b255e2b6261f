"""Many sets of one geometry: each is fitted as `calibrate` fits it alone."""

from __future__ import annotations

import numpy as np
import population as pop
import pytest
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, Method
from sunarc.calibration.model.sightings import Sightings
from sunarc.lab.studies.trials import Batch
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]

SKY = hemisphere(300)
TRUTH = pop.random_camera(np.random.default_rng(3))
TIMES = pop.sun_track(np.zeros(1), cadence_s=60.0)
EXACT = pop.sightings(TRUTH, TIMES, np.zeros((TIMES.size, 2)))


def _circle(dx: float) -> ImageCircle:
    x, y = TRUTH.principal_point_px
    return ImageCircle(x=x + dx, y=y - 1.0, radius=TRUTH.focal_length_px[0] * 2.0**0.5 + 0.7)


def _alone(pixels: FloatArray, method: Method, circle: ImageCircle) -> Camera:
    return calibrate(
        Sightings.of(unix_s=TIMES, pixels=pixels),
        site=pop.SGP,
        image_size=(TRUTH.width, TRUTH.height),
        options=CalibrationOptions(method=method),
        circle=circle,
    ).camera


def _apart_px(one: Camera, other: Camera) -> float:
    return float(np.sqrt(np.mean(np.sum((project(one, SKY) - project(other, SKY)) ** 2, axis=-1))))


@pytest.mark.parametrize("method", ["robust", "paper"])
def test_every_set_gives_the_camera_of_a_fit_alone(method: Method) -> None:
    options = CalibrationOptions(method=method)
    batch = Batch.near(TRUTH, EXACT, site=pop.SGP, options=options, circle=_circle(0.0))
    for seed in (1, 2):
        pixels = EXACT.pixels + np.random.default_rng(seed).normal(0.0, 0.3, EXACT.pixels.shape)
        found = batch.fitted(pixels, _circle(float(seed)))
        alone = _alone(pixels, method, _circle(float(seed)))
        assert _apart_px(found, alone) < 0.02
        assert _apart_px(found, TRUTH) > 0.05  # and not where it began
        assert found.max_angle == pytest.approx(alone.max_angle, abs=1e-3)


def test_outliers_and_a_field_are_seen_as_alone() -> None:
    rng = np.random.default_rng(5)
    field = pop.smooth_field(rng, amplitude_px=0.4, length_px=425.0)
    noise = pop.biased_outliers(rng, rng.normal(0.0, 0.03, (TIMES.size, 2)), share=0.2, offset_px=8.0)
    pixels = EXACT.pixels + field(EXACT.pixels) + noise
    circle = _circle(0.0)
    found = Batch.near(TRUTH, EXACT, site=pop.SGP, options=CalibrationOptions(), circle=circle).fitted(pixels, circle)
    alone = _alone(pixels, "robust", circle)
    assert found.displacement is not None
    assert alone.displacement is not None
    assert _apart_px(found, alone) < 0.05


@pytest.mark.parametrize("method", ["robust", "paper"])
def test_without_noise_the_true_camera_comes_out(method: Method) -> None:
    batch = Batch.near(TRUTH, EXACT, site=pop.SGP, options=CalibrationOptions(method=method), circle=_circle(0.0))
    assert _apart_px(batch.fitted(EXACT.pixels, _circle(0.0)), TRUTH) < 0.05
