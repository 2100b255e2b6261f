"""The moon at night: its exposures, its sightings among rendered nights, and what makes none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.fixtures.archive import new_archive
from tests.imager.workers.test_night import CAMERA, calibration_of

from sunarc.detection.moon import Cutout, brightest_cutouts
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.values import CameraRecord, SunPoint
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.workers.night.exposures import MOST_LEVEL, MoonExposures
from sunarc.imager.workers.night.moon import MoonImages, MoonNight, brightest_level
from sunarc.imager.workers.options import SensorOptions
from sunarc.imaging.exposure import ExposureBounds
from sunarc.lab.simulation.options import SceneOptions, SimulatedNight
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.night import MoonDisc, body_position, moon_disc

HALF = datetime(2013, 5, 18, 3, 20, tzinfo=UTC)
"""The moon half lit, 50 degrees high."""
FULL = datetime(2013, 5, 25, 5, 0, tzinfo=UTC)
BOUNDS = ExposureBounds(minimum_us=10.0, maximum_us=30e6, step_us=1.0)
SENSOR = SensorOptions(black_level_fraction=32.0 / 4095.0)


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    made = new_archive(tmp_path)
    made.cameras.save(CameraRecord.at(SGP, name="roof", width=CAMERA.width, height=CAMERA.height))
    yield made
    made.close()


def disc_at(time: datetime) -> MoonDisc:
    return moon_disc(time.timestamp(), SGP)


@cache
def scene_of(**sky: Any) -> Scene:  # noqa: ANN401 - of `SceneOptions`
    night = SimulatedNight(warm_spots=0, satellites=0.0, aircraft=0.0, faintest=2.0)
    return Scene(CAMERA, SGP, options=SceneOptions(night=night, **sky))


def frame(
    time: datetime,
    exposure_us: float,
    *,
    pixel_format: str = "Mono12",
    shown: datetime | None = None,
    **sky: Any,  # noqa: ANN401
) -> Frame:
    scene = scene_of(**sky)
    start = time if shown is None else shown
    bayer: Any = "RGGB" if pixel_format.startswith("Bayer") else None
    image = scene.render(int(start.timestamp() * 1e6), exposure_us=exposure_us, bayer=bayer)
    return Frame(
        image=image, time=time + timedelta(microseconds=exposure_us / 2.0), exposure_us=exposure_us, gain_db=0.0,
        pixel_format=pixel_format, full_scale=4095, frame_id=0,
    )  # fmt: skip


def night(
    archive: Archive,
    begin: datetime,
    *,
    slots: int = 4,
    camera: Camera = CAMERA,
    late_s: float = 0.0,
    **options: Any,  # noqa: ANN401
) -> tuple[MoonNight, list[tuple[float, ...]]]:
    """Return what a night gave, every slot with the exposures that were chosen."""
    exposures, chosen = MoonExposures(disc_at), []
    images = MoonImages(CameraArchive(archive, name="roof", site=SGP), options=SENSOR, exposures=exposures)
    for slot in range(slots):
        time = begin + timedelta(minutes=10 * slot)
        wanted = exposures.next_us(time, BOUNDS)
        chosen.append(wanted)
        shown = time + timedelta(seconds=late_s)
        if wanted:
            images.add([frame(time, us, shown=shown, **options) for us in wanted])
    found = images.finish(calibration_of(camera), within_px=1.0, clock_error_s=lambda _: 0.01)
    return found, chosen


def errors(points: tuple[SunPoint, ...]) -> np.ndarray[Any, np.dtype[np.float64]]:
    unix_s = np.array([point.time.timestamp() for point in points])
    true = project(CAMERA, np.array([body_position("moon", at, SGP).direction for at in unix_s.tolist()]))
    return np.array([[point.x_px, point.y_px] for point in points]) - true


@pytest.mark.parametrize(
    ("begin", "pixel_format"),
    [(HALF, "Mono12"), (FULL, "Mono12"), (HALF, "BayerRG12")],
    ids=["half", "full", "half behind a mosaic"],
)
def test_a_night_s_moon_becomes_sightings(archive: Archive, begin: datetime, pixel_format: str) -> None:
    found, chosen = night(archive, begin, pixel_format=pixel_format)
    assert (len(found.points), found.images, found.refused) == (4, 4, ())
    assert len(chosen[0]) == 5
    assert [len(one) for one in chosen[1:]] == [2, 2, 2]
    assert {(point.body, point.method, point.accepted, point.verdict) for point in found.points} == {
        ("moon", "moon", True, "clear")
    }
    off = errors(found.points)
    sigma = np.array([point.sigma_px for point in found.points])
    assert float(np.max(np.linalg.norm(off, axis=-1) / sigma)) < 3.0
    assert float(np.sqrt(np.mean(off**2))) < 0.06
    assert all(0.01 < (point.peak_fraction or 0.0) < 1.0 for point in found.points)


@pytest.mark.parametrize("pixel_format", ["Mono12", "BayerRG12"])
@pytest.mark.parametrize(("begin", "exposure_us"), [(HALF, 160.0), (FULL, 20.0)], ids=["half", "full"])
def test_the_level_of_a_moon_is_that_of_its_brightest_pixel(
    begin: datetime, exposure_us: float, pixel_format: str
) -> None:
    for slot in range(4):
        seen = frame(begin + timedelta(minutes=10 * slot), exposure_us, pixel_format=pixel_format)
        cutouts = brightest_cutouts(seen.image, full_scale=seen.full_scale)
        assert brightest_level(seen, cutouts) == pytest.approx(
            float(np.max(cutouts[0].image)) / seen.full_scale, rel=1e-6
        )


@pytest.mark.parametrize("stuck", [((10, 10),), ((10, 10), (10, 11)), ((24, 28), (25, 28))])
def test_two_stuck_pixels_do_not_make_the_level(stuck: tuple[tuple[int, int], ...]) -> None:
    """Alone in the sky, beside each other, and at the moon's limb, where some of its light lies about them."""
    seen = frame(HALF, 160.0)
    (moon, *_) = brightest_cutouts(seen.image, full_scale=seen.full_scale)
    level = brightest_level(seen, (moon,))
    image = moon.image.copy()
    for row, column in stuck:
        image[row, column] = seen.full_scale
    assert level <= brightest_level(seen, (Cutout(moon.x, moon.y, image),)) < MOST_LEVEL
    whole = np.full_like(image, seen.full_scale)
    assert brightest_level(seen, (Cutout(moon.x, moon.y, whole),)) == 1.0
    assert brightest_level(seen, ()) == 0.0


