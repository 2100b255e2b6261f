"""The factor between a stated sigma and the scatter of the inliers."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.calibration import SGP, small_camera, stated_calibration
from tests.fixtures.settings import new_settings

from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.values import CameraRecord, SunPoint
from sunarc.imager.live.learned_sigma import ValidCamera, factor_in_force, learn_sigma, series_sigma, sigma_factor
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions

COUNT = 400
MORNING = datetime(2013, 5, 13, 14, 0, tzinfo=UTC)
CAMERA = small_camera()
TRUTH = stated_calibration(CAMERA)


def scattered(sigma_px: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.random.default_rng(8).normal(0.0, sigma_px, (COUNT, 2))


@pytest.mark.parametrize("true", [1.3, 1.5, 3.0])
def test_the_factor_is_that_of_the_scatter(true: float) -> None:
    stated = np.random.default_rng(9).uniform(1.0, 4.0, COUNT)
    factor = sigma_factor(true * stated[:, None] * scattered(1.0), stated)
    assert factor == pytest.approx(true, rel=0.1)


def test_outliers_and_unknown_sigmas_do_not_count() -> None:
    residual, stated = scattered(2.0), np.ones(COUNT)
    residual[::4] += 80.0
    residual[1::40] = np.nan
    stated[2::40] = np.nan
    assert sigma_factor(residual, stated) == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize("true", [0.1, 0.5, 0.95, 1.0, 1.05])
def test_a_sigma_that_is_enough_is_left(true: float) -> None:
    assert sigma_factor(scattered(true), np.ones(COUNT)) is None


@pytest.mark.parametrize("true", [6.0, 20.0])
def test_what_no_detector_is_wrong_by_is_not_learned(true: float) -> None:
    assert sigma_factor(scattered(true), np.ones(COUNT)) is None


@pytest.mark.parametrize(
    ("true", "in_force", "expected"),
    [(0.5, 1.6, 1.0 / 1.6), (0.7, 3.0, 0.7), (0.5, 1.1, None), (1.0, 3.0, None), (2.0, 2.0, 2.0), (2.0, 2.8, None)],
)
def test_a_factor_in_force_is_taken_back_but_not_below_what_is_stated(
    true: float, in_force: float, expected: float | None
) -> None:
    factor = sigma_factor(scattered(true), np.ones(COUNT), in_force=in_force)
    assert factor == (None if expected is None else pytest.approx(expected, rel=0.1))


def test_each_kind_of_sky_has_the_sigma_of_its_own_residuals() -> None:
    """Clear suns as stated; veiled ones with tails; in broken cloud what states half a pixel errs by ten."""
    rng = np.random.default_rng(3)
    sky = np.repeat(["clear", "veiled", "partly_covered", "clear"], [300, 200, 150, 80])
    stated = np.repeat([0.5, 1.0, 0.5, 2.0], [300, 200, 150, 80])
    true = np.repeat([0.5, 2.0, 10.0, 2.0], [300, 200, 150, 80])
    residual = true[:, None] * rng.standard_t(4, (730, 2)) / np.sqrt(2.0)
    sigma = series_sigma(residual, stated, sky.tolist())
    for kind in ("clear", "veiled", "partly_covered"):
        z = (residual / sigma[:, None])[sky == kind]
        assert 0.8 < float(np.sqrt(np.mean(z**2))) < 1.3, kind
    assert len(set(sigma.tolist())) == 4


def test_a_rare_sky_has_the_sigma_of_all_and_none_less_than_is_stated() -> None:
    residual, stated = scattered(3.0), np.ones(COUNT)
    residual[:10] = np.nan
    stated[10:20] = np.nan
    sigma = series_sigma(residual, stated, ["veiled"] * 15 + ["clear"] * (COUNT - 15))
    assert np.isnan(sigma[10:20]).all()
    assert sigma[:10] == pytest.approx(3.0, rel=0.1)
    assert sigma[20:] == pytest.approx(3.0, rel=0.1)
    assert np.all(series_sigma(scattered(0.2), np.ones(COUNT), ["clear"] * COUNT) == 1.0)
    assert np.all(series_sigma(scattered(9.0)[:12], np.ones(12), ["clear"] * 12) == 1.0)


def test_few_sightings_teach_nothing() -> None:
    assert sigma_factor(scattered(2.0)[:19], np.ones(19)) is None
    assert sigma_factor(np.zeros((0, 2)), np.zeros(0)) is None


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    make_empty(tmp_path / "sunarc.sqlite")
    with open_archive(tmp_path / "sunarc.sqlite") as made:
        made.cameras.save(CameraRecord.at(SGP, name="roof", width=CAMERA.width, height=CAMERA.height))
        yield made


def store(archive: Archive, numbers: range, *, sigma_px: float, error_px: float) -> None:
    """Store accepted sightings of a series, so far (1-sigma) from where the camera sees the sun."""
    rng, times = np.random.default_rng(numbers.start), [MORNING + timedelta(minutes=8 * n) for n in numbers]
    pixels = project(CAMERA, sun_directions(np.array([time.timestamp() for time in times]), SGP))
    pixels += rng.normal(0.0, error_px, pixels.shape)
    archive.sightings.add(
        SunPoint(
            camera="roof",
            pose_epoch=archive.epochs.at("roof", time, reason="test").id,
            time=time,
            method="paper",
            accepted=True,
            verdict="clear",
            x_px=x,
            y_px=y,
            sigma_px=sigma_px,
            file=f"{number}.jpg",
        )
        for number, time, (x, y) in zip(numbers, times, pixels.tolist(), strict=True)
    )


def test_what_is_learned_is_in_force_for_later_sightings_and_is_kept(archive: Archive, tmp_path: Path) -> None:
    settings = new_settings(tmp_path)
    store(archive, range(60), sigma_px=1.0, error_px=2.0)
    learn_sigma(archive, settings, [ValidCamera(TRUTH)], now=MORNING)
    learned = factor_in_force(archive, "roof", "paper")
    assert learned == pytest.approx(2.0, rel=0.2)
    assert factor_in_force(archive, "roof", "disc") == 1.0
    assert {point.sigma_px for point in archive.sightings.find("roof")} == {learned}
    store(archive, range(60, 75), sigma_px=learned, error_px=2.0)
    learn_sigma(archive, settings, [ValidCamera(TRUTH)], now=MORNING)
    assert [event.details["factor"] for event in archive.events.find("roof")] == [
        learned
    ]  # as stated: nothing is changed


def test_each_stretch_is_compared_with_its_own_camera(archive: Archive, tmp_path: Path) -> None:
    store(archive, range(70), sigma_px=1.0, error_px=2.0)
    half = (MORNING + timedelta(minutes=8 * 35)).timestamp()
    moved = ValidCamera(stated_calibration(small_camera(mirrored=True)), until=half)
    learn_sigma(archive, new_settings(tmp_path), [moved], now=MORNING)
    assert factor_in_force(archive, "roof", "paper") == 1.0  # the moved camera explains nothing, and 35 are not seen
    learn_sigma(archive, new_settings(tmp_path), [ValidCamera(TRUTH, since=half)], now=MORNING)
    assert factor_in_force(archive, "roof", "paper") == pytest.approx(2.0, rel=0.3)
