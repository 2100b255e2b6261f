"""The projection of a lens that nobody names: found from a day's sightings, and not named where they cannot tell."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import population as pop
import pytest
from numpy.typing import NDArray

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.fit.assemble import Job
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.projection_choice import (
    ProjectionChoice,
    _add_differences,
    compare_projections,
    options_as_served,
)
from sunarc.optics.camera import Camera
from sunarc.optics.pose import pose_angles, rotation_from_pose_angles
from sunarc.optics.projections import PROJECTIONS, Projection, ideal_radius

FloatArray = NDArray[np.float64]

SIZE = (pop.SIZE, pop.SIZE)


def _lens(projection: Projection, seed: int) -> Camera:
    """Return a lens near a projection, its image circle as large as the image."""
    edge = math.radians(60.0) if projection == "perspective" else math.pi / 2
    focal = 0.5 * pop.SIZE / float(ideal_radius(projection, edge))
    base = replace(pop.CASE_3, projection=projection, focal_length_px=(focal, focal))
    return pop.random_camera(np.random.default_rng(seed), base=base)


def _day(camera: Camera, *, cadence_s: float = 360.0, sigma_px: float = 0.4) -> Sightings:
    times = pop.sun_track(np.zeros(1), cadence_s=cadence_s)
    points = pop.sightings(camera, times, pop.white_noise(np.random.default_rng(1), times.size, sigma_px))
    return points.select(np.all(np.isfinite(points.pixels) & (np.abs(points.pixels - 873.5) < 873.0), axis=-1))


def _choice(points: Sightings, projection: Projection = "equisolid") -> ProjectionChoice:
    usable, options = filter_sightings(points, site=pop.SGP, image_size=SIZE), CalibrationOptions(projection=projection)
    job = Job(points=points, usable=usable, site=pop.SGP, image_size=SIZE, options=options, circle=None)
    return compare_projections(job)[0]


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_the_true_projection_is_found(projection: Projection) -> None:
    points = _day(_lens(projection, 11))
    choice = _choice(points)
    assert choice.projection == projection
    assert choice.log_evidence[projection] == 0.0
    assert choice.finding(0.0).code == "projection_chosen"
    # the two nearest ones, equidistant and equisolid, are told apart by a factor of ten thousand and more
    assert 3.5 < float(choice.finding(0.0).data["log10_odds"]) < 1e4
    assert choice.n == len(points)


def test_the_calibration_is_that_of_the_projection_that_is_found() -> None:
    points = _day(_lens("stereographic", 3))
    found = calibrate(points, site=pop.SGP, image_size=SIZE)
    assert found.camera.projection == "stereographic"
    assert found.verdict.accepted
    assert found.verdict.findings[-1].code == "projection_chosen"
    assert found.verdict.findings[-1].data["projection"] == "stereographic"


def test_few_sightings_do_not_name_a_projection_and_state_how_far_the_others_are() -> None:
    whole = _day(_lens("equidistant", 4), cadence_s=600.0, sigma_px=0.05)
    points = whole.select(np.arange(len(whole)) < len(whole) // 3)
    assert 20 < len(points) < 60
    found = calibrate(points, site=pop.SGP, image_size=SIZE)
    (note,) = [one for one in found.verdict.findings if one.code == "projection_ambiguous"]
    stated = calibrate(
        points, site=pop.SGP, image_size=SIZE, options=CalibrationOptions(projection=found.camera.projection)
    )
    off_deg = float(note.data["off_deg"])
    assert off_deg > 0.1
    # per axis half of the square distance
    assert found.sky_rms_deg == pytest.approx(math.hypot(stated.sky_rms_deg, off_deg / math.sqrt(2.0)), rel=0.1)
    assert found.verdict.accepted == (found.sky_rms_deg <= CalibrationOptions().max_sky_deg)


def test_of_a_morning_the_hours_are_named_that_are_missing() -> None:
    whole = _day(_lens("equidistant", 4), cadence_s=600.0, sigma_px=0.4)
    found = calibrate(whole.select(np.arange(len(whole)) < len(whole) // 3), site=pop.SGP, image_size=SIZE)
    assert not found.verdict.accepted
    (hours,) = [one.data for one in found.verdict.findings if one.code == "hours_missing"]
    assert 2.0 <= float(hours["covered_h"]) <= 6.0
    assert float(hours["up_h"]) > 2.0 * float(hours["covered_h"])


def test_without_sightings_no_projection_is_called_probable() -> None:
    nothing = _day(_lens("equidistant", 4)).select(np.zeros(0, dtype=np.int64))
    choice = _choice(nothing)
    assert not choice.compared
    found = calibrate(nothing, site=pop.SGP, image_size=SIZE)
    assert [one.code for one in found.verdict.findings] == ["too_few_sightings"]


def test_too_few_sightings_leave_the_named_one_and_say_so() -> None:
    points = _day(_lens("equidistant", 4), cadence_s=7200.0)
    options = CalibrationOptions(projection="orthographic")
    choice = _choice(points, "orthographic")
    assert (choice.projection, choice.finding(0.0).code) == ("orthographic", "projection_ambiguous")
    found = calibrate(points, site=pop.SGP, image_size=SIZE, options=options)
    assert found.verdict.findings[0].code == "too_few_sightings"


@pytest.mark.parametrize(
    ("log_odds", "n", "code"),
    [(3.1, 60, "projection_chosen"), (2.9, 60, "projection_ambiguous"), (50.0, 59, "projection_ambiguous")],
)
def test_twenty_to_one_and_sixty_sightings_decide(log_odds: float, n: int, code: str) -> None:
    evidence = dict.fromkeys(PROJECTIONS, -math.inf) | {"equisolid": 0.0, "equidistant": -log_odds}
    finding = ProjectionChoice("equisolid", evidence, n).finding(0.5)
    assert finding.code == code
    assert finding.data["next"] == "equidistant"
    assert finding.data["log10_odds"] == pytest.approx(log_odds / math.log(10.0))


@pytest.mark.parametrize(
    ("log_odds", "n", "possible"),
    [(4.5, 60, ("equidistant",)), (4.7, 60, ()), (19.9, 59, ("equidistant",)), (20.1, 59, ())],
)
def test_what_is_probable_to_one_percent_is_possible(log_odds: float, n: int, possible: tuple[str, ...]) -> None:
    evidence = dict.fromkeys(PROJECTIONS, -math.inf) | {"equisolid": 0.0, "equidistant": -log_odds}
    assert ProjectionChoice("equisolid", evidence, n).possible == possible


def test_a_camera_that_is_served_states_what_the_settings_do_not() -> None:
    lens = replace(_lens("stereographic", 3), mirrored=True)
    usual = CalibrationOptions()
    served = calibrate(_day(lens), site=pop.SGP, image_size=SIZE, options=replace(usual, mirrored="yes"))
    found = options_as_served(usual, served)
    assert (found.projection, found.mirrored) == ("stereographic", "yes")
    stated = replace(usual, projection="equidistant", mirrored="no")
    assert options_as_served(stated, served) == stated
    assert options_as_served(usual, None) == usual
    assert options_as_served(usual, replace(served, sigma_limit_deg=1.5)) == usual
    (chosen,) = [one for one in served.verdict.findings if one.code == "projection_chosen"]
    undecided = replace(
        served, verdict=replace(served.verdict, findings=(replace(chosen, code="projection_ambiguous"),))
    )
    assert options_as_served(usual, undecided).projection == "auto"


@pytest.fixture(scope="module")
def served() -> Calibration:
    return calibrate(_day(_lens("equidistant", 3)), site=pop.SGP, image_size=SIZE)


@pytest.mark.parametrize("max_deg", [5.0, 30.0, 60.0])
def test_sky_that_another_lens_does_not_image_is_a_large_difference(served: Calibration, max_deg: float) -> None:
    narrow = replace(served.camera, max_angle=math.radians(max_deg))
    widened, off_deg = _add_differences(served, [narrow])
    assert 20.0 < off_deg < 90.0
    assert widened.sky_rms_deg > 10.0


def test_the_rim_that_another_lens_does_not_image_is_left_out(served: Calibration) -> None:
    angles = pose_angles(served.camera.rotation_cam_enu)
    off = angles._replace(phi_xz_deg=angles.phi_xz_deg + 1.0)
    turned = replace(served.camera, rotation_cam_enu=rotation_from_pose_angles(off))
    _, whole = _add_differences(served, [turned])
    _, cut = _add_differences(served, [replace(turned, max_angle=math.radians(86.0))])
    assert whole == pytest.approx(cut, rel=0.05)
    assert whole == pytest.approx(1.0 * math.sqrt(2.0 / 3.0), rel=0.2)


def test_a_lens_that_images_nothing_makes_no_number_unknown(served: Calibration) -> None:
    blind = replace(served.camera, max_angle=1e-9)
    widened, off_deg = _add_differences(served, [blind])
    assert 20.0 < off_deg < 90.0
    assert math.isfinite(widened.sky_rms_deg)
    same, none = _add_differences(served, [served.camera])
    assert none == pytest.approx(0.0, abs=1e-6)
    assert same.sky_rms_deg == pytest.approx(served.sky_rms_deg)
