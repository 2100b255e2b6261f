"""Several cameras of a type and several epochs of one, against the stacked least-squares problem."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.fixtures.clear_day import SGP, simulate

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.lens_library.joint import Entry, calibrate_jointly
from sunarc.calibration.lens_library.lens_type import IN_FREE, LensType, lens_frame, usual_precision
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import LENS, N_LENS
from sunarc.common.errors import InputError
from sunarc.optics.camera import POSE, Camera
from sunarc.optics.forward import project, project_fast
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from tests.fixtures.clear_day import FloatArray
    from tests.fixtures.lens_types import Fitted, Units

SKY = hemisphere(200)
OPTIONS = CalibrationOptions(level_within_deg=15.0)


def entry(name: str, points: Sightings, *, epoch: str = "", **change: object) -> Entry:
    whole = Entry(camera=name, epoch=epoch, points=points, site=SGP, image_size=(1748, 1748), options=OPTIONS)
    return replace(whole, **change)  # type: ignore[arg-type]


def rms(first: Camera, second: Camera) -> float:
    return float(np.sqrt(np.nanmean(np.sum((project(first, SKY) - project(second, SKY)) ** 2, axis=-1))))


class Stacked:
    """The least-squares problem of some cameras of a type: their lenses, their poses and the mean of the type."""

    def __init__(self, records: list[Sightings], like: Calibration, scales: FloatArray | None) -> None:
        self.records, self.like, self.scales = records, like, scales
        self.frame = lens_frame(like.camera)
        self.root = np.sqrt(usual_precision(like.evidence.radial_px))
        self.suns = [sun_directions(points.unix_s, SGP) for points in records]

    def cameras(self, unknowns: FloatArray) -> list[Camera]:
        found = []
        for one in unknowns[: 20 * len(self.records)].reshape(-1, 20):
            vector = self.like.camera.to_vector()
            vector[LENS], vector[POSE] = self.frame.lens(one[:N_LENS]), one[N_LENS:]
            found.append(self.like.camera.replace_parameters(vector))
        return found

    def misfit(self, unknowns: FloatArray) -> FloatArray:
        """Return all residuals; a camera alone has the prior that the mean of a type has."""
        mean = unknowns[20 * len(self.records) :]
        parts = [self.root * (unknowns[:N_LENS] if self.scales is None else mean)]
        for camera, sun, points in zip(self.cameras(unknowns), self.suns, self.records, strict=True):
            parts.append(((project_fast(camera, sun) - points.pixels) / 0.1).ravel())
        if self.scales is not None:
            lenses = unknowns[: 20 * len(self.records)].reshape(-1, 20)[:, :N_LENS]
            parts.append(((lenses - mean) / self.scales).ravel())
        return np.concatenate(parts)

    def solved(self, start: FloatArray) -> tuple[list[Camera], FloatArray]:
        """Return the cameras, and the covariance of the unknowns."""
        answer = least_squares(self.misfit, start, x_scale="jac", max_nfev=30)
        jacobian = np.asarray(answer.jac)
        return self.cameras(answer.x), np.linalg.inv(jacobian.T @ jacobian)


def plain_fit(begin: Calibration, points: Sightings) -> Calibration:
    """Return a fit by scipy, whose covariance is that of its normal equations."""
    problem = Stacked([points], begin, None)
    (camera,), covariance = problem.solved(np.r_[problem.frame.whitened(begin.camera), begin.camera.rotation_cam_enu])
    to_parameters = np.zeros((20, 20))
    to_parameters[np.ix_(IN_FREE, np.arange(N_LENS))] = problem.frame.basis
    to_parameters[np.ix_(~IN_FREE, np.arange(N_LENS, 20))] = np.eye(3)
    return replace(
        begin,
        camera=camera,
        covariance=to_parameters @ covariance @ to_parameters.T,
        field=replace(begin.field, amplitude_px=0.0, cross=0.0 * begin.field.cross),
    )


def test_three_cameras_together_are_what_the_stacked_problem_says(
    fitted: Fitted, lens: LensType, monkeypatch: pytest.MonkeyPatch
) -> None:
    records = [fitted(number)[0].select(slice(None, None, 4)) for number in range(3)]
    like = fitted(0)[1]
    alone = [plain_fit(replace(fitted(k)[1], evidence=like.evidence), records[k]) for k in range(3)]
    by_first = {float(points.pixels[0, 0]): one for points, one in zip(records, alone, strict=True)}
    entries = [entry(str(k), points) for k, points in enumerate(records)]
    of_record = lambda points, **_: by_first[float(points.pixels[0, 0])]  # noqa: E731
    monkeypatch.setattr("sunarc.calibration.lens_library.joint.calibrate", of_record)
    joint = calibrate_jointly(entries, spread=lens.spread)
    problem = Stacked(records, like, lens.spread.scales(float(np.mean(like.camera.focal_length_px))))
    lenses = [problem.frame.whitened(one.camera) for one in alone]
    starts = [np.r_[z, one.camera.rotation_cam_enu] for z, one in zip(lenses, alone, strict=True)]
    expected, _ = problem.solved(np.concatenate([*starts, np.mean(lenses, axis=0)]))
    for found, single, brute in zip(joint.calibrations, alone, expected, strict=True):
        sigma_px = float(np.radians(found.sky_rms_deg) * 601.0)
        assert rms(found.camera, brute) < 0.3 * sigma_px
        assert rms(found.camera, brute) < 0.3 * rms(single.camera, brute)
    assert joint.lens is not None
    assert joint.lens.cameras == ("0", "1", "2")


def test_epochs_of_one_camera_share_its_lens_and_have_their_own_poses(unit: Units) -> None:
    first = unit(5)
    second = replace(first, rotation_cam_enu=rotation_from_pose_angles(PoseAngles(100.0, 1.0, 200.0)))
    records = [
        simulate(camera, days=(day,), cadence_s=600.0, sigma_px=0.1).points
        for camera, day in ((first, 0.0), (second, 30.0))
    ]
    entries = [entry("roof", points, epoch=str(k)) for k, points in enumerate(records)]
    joint = calibrate_jointly(entries)
    (a, b) = joint.calibrations
    assert a.verdict.accepted
    assert b.verdict.accepted
    apart = (a.camera.to_vector() - b.camera.to_vector())[LENS]
    sigma = np.sqrt(np.diag(a.covariance)[np.isin(np.delete(np.arange(23), [8, 9, 10]), LENS)])
    assert np.abs(apart / sigma).max() < 0.3
    assert rms(a.camera, first) < 0.4
    assert rms(b.camera, second) < 0.4
    assert joint.lens is not None
    assert joint.lens.cameras == ("roof",)


def test_a_camera_of_another_lens_is_refused_and_says_nothing_of_the_type(
    fitted: Fitted, unit: Units, lens: LensType
) -> None:
    other = replace(unit(7), focal_length_px=(650.0, 650.0))
    strange = simulate(other, cadence_s=360.0, sigma_px=0.1).points
    entries = [entry("0", fitted(0)[0]), entry("1", fitted(1)[0]), entry("odd", strange)]
    joint = calibrate_jointly(entries, spread=lens.spread)
    assert not joint.calibrations[2].verdict.accepted
    assert joint.calibrations[2].verdict.findings[0].code == "lens_prior_contradicted"


def test_nothing_usable_gives_refusals_and_no_type() -> None:
    empty = Sightings.of(unix_s=np.zeros(0), pixels=np.zeros((0, 2)))
    joint = calibrate_jointly([entry("a", empty)])
    assert joint.lens is None
    assert joint.calibrations[0].verdict.findings[0].code == "too_few_sightings"


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"image_size": (1740, 1748)}, "b"),
        ({"options": replace(OPTIONS, projection="equidistant")}, "b"),
        ({"options": replace(OPTIONS, mirrored="yes")}, "b"),
        ({"name": "a", "epoch": "later", "site": replace(SGP, latitude=10.0)}, "a later"),
    ],
)
def test_what_cannot_share_a_lens_is_named(change: dict[str, Any], field: str) -> None:
    empty = Sightings.of(unix_s=np.zeros(0), pixels=np.zeros((0, 2)))
    with pytest.raises(InputError) as refused:
        calibrate_jointly([entry("a", empty), entry(change.pop("name", "b"), empty, **change)])
    assert refused.value.field == field


def test_no_entry_is_refused() -> None:
    with pytest.raises(InputError):
        calibrate_jointly([])
