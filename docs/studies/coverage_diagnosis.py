"""Where rows of `coverage.py` come to be too narrow: fits that know the true scales beside fits that infer them.

    OMP_NUM_THREADS=1 python docs/studies/coverage_diagnosis.py --lenses 40 [--case NAME]… [--control NAME]…
    OMP_NUM_THREADS=1 python docs/studies/coverage_diagnosis.py --whitened | --real-like 30

Lenses, fields and noise are those of `coverage.py` by the same numbers. Controls: "as served"; "field known", whose
grid of scales holds the true amplitude and length of the field alone; "scales known", that holds the true scales of
radial distortion and decentering alone as well; "gauge projected", in which the residual radial distortion's prior
loses its share of a change of focal length by projection, as the lenses of `population.py` do, not by conditioning on
there being none. Where a control is right and the service's fit is not, what it replaces is at fault; where the scales
are known and it is wrong still, the model or the Gaussian approximation is.

Printed for each: the share of the sky within the stated 95 %, near the track and far; the 10, 50 and 90 % quantiles
over lenses of the mean squared error in stated sigmas per axis (1 expected), far from the track; the share of lenses of
which less than 0.8 of the sky lies within the stated 95 %, and the share of all that lies outside which they have; the
coverage of the others; and the medians of the error over the sky and of the one stated, px.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import population as pop
from coverage import CASES, Case, field_of, field_scales, lens_of
from coverage_statistics import CHI_SQUARE_95, degrees_from_track, every_so_many, squared_sigmas
from numpy.typing import NDArray
from real_like_fits import sky_error_px
from real_like_tracks import real_like_track

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.fit import robust_fit
from sunarc.calibration.fit.marginal_likelihood import HyperparameterGrid
from sunarc.calibration.model.options import CalibrationOptions, LensTolerances
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve import priors
from sunarc.optics.camera import RADIAL_ORDERS, Camera, camera_sees
from sunarc.optics.displacement import wave_basis
from sunarc.optics.projections import ideal_radius

FloatArray = NDArray[np.float64]
_SKY = hemisphere(600)
_IMPOSSIBLE = -50.0
"""Log prior of the field's floor where a field is known: it stays in the grid, which expects one."""
_GAUGE_PX = 0.3
"""The share of a change of focal length that stays in the residual distortion, 1-sigma, as in the fit's own prior."""
_RADIAL_PX = 1.5
"""Scale of the radial distortion of `population.py`."""
CONTROLS = "as served", "field known", "scales known", "gauge projected"


def projected_radial_basis(camera: Camera, *, length: float, upto: float) -> FloatArray:
    """Return what `priors.radial_basis` does, the share of a change of focal length taken out by projection."""
    focal = float(np.mean(camera.focal_length_px))
    theta = np.linspace(0.0, upto, 181)
    kernel = np.exp(-0.5 * ((theta[:, None] - theta) / length) ** 2) + 0.25**2 * np.eye(theta.size)
    powers = (theta / (math.pi / 2))[:, None] ** np.array(RADIAL_ORDERS)
    ideal = ideal_radius(camera.projection, theta)
    unit = ideal / np.linalg.norm(ideal)
    # least squares onto the powers, themselves held orthogonal to the ideal projection
    normal = np.zeros((9, 9))
    normal[:8, :8] = powers.T @ powers + 1e-10 * np.eye(8)
    normal[8, :8] = normal[:8, 8] = ideal @ powers
    orthogonal = np.vstack([powers.T @ (np.eye(theta.size) - np.outer(unit, unit)), np.zeros((1, theta.size))])
    to_coefficients = np.linalg.solve(normal, orthogonal)[:8] / focal
    share = np.linalg.lstsq(powers, unit)[0] * math.sqrt(theta.size) * _GAUGE_PX / focal
    covariance = to_coefficients @ kernel @ to_coefficients.T + np.outer(share, share)
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 1e-14 * values[-1])))


def known_grid(grid: HyperparameterGrid, scales: tuple[float, float], lens: FloatArray | None) -> HyperparameterGrid:
    """Return the grid with the field's amplitude and length, px, known, and those of the lens unless they are None."""
    amplitude, length = scales
    lens_scales, of_lens = grid.lens_scales, grid.log_prior[0, 0] - np.max(grid.log_prior[0, 0])
    if lens is not None:
        lens_scales, of_lens = lens[None], np.zeros(1)
    if amplitude <= 0.0:
        floor = replace(grid, amplitudes=grid.amplitudes[:1], lens_scales=lens_scales)
        return replace(floor, log_prior=np.zeros((1, grid.lengths.size, 1)) + of_lens)
    size = _size(grid)
    basis = wave_basis(width=size[0], height=size[1], shortest_px=length, longest_px=length)
    amplitudes = np.array([grid.amplitudes[0], amplitude])
    log_prior = np.array([_IMPOSSIBLE, 0.0])[:, None, None] + of_lens
    return HyperparameterGrid(
        amplitudes=amplitudes, lengths=np.array([length]), lens_scales=lens_scales, log_prior=log_prior, basis=basis
    )


def _size(grid: HyperparameterGrid) -> tuple[int, int]:
    """Return the image's size, px."""
    width, height = (round(2.0 * middle + 1.0) for middle in grid.basis.center_px)
    return width, height


