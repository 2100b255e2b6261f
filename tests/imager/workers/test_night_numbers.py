"""The numbers of a night by its images, and the conditions that nights give rise to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tests.fixtures.archive import new_archive
from tests.fixtures.nights import judged
from tests.imager.workers.test_night import BEGIN, CAMERA, Bench, clear, frame_at

from sunarc.detection.stars.photometry import NightLimits
from sunarc.imager.archive.values import CameraRecord
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.workers.night.night import night_conditions
from sunarc.lab.simulation.truth import SGP

LIMITS = NightLimits()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    archive = new_archive(tmp_path)
    archive.cameras.save(CameraRecord.at(SGP, name="roof", width=CAMERA.width, height=CAMERA.height))
    made = Bench(archive)
    made.serve(CAMERA)
    yield made
    archive.close()


def dewed(frame: Frame, depth: float) -> Frame:
    """Return a frame through a wet dome: fainter stars, wider ones, and a part of their light in a halo."""
    sky = float(np.median(frame.image))
    stars = frame.image.astype(np.float64) - sky
    wet = (1.0 - 0.5 * depth) * ((1.0 - 0.4 * depth) * gaussian_filter(stars, 0.9 * depth)) + 0.2 * depth * (
        gaussian_filter(stars, 6.0)
    )
    return replace(frame, image=np.clip(np.rint(wet + sky), 0, 4095).astype(np.uint16))


def test_a_clear_night_has_the_numbers_of_its_air_and_of_its_lens(bench: Bench) -> None:
    details = bench.night(*clear(0, 20, 40, 60, 80, 100)).details
    # 0.2 magnitudes an air mass of the simulated air; the coma at the edge takes a part of the light
    assert 0.13 < details["extinction"] < 0.33
    assert 0.003 < details["extinction_sigma"] < 0.05
    assert 0.02 < details["star_ellipticity"] < 0.4
    assert details["width_growth"] == pytest.approx(1.0, abs=0.06)
    assert abs(details["halo_growth"]) < 0.03
    assert abs(details["fading_mag"]) < 0.12
    images = details["images"]
    assert len(images["time"]) == 6
    assert {len(column) for column in images.values()} == {6}
    assert images["time"][0] == "2013-05-13T05:00:02+00:00"
    assert all(0.0 <= share < 0.3 for share in images["cloud_fraction"])
    assert all(3.5 < limit <= 5.5 for limit in images["limiting_magnitude"])
    # 50,000 electrons a second of V 0 outside the air
    assert np.ptp(images["zero_point"]) < 0.2
    bands = details["zenith_bands"]
    assert [band["from_deg"] for band in bands] == [0.0, 30.0, 50.0, 65.0]
    assert all(0.7 * band["predicted"] < band["found"] <= band["predicted"] for band in bands)
    shares = [band["transparency"] for band in bands]
    assert 0.45 < shares[-1] < shares[0] < 0.95
    assert bench.board.snapshot().reasons == ()


def test_a_dome_that_dews_over_is_suspected_until_the_next_night_without(bench: Bench) -> None:
    frames = [dewed(frame_at(20 * k), max(0.0, (k - 2) / 5.0)) for k in range(8)]
    for frame in frames:
        bench.worker.look_at(frame)
    bench.worker.finish()
    (reason,) = bench.board.snapshot().reasons
    assert reason.code == "night_dew_suspected"
    assert reason.severity == "degraded"
    assert float(reason.data["fading_mag"]) > 0.4
    bench.board.set_condition(reason.code, None)
    bench.worker.publish_conditions()  # as after a restart
    assert [one.code for one in bench.board.snapshot().reasons] == ["night_dew_suspected"]
    night(bench, number=1, star_fwhm_px=2.4, width_growth=1.0, halo_growth=0.0, fading_mag=0.0)
    bench.worker.publish_conditions()
    assert bench.board.snapshot().reasons == ()


def night(bench: Bench, *, number: int, **numbers: Any) -> None:  # noqa: ANN401 - of JSON
    """Store a night."""
    time = BEGIN.replace(month=6, day=number)
    bench.archive.nights.save(judged(f"2013-06-{number:02d}", at=time, verdict="clear", **numbers))


def test_a_lens_out_of_focus_is_said_after_two_nights(bench: Bench) -> None:
    for number, width in enumerate((2.4, 2.5, 2.3, 2.4, 3.3), start=1):
        night(bench, number=number, star_fwhm_px=width)
    bench.worker.publish_conditions()
    assert bench.board.snapshot().reasons == ()
    night(bench, number=6, star_fwhm_px=3.2)
    bench.worker.publish_conditions()
    (reason,) = bench.board.snapshot().reasons
    assert reason.code == "night_focus_worse"
    assert reason.data["ratio"] == pytest.approx(3.2 / 2.4)
    night(bench, number=7, star_fwhm_px=2.4)
    bench.worker.publish_conditions()
    assert bench.board.snapshot().reasons == ()


def test_nights_without_numbers_give_rise_to_nothing() -> None:
    nothing = {"night_focus_worse": None, "night_dew_suspected": None}
    assert night_conditions([], LIMITS) == nothing
    assert night_conditions([judged("2013-06-01", at=BEGIN)] * 9, LIMITS) == nothing
    widths = (9.0, 9.0, 2.0, 2.0, 2.0)
    cloudy = [judged("2013-06-01", at=BEGIN, verdict="cloudy", star_fwhm_px=width) for width in widths]
    assert night_conditions(cloudy, LIMITS) == nothing
