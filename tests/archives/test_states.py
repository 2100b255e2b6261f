"""Bumps, lenses and clocks in sightings of a known camera are found to the sighting; doubtful sites and zones named."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from tests.fixtures.calibration import ideal_camera

from sunarc.archives.fit import CameraSightings, Final, Rough, final_analysis, first_analysis
from sunarc.archives.states import ArchiveCamera
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import FloatArray
from sunarc.lab.simulation.made_archive import CameraChange, MadeArchive, MadeCamera, camera_at, true_times
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

SIZE = 480
NOISE_PX = 0.3


@dataclass(frozen=True)
class Truth:
    camera: MadeCamera
    made: MadeArchive

    def sightings(self, *, mirrored: bool = False) -> tuple[Sightings, FloatArray]:
        """Return sightings by the camera's clock, some of them false, and when they truly were."""
        rng = np.random.default_rng(5)
        times = true_times(self.made)
        times = times[rng.random(times.size) < 0.8]
        directions = sun_directions(times, self.made.site)
        pixels = np.array(
            [project(camera_at(self.made, self.camera, t), d) for t, d in zip(times.tolist(), directions, strict=True)]
        )
        pixels += rng.normal(0.0, NOISE_PX, pixels.shape)
        false = rng.random(times.size) < 0.03
        pixels[false] = rng.uniform(60, 400, (int(false.sum()), 2))
        if mirrored:
            pixels[:, 0] = SIZE - 1 - pixels[:, 0]
        day = (times - self.made.first_day.timestamp() - 21_600.0) // 86_400 / self.made.step_days
        stated = times + self.camera.wrong_s * np.isin(day, self.camera.wrong_days)
        return Sightings.of(unix_s=stated, pixels=pixels, sigma_px=np.full(times.size, NOISE_PX)), times


def truth(**camera: object) -> Truth:
    made_camera = MadeCamera(name="roof", naming="", **camera)  # type: ignore[arg-type]
    return Truth(made_camera, MadeArchive(cameras=(made_camera,), days=8, per_day=20, size=SIZE))


def known(site: Site) -> ArchiveCamera:
    return ArchiveCamera(site, (SIZE, SIZE), CalibrationOptions())


@cache
def analysed(one: Truth) -> tuple[Rough, Final]:
    points, _ = one.sightings()
    camera = known(one.made.site)
    rough = first_analysis(CameraSightings(points, camera))
    return rough, final_analysis(CameraSightings(points, camera, rough.states))


BUMP = truth(changes=(CameraChange(day=4, hour=18.2, turn_deg=(1.0, 0.0, 2.0)),))
STILL = truth()
CLOCK = truth(wrong_days=(3, 4), heading_deg=110.0)


def test_a_bump_is_found_between_the_sightings_that_it_came_between() -> None:
    _, final = analysed(BUMP)
    _, times = BUMP.sightings()
    at = BUMP.made.first_day.timestamp() + 4 * 14 * 86_400 + 18.2 * 3600
    assert [one.cause for one in final.epochs] == ["start", "moved"]
    assert final.epochs[1].first == int(np.searchsorted(times, at))
    assert {state.lens for state in final.states} == {0}


def test_the_hour_of_a_wrong_clock_is_named_and_ends() -> None:
    _, final = analysed(CLOCK)
    points, times = CLOCK.sightings()
    assert [one.cause for one in final.epochs] == ["start", "clock", "clock"]
    offsets = [final.states[one.state].clock_offset_s for one in final.epochs]
    assert offsets == [0.0, 3600.0, 0.0]
    wrong = np.flatnonzero(points.unix_s != times)
    assert (final.epochs[1].first, final.epochs[1].last) == (wrong[0], wrong[-1])
    assert len(final.fitted) == 1  # one pose


def test_a_clock_that_follows_summer_time_shows_as_epochs_of_one_pose() -> None:
    """Most sightings are by the summer's clock, but by the winter's the camera stands level: that one is right."""
    summers = truth(wrong_days=(1, 2, 3, 5, 6, 7))
    points, times = summers.sightings()
    rough = first_analysis(CameraSightings(points, known(summers.made.site)))
    assert [one.cause for one in rough.epochs] == ["start", "clock", "clock", "clock"]
    assert [rough.states[one.state].clock_offset_s for one in rough.epochs] == [0.0, 3600.0, 0.0, 3600.0]
    jumps = np.flatnonzero(np.diff(points.unix_s - times)) + 1
    assert [one.first for one in rough.epochs] == [0, *jumps]
    assert len({one.pose for one in rough.states}) == 1
    camera = known(summers.made.site)
    for number, one in enumerate(rough.epochs):  # each state still sees its own sightings, by its own clock
        seen = points.select(slice(one.first, one.last + 1))
        assert float(np.median(camera.distances(rough.states[one.state], seen))) < 3 * NOISE_PX, number


def test_another_lens_is_no_move() -> None:
    lens = truth(changes=(CameraChange(day=3, hour=17.9, focal_scale=1.12, turn_deg=(0.0, 0.0, 5.0)),))
    points, times = lens.sightings()
    rough = first_analysis(CameraSightings(points, known(lens.made.site)))
    at = lens.made.first_day.timestamp() + 3 * 14 * 86_400 + 17.9 * 3600
    assert [one.cause for one in rough.epochs] == ["start", "lens"]
    assert rough.epochs[1].first == int(np.searchsorted(times, at))
    focal = [one.calibration.camera.focal_length_px[0] for one in (rough.states[epoch.state] for epoch in rough.epochs)]
    assert focal[1] / focal[0] == pytest.approx(1.12, rel=0.01)