def fit_of(case: Case, truth: Camera, points: Sightings, scales: tuple[float, float], control: str) -> Calibration:
    """Return the fit of a lens's sightings with what a control knows."""
    share = min(case.size) / pop.SIZE
    lens = np.array([1.5 * share, 0.6 * share]) if control == "scales known" else None
    ordinary = robust_fit.make_hyperparameter_grid

    def grid_of(template: Camera, options: CalibrationOptions) -> HyperparameterGrid:
        grid = ordinary(template, options)
        return known_grid(grid, scales, lens) if control in {"field known", "scales known"} else grid

    basis = projected_radial_basis if control == "gauge projected" else priors.radial_basis
    with patch.object(robust_fit, "make_hyperparameter_grid", grid_of), patch.object(priors, "radial_basis", basis):
        options = CalibrationOptions(projection=case.projection, level_within_deg=60.0)
        return calibrate(points, site=case.site, image_size=case.size, options=options, start=truth)


def one_lens(seed: int, case: Case, controls: tuple[str, ...]) -> FloatArray:
    """Return (controls, 6) of one lens.

    The share covered over the sky, near the track and far, the mean squared sigmas far, the RMS error and the stated
    one over the sky, px.
    """
    rng = np.random.default_rng([seed, 20])
    truth = lens_of(case, rng)
    scales = field_scales(case, rng)
    field = field_of(scales, rng)
    sun = pop.track(case.days, site=case.site, cadence_s=case.cadence_s).shown_by(truth)
    points = pop.sightings_of(
        truth, sun.unix_s, sun.directions, case.noise(rng, sun.zenith_deg, case.sigma_px), field=field
    )
    expected, away = pop.seen_at(truth, _SKY, field), degrees_from_track(_SKY, every_so_many(sun.directions))
    rows = []
    for control in controls:
        found, covariance = project_with_covariance(fit_of(case, truth, points, scales, control), _SKY)
        shown = camera_sees(truth, expected) & np.all(np.isfinite(found), axis=-1)
        square = squared_sigmas((found - expected)[shown], covariance[shown])
        near, far = away[shown] < 20.0, away[shown] > 40.0
        inside = square < CHI_SQUARE_95
        shares = [float(inside[where].mean()) if np.any(where) else math.nan for where in (near, far)]
        z = 0.5 * float(square[far].mean()) if np.any(far) else math.nan
        rms = math.sqrt(float(np.mean(np.sum((found - expected)[shown] ** 2, axis=-1))))
        stated = math.sqrt(float(np.mean(np.trace(covariance[shown], axis1=-2, axis2=-1))))
        rows.append([float(inside.mean()), *shares, z, rms, stated])
    return np.array(rows)


def print_whitened() -> None:
    """Print the RMS of the eight whitened coordinates of 300 lenses' radial distortion, in sigmas of either prior."""
    for name, basis in (("as served", priors.radial_basis), ("gauge projected", projected_radial_basis)):
        found = []
        for seed in range(300):
            camera = lens_of(Case(), np.random.default_rng([seed, 20]))
            radial = basis(camera, length=math.radians(LensTolerances().radial_length_deg), upto=math.pi / 2)
            found.append(np.linalg.solve(radial, np.array(camera.radial)) / _RADIAL_PX)
        print(name, np.round(np.sqrt(np.mean(np.square(found), axis=0)), 2))


def print_real_like(count: int) -> None:
    """Print how real-like tracks are fitted with either prior: error over the sky, px, and the verdict."""
    rows = []
    for seed in range(count):
        track, row = real_like_track(seed), list[float]()
        for basis in (priors.radial_basis, projected_radial_basis):
            with patch.object(priors, "radial_basis", basis):
                fit = calibrate(track.points, site=track.site, image_size=track.image_size, options=track.options)
            row += [sky_error_px(fit, track), float(fit.verdict.accepted)]
        rows.append(row)
    before, kept, after, kept_after = np.array(rows).T
    both = (kept > 0.0) & (kept_after > 0.0)
    print(f"median {np.median(before):.2f}, {np.median(after):.2f}; accepted {kept.sum():.0f}, {kept_after.sum():.0f}")
    print(f"by both accepted: median ratio {np.median(after[both] / before[both]):.3f}")


def print_table(cases: list[str], seeds: range, controls: tuple[str, ...]) -> None:
    """Print the table."""
    print(
        "| case | control | coverage | near, far | z² far: 10, 50, 90 % "
        "| lenses < 0.8, their share | others | sky, stated px |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name in cases:
        table = np.array([one_lens(seed, CASES[name], controls) for seed in seeds])
        for number, control in enumerate(controls):
            covered, near, far, z, rms, stated = table[:, number].T
            poor = covered < 0.8
            share = float(np.sum(1.0 - covered[poor]) / max(np.sum(1.0 - covered), 1e-9))
            quantiles = ", ".join(f"{value:.2f}" for value in np.nanquantile(z, [0.1, 0.5, 0.9]))
            print(
                f"| {name} | {control} | {covered.mean():.3f} | {np.nanmean(near):.3f}, {np.nanmean(far):.3f} "
                f"| {quantiles} | {poor.mean():.2f}, {share:.2f} | {covered[~poor].mean():.3f} "
                f"| {np.median(rms):.3f}, {np.median(stated):.3f} |",
                flush=True,
            )


def main() -> None:
    """Print what is chosen."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lenses", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--case", action="append", choices=list(CASES))
    parser.add_argument("--control", action="append", choices=CONTROLS)
    parser.add_argument("--whitened", action="store_true")
    parser.add_argument("--real-like", type=int, default=0)
    chosen = parser.parse_args()
    if chosen.whitened:
        print_whitened()
    elif chosen.real_like:
        print_real_like(chosen.real_like)
    else:
        seeds = range(chosen.first, chosen.first + chosen.lenses)
        print_table(chosen.case or list(CASES), seeds, tuple(chosen.control or CONTROLS))


if __name__ == "__main__":
    main()
