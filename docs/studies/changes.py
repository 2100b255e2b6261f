"""How soon a change is noticed, what it is called, and how often there was none.

    OMP_NUM_THREADS=1 python docs/studies/changes.py --days 300
    OMP_NUM_THREADS=1 python docs/studies/changes.py --clouded 100 --cadence 60
    OMP_NUM_THREADS=1 python docs/studies/changes.py --changes 20

The first counts false alarms over simulated days, half of them cloudy with 30 % false sightings, on a mount that
wanders by 0.01 degrees with the heat of the day. The second counts them over days on each of which cloud draws the
detections aside three times, for 5 minutes to an hour, by 1 to 10 px. The third makes changes of every kind at random
times of random days, and prints after how many sightings they were noticed, how far the change was misdated, and what
they were called.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from real_like_tracks import drawn_aside
from scipy.spatial.transform import Rotation

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.online import change_details, update_window
from sunarc.changes.values import Sighting, SightingWindow, WatchOptions
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.sun import sun_angles, sun_directions

FloatArray = NDArray[np.float64]

_FIRST_NOON = 1_368_403_200.0 + 43_200.0 + 97.484856 * 240.0
_SIGMA_PX = 0.02
_WANDER_DEG = 0.01
_TRUTH = replace(true_camera(), max_angle=2.5)


def times_of(day: int, cadence_s: float) -> FloatArray:
    """Return the times of a day's sightings."""
    times = _FIRST_NOON + 86_400.0 * day + np.arange(-43_200.0, 43_200.0, cadence_s)
    return times[sun_angles(times, SGP).apparent_zenith < 89.0]


def turned(camera: Camera, turn_deg: FloatArray) -> Camera:
    """Return a camera after a turn about its own axes."""
    matrix = Rotation.from_rotvec(np.radians(turn_deg)).as_matrix() @ rotation_matrix(camera.rotation_cam_enu)
    return replace(camera, rotation_cam_enu=rotation_vector(matrix))


def wandering(times: FloatArray, axis: FloatArray) -> FloatArray:
    """Return pixels (n, 2) of the sun for a mount that leans to and fro with the heat of the day."""
    phase = np.sin(2.0 * np.pi * (times - _FIRST_NOON) / 86_400.0)
    plain = project(_TRUTH, sun_directions(times, SGP))
    leaning = project(turned(_TRUTH, _WANDER_DEG * axis), sun_directions(times, SGP))
    return plain + phase[:, None] * (leaning - plain)


def calibrated() -> Calibration:
    """Return the fit of a year's clear days."""
    times = np.concatenate([times_of(day, 900.0) for day in range(0, 360, 12)])
    noise = np.random.default_rng(1).normal(0.0, _SIGMA_PX, (times.size, 2))
    points = Sightings.of(unix_s=times, pixels=project(_TRUTH, sun_directions(times, SGP)) + noise)
    return calibrate(points, site=SGP, image_size=(_TRUTH.width, _TRUTH.height))


def looked(
    watch: SightingWindow, calibration: Calibration, times: FloatArray, pixels: FloatArray, **told: bool
) -> tuple[SightingWindow, int, PoseChange | None]:
    """Return the watch after sightings, how many it took, and the change it found."""
    directions = sun_directions(times, SGP)
    for number, (unix_s, pixel, direction) in enumerate(zip(times, pixels, directions, strict=True), 1):
        one = Sighting(unix_s=float(unix_s), pixel=tuple(pixel), direction=tuple(direction), sigma_px=_SIGMA_PX)
        watch, change = update_window(watch, one, calibration=calibration, site=SGP, options=WatchOptions(), **told)
        if change is not None:
            return watch, number, change
    return watch, times.size, None


def false_alarms(days: int, calibration: Calibration, cadence_s: float) -> None:
    """Print the false alarms over simulated days."""
    rng, watch, found = np.random.default_rng(7), SightingWindow(), []
    total = 0
    for day in range(days):
        times = times_of(day, cadence_s)
        pixels = wandering(times, np.array([0.7, 0.7, 0.1])) + rng.normal(0.0, _SIGMA_PX, (times.size, 2))
        if day % 2:
            kept = rng.random(times.size) < 0.5
            times, pixels = times[kept], pixels[kept]
            false = rng.random(times.size) < 0.3
            pixels = pixels + np.where(false[:, None], rng.normal(0.0, 8.0, pixels.shape), 0.0)
        total += times.size
        watch, _, change = looked(watch, calibration, times, pixels)
        if change is not None:
            found.append((day, change.cause, change_details(change)["text"]))
            watch = SightingWindow()
    print(f"{days} days, {total} sightings: {len(found)} false alarms {found}")


