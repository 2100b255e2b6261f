"""Two passes: the camera that most sightings agree on predicts the sun, and what is not there is looked at again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.fixtures.calibration import SGP, small_camera, stated_calibration
from tests.fixtures.settings import new_settings

from sunarc.archives import fit, passes, states
from sunarc.archives.ingest import IngestOptions, ingest_folder
from sunarc.archives.ingest_summary import IngestSummary
from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.findings import Finding
from sunarc.detection.photo.ordinary_image import Photo
from sunarc.detection.values import Detection, Expectation
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.values import SunPoint
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions
from sunarc.sources import look
from sunarc.sources.expected_sun import PREDICTED, SEARCHED

MORNING = datetime(2013, 5, 13, 14, 0, tzinfo=UTC)
CAMERA = small_camera()
TRUTH = stated_calibration(CAMERA)
COUNT = 12
REFUSED = Verdict(accepted=False, findings=(Finding("too_few_sightings", {"n": 1, "least": 20}),))
STATED_PX = 2.0
NEAR_PX, MOST = 30.0, 0.75


def sun_px(number: int, camera: Camera = CAMERA) -> tuple[float, float]:
    x, y = project(camera, sun_directions((MORNING + timedelta(minutes=30 * number)).timestamp(), SGP)).tolist()
    return x, y


def draw(folder: Path, number: int, *bright: tuple[float, float], suffix: str = "") -> None:
    """Write an image with bright points; the brightest is what a detector finds without a prediction."""
    image = np.zeros((CAMERA.height, CAMERA.width), dtype=np.uint8)
    for level, (x, y) in zip((255, 200), bright, strict=False):
        image[round(y), round(x)] = level
    folder.mkdir(exist_ok=True)
    time = MORNING + timedelta(minutes=30 * number)
    cv2.imwrite(str(folder / f"{time:%Y%m%dT%H%M%SZ}{suffix}.png"), image)


def find(image: np.ndarray[Any, Any], *, expectation: Expectation | None, **_: object) -> Detection:
    """Return the brightest point, or with a prediction the one within 20 px of it."""
    points = [(float(x), float(y), int(image[y, x])) for y, x in np.argwhere(image > 0)]
    if expectation is not None:
        points = [p for p in points if math.hypot(p[0] - expectation.x_px, p[1] - expectation.y_px) < 20.0]
    if not points:
        missing = (Finding("no_round_region"),)
        return Detection(method="paper", accepted=False, verdict="hidden", findings=missing)
    x, y, _level = max(points, key=lambda point: point[2])
    found = (Finding("blob_found", {"diameter_px": 9.0, "share": 1.0}),)
    return Detection(method="paper", accepted=True, verdict="clear", findings=found, x_px=x, y_px=y, sigma_px=STATED_PX)


class Fits:
    """In place of `calibrate`: answers with that of some cameras which most sightings are near, and remembers these."""

    def __init__(self, *answers: Calibration) -> None:
        self.given: list[Sightings] = []
        self._answers = answers

    def __call__(self, points: Sightings, **_: object) -> Calibration:
        self.given.append(points)
        directions = sun_directions(points.unix_s, SGP)
        shares = [
            float(np.mean(np.linalg.norm(points.pixels - project(one.camera, directions), axis=-1) < NEAR_PX))
            for one in self._answers
        ]
        best = self._answers[int(np.argmax(shares))]
        return best if max(shares) >= MOST else replace(best, verdict=REFUSED)


@pytest.fixture
def images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(look, "detect_in_image", find)
    return tmp_path / "images"


def ingested(
    images: Path,
    monkeypatch: pytest.MonkeyPatch,
    fits: Fits,
    judged: Calibration = TRUTH,
    **more: Any,  # noqa: ANN401
) -> IngestSummary:
    monkeypatch.setattr(states, "calibrate", fits)
    monkeypatch.setattr(fit, "calibrate", lambda *_, **__: judged)
    return ingest_folder(new_settings(images.parent), images, options=IngestOptions(**more))


def stored(images: Path) -> tuple[SunPoint, ...]:
    with open_archive(images.parent / "state" / "sunarc.sqlite") as archive:
        return archive.sightings.find("roof")


def errors_px(points: Sequence[SunPoint]) -> list[float]:
    """Return how far sightings are from the sun."""
    numbers = [round((point.time - MORNING).total_seconds() / 1800) for point in points]
    pairs = zip(points, (sun_px(n) for n in numbers), strict=True)
    return [math.hypot((p.x_px or 0.0) - x, (p.y_px or 0.0) - y) for p, (x, y) in pairs]


def test_a_ghost_is_replaced_by_the_sun_beside_it_and_a_ghost_alone_is_rejected(
    images: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ghost = (40.0, 60.0)
    for number in range(COUNT):
        draw(images, number, *{3: (ghost, sun_px(3)), 5: (ghost,)}.get(number, (sun_px(number),)))
    fits = Fits(TRUTH)
    summary = ingested(images, monkeypatch, fits)
    assert (summary.accepted, summary.rejected) == (COUNT - 1, 1)
    assert summary.by_verdict == {"clear": COUNT - 1, "reflection": 1}
    assert len(fits.given[0]) == COUNT
    accepted = [point for point in stored(images) if point.accepted]
    assert max(errors_px(accepted)) < 1.0
    assert {point.ingest_pass for point in stored(images)} == {PREDICTED}


def test_a_stack_is_looked_at_again_as_a_whole_where_its_sighting_is_a_ghost(
    images: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked_at: list[tuple[int, bool]] = []

    def find_in_stack(exposures: list[Photo], *, expectation: Expectation | None, **_: object) -> Detection:
        looked_at.append((len(exposures), expectation is not None))
        return find(exposures[0].image, expectation=expectation)

    monkeypatch.setattr(look, "detect_sun_in_stack", find_in_stack)
    for number in range(COUNT):
        for exposure in ("20us", "5us"):
            draw(images, number, *{3: ((40.0, 60.0), sun_px(3))}.get(number, (sun_px(number),)), suffix=f"_{exposure}")
    summary = ingested(images, monkeypatch, Fits(TRUTH), method="paper")
    assert (summary.accepted, summary.rejected, summary.stacked) == (COUNT, 0, COUNT)
    assert looked_at == [(2, False)] * COUNT + [(2, True)]
    points = stored(images)
    assert {point.ingest_pass for point in points} == {PREDICTED}
    assert max(errors_px([point for point in points if point.accepted])) < 1.0


def test_a_run_after_the_first_looks_at_nothing_and_fits_nothing(images: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(COUNT):
        draw(images, number, sun_px(number))
    ingested(images, monkeypatch, Fits(TRUTH))
    fits = Fits(TRUTH)
    monkeypatch.setattr(passes, "find_static_mask", None)  # nor are images read for a mask
    again = ingested(images, monkeypatch, fits)
    assert (again.known, again.accepted, again.rejected, fits.given) == (COUNT, 0, 0, [])


def test_a_run_that_was_broken_off_goes_on_where_it_was(images: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(COUNT):
        draw(images, number, sun_px(number))

    def broken_off(_stage: str, done: int, _total: int) -> None:
        if done == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(states, "calibrate", Fits(TRUTH))
    with pytest.raises(KeyboardInterrupt):
        ingest_folder(new_settings(images.parent), images, options=IngestOptions(), progress=broken_off)
    assert [point.ingest_pass for point in stored(images)] == [SEARCHED] * 5
    summary = ingested(images, monkeypatch, Fits(TRUTH))
    assert (summary.known, summary.accepted) == (5, COUNT - 5)
    assert {point.ingest_pass for point in stored(images)} == {PREDICTED}


def test_without_a_camera_the_first_answers_stay_and_the_reason_is_given(
    images: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(COUNT):
        draw(images, number, sun_px(number))
    summary = ingested(images, monkeypatch, Fits(refusing()))
    assert [finding.code for finding in summary.camera_findings] == ["too_few_sightings"]
    assert "20" in summary.camera_findings[0].sentence
    assert {point.ingest_pass for point in stored(images)} == {SEARCHED}
    assert summary.accepted == COUNT


@pytest.mark.parametrize("judged", [TRUTH, replace(TRUTH, verdict=REFUSED)], ids=["accepted", "refused"])
def test_only_an_accepted_epoch_lifts_the_refusal_of_a_sun(
    images: Path, monkeypatch: pytest.MonkeyPatch, judged: Calibration
) -> None:
    """What the first pass refused in cloud, a prediction finds at a gap; images wait until an epoch is accepted."""
    cloud, ghost = (5.0, 5.0), (40.0, 60.0)

    def find_or_refuse(image: np.ndarray[Any, Any], *, expectation: Expectation | None, **more: object) -> Detection:
        if expectation is None and image[5, 5] > 0:
            return Detection(method="paper", accepted=False, verdict="veiled", findings=(Finding("no_round_region"),))
        return find(image, expectation=expectation, **more)

    monkeypatch.setattr(look, "detect_in_image", find_or_refuse)
    for number in range(COUNT + 4):
        x, y = sun_px(number)
        draw(images, number, *{3: ((x + 5.0, y), cloud), 5: (ghost, (x, y))}.get(number, ((x, y),)))
    summary = ingested(images, monkeypatch, Fits(TRUTH), judged)
    veiled = next(point for number, point in enumerate(stored(images)) if number == 3)
    if judged.verdict.accepted:
        assert (veiled.accepted, veiled.ingest_pass, summary.camera_findings) == (True, PREDICTED, ())
    else:
        assert (veiled.accepted, veiled.verdict, veiled.ingest_pass) == (False, "veiled", SEARCHED)
        assert summary.camera_findings == REFUSED.findings
        assert max(errors_px([point for point in stored(images) if point.accepted])) < 1.0  # a sighting may move
        again = ingested(images, monkeypatch, Fits(TRUTH), TRUTH)
        assert (again.known, stored(images)[3].accepted) == (COUNT + 4, True)


def refusing() -> Calibration:
    return replace(TRUTH, verdict=REFUSED)


def test_a_mirrored_camera_is_named_where_the_settings_say_otherwise(
    images: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mirrored = small_camera(mirrored=True)
    for number in range(COUNT):
        draw(images, number, sun_px(number, mirrored))
    summary = ingested(images, monkeypatch, Fits(stated_calibration(mirrored)))
    assert [(one.code, one.data) for one in summary.camera_findings] == [
        ("mirrored_setting_differs", {"mirrored": "yes"})
    ]


def test_images_mirrored_midway_are_not_accepted(images: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(COUNT):
        x, y = sun_px(number)
        draw(images, number, (CAMERA.width - 1 - x, y) if number in {8, 9} else (x, y))
    ingested(images, monkeypatch, Fits(TRUTH))
    points = stored(images)
    assert [number for number, point in enumerate(points) if not point.accepted] == [8, 9]


def test_the_learned_sigma_is_stored(images: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    for number in range(3 * COUNT):
        x, y = np.array(sun_px(number % 20 + 48 * (number // 20))) + 5.0 * rng.standard_normal(2)
        draw(images, number % 20 + 48 * (number // 20), (float(x), float(y)))
    ingested(images, monkeypatch, Fits(TRUTH))
    sigma = {point.sigma_px for point in stored(images)}
    assert len(sigma) == 1
    assert 3.5 < float(sigma.pop() or 0.0) < 7.0


def test_a_camera_that_was_moved_after_weeks_is_fitted_again(images: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    moved = small_camera(mirrored=True)
    after = 48 * 25
    for number in range(COUNT):
        draw(images, number, sun_px(number))
        draw(images, after + number, sun_px(after + number, moved))
        draw(images, 2 * after + number, sun_px(2 * after + number, moved))
    fits = Fits(TRUTH, stated_calibration(moved))
    summary = ingested(images, monkeypatch, fits)
    assert summary.by_verdict == {"clear": 3 * COUNT}
    assert len(fits.given[-1]) > COUNT  # the third stretch is of the second's camera