def test_a_camera_that_stood_still_has_one_epoch_with_all_sightings() -> None:
    points, _ = STILL.sightings()
    rough = first_analysis(CameraSightings(points, known(STILL.made.site)))
    assert [(one.cause, one.first, one.last) for one in rough.epochs] == [("start", 0, len(points) - 1)]
    assert rough.findings == ()


def test_the_calibrations_are_near_the_truth() -> None:
    _, final = analysed(BUMP)
    camera = camera_at(BUMP.made, BUMP.camera, BUMP.made.first_day.timestamp())
    _, times = BUMP.sightings()
    directions = sun_directions(times, BUMP.made.site)
    fitted = final.fitted[final.states[final.epochs[0].state].pose].calibration.camera
    off = np.linalg.norm(project(fitted, directions) - project(camera, directions), axis=-1)
    assert 0.0 < float(np.median(off)) < NOISE_PX


def test_a_mirrored_camera_is_named() -> None:
    points, _ = STILL.sightings(mirrored=True)
    findings = first_analysis(CameraSightings(points, known(STILL.made.site))).findings
    assert [(one.code, one.data) for one in findings] == [("camera_mirrored", {"mirrored": "yes"})]


def test_the_latitude_at_which_a_camera_is_level_is_named_where_its_sign_is_wrong() -> None:
    points, _ = STILL.sightings()
    south = replace(STILL.made.site, latitude=-STILL.made.site.latitude)
    (finding,) = first_analysis(CameraSightings(points, known(south))).findings
    assert finding.code == "camera_tilted_by_latitude"
    assert finding.data["latitude"] == pytest.approx(STILL.made.site.latitude, abs=3.0)  # the camera's tilt is 1.5


@pytest.mark.parametrize("hours", [2.0, -1.0])
def test_a_wrong_zone_is_named_with_the_hours(hours: float) -> None:
    points, _ = STILL.sightings()
    ahead = replace(points, unix_s=points.unix_s + hours * 3600.0)
    (finding,) = first_analysis(CameraSightings(ahead, known(STILL.made.site))).findings
    assert finding.code == "camera_tilted_by_clock"
    assert finding.data["hours"] == hours
    assert float(finding.data["odds"]) > 1.0
    assert 10.0 * abs(hours) - 2.0 < float(finding.data["tilt_deg"]) < 15.0 * abs(hours) + 2.0


@pytest.mark.parametrize(("exchanged", "code"), [(False, None), (True, "camera_tilted_by_exchange")])
def test_a_site_is_doubted_unless_the_suns_at_the_horizon_show_the_tilt(*, exchanged: bool, code: str | None) -> None:
    site = Site(latitude=37.98, longitude=23.73)
    times = 1_710_928_800.0 + np.arange(-43_200.0, 43_200.0, 240.0)
    times = times[sun_angles(times, site).apparent_zenith < 89.5]
    pose = rotation_from_pose_angles(PoseAngles(25.0, 1.5 if exchanged else 12.0, 200.0))
    camera = replace(ideal_camera(), rotation_cam_enu=pose)
    noise = np.random.default_rng(1).normal(0.0, 0.02, (times.size, 2))
    points = Sightings.of(unix_s=times, pixels=project(camera, sun_directions(times, site)) + noise)
    stated = replace(site, latitude=site.longitude, longitude=site.latitude) if exchanged else site
    archive = ArchiveCamera(stated, (camera.width, camera.height), CalibrationOptions())
    rough = first_analysis(CameraSightings(points, archive))
    assert [one.code for one in rough.findings] == ([] if code is None else [code])
    assert rough.states


@pytest.mark.parametrize("n", [0, 5])
def test_too_few_sightings_have_no_state(n: int) -> None:
    points, _ = STILL.sightings()
    rough = first_analysis(CameraSightings(points.select(slice(0, n)), known(STILL.made.site)))
    assert (rough.states, [one.code for one in rough.findings]) == ((), ["too_few_sightings"])


def test_sightings_anywhere_have_no_state() -> None:
    points, _ = STILL.sightings()
    rng = np.random.default_rng(3)
    anywhere = replace(points, pixels=rng.uniform(60, 400, points.pixels.shape)).select(slice(0, 40))
    rough = first_analysis(CameraSightings(anywhere, known(STILL.made.site)))
    assert rough.states == ()
    assert len(rough.findings) == 1


def test_a_lens_that_explains_days_of_two_states_in_part_is_that_of_former_ones() -> None:
    """Of the days that a state is sought in, a known lens by another clock explains two thirds: no other lens is."""
    changes = (
        CameraChange(day=5, hour=1.0, turn_deg=(3.0, 0.0, 0.0)),
        CameraChange(day=7, hour=1.0, turn_deg=(3.0, 0.0, 0.0), focal_scale=1.08),
    )
    mixed = truth(changes=changes, wrong_days=tuple(range(3, 11)))
    mixed = replace(mixed, made=replace(mixed.made, days=11, step_days=1, per_day=18))
    points, _ = mixed.sightings()
    rough = first_analysis(CameraSightings(points, known(mixed.made.site)))
    assert [one.cause for one in rough.epochs] == ["start", "clock", "moved", "lens"]
    assert len({one.lens for one in rough.states}) == 2
