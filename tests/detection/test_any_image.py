"""Any array of counts gets an answer from the detectors of sun and stars, or a named error: never a fault of theirs."""

from __future__ import annotations

import numpy as np
import pytest
from tests.detection.random_images import random_images

from sunarc.common.errors import InputError
from sunarc.detection.stars.detect import detect_stars
from sunarc.detection.values import Expectation
from sunarc.sources.detect_files import METHODS, detect_in_image, estimated_full_scale

COUNT = 60


def test_the_sun_is_looked_for_in_any_image() -> None:
    rng = np.random.default_rng(5)
    for image in random_images(COUNT, seed=3):
        rows, columns = image.shape[:2]
        x, y = rng.uniform(-20.0, columns + 20.0), rng.uniform(-20.0, rows + 20.0)
        place = Expectation(x_px=x, y_px=y, uncertainty_px=rng.uniform(0.5, 30.0))
        answers = [detect_in_image(image, method=method) for method in METHODS]
        answers += [detect_in_image(image, expectation=place, elsewhere=elsewhere) for elsewhere in (True, False)]
        assert all(one.findings or one.accepted for one in answers)
        for one in answers:
            if one.x_px is not None:
                assert np.isfinite([one.x_px, one.y_px or np.nan]).all()


def test_stars_are_looked_for_in_any_image() -> None:
    for image in random_images(COUNT, seed=4):
        stars = detect_stars(image, full_scale=estimated_full_scale(image))
        assert np.all(np.isfinite(stars.pixels))
        assert not np.any(np.isnan(stars.sigma_px))


def test_a_mosaic_without_a_cell_of_its_colours_is_named() -> None:
    for shape in ((1, 40), (40, 1), (1, 1)):
        image = np.full(shape, 200, dtype=np.uint8)
        for look in (
            lambda one: detect_in_image(one, method="paper", bayer="RGGB"),
            lambda one: detect_stars(one, full_scale=255, bayer="RGGB"),
        ):
            with pytest.raises(InputError, match="2 x 2"):
                look(image)
    assert not detect_in_image(np.full((2, 2), 200, dtype=np.uint8), method="paper", bayer="RGGB").accepted
