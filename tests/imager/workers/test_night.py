"""Images of a simulated night become sightings of named stars and a verdict, or none and the reason."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.fixtures.archive import add_after_opening, new_archive
from tests.fixtures.calibrations import chosen_calibration

from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import Image
from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.archive.obstructions import LearnedObstructions, ObstructionLearner
from sunarc.imager.archive.values import CameraRecord, Event, Refit
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.night.exposures import NightCapture, NightExposures
from sunarc.imager.workers.night.night import NightWorker
from sunarc.imager.workers.options import SensorOptions
from sunarc.imaging.horizon import horizon_profile
from sunarc.imaging.obstructions import FREE, HIDDEN, ObstructionMask
from sunarc.lab.simulation.options import SceneOptions, SimulatedNight, Weather
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.night import STAR, body_directions

BEGIN = datetime(2013, 5, 13, 5, 0, tzinfo=UTC)
EXPOSURE_US = 5e6


def small_camera() -> Camera:
    """Return the paper's camera at half its size, for speed."""
    full = true_camera()
    (fx, fy), (x, y) = full.focal_length_px, full.principal_point_px
    return replace(
        full,
        width=full.width // 2,
        height=full.height // 2,
        focal_length_px=(fx / 2, fy / 2),
        principal_point_px=(x / 2, y / 2),
    )


CAMERA = small_camera()


def calibration_of(camera: Camera) -> Calibration:
    calibration = chosen_calibration(
        camera,
        names=("principal_point_x_px", "principal_point_y_px"),
        covariance=0.01 * np.eye(2),
        orders=np.array([[1, 1]]),
    )
    return replace(calibration, site=SGP)


@cache
def image_at(minutes: int, weather: Weather = "clear", *, moon: bool = False) -> Image:
    options = SimulatedNight(moon=moon, star_e_per_s=50_000.0, faintest=6.0, warm_spots=120)
    scene = Scene(CAMERA, SGP, options=SceneOptions(night=options, weather=(weather,)))
    start = BEGIN + timedelta(minutes=minutes)
    return scene.render(int(start.timestamp() * 1e6), exposure_us=EXPOSURE_US)


def frame_at(minutes: int, *, shown: int | None = None, **options: Any) -> Frame:  # noqa: ANN401 - of `image_at`
    image = image_at(minutes if shown is None else shown, **options)
    middle = BEGIN + timedelta(minutes=minutes, microseconds=EXPOSURE_US / 2.0)
    return Frame(
        image=image, time=middle, exposure_us=EXPOSURE_US, gain_db=0.0, pixel_format="Mono12", full_scale=4095,
        frame_id=minutes,
    )  # fmt: skip


@dataclass
class Bench:
    """A night worker on an archive of its own."""

    archive: Archive
    zenith_deg: float = 120.0
    trusted: bool = True
    clock_error_s: float = 0.01
    now: datetime = BEGIN + timedelta(hours=6)
    passes_s: float = 0.0
    """By so much time goes on with each look at it."""
    refits: list[str] = field(default_factory=list)
    store: ImageStore | None = None
    warm_pixels: Path | None = None

    def __post_init__(self) -> None:
        self.capture = NightCapture(NightExposures(), DropOldestQueue(capacity=9))
        self.camera = CameraArchive(self.archive, name="roof", site=SGP)
        self.board = StatusRegistry(version="0", started_at=BEGIN, monotonic=lambda: 0.0)
        self.worker = NightWorker(
            self.capture,
            camera=self.camera,
            options=SensorOptions(),
            apparent_zenith=lambda: self.zenith_deg,
            clock_error_s=lambda _: self.clock_error_s,
            trusted=lambda: self.trusted,
            now=self.tell,
            request_refit=self.ask,
            board=self.board,
            store=self.store,
            warm_pixels=self.warm_pixels,
            resumes=True,
        )
        self.worker.resume()

    def tell(self) -> datetime:
        self.now += timedelta(seconds=self.passes_s)
        return self.now

    def ask(self, reason: str) -> Refit:
        self.refits.append(reason)
        return Refit(id=f"{len(self.refits)}", camera="roof", requested_at=BEGIN, reason=reason)

    def serve(self, camera: Camera) -> None:
        epoch = self.archive.epochs.at("roof", BEGIN - timedelta(days=1), reason="first frame")
        document = to_document(
            calibration_of(camera), id="day", camera="roof", state="candidate", created_at=BEGIN,
            valid_from=BEGIN - timedelta(days=1), valid_until=None, pose_epoch=epoch.id, software_version="0",
        )  # fmt: skip
        self.archive.calibrations.add(document)
        self.archive.calibrations.activate("day")

    def night(self, *frames: Frame) -> Event:
        for frame in frames:
            self.worker.look_at(frame)
        self.worker.finish()
        (event,) = self.archive.events.find("roof", kind="night")
        return event


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    archive = new_archive(tmp_path)
    archive.cameras.save(CameraRecord.at(SGP, name="roof", width=CAMERA.width, height=CAMERA.height))
    yield Bench(archive)
    archive.close()


