"""Every sighting against the calibration: what is noticed, how soon, and what it is called."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.pose import estimate_pose
from sunarc.changes.online import change_details, distrusted, update_window
from sunarc.changes.values import Sighting, SightingWindow, WatchOptions
from sunarc.lab.simulation.truth import SGP
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated

FloatArray = NDArray[np.float64]
After = Callable[[Camera, FloatArray], FloatArray]
BEFORE, AFTER = 30, 20
NOON = 1_368_403_200.0 + 86_400.0 + 43_200.0 + 97.484856 * 240.0


@pytest.fixture(scope="module")
def camera(clear_day: Simulated) -> Camera:
    return replace(clear_day.camera, max_angle=2.5)


def rotated(camera: Camera, turn_deg: tuple[float, float, float]) -> Camera:
    matrix = Rotation.from_rotvec(np.radians(turn_deg)).as_matrix() @ rotation_matrix(camera.rotation_cam_enu)
    return replace(camera, rotation_cam_enu=rotation_vector(matrix))


def sightings(camera: Camera, after: After, *, false: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return one every minute around noon; `after` says where the sun is seen from the 31st on."""
    times = NOON + 60.0 * np.arange(-BEFORE, AFTER, dtype=np.float64)
    rng = np.random.default_rng(seed)
    before = project(camera, sun_directions(times[:BEFORE], SGP))
    pixels = np.concatenate([before, after(camera, times[BEFORE:])]) + rng.normal(0.0, 0.02, (times.size, 2))
    wrong = rng.random(times.size) < false
    return times, pixels + np.where(wrong[:, None], rng.normal(0.0, 8.0, pixels.shape), 0.0)


def watched(
    calibration: Calibration, times: FloatArray, pixels: FloatArray, *, site: Site = SGP, **describe_change: bool
) -> tuple[int, PoseChange | None]:
    """Return after how many sightings what was found."""
    watch, directions = SightingWindow(), sun_directions(times, site)
    for number, (unix_s, pixel, direction) in enumerate(zip(times, pixels, directions, strict=True), 1):
        one = Sighting(unix_s=float(unix_s), pixel=tuple(pixel), direction=tuple(direction), sigma_px=0.02)
        watch, change = update_window(
            watch, one, calibration=calibration, site=site, options=WatchOptions(), **describe_change
        )
        if change is not None:
            return number, change
    return len(times), None


def bumped(*turn_deg: float) -> After:
    return lambda camera, times: project(rotated(camera, turn_deg), sun_directions(times, SGP))  # type: ignore[arg-type]


def mirrored(camera: Camera, times: FloatArray) -> FloatArray:
    return np.array([camera.width - 1.0, 0.0]) + [-1.0, 1.0] * project(camera, sun_directions(times, SGP))


@pytest.mark.parametrize("turn_deg", [(0.1, 0.0, 0.17), (-0.2, 0.0, 0.0), (0.012, 0.016, 0.0), (20.0, 10.0, -30.0)])
def test_a_turn_is_noticed_within_ten_sightings_and_dated_to_two(
    calibrated: Calibration, camera: Camera, turn_deg: tuple[float, float, float]
) -> None:
    times, pixels = sightings(camera, bumped(*turn_deg), false=0.0, seed=1)
    number, change = watched(calibrated, times, pixels)
    assert change is not None
    assert change.cause == "bump"
    assert number - BEFORE <= 10
    assert abs(change.time - times[BEFORE]) <= 2 * 60.0
    assert change.bracket[0] < times[BEFORE] <= change.bracket[1]


def test_a_third_of_false_sightings_hide_no_turn(calibrated: Calibration, camera: Camera) -> None:
    times, pixels = sightings(camera, bumped(0.0, 0.15, 0.1), false=0.33, seed=2)
    number, change = watched(calibrated, times, pixels)
    assert change is not None
    assert change.cause == "bump"
    assert number - BEFORE <= 15
    assert abs(change.time - times[BEFORE]) <= 2 * 60.0


@pytest.mark.parametrize("false", [0.0, 0.33])
def test_false_sightings_alone_are_no_change(calibrated: Calibration, camera: Camera, false: float) -> None:
    times, pixels = sightings(camera, bumped(0.0, 0.0, 0.0), false=false, seed=3)
    assert watched(calibrated, times, pixels) == (times.size, None)


