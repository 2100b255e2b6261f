"""Stand-ins of photographs in a series: what was learned from it agrees with the true error, then and later."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.detection.photo.facts import KINDS, sun_photo
from tests.fixtures.calibration import SGP, ideal_camera, stated_calibration
from tests.fixtures.settings import new_settings

from sunarc.archives import states
from sunarc.archives.ingest import IngestOptions, ingest_folder
from sunarc.imager.archive.archive import open_archive
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions

SIZE = 480
CAMERA = replace(
    ideal_camera(), width=SIZE, height=SIZE, principal_point_px=(239.5, 239.5), focal_length_px=(150.0, 150.0)
)
MORNING = datetime(2013, 5, 13, 14, 30, tzinfo=UTC)
EVEN = KINDS["clear, saturated"]._replace(uneven=(0.4, 0.4))
SHAKEN_PX = 1.0
"""1-sigma per axis by which the camera shakes: what the detector states is too little."""


def sun_px(time: datetime) -> tuple[float, float]:
    x, y = project(CAMERA, sun_directions(time.timestamp(), SGP)).tolist()
    return x, y


def draw(folder: Path, numbers: range, *, every_min: float = 12.0) -> None:
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng([5, numbers.start])
    for number in numbers:
        time = MORNING + timedelta(minutes=every_min * number)
        x, y = sun_px(time) + rng.normal(0.0, SHAKEN_PX, 2)
        image, _ = sun_photo(EVEN, rng, size=SIZE, place=(float(x), float(y)))
        cv2.imwrite(str(folder / f"{time:%Y%m%dT%H%M%SZ}.png"), image)


def chi2(folder: Path, *, since: datetime) -> tuple[int, float]:
    """Return the number of accepted sightings, and their squared error per axis over the stated variance."""
    with open_archive(folder / "state" / "sunarc.sqlite") as archive:
        points = [point for point in archive.sightings.find("roof") if point.accepted and point.time >= since]
    ratios = []
    for point in points:
        x, y = sun_px(point.time)
        ratios.append(math.hypot((point.x_px or 0.0) - x, (point.y_px or 0.0) - y) / (point.sigma_px or math.nan))
    return len(ratios), float(np.mean(np.square(ratios))) / 2.0


def test_the_sigma_learned_from_a_series_is_its_error_and_that_of_what_comes_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(states, "calibrate", lambda *_, **__: stated_calibration(CAMERA))
    images = tmp_path / "images"
    found = []
    for numbers in (range(40), range(40, 50)):
        draw(images, numbers)
        ingest_folder(new_settings(tmp_path), images, options=IngestOptions(method="paper"))
        found.append(chi2(tmp_path, since=MORNING + timedelta(minutes=12.0 * numbers.start)))
    (count, then), (more, later) = found
    with open_archive(tmp_path / "state" / "sunarc.sqlite") as archive:
        (learned,) = archive.events.find("roof")
    factor = learned.details["factor"]
    assert count >= 30
    assert then * factor**2 > 1.3  # what the detector states is too little
    assert 0.75 < then < 1.3
    assert more >= 6
    assert 0.4 < later < 2.0  # of few sightings; without the factor 1.5 times as much
    ingest_folder(new_settings(tmp_path), images, options=IngestOptions(method="paper", reprocess=True))
    assert 0.75 < chi2(tmp_path, since=MORNING)[1] < 1.3