def clear(*minutes: int) -> list[Frame]:
    return [frame_at(minute) for minute in minutes or (0, 40, 80)]


def test_a_clear_night_is_named_stored_and_fitted(bench: Bench) -> None:
    bench.serve(CAMERA)
    event = bench.night(*clear())
    details = event.details
    assert details["verdict"] == "clear"
    assert (details["n_images"], details["n_accepted"]) == (3, 3)
    assert details["cloud_fraction"] < 0.25
    assert 3.5 <= details["limiting_magnitude"] <= 5.5
    assert 1.5 < details["star_fwhm_px"] < 3.5
    assert details["transparency"] == pytest.approx(10.0**-0.08, abs=0.06)  # coma at the edge takes a part
    assert bench.refits == ["after the night of 2013-05-12 (clear)"]
    columns = bench.archive.sightings.columns("roof", body=None)
    assert 60 <= columns.ids.size == details["n_stored"] <= 90
    assert np.all(np.char.startswith(columns.body, STAR))
    true = project(CAMERA, body_directions(columns.body, columns.unix_s, SGP))
    apart = np.linalg.norm(columns.pixels - true, axis=-1)
    assert apart.max() < 1.0
    assert np.median(apart) < 0.15
    assert 0.01 < details["star_offset_px"] < 0.3  # the coma of the simulated lens
    outwards = (true - np.array(CAMERA.principal_point_px)) / CAMERA.focal_length_px[0]
    size = np.linalg.norm(outwards, axis=-1)
    along = np.sum((columns.pixels - true) * outwards, axis=-1) / size
    # stored as detected: coma displaces the stars of the edge along the radius, and the fit has that among its unknowns
    assert 0.03 < abs(np.median(along[size > 0.9])) < 0.3
    assert np.min(columns.sigma_px) < 0.05
    assert bench.archive.sightings.find("roof") == ()
    points = bench.archive.sightings.find("roof", body=None)
    assert {(point.method, point.accepted, point.exposure_us, point.clock_error_s) for point in points} == {
        ("star", True, EXPOSURE_US, 0.01)
    }
    assert max(point.peak_fraction or 1.0 for point in points) < 0.9