def test_a_mount_that_wanders_with_the_heat_is_no_change(calibrated: Calibration, camera: Camera) -> None:
    times = NOON + np.arange(-5.0, 5.0, 0.1) * 3600.0
    lean = 0.01 * np.sin(2.0 * np.pi * (times - NOON) / (4.0 * 3600.0))
    pixels = np.array(
        [project(rotated(camera, (a, 0.0, 0.0)), sun_directions(t, SGP)) for a, t in zip(lean, times, strict=True)]
    )
    noise = np.random.default_rng(4).normal(0.0, 0.02, pixels.shape)
    assert watched(calibrated, times, pixels + noise)[1] is None


def test_a_clock_that_the_host_says_was_set_is_a_clock(calibrated: Calibration, camera: Camera) -> None:
    times, pixels = sightings(camera, lambda seen, t: project(seen, sun_directions(t + 5.0, SGP)), false=0.0, seed=5)
    _, change = watched(calibrated, times, pixels, clock_stepped=True)
    assert change is not None
    assert (change.cause, change_details(change)["unit"]) == ("clock", "s")
    assert change_details(change)["size"] == pytest.approx(5.0, abs=4.0 * change_details(change)["size_sigma"])


def test_a_turn_is_a_turn_though_the_clock_was_set(calibrated: Calibration, camera: Camera) -> None:
    times, pixels = sightings(camera, bumped(0.1, 0.3, 0.0), false=0.0, seed=6)
    _, change = watched(calibrated, times, pixels, clock_stepped=True)
    assert change is not None
    assert change.cause == "bump"


@pytest.mark.parametrize("false", [0.0, 0.3])
def test_a_mirrored_image_is_named(calibrated: Calibration, camera: Camera, false: float) -> None:
    times, pixels = sightings(camera, mirrored, false=false, seed=7)
    _, change = watched(calibrated, times, pixels)
    assert change is not None
    assert change.cause == "mirrored"
    assert "reverse" in change_details(change)["remedy"]


@pytest.mark.parametrize(("latitude", "longitude"), [(-1.0, 1.0), (1.0, -1.0)])
def test_a_site_with_the_wrong_sign_is_named(
    calibrated: Calibration, camera: Camera, latitude: float, longitude: float
) -> None:
    wrong = replace(SGP, latitude=latitude * SGP.latitude, longitude=longitude * SGP.longitude)
    times, pixels = sightings(camera, bumped(0.0, 0.0, 0.0), false=0.0, seed=8)
    _, change = watched(calibrated, times, pixels, site=wrong)
    assert change is not None
    assert change.cause == "site"


def test_another_lens_is_named_at_once_or_when_its_pose_does_not_hold(calibrated: Calibration, camera: Camera) -> None:
    other = replace(
        rotated(camera, (1.0, 2.0, 30.0)), focal_length_px=(590.0, 590.0), principal_point_px=(885.0, 870.0)
    )
    times = NOON + 60.0 * np.arange(-30.0, 60.0)
    seen = [project(one, sun_directions(part, SGP)) for one, part in ((camera, times[:30]), (other, times[30:]))]
    pixels = np.concatenate(seen) + np.random.default_rng(9).normal(0.0, 0.02, (times.size, 2))
    number, first = watched(calibrated, times, pixels)
    assert first is not None
    if first.cause == "lens":
        return
    begun = times >= first.time
    few = Sightings.of(unix_s=times[begun][: number - 30], pixels=pixels[begun][: number - 30])
    posed = estimate_pose(few, start=calibrated, site=SGP, options=CalibrationOptions(level_within_deg=40.0))
    _, second = watched(posed, times[begun], pixels[begun], posed_from_few=True)
    assert second is not None
    assert second.cause == "lens"


@pytest.mark.parametrize("grown", [0.99, 1.01])
def test_a_refocused_lens_is_named_with_how_much_the_image_grew(
    calibrated: Calibration, camera: Camera, grown: float
) -> None:
    focal = grown * camera.focal_length_px[0]
    refocused = replace(camera, focal_length_px=(focal, focal))
    times, pixels = sightings(camera, lambda _, t: project(refocused, sun_directions(t, SGP)), false=0.0, seed=10)
    number, change = watched(calibrated, times, pixels)
    assert change is not None
    assert (change.cause, change_details(change)["unit"]) == ("refocus", "%")
    assert number - BEFORE <= 10
    assert change_details(change)["size"] == pytest.approx(
        100.0 * (grown - 1.0), abs=4.0 * change_details(change)["size_sigma"]
    )


