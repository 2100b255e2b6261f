"""What the service does when the camera moves: events, epochs, provisional poses, sightings left out."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.fixtures.archive import make_empty
from tests.fixtures.finding_codes import codes

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes import online
from sunarc.changes.online import update_window
from sunarc.changes.values import Sighting, SightingWindow, WatchOptions
from sunarc.common.errors import OutsideError
from sunarc.common.findings import from_json, uncoded
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.imager.archive.archive import CameraArchive, open_archive
from sunarc.imager.archive.move_pictures import MovePictures
from sunarc.imager.archive.values import CameraRecord, DayAir, Event, SunPoint
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.calibrating import watch
from sunarc.imager.workers.calibrating.provisional_pose import ProvisionalPoseEstimator
from sunarc.imager.workers.calibrating.watch import WatchWorker
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

FloatArray = NDArray[np.float64]
DAY = datetime(2013, 5, 13, 6, tzinfo=UTC).timestamp()
NOON = datetime(2013, 5, 14, 18, 30, tzinfo=UTC).timestamp()
SIZE = (1748, 1748)
TRUTH = replace(true_camera(), max_angle=2.0)


def turned(camera: Camera, turn_deg: tuple[float, float, float]) -> Camera:
    matrix = Rotation.from_rotvec(np.radians(turn_deg)).as_matrix() @ rotation_matrix(camera.rotation_cam_enu)
    return replace(camera, rotation_cam_enu=rotation_vector(matrix))


@pytest.fixture(scope="module")
def good() -> Calibration:
    times = DAY + np.arange(0.0, 86_400.0, 240.0)
    times = times[sun_angles(times, SGP).apparent_zenith < 88.0]
    noise = np.random.default_rng(3).normal(0.0, 0.02, (times.size, 2))
    points = Sightings.of(unix_s=times, pixels=project(TRUTH, sun_directions(times, SGP)) + noise)
    return calibrate(points, site=SGP, image_size=SIZE)


class Imager:
    """A watch over an archive, shown sightings of a camera that may move."""

    def __init__(self, folder: Path, calibration: Calibration, board: StatusRegistry) -> None:
        make_empty(folder / "sunarc.sqlite")
        self.archive = open_archive(folder / "sunarc.sqlite")
        self.board = board
        self.now = datetime.fromtimestamp(NOON - 3600.0, UTC)
        self.archive.cameras.save(
            CameraRecord(name="roof", latitude=36.6, longitude=-97.5, altitude=318.0, width=SIZE[0], height=SIZE[1])
        )
        self.archive.epochs.at("roof", datetime.fromtimestamp(DAY, UTC), reason="first frame")
        document = to_document(
            calibration,
            id="full",
            camera="roof",
            state="candidate",
            created_at=self.now,
            valid_from=datetime.fromtimestamp(DAY, UTC),
            valid_until=None,
            pose_epoch="roof-1",
            software_version="1",
        )
        self.archive.calibrations.activate(self.archive.calibrations.add(document).id)
        self.rng = np.random.default_rng(5)
        self.watch = self.new_watch()

    def new_watch(self) -> WatchWorker:
        reposer = ProvisionalPoseEstimator(
            camera=CameraArchive(self.archive, name="roof", site=SGP),
            options=CalibrationOptions(level_within_deg=40.0),
            wander_deg=0.0,
            now=lambda: self.now,
        )
        return WatchWorker(
            camera=CameraArchive(self.archive, name="roof", site=SGP),
            options=WatchOptions(),
            reposer=reposer,
            now=lambda: self.now,
            board=self.board,
        )

    def see(self, pixel: FloatArray, unix_s: float, *, verdict: str = "clear") -> None:
        """Store one sighting and let the watch look at it."""
        moment = datetime.fromtimestamp(unix_s, UTC)
        x, y = (float(v) for v in pixel + self.rng.normal(0.0, 0.02, 2))
        epoch = self.archive.epochs.at("roof", moment, reason="first frame")
        point = SunPoint(
            camera="roof",
            pose_epoch=epoch.id,
            time=moment,
            method="disc",
            accepted=verdict == "clear",
            verdict=verdict,
            x_px=x,
            y_px=y,
            sigma_px=0.02,
        )
        self.archive.sightings.add([point])
        self.now = moment
        self.watch.notice(moment, x_px=x, y_px=y, sigma_px=0.02)
        while self.watch.process_next():
            pass

    def see_many(self, camera: Camera, minutes: range, *, verdict: str = "clear", clock_s: float = 0.0) -> None:
        for minute in minutes:
            unix_s = NOON + 60.0 * minute
            self.see(project(camera, sun_directions(unix_s + clock_s, SGP)), unix_s, verdict=verdict)

    def codes(self) -> set[str]:
        return {reason.code for reason in self.board.snapshot().reasons}

    def served(self) -> Calibration:
        record = self.archive.calibrations.current("roof")
        assert record is not None
        return from_document(record.document)

    def events(self) -> list[Event]:
        return [event for event in self.archive.events.find("roof") if event.severity == "alarm"]


@pytest.fixture
def imager(tmp_path: Path, good: Calibration, board: StatusRegistry) -> Imager:
    return Imager(tmp_path, good, board)


def off_in_sigmas(found: Calibration, truth: Camera) -> float:
    sky = hemisphere(300)
    pixels, covariance = project_with_covariance(replace(found, camera=replace(found.camera, max_angle=2.0)), sky)
    error = pixels - project(truth, sky)
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=-1)) / np.nanmean(np.trace(covariance, axis1=1, axis2=2))))


def test_after_a_bump_a_provisional_pose_is_served_within_twenty_sightings(imager: Imager) -> None:
    moved = turned(TRUTH, (0.12, -0.1, 0.12))
    imager.see_many(TRUTH, range(-20, 0))
    imager.see_many(moved, range(10))
    (event,) = imager.events()
    assert event.kind == "bump"
    assert abs(event.time.timestamp() - NOON) <= 120.0
    assert imager.board.snapshot().health == "degraded"
    imager.see_many(moved, range(10, 20))
    first, second = imager.archive.epochs.find("roof")
    assert abs(second.started_at.timestamp() - NOON) <= 120.0
    current = imager.archive.calibrations.current("roof")
    assert current is not None
    assert (current.pose_epoch, current.valid_from) == (second.id, second.started_at)
    assert "provisional" in codes(current.findings)
    assert off_in_sigmas(imager.served(), moved) < 2.0
    assert "provisional_pose" in imager.codes()
    assert imager.archive.refits.find("roof") == ()
    before = imager.archive.calibrations.current("roof", at=datetime.fromtimestamp(NOON - 300.0, UTC))
    assert before is not None
    assert before.id == "full"
    times = imager.archive.sightings.columns("roof", pose_epoch=second.id).unix_s
    assert times.min() >= NOON
    assert imager.archive.sightings.columns("roof", pose_epoch=first.id).unix_s.max() < NOON


def notes(imager: Imager) -> dict[str, tuple[str, str]]:
    """Return state and sentence of the notes by code, after the watch looked at the archive."""
    imager.watch.process_next()
    return {one.code: (one.state, one.text) for one in imager.board.snapshot().notes}


def serve_full(imager: Imager, calibration: Calibration, *, pose_epoch: str) -> None:
    full = to_document(
        calibration,
        id=f"full-{pose_epoch}",
        camera="roof",
        state="candidate",
        created_at=imager.now,
        valid_from=imager.now,
        valid_until=None,
        pose_epoch=pose_epoch,
        software_version="1",
    )
    imager.archive.calibrations.activate(imager.archive.calibrations.add(full).id)


def test_a_move_asks_for_attention_until_it_is_fitted_and_is_a_note_until_it_is_acknowledged(
    imager: Imager, good: Calibration
) -> None:
    moved = turned(TRUTH, (0.0, 2.5, 0.0))
    imager.see_many(TRUTH, range(-15, 0))
    assert notes(imager) == {}
    imager.see_many(moved, range(20))
    state, text = notes(imager)["camera_moved"]
    assert state == imager.board.snapshot().state == "attention"
    assert text == imager.board.snapshot().state_text
    assert re.fullmatch(
        r"moved by 2\.5° ± 0\.\d+° on 14 May 2013 18:\d\d UTC, provisional pose since, next fit after a clear day", text
    )
    (event,) = imager.events()
    assert event.to_acknowledge
    assert event.id is not None
    serve_full(imager, replace(good, camera=replace(moved, max_angle=good.camera.max_angle)), pose_epoch="roof-2")
    assert [(code, state) for code, (state, _) in notes(imager).items()] == [("camera_moved_fitted", "ready_with_note")]
    imager.archive.events.acknowledge("roof", event.id, at=imager.now, reason="a bird")
    assert notes(imager) == {}
    assert not imager.events()[0].to_acknowledge


def test_a_move_that_is_acknowledged_asks_for_attention_until_it_is_fitted(imager: Imager) -> None:
    imager.see_many(TRUTH, range(-15, 0))
    imager.see_many(turned(TRUTH, (0.0, 2.5, 0.0)), range(10))
    (event,) = imager.events()
    assert event.id is not None
    imager.archive.events.acknowledge("roof", event.id, at=imager.now, reason="a bird")
    assert notes(imager).keys() == {"camera_moved"}
    imager.watch = imager.new_watch()  # a restart forgets nothing
    assert notes(imager).keys() == {"camera_moved"}


def test_a_move_whose_epoch_is_closed_is_acknowledged_and_shown_no_longer(imager: Imager) -> None:
    imager.see_many(TRUTH, range(-15, 0))
    imager.see_many(turned(TRUTH, (0.0, 2.5, 0.0)), range(10))
    imager.archive.calibrations.close_epoch("roof-2", at=imager.now, reason="a bird")
    assert notes(imager) == {}
    assert [event.to_acknowledge for event in imager.events()] == [False]


def test_the_pictures_before_and_after_a_move_are_kept(imager: Imager, tmp_path: Path) -> None:
    shown = tmp_path / "newest.png"
    imager.watch = replace_pictures(imager.watch, MovePictures(tmp_path / "moves"), shown)
    show(shown, 40)
    imager.see_many(TRUTH, range(-15, 0))
    show(shown, 200)
    imager.see_many(turned(TRUTH, (0.0, 2.5, 0.0)), range(12))
    (event,) = imager.events()
    pictures = imager.watch.pictures
    assert pictures is not None
    before, after = pictures.path(event, "before"), pictures.path(event, "after")
    assert before is not None
    assert after is not None
    assert pictures.time(before) <= event.time <= pictures.time(after) <= event.time + timedelta(minutes=6)
    levels = [int(np.mean(cv2.imread(str(path)))) for path in (before, after)]  # type: ignore[arg-type]
    assert levels == [40, 200]
    assert pictures.is_complete(event)


def show(path: Path, level: int) -> None:
    cv2.imwrite(str(path), np.full((60, 80, 3), level, np.uint8))


def replace_pictures(watch: WatchWorker, pictures: MovePictures, newest: Path) -> WatchWorker:
    """Return a watch that keeps pictures, of which one file is the newest."""
    return replace(watch, pictures=pictures, newest_picture=lambda: newest)


def test_a_disk_that_takes_no_picture_hinders_no_watch(imager: Imager, tmp_path: Path) -> None:
    show(tmp_path / "newest.png", 40)
    (tmp_path / "file").touch()
    imager.watch = replace_pictures(imager.watch, MovePictures(tmp_path / "file" / "moves"), tmp_path / "newest.png")
    imager.see_many(TRUTH, range(-15, 0))
    imager.see_many(turned(TRUTH, (0.0, 2.5, 0.0)), range(12))
    assert [event.kind for event in imager.events()] == ["bump"]


def test_a_provisional_pose_grows_surer_and_a_full_fit_ends_it(imager: Imager, good: Calibration) -> None:
    moved = turned(TRUTH, (0.0, 0.2, 0.0))
    imager.see_many(TRUTH, range(-15, 0))
    imager.see_many(moved, range(8))
    early = imager.served().sky_rms_deg
    imager.see_many(moved, range(8, 40))
    assert imager.served().sky_rms_deg < 0.5 * early
    full = to_document(
        replace(good, camera=replace(moved, max_angle=good.camera.max_angle)),
        id="later",
        camera="roof",
        state="candidate",
        created_at=imager.now,
        valid_from=imager.now,
        valid_until=None,
        pose_epoch="roof-2",
        software_version="1",
    )
    imager.archive.calibrations.activate(imager.archive.calibrations.add(full).id)
    imager.see_many(moved, range(40, 44))
    assert "provisional_pose" not in imager.codes()
    assert len(imager.events()) == 1


def test_a_camera_that_looks_elsewhere_is_followed(imager: Imager) -> None:
    moved = turned(TRUTH, (12.0, 8.0, -20.0))
    imager.see_many(TRUTH, range(-15, 0))
    imager.see_many(moved, range(20), verdict="elsewhere")
    assert [event.kind for event in imager.events()] == ["bump"]
    assert off_in_sigmas(imager.served(), moved) < 2.0
    assert imager.archive.sightings.columns("roof", pose_epoch="roof-2").unix_s.size >= 4


def test_a_move_for_which_no_pose_is_found_is_one_event_and_one_epoch(
    imager: Imager, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(online, "REMEMBERED", 12)
    moved = turned(TRUTH, (12.0, 8.0, -20.0))
    monkeypatch.setattr(imager.watch.reposer, "improve", lambda: False)
    imager.see_many(TRUTH, range(-10, 0))
    imager.see_many(moved, range(30), verdict="elsewhere")
    (event,) = imager.events()
    assert event.kind == event.details["kind"] == "bump"
    assert {"unit", "size_sigma", "text", "remedy"} <= set(event.details)
    (finding,) = event.findings
    assert finding["code"] == "changed_bump"
    assert from_json(finding).text == event.text  # the data are those of the sentence
    assert len(imager.archive.epochs.find("roof")) == 2
    assert "changed_bump" in imager.codes()
    assert imager.archive.sightings.columns("roof", pose_epoch="roof-2").unix_s.size == 30


def test_a_set_clock_leaves_the_calibration_alone_until_it_is_right_again(imager: Imager) -> None:
    imager.see_many(TRUTH, range(-15, 0))
    step = Event(
        time=datetime.fromtimestamp(NOON - 10.0, UTC),
        kind="clock_step",
        severity="warning",
        text="set",
        camera="roof",
        details={"step_s": 5.0},
    )
    imager.archive.events.add(step)
    imager.see_many(TRUTH, range(10), clock_s=5.0)
    assert [event.kind for event in imager.events()] == ["clock"]
    assert "changed_clock" in imager.codes()
    assert len(imager.archive.epochs.find("roof")) == 1
    current = imager.archive.calibrations.current("roof")
    assert current is not None
    assert current.id == "full"
    assert imager.archive.sightings.columns("roof").unix_s.max() < NOON
    imager.see_many(TRUTH, range(10, 20))
    assert "changed_clock" not in imager.codes()
    assert imager.archive.sightings.columns("roof").unix_s.max() >= NOON + 16 * 60.0


@pytest.fixture
def unwatched(imager: Imager) -> Imager:
    """Have the images dated by another machine, as those of a folder."""
    imager.watch = replace(imager.watch, host_dates=False)
    return imager


@pytest.mark.parametrize("step_s", [-12.0, 420.0])
def test_a_step_of_a_clock_that_nothing_watches_turns_no_camera(unwatched: Imager, step_s: float) -> None:
    unwatched.see_many(TRUTH, range(-15, 0))
    unwatched.see_many(TRUTH, range(12), clock_s=step_s, verdict="clear" if abs(step_s) < 60.0 else "elsewhere")
    assert [event.kind for event in unwatched.events()] == ["clock"]
    assert len(unwatched.archive.epochs.find("roof")) == 1
    unwatched.see_many(TRUTH, range(12, 20))
    assert "changed_clock" not in unwatched.codes()


def test_a_turn_that_began_like_a_step_of_the_clock_is_found_by_more_sightings(unwatched: Imager) -> None:
    pole = np.array([0.0, np.cos(np.radians(SGP.latitude)), np.sin(np.radians(SGP.latitude))])
    sun = sun_directions(NOON + 120.0, SGP)  # a turn about it shows hours later
    moved = turned(TRUTH, tuple(0.3 * rotation_matrix(TRUTH.rotation_cam_enu) @ (pole + sun)))
    unwatched.see_many(TRUTH, range(-15, 0))
    unwatched.see_many(moved, range(5))
    assert [event.kind for event in unwatched.events()] == ["clock"]
    unwatched.see_many(moved, range(5, 100, 8))
    assert [event.kind for event in unwatched.events()] == ["bump", "clock"]
    assert "changed_clock" not in unwatched.codes()
    assert off_in_sigmas(unwatched.served(), moved) < 2.0


def test_a_mirrored_image_moves_nothing(imager: Imager) -> None:
    imager.see_many(TRUTH, range(-15, 0))
    for minute in range(8):
        unix_s = NOON + 60.0 * minute
        x, y = project(TRUTH, sun_directions(unix_s, SGP))
        imager.see(np.array([SIZE[0] - 1.0 - x, y]), unix_s, verdict="elsewhere")
    assert [event.kind for event in imager.events()] == ["mirrored"]
    assert len(imager.archive.epochs.find("roof")) == 1


def test_a_restart_in_the_midst_of_a_bump_finds_it_all_the_same(imager: Imager) -> None:
    moved = turned(TRUTH, (0.15, 0.1, 0.0))
    imager.see_many(TRUTH, range(-15, 0))
    imager.see_many(moved, range(3))
    assert imager.events() == []
    imager.watch = imager.new_watch()
    imager.watch.remember()
    imager.see_many(moved, range(3, 10))
    assert [event.kind for event in imager.events()] == ["bump"]
    imager.watch = imager.new_watch()
    imager.watch.remember()
    imager.see_many(moved, range(10, 14))
    assert [event.kind for event in imager.events()] == ["bump"]


def test_a_database_that_refuses_for_a_while_does_not_end_the_worker(
    imager: Imager, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OutsideError("cannot use the database: disk is full")

    imager.see_many(TRUTH, range(-5, 0))
    with monkeypatch.context() as patched:
        patched.setattr(imager.archive.epochs, "current", refuse)
        imager.watch.notice(imager.now, x_px=800.0, y_px=800.0, sigma_px=0.02)
        assert imager.watch.process_next()
    imager.see_many(TRUTH, range(5))
    assert imager.events() == []


def test_what_is_set_aside_keeps_its_place_in_the_record(imager: Imager) -> None:
    imager.see_many(TRUTH, range(-5, 5))
    since, until = (datetime.fromtimestamp(NOON + s, UTC) for s in (-60.0, 90.0))
    why = uncoded("test")
    assert imager.archive.sightings.exclude("roof", why, since=since, until=until) == 3
    assert imager.archive.sightings.columns("roof").unix_s.size == 7
    aside = [point for point in imager.archive.sightings.find("roof") if point.verdict == "set_aside"]
    assert [point.findings for point in aside] == [(why,)] * 3


def test_a_closed_pose_epoch_ends_the_conditions_of_its_move(imager: Imager, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        ProvisionalPoseEstimator, "improve", lambda _: False
    )  # as while the sightings are too few for a pose
    imager.see_many(TRUTH, range(-20, 0))
    imager.see_many(turned(TRUTH, (0.12, -0.1, 0.12)), range(10))
    assert imager.codes() == {"changed_bump"}
    before = imager.events()
    last = imager.archive.epochs.find("roof")[-1].id
    assert imager.archive.calibrations.close_epoch(last, at=imager.now, reason="a bird") == "full"
    imager.see_many(TRUTH, range(10, 14))
    assert imager.codes() == set()
    assert [event.id for event in imager.events()] == [event.id for event in before]  # is not found again


def test_a_provisional_pose_is_not_shown_once_it_is_retired(imager: Imager) -> None:
    imager.see_many(TRUTH, range(-20, 0))
    moved = turned(TRUTH, (0.12, -0.1, 0.12))
    imager.see_many(moved, range(20))
    current = imager.archive.calibrations.current("roof")
    assert current is not None
    assert "provisional_pose" in imager.codes()
    imager.archive.calibrations.retire(current.id, at=imager.now)  # as when another camera takes its place
    imager.see_many(moved, range(20, 22))
    assert "provisional_pose" not in imager.codes()


def test_an_epoch_that_another_part_opens_is_followed_though_there_was_none_at_the_start(imager: Imager) -> None:
    imager.see_many(TRUTH, range(-20, 0))  # `remember` was never called: the record was empty then
    imager.archive.epochs.open("roof", at=imager.now, reason="bump")
    imager.see_many(TRUTH, range(1))
    assert len(imager.watch._watch) == 2  # the last sighting before is the epoch's first


def test_sightings_are_compared_with_the_sun_in_the_measured_air(
    tmp_path: Path, good: Calibration, board: StatusRegistry, monkeypatch: pytest.MonkeyPatch
) -> None:
    imager = Imager(tmp_path, good, board)
    air = replace(SGP, temperature=40.0, pressure=90_000.0)
    compared: list[tuple[float, ...]] = []

    def noting(
        watched: SightingWindow,
        seen: Sighting,
        *,
        site: Site,
        **how: Any,  # noqa: ANN401 - of observe
    ) -> tuple[SightingWindow, PoseChange | None]:
        compared.append(seen.direction)
        assert site == (air if len(compared) == 2 else SGP)
        return update_window(watched, seen, site=site, **how)

    monkeypatch.setattr(watch, "update_window", noting)
    low = datetime(2013, 5, 14, 12, 0, tzinfo=UTC).timestamp()
    imager.see(project(TRUTH, sun_directions(low, SGP)), low)
    day = DayAir(camera="roof", date=date(2013, 5, 14), temperature_c=40.0, pressure_hpa=900.0, set_at=imager.now)
    imager.archive.days.set_air(day)
    imager.see(project(TRUTH, sun_directions(low + 60.0, air)), low + 60.0)
    assert compared == [tuple(sun_directions(low, SGP).tolist()), tuple(sun_directions(low + 60.0, air).tolist())]