def test_an_epoch_that_is_opened_before_the_stars_are_stored_has_those_of_its_time(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.serve(CAMERA)
    moved = BEGIN + timedelta(minutes=60)
    monkeypatch.setattr(bench.archive.sightings, "add", add_after_opening(bench.archive, at=moved))
    bench.night(*clear())
    points = bench.archive.sightings.find("roof", body=None)
    assert {(point.time >= moved, point.pose_epoch) for point in points} == {(False, "roof-1"), (True, "roof-2")}


@pytest.mark.parametrize(
    ("turn", "shown"),
    [(0.3, None), (0.0, -10), (0.0, 60)],
    ids=["camera turned by 17 degrees", "clock 10 minutes late", "clock an hour early"],
)
def test_a_night_that_the_calibration_does_not_predict_leaves_nothing(
    bench: Bench, turn: float, shown: int | None
) -> None:
    axis = np.array(CAMERA.rotation_cam_enu)
    turned = tuple((axis * (1.0 + turn / np.linalg.norm(axis))).tolist())
    bench.serve(replace(CAMERA, rotation_cam_enu=turned))
    frames = [frame_at(minute, shown=None if shown is None else minute + shown) for minute in (0, 40, 80)]
    event = bench.night(*frames)
    assert event.details["verdict"] == "cloudy"
    assert event.details["n_accepted"] == 0
    assert bench.archive.sightings.find("roof", body=None) == ()
    assert bench.refits == []


def test_clouds_leave_nothing(bench: Bench) -> None:
    bench.serve(CAMERA)
    event = bench.night(*(frame_at(minute, weather="overcast") for minute in (0, 40, 80)))
    assert event.details["verdict"] == "cloudy"
    assert (event.details["cloud_fraction"], bench.refits) == (1.0, [])
    assert bench.archive.sightings.find("roof", body=None) == ()


def test_a_camera_that_delivers_one_image_all_night_leaves_its_first_moment_alone(bench: Bench) -> None:
    bench.serve(CAMERA)
    bench.night(*(frame_at(minute, shown=0) for minute in (0, 40, 80)))
    times = {point.time for point in bench.archive.sightings.find("roof", body=None)}
    assert times <= {frame_at(0).time}


def test_without_a_calibration_or_a_clock_nothing_is_stored(bench: Bench) -> None:
    event = bench.night(*clear(0))
    assert (event.details["verdict"], event.details["findings"][0]["code"]) == ("unusable", "night_without_calibration")
    bench.serve(CAMERA)
    bench.trusted = False
    bench.worker.look_at(frame_at(40))
    bench.worker.finish()
    newest = bench.archive.events.find("roof", kind="night")[0]
    assert newest.details["findings"][0]["code"] == "night_clock_not_trusted"
    assert bench.archive.sightings.find("roof", body=None) == ()
    assert bench.refits == []


def test_two_images_are_no_night(bench: Bench) -> None:
    bench.serve(CAMERA)
    assert bench.night(*clear(0, 40)).details["verdict"] == "unusable"
    assert bench.refits == []


def test_the_night_ends_when_the_sun_comes_back_and_not_before(bench: Bench) -> None:
    bench.serve(CAMERA)
    bench.passes_s = 40.0
    stop = threading.Event()
    for frame in clear():
        bench.capture.frames.put(frame)
    beats: list[int] = []

    def heartbeat() -> None:
        beats.append(len(bench.archive.events.find("roof", kind="night")))
        if len(beats) == 5:
            assert beats[-1] == 0
            bench.zenith_deg = 101.0
        if beats[-1]:
            stop.set()

    bench.worker.run(stop, heartbeat)
    assert len(bench.archive.events.find("roof", kind="night")) == 1
    assert len(bench.refits) == 1


def test_an_image_of_the_next_night_ends_the_one_before(bench: Bench) -> None:
    bench.serve(CAMERA)
    for frame in clear():
        bench.worker.look_at(frame)
    bench.worker.look_at(replace(frame_at(0), time=frame_at(0).time + timedelta(days=1)))
    assert len(bench.archive.events.find("roof", kind="night")) == 1


WALL_ROWS = 220


def behind_a_wall(minutes: int) -> Frame:
    frame = frame_at(minutes)
    image = frame.image.copy()
    image[:WALL_ROWS] = np.median(image)
    return replace(frame, image=image)


def test_stars_behind_an_obstruction_are_not_missed_and_those_never_found_show_one(
    bench: Bench, tmp_path: Path
) -> None:
    bench.serve(CAMERA)
    learner = ObstructionLearner(bench.camera, tmp_path / "obstructions.npz")
    learner._follow_calibration("day", calibration_of(CAMERA))
    bench.worker.obstructions = learner
    grid, sums = learner._grid, learner._sums
    assert grid is not None
    assert sums is not None
    clouds = bench.night(*(behind_a_wall(minutes) for minutes in (0, 40, 80))).details["cloud_fraction"]
    after = learner._sums
    assert after is not None
    wall = np.zeros(grid.shape, dtype=bool)
    wall[: WALL_ROWS * grid.shape[0] // CAMERA.height] = True
    assert np.sum(after.log_odds[wall & grid.sky] > 0.0) > 20.0
    assert np.mean((after.log_odds > 0.0)[~wall & grid.sky]) < 0.01
    assert np.sum(after.log_odds[~wall & grid.sky] < 0.0) > 200.0
    state = np.where(wall, HIDDEN, FREE).astype(np.uint8)
    mask = ObstructionMask(grid=grid, probability=wall.astype(np.float32), state=state)
    learned = LearnedObstructions("day", "", BEGIN, mask, horizon_profile(mask))
    vars(learner)["_learned"] = learned
    for minutes in (0, 40, 80):
        bench.worker.look_at(behind_a_wall(minutes))
    night = bench.worker.finish()
    assert night.verdict == "clear"
    assert night.cloud_fraction is not None
    assert night.cloud_fraction < 0.6 * clouds