def clouded(days: int, calibration: Calibration, cadence_s: float) -> int:
    """Print, and return, the false alarms over days on which cloud draws the detections aside."""
    rng, watch, found, total = np.random.default_rng(11), SightingWindow(), [], 0
    for day in range(days):
        times = times_of(day, cadence_s)
        pixels = wandering(times, np.array([0.7, 0.7, 0.1])) + rng.normal(0.0, _SIGMA_PX, (times.size, 2))
        for _ in range(3):
            long = float(rng.uniform(300.0, 3600.0))
            share = (times - rng.uniform(times[0] - 0.5 * long, times[-1] - 0.5 * long)) / long
            mine = (share >= 0.0) & (share <= 1.0)
            pixels[mine] += drawn_aside(rng, share[mine], float(rng.uniform(1.0, 10.0)))
        total += times.size
        watch, number, change = looked(watch, calibration, times, pixels)
        if change is not None:
            found.append((day, number, change.cause, change_details(change)["text"]))
            watch = SightingWindow()
    print(f"{days} days with cloud, a sighting every {cadence_s:g} s, {total}: {len(found)} false alarms", flush=True)
    for one in found:
        print(f"  {one}")
    return len(found)


def bump(size_deg: float) -> Callable[[np.random.Generator, FloatArray], FloatArray]:
    """Return a turn of this size about a random axis."""

    def seen(rng: np.random.Generator, times: FloatArray) -> FloatArray:
        axis = rng.normal(size=3)
        return project(turned(_TRUTH, size_deg * axis / np.linalg.norm(axis)), sun_directions(times, SGP))

    return seen


def clock(step_s: float) -> Callable[[np.random.Generator, FloatArray], FloatArray]:
    """Return a clock that was set."""
    return lambda _, times: project(_TRUTH, sun_directions(times + step_s, SGP))


def mirrored(_: np.random.Generator, times: FloatArray) -> FloatArray:
    """Return the pixels of a mirrored image."""
    return np.array([_TRUTH.width - 1.0, 0.0]) + [-1.0, 1.0] * project(_TRUTH, sun_directions(times, SGP))


def other_lens(rng: np.random.Generator, times: FloatArray) -> FloatArray:
    """Return the pixels of another camera altogether."""
    return project(replace(true_camera(int(rng.integers(1, 1000))), max_angle=2.5), sun_directions(times, SGP))


def refocused(rng: np.random.Generator, times: FloatArray) -> FloatArray:
    """Return the pixels of the same lens, refocused: an image larger or smaller by 0.3 to 2 %."""
    focal = _TRUTH.focal_length_px[0] * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.003, 0.02))
    return project(replace(_TRUTH, focal_length_px=(focal, focal)), sun_directions(times, SGP))


def shifted(rng: np.random.Generator, times: FloatArray) -> FloatArray:
    """Return the pixels of a sensor that slid by 2 to 20 px behind its lens."""
    way, (x, y) = rng.uniform(0.0, 2.0 * np.pi), _TRUTH.principal_point_px
    by = rng.uniform(2.0, 20.0)
    moved = replace(_TRUTH, principal_point_px=(x + by * np.cos(way), y + by * np.sin(way)))
    return project(moved, sun_directions(times, SGP))


CHANGES = {
    "bump 0.02 degrees": bump(0.02),
    "bump 0.2 degrees": bump(0.2),
    "bump 5 degrees": bump(5.0),
    "clock 5 s": clock(5.0),
    "mirrored": mirrored,
    "lens": other_lens,
    "refocus": refocused,
    "shift": shifted,
}


def changes(trials: int, calibration: Calibration, cadence_s: float) -> None:
    """Print how changes of every kind were noticed."""
    print(f"{'change':20s}{'noticed after':>16s}{'misdated by':>14s}  called")
    for name, change in CHANGES.items():
        rng = np.random.default_rng(3)
        took, off, called = [], [], Counter[str]()
        for _ in range(trials):
            times = times_of(int(rng.integers(0, 360)), cadence_s)
            first = int(rng.integers(40, times.size - 100))
            times = times[first - 40 : first + 100]
            pixels = np.concatenate([wandering(times[:40], np.array([0.7, 0.7, 0.1])), change(rng, times[40:])])
            pixels = pixels + rng.normal(0.0, _SIGMA_PX, pixels.shape)
            inside = np.all(np.isfinite(pixels), axis=-1)
            _, number, found = looked(
                SightingWindow(), calibration, times[inside], pixels[inside], clock_stepped=name.startswith("clock")
            )
            called["nothing" if found is None else found.cause] += 1
            if found is not None:
                took.append(number - 40)
                off.append(abs(found.time - times[40]) / cadence_s)
        worst = (f"{np.median(took):.0f}, at most {max(took)}", f"at most {max(off):.0f}") if took else ("-", "-")
        print(f"{name:20s}{worst[0]:>16s}{worst[1]:>14s}  {dict(called)}", flush=True)


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=int, default=0)
    parser.add_argument("--clouded", type=int, default=0, help="days on which cloud draws detections aside")
    parser.add_argument("--changes", type=int, default=0)
    parser.add_argument("--cadence", type=float, default=120.0)
    chosen = parser.parse_args()
    calibration = calibrated()
    if chosen.days:
        false_alarms(chosen.days, calibration, chosen.cadence)
    if chosen.clouded:
        clouded(chosen.clouded, calibration, chosen.cadence)
    if chosen.changes:
        changes(chosen.changes, calibration, chosen.cadence)


if __name__ == "__main__":
    main()
