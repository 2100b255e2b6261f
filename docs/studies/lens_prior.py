"""What a lens prior is worth: one day alone, with the type of 1 and 3 other units, joint epochs; and first poses.

    OMP_NUM_THREADS=1 python docs/studies/lens_prior.py --lenses 16 [--first 0] [--only fits|poses]

Units are drawn about a random lens with a spread of 0.3 % in focal length, 8 px in the centre, 0.4 px of radial and
0.3 px of decentering distortion; other units have three days each. The stated spread is the default of `UnitSpread`.
Prints for each way to fit the median and the 90th percentile over lenses of the error over the sky (px), the mean share
of the sky within the stated 95 %, and how many were accepted; then how often a right and a wrong type were refused or
left out; then for first poses the error, the coverage, and the mean square of the north's error in stated sigmas (1
expected) with that sigma.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from dataclasses import replace

import numpy as np
import population as pop
from coverage_statistics import CHI_SQUARE_95, squared_sigmas
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.lens_library.conditioning import apply_lens_prior
from sunarc.calibration.lens_library.first_pose import first_pose, north_sigma_deg
from sunarc.calibration.lens_library.joint import Entry, Unit, calibrate_jointly, estimate_lens_type
from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread, lens_frame
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import LENS
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector

FloatArray = NDArray[np.float64]
SKY = hemisphere(500)
SPREAD = UnitSpread(focal_length=0.003, center_px=8.0, radial_px=0.4, decentering_px=0.3)
OPTIONS = CalibrationOptions(level_within_deg=15.0)
SIGMA_PX, POSE_SIGMA_PX = 0.5, 0.3
WHEN = {"morning": 0.15, "noon": 0.5, "low sun": 0.01}


def unit_of(rng: np.random.Generator, mean: Camera) -> Camera:
    """Draw a unit of a type, in some pose."""
    frame, scales = lens_frame(mean), SPREAD.scales(mean.focal_length_px[0])
    scales[[1, 2]] = 0.1
    vector = pop.random_camera(rng).to_vector()
    vector[LENS] = frame.lens(frame.whitened(mean) + scales * rng.standard_normal(scales.size))
    return mean.replace_parameters(vector)


def record(rng: np.random.Generator, camera: Camera, days: tuple[float, ...], *, part: float = 1.0) -> Sightings:
    """Draw the sightings of days, or of the first part of one."""
    times = pop.sun_track(np.array(days), cadence_s=120.0)
    times = times[: int(part * times.size)]
    points = pop.sightings(camera, times, pop.white_noise(rng, times.size, SIGMA_PX))
    return replace(points, sigma_px=np.full(len(points), SIGMA_PX))


def fit(points: Sightings) -> Calibration:
    """Fit sightings alone."""
    return calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE), options=OPTIONS)


def score(found: Calibration, truth: Camera) -> list[float]:
    """Return the error over the sky, px, its coverage, and whether it was accepted."""
    pixels, covariance = project_with_covariance(found, SKY)
    error = pixels - project(truth, SKY)
    square = squared_sigmas(error, covariance)
    rms = float(np.sqrt(np.nanmean(np.sum(error**2, axis=-1))))
    return [rms, float(np.nanmean(square < CHI_SQUARE_95)), float(found.verdict.accepted)]


def of_one_lens(seed: int, rows: dict[str, list[list[float]]], verdicts: dict[str, Counter[str]]) -> None:
    """Add what one unit, three others and a wrong type come to."""
    rng = np.random.default_rng(7000 + seed)
    mean = pop.random_camera(rng)
    camera = unit_of(rng, mean)
    others = [Unit(str(k), fit(record(rng, unit_of(rng, mean), (0.0, 1.0, 20.0)))) for k in range(3)]
    types = {"1 unit": estimate_lens_type(others[:1]), "3 units": estimate_lens_type(others)}
    wrong = pop.random_camera(rng)
    wrong_type = estimate_lens_type([Unit("wrong", fit(record(rng, wrong, (0.0, 1.0, 20.0))))])
    for name, part in (("1 day", 1.0), ("half a day", 0.5)):
        points = record(rng, camera, (10.0,), part=part)
        alone = fit(points)
        rows[f"{name}, alone"].append(score(alone, camera))
        for what, lens in types.items():
            found = apply_lens_prior(alone, lens, points=points, options=OPTIONS)
            rows[f"{name}, type of {what}"].append(score(found, camera))
            verdicts[f"{name}, right type of {what}"][_outcome(found)] += 1
        found = apply_lens_prior(alone, wrong_type, points=points, options=OPTIONS)
        verdicts[f"{name}, type of another lens"][_outcome(found)] += 1
    rows["3 epochs, joint"].append(score(joint_of(rng, camera), camera))


def joint_of(rng: np.random.Generator, camera: Camera) -> Calibration:
    """Return the calibration of the last of three epochs of a camera, a day each, fitted together."""
    poses = [pop.random_camera(rng).rotation_cam_enu for _ in range(2)] + [camera.rotation_cam_enu]
    entries = [
        Entry(
            camera="one",
            epoch=str(k),
            points=record(rng, replace(camera, rotation_cam_enu=pose), (day,)),
            site=pop.SGP,
            image_size=(pop.SIZE, pop.SIZE),
            options=OPTIONS,
        )
        for k, (pose, day) in enumerate(zip(poses, (0.0, 5.0, 10.0), strict=True))
    ]
    return calibrate_jointly(entries).calibrations[-1]


def _outcome(found: Calibration) -> str:
    codes = {finding.code for finding in found.verdict.findings}
    for code in ("lens_prior_contradicted", "lens_prior_left_out", "lens_prior_used"):
        if code in codes:
            return code.removeprefix("lens_prior_")
    return "refused"


def poses_of_one_lens(seed: int, rows: dict[str, list[list[float]]]) -> None:
    """Add the first poses of one unit whose type is known exactly, within the spread."""
    rng = np.random.default_rng(9000 + seed)
    mean = pop.random_camera(rng)
    camera, frame = unit_of(rng, mean), lens_frame(mean)
    level = replace(mean, rotation_cam_enu=(0.0, 0.0, 0.0))
    covariance = frame.basis @ np.diag(SPREAD.scales(mean.focal_length_px[0]) ** 2) @ frame.basis.T
    lens = LensType(
        camera=level, covariance=covariance, spread=SPREAD, field_px=0.0, field_length_px=0.0, cameras=("a",), days=()
    )
    times = pop.sun_track(np.array([0.0]), cadence_s=60.0)
    for when, begin in WHEN.items():
        for count in (5, 10, 20):
            first = int(begin * times.size)
            noise = pop.white_noise(rng, count, POSE_SIGMA_PX)
            points = pop.sightings(camera, times[first : first + count], noise)
            points = replace(points, sigma_px=np.full(len(points), POSE_SIGMA_PX))
            found = first_pose(points, lens=lens, site=pop.SGP, options=CalibrationOptions())
            turn = rotation_matrix(found.camera.rotation_cam_enu).T @ rotation_matrix(camera.rotation_cam_enu)
            north = float(np.degrees(rotation_vector(turn)[2])) / north_sigma_deg(found)
            rows[f"{count} sightings, {when}"].append([*score(found, camera), north**2, north_sigma_deg(found)])


def print_rows(rows: dict[str, list[list[float]]], more: tuple[str, ...] = ()) -> None:
    """Print a table of scores."""
    print(f"{'':28s}{'sky med':>9s}{'P90':>9s}{'cover':>9s}{'accepted':>9s}" + "".join(f"{m:>9s}" for m in more))
    for name, found in rows.items():
        table = np.array(found)
        median, high = np.quantile(table[:, 0], [0.5, 0.9])
        means = "".join(f"{value:9.3f}" for value in table[:, 1:].mean(axis=0))
        print(f"{name:28s}{median:9.3f}{high:9.3f}{means}", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lenses", type=int, default=16)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", choices=("fits", "poses"))
    chosen = parser.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.lenses)
    if chosen.only != "poses":
        rows: dict[str, list[list[float]]] = defaultdict(list)
        verdicts: dict[str, Counter[str]] = defaultdict(Counter)
        for seed in seeds:
            of_one_lens(seed, rows, verdicts)
        print_rows(rows)
        for name, outcomes in verdicts.items():
            print(f"{name:40s}", dict(outcomes))
    if chosen.only != "fits":
        poses: dict[str, list[list[float]]] = defaultdict(list)
        for seed in seeds:
            poses_of_one_lens(seed, poses)
        print_rows(poses, ("north²", "north°"))


if __name__ == "__main__":
    main()