def test_a_sensor_that_shifts_is_a_bump_that_may_be_a_shift_while_both_look_alike(
    calibrated: Calibration, camera: Camera
) -> None:
    x, y = camera.principal_point_px
    shifted = replace(camera, principal_point_px=(x + 4.0, y - 3.0))
    times, pixels = sightings(camera, lambda _, t: project(shifted, sun_directions(t, SGP)), false=0.0, seed=11)
    _, change = watched(calibrated, times, pixels)
    assert change is not None
    assert change.cause == "shift" or "shift" in change.perhaps
    assert "sensor" in change_details(change)["text"]


def test_another_lens_is_named_once_the_arc_is_long_enough(calibrated: Calibration, camera: Camera) -> None:
    other = replace(
        rotated(camera, (1.0, 2.0, 30.0)), focal_length_px=(585.0, 585.0), principal_point_px=(890.0, 860.0)
    )
    times = NOON + 360.0 * np.arange(-10, 30)
    pixels = np.concatenate(
        [project(camera, sun_directions(times[:10], SGP)), project(other, sun_directions(times[10:], SGP))]
    )
    found: set[str] = set()
    watch, directions = SightingWindow(), sun_directions(times, SGP)
    for unix_s, pixel, direction in zip(times, pixels, directions, strict=True):
        one = Sighting(unix_s=float(unix_s), pixel=tuple(pixel), direction=tuple(direction), sigma_px=0.02)
        watch, change = update_window(watch, one, calibration=calibrated, site=SGP, options=WatchOptions())
        found |= set() if change is None else {change.cause}
    assert "lens" in found


@pytest.mark.parametrize("shown", ["first", "last", "two"])
def test_an_image_that_comes_again_is_no_exception(calibrated: Calibration, camera: Camera, shown: str) -> None:
    times, pixels = sightings(camera, bumped(0.0, 0.0, 0.0), false=0.0, seed=1)
    frozen = {"first": pixels[:1], "last": pixels[BEFORE - 1 : BEFORE], "two": pixels[:2]}[shown]
    pixels[BEFORE:] = np.resize(frozen, (AFTER, 2))
    watched(calibrated, times, pixels)


@pytest.mark.parametrize(
    ("cadence_s", "shape"),
    [(60.0, "grows and vanishes"), (60.0, "comes at once and fades"), (120.0, "comes at once and fades")],
)
def test_cloud_that_draws_the_detections_aside_for_twenty_minutes_is_no_change(
    calibrated: Calibration, camera: Camera, cadence_s: float, shape: str
) -> None:
    times = NOON + np.arange(-40.0 * cadence_s, 1600.0, cadence_s)
    share = times - NOON
    share = np.clip(share / 1200.0, 0.0, 1.0)
    size = np.sin(np.pi * share) if shape == "grows and vanishes" else np.where(share > 0.0, 1.0 - share, 0.0)
    angle = 1.0 + 0.7 * share
    aside = 5.0 * size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    noise = np.random.default_rng(9).normal(0.0, 0.02, aside.shape)
    pixels = project(camera, sun_directions(times, SGP)) + aside + noise
    assert watched(calibrated, times, pixels) == (times.size, None)


def test_as_many_sightings_as_an_hour_has_minutes_less_four_are_remembered(
    calibrated: Calibration, camera: Camera
) -> None:
    times = NOON + 60.0 * np.arange(59, dtype=np.float64)
    directions = sun_directions(times, SGP)
    watch = SightingWindow()
    for unix_s, pixel, direction in zip(times, project(camera, directions), directions, strict=True):
        one = Sighting(unix_s=float(unix_s), pixel=tuple(pixel), direction=tuple(direction), sigma_px=0.02)
        watch, _ = update_window(watch, one, calibration=calibrated, site=SGP, options=WatchOptions())
    assert watch.unix_s.tolist() == times[-56:].tolist()


@pytest.mark.parametrize(
    ("late", "expected"),
    [
        ((True, True, True, False, False, False), True),
        ((False, True, False, True, True, False), True),
        ((True, True, True, True, False, False), False),
        ((False, False, False, False, False, True), False),
    ],
)
def test_half_of_the_last_six_must_disagree_the_last_one_too(late: tuple[bool, ...], *, expected: bool) -> None:
    before = [False] * 5  # earlier ones do not count
    trusted = np.array([*before, *late])
    assert distrusted(SightingWindow(pixels=np.zeros((trusted.size, 2)), trusted=trusted)) == expected
