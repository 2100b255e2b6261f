"""The first hour of a camera whose type of lens is known: from the first sun to a full fit, and what is not served."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.finding_codes import codes
from tests.imager.workers.test_watch import DAY, NOON, SIZE, TRUTH, Imager, off_in_sigmas, turned

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.lens_library.first_pose import north_sigma_deg
from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread, lens_frame, type_camera
from sunarc.calibration.model.options import CalibrationOptions, FirstPoseOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.values import WatchOptions
from sunarc.common.errors import InputError
from sunarc.formats.lens_prior import lens_type_to_json
from sunarc.imager.archive.archive import CameraArchive, open_archive
from sunarc.imager.archive.values import CameraRecord
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imager.workers.calibrating.provisional_pose import FirstPose, ProvisionalPoseEstimator
from sunarc.imager.workers.calibrating.watch import WatchWorker
from sunarc.imager.workers.options import LensPriorOptions
from sunarc.lab.simulation.truth import SGP
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.mounting import top_azimuth_deg
from sunarc.sky.sun import sun_angles, sun_directions

SPREAD = UnitSpread(focal_length=0.003, center_px=8.0, radial_px=0.4, decentering_px=0.3)
LEVEL = replace(TRUTH, max_angle=2.0)


@pytest.fixture(scope="module")
def lens() -> LensType:
    """Return a type that the simulated lens is a unit of."""
    frame = lens_frame(TRUTH)
    scales = SPREAD.scales(TRUTH.focal_length_px[0])
    mean = frame.whitened(TRUTH) + 0.7 * scales * np.random.default_rng(2).standard_normal(17)
    return LensType(
        camera=type_camera(frame, mean, TRUTH, max_angle=1.7),
        covariance=frame.basis @ np.diag(scales**2) @ frame.basis.T,
        spread=SPREAD,
        field_px=0.0,
        field_length_px=0.0,
        cameras=("one",),
        days=("2013-05-01",),
    )


class NewImager(Imager):
    """A watch over an archive without a calibration, of a camera whose type of lens is known."""

    def __init__(self, folder: Path, first: FirstPose | None, board: StatusRegistry) -> None:
        make_empty(folder / "sunarc.sqlite")
        self.archive = open_archive(folder / "sunarc.sqlite")
        self.board, self.first = board, first
        self.now = datetime.fromtimestamp(NOON - 3600.0, UTC)
        self.archive.cameras.save(
            CameraRecord(name="roof", latitude=36.6, longitude=-97.5, altitude=318.0, width=SIZE[0], height=SIZE[1])
        )
        self.rng = np.random.default_rng(5)
        self.watch = self.new_watch()

    def new_watch(self) -> WatchWorker:
        camera = CameraArchive(self.archive, name="roof", site=SGP)
        return WatchWorker(
            camera=camera,
            options=WatchOptions(),
            reposer=ProvisionalPoseEstimator(
                camera=camera,
                options=CalibrationOptions(),
                wander_deg=0.0,
                now=lambda: self.now,
                first=self.first,
            ),
            now=lambda: self.now,
            board=self.board,
        )

    def reason(self, code: str) -> Reason:
        return next(reason for reason in self.board.snapshot().reasons if reason.code == code)


def first_hour(folder: Path, lens: LensType, board: StatusRegistry, **known: float) -> NewImager:
    return NewImager(folder, FirstPose(lens, FirstPoseOptions(**known)), board)


def test_a_pose_is_served_from_the_fourth_sighting_on_and_grows_surer(
    tmp_path: Path, lens: LensType, board: StatusRegistry
) -> None:
    imager = first_hour(tmp_path, lens, board)
    imager.see_many(TRUTH, range(3))
    assert imager.archive.calibrations.current("roof") is None
    assert imager.reason("first_sun").data["n"] == 3
    sigmas = []
    for minutes in (range(3, 5), range(5, 20), range(20, 60)):
        imager.see_many(TRUTH, minutes)
        served = imager.served()
        assert off_in_sigmas(served, TRUTH) < 3.0
        sigmas.append(served.sky_rms_deg)
        shown = imager.reason("first_pose_provisional").data
        assert shown["north_sigma_deg"] == pytest.approx(north_sigma_deg(served))
        assert shown["top_azimuth_deg"] == pytest.approx(top_azimuth_deg(served.camera))
        assert {"first_sun", "provisional_pose", "first_pose_refused"}.isdisjoint(imager.codes())
    assert 5.0 > sigmas[0] > 1.1 * sigmas[1] > 1.1 * sigmas[2] > 0.05
    record = imager.archive.calibrations.current("roof")
    assert record is not None
    assert {"provisional", "first_pose"} <= set(codes(record.findings))
    assert record.parent is None
    assert record.valid_from <= datetime.fromtimestamp(NOON, UTC)
    assert imager.events() == []


def test_a_full_fit_ends_it(tmp_path: Path, lens: LensType, board: StatusRegistry) -> None:
    imager = first_hour(tmp_path, lens, board)
    imager.see_many(TRUTH, range(6))
    full = full_fit()
    store_current(imager, full)
    imager.see_many(TRUTH, range(6, 10))
    assert imager.served().evidence.options["free"] == "all"
    assert "first_pose_provisional" not in imager.codes()


def full_fit() -> Calibration:
    times = DAY + np.arange(0.0, 86_400.0, 600.0)
    times = times[sun_angles(times, SGP).apparent_zenith < 88.0]
    noise = np.random.default_rng(3).normal(0.0, 0.02, (times.size, 2))
    pixels = project(TRUTH, sun_directions(times, SGP)) + noise
    return calibrate(Sightings.of(unix_s=times, pixels=pixels), site=SGP, image_size=SIZE)


def store_current(imager: NewImager, full: Calibration) -> None:
    from sunarc.formats.calibration_document import to_document  # noqa: PLC0415 - beside its only use

    epoch = imager.archive.epochs.current("roof", at=imager.now + timedelta(seconds=1))
    assert epoch is not None
    document = to_document(
        full,
        id="full",
        camera="roof",
        state="candidate",
        created_at=imager.now,
        valid_from=imager.now,
        valid_until=None,
        pose_epoch=epoch.id,
        software_version="1",
    )
    imager.archive.calibrations.activate(imager.archive.calibrations.add(document).id)


@pytest.mark.parametrize("wrong", ["mirrored", "mounted"])
def test_a_mirrored_image_and_a_wrong_north_are_said_and_not_served(
    tmp_path: Path, lens: LensType, board: StatusRegistry, wrong: str
) -> None:
    top = (top_azimuth_deg(TRUTH) + (180.0 if wrong == "mounted" else 0.0)) % 360.0
    camera: Camera = replace(TRUTH, mirrored=wrong == "mirrored")
    imager = first_hour(tmp_path, lens, board, top_azimuth_deg=top)
    imager.see_many(camera, range(12))
    assert imager.archive.calibrations.current("roof") is None
    assert "first_pose_refused" in imager.codes()
    assert "first_pose_provisional" not in imager.codes()
    assert str(imager.reason("first_pose_refused").remedy)


def test_a_restart_goes_on(tmp_path: Path, lens: LensType, board: StatusRegistry) -> None:
    imager = first_hour(tmp_path, lens, board)
    imager.see_many(TRUTH, range(8))
    before = imager.served()
    imager.watch = imager.new_watch()
    imager.watch.remember()
    imager.see_many(TRUTH, range(8, 20))
    assert imager.served().sky_rms_deg < before.sky_rms_deg


def test_a_bump_in_the_first_hour_begins_anew(tmp_path: Path, lens: LensType, board: StatusRegistry) -> None:
    imager = first_hour(tmp_path, lens, board)
    imager.see_many(TRUTH, range(30))
    moved = turned(TRUTH, (3.0, 2.0, 8.0))
    imager.see_many(moved, range(30, 60))
    assert [event.kind for event in imager.events()] == ["bump"]
    assert off_in_sigmas(imager.served(), moved) < 3.0


def test_without_a_lens_prior_nothing_is_served_before_the_first_fit(tmp_path: Path, board: StatusRegistry) -> None:
    imager = NewImager(tmp_path, None, board)
    imager.see_many(TRUTH, range(6))
    assert imager.archive.calibrations.current("roof") is None
    assert imager.codes().isdisjoint({"first_sun", "first_pose_refused", "first_pose_provisional"})


def test_the_settings_name_a_lens_prior_file(tmp_path: Path, lens: LensType) -> None:
    path = tmp_path / "lens.json"
    path.write_text(json.dumps(lens_type_to_json(lens, software_version="1")))
    found = FirstPose.of(LensPriorOptions(lens_prior=path, top_azimuth_deg=10.0))
    assert found is not None
    assert (found.lens.cameras, found.pose.top_azimuth_deg) == (("one",), 10.0)
    assert FirstPose.of(LensPriorOptions()) is None
    path.write_text("{")
    with pytest.raises(InputError) as refused:
        FirstPose.of(LensPriorOptions(lens_prior=path))
    assert refused.value.field == path.name
    with pytest.raises(InputError):
        FirstPose.of(LensPriorOptions(lens_prior=tmp_path / "missing.json"))
    with pytest.raises(InputError) as refused:
        LensPriorOptions(tilt_deg=0.0)
    assert refused.value.field == "first_pose.tilt_deg"