def test_clouds_before_the_moon_leave_nothing_and_the_reason(archive: Archive) -> None:
    found, _ = night(archive, HALF, weather=("overcast",))
    assert found.points == ()
    assert found.images == 4
    assert {one.code for one in found.refused} <= {"moon_not_found", "moon_in_cloud", "moon_poor_fit"}
    assert found.refused


@pytest.mark.parametrize(("turn", "late_s"), [(0.1, 0.0), (0.0, 600.0), (0.0, -3600.0)])
def test_a_moon_that_is_not_where_it_was_predicted_is_not_used(archive: Archive, turn: float, late_s: float) -> None:
    axis = np.array(CAMERA.rotation_cam_enu)
    turned = tuple((axis * (1.0 + turn / np.linalg.norm(axis))).tolist())
    found, _ = night(archive, HALF, camera=replace(CAMERA, rotation_cam_enu=turned), late_s=late_s)
    assert found.points == ()
    assert found.refused[0].code in {"moon_not_found", "moon_displaced"}


def test_one_sighting_alone_is_compared_with_none_and_not_used(archive: Archive) -> None:
    found, _ = night(archive, HALF, slots=1)
    assert found.points == ()
    assert [one.code for one in found.refused] == ["moon_few"]


def test_a_frozen_image_gives_no_second_sighting(archive: Archive) -> None:
    exposures = MoonExposures(disc_at)
    images = MoonImages(CameraArchive(archive, name="roof", site=SGP), options=SENSOR, exposures=exposures)
    one = frame(HALF, 160.0)
    for slot in range(4):
        images.add([replace(one, time=one.time + timedelta(minutes=10 * slot))])
    found = images.finish(calibration_of(CAMERA), within_px=1.0, clock_error_s=lambda _: 0.01)
    assert found.points == ()
    assert found.refused[-1].code == "moon_few"


def test_sightings_are_kept_with_their_body_in_the_epochs_of_their_times(archive: Archive) -> None:
    archive.epochs.open("roof", at=HALF - timedelta(days=1), reason="installed")
    found, _ = night(archive, HALF)
    archive.epochs.open("roof", at=HALF + timedelta(minutes=15), reason="moved")
    assert archive.sightings.add(found.points) == 4
    columns = archive.sightings.columns("roof", body=None)
    assert set(columns.body.tolist()) == {"moon"}
    assert columns.epoch.tolist() == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("time", "exposures"),
    [
        (HALF, 5),
        (HALF + timedelta(hours=5), 0),
        (datetime(2013, 5, 10, 2, 0, tzinfo=UTC), 0),
    ],
    ids=["high", "set", "new moon"],
)
def test_only_a_moon_that_is_up_is_exposed(time: datetime, exposures: int) -> None:
    assert len(MoonExposures(disc_at).next_us(time, BOUNDS)) == exposures


def test_the_exposure_follows_phase_and_height() -> None:
    exposures = MoonExposures(disc_at)
    exposures.report(FULL, ((100.0, 0.25),))
    short, long = exposures.next_us(FULL, BOUNDS)
    assert long == pytest.approx(200.0)
    assert short == pytest.approx(long / 3.0)
    half = exposures.next_us(HALF, BOUNDS)[1]
    assert 2.0 < half / long < 8.0  # a half moon's surface is about a third as bright


def test_clipped_images_shorten_it_and_images_without_a_moon_begin_anew() -> None:
    exposures = MoonExposures(disc_at)
    exposures.report(FULL, ((100.0, 0.25),))
    before = exposures.next_us(FULL, BOUNDS)[1]
    exposures.report(FULL, ((60.0, 0.99), (200.0, 0.99)))
    assert exposures.next_us(FULL, BOUNDS)[1] == pytest.approx(before / 9.0)
    for _ in range(3):
        exposures.report(FULL, ((60.0, 0.0), (200.0, 0.0)))
    assert len(exposures.next_us(FULL, BOUNDS)) == 5


def test_a_cloud_makes_it_longer_by_a_factor_of_two_at_most() -> None:
    exposures = MoonExposures(disc_at)
    exposures.report(FULL, ((100.0, 0.25),))
    exposures.report(FULL, ((200.0, 0.01),))
    assert exposures.next_us(FULL, BOUNDS)[1] == pytest.approx(400.0)
