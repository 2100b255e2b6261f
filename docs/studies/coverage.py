"""How often the truth lies within the stated 95 %, over cameras, sites, days and noise of many kinds.

    OMP_NUM_THREADS=1 python docs/studies/coverage.py --lenses 200 [--case NAME]… [--jobs 2] [--search]

Fits begin at the true camera, which halves their time; with `--search` they begin with the search for a start. Where a
case names no field, a lens has one or none as the fit's prior has it (`ranks.py`). Printed for every case, over the sky
that the image holds: the median over lenses of the true error (px), the share of directions whose error lies within the
stated 95 % ellipse, its 95 % interval by bootstrap over lenses, the shares within the ellipses for 50, 68, 95 and 99 %,
for 50 and 95 % within 20 degrees of the sun's track and beyond 40 degrees, and by zenith angle (below 30 degrees, below
60, beyond), and how many of the fits their own verdict accepts. With `--worlds` nothing is fitted: see
`coverage_pairs.py`.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import population as pop
from coverage_statistics import SKY, TrueSky, bootstrap_interval, degrees_from_track, every_so_many, judged
from numpy.typing import NDArray
from ranks import FIELD_LENGTHS
from ranks import amplitude_px as drawn_amplitude_px
from real_lenses import best_projection, published, residual_radius

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import USUAL_OPTIONS, CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.camera import RADIAL_ORDERS, Camera, camera_sees
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.optics.projections import Projection, ideal_radius
from sunarc.sky.refraction import ASSUMED_AIR_SD, DAILY_AIR_SD, raised, refraction_rad
from sunarc.sky.site import Site

FloatArray = NDArray[np.float64]
Noise = Callable[[np.random.Generator, FloatArray, float], FloatArray]
"""Errors (n, 2), px, of sightings at zenith angles (n,), degrees, for a 1-sigma per axis."""

_CORRELATION = 0.9
_SCALES = (7.0, 2.6), (1.2, 2.0)
"""Of radial distortion and decentering as the fit's prior has them: the median, px, and the factor of 1 sigma."""


def white(rng: np.random.Generator, zenith: FloatArray, sigma_px: float) -> FloatArray:
    """Draw independent errors."""
    return pop.white_noise(rng, zenith.size, sigma_px)


def correlated(rng: np.random.Generator, zenith: FloatArray, sigma_px: float) -> FloatArray:
    """Draw first-order autoregressive errors."""
    return pop.correlated_noise(rng, zenith.size, sigma_px, _CORRELATION)


def growing(rng: np.random.Generator, zenith: FloatArray, sigma_px: float) -> FloatArray:
    """Draw errors that are six times as large at the horizon as at the zenith."""
    return white(rng, zenith, sigma_px) * (1.0 + 5.0 * zenith / 90.0)[:, None]


def heavy_tailed(rng: np.random.Generator, zenith: FloatArray, sigma_px: float) -> FloatArray:
    """Draw errors of Student's t with three degrees of freedom, of the scale sigma."""
    return sigma_px * rng.standard_t(3, (zenith.size, 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What is simulated.

    days: offsets from 13 May 2013, a sighting every `cadence_s`. field_px: None draws it from the fit's prior, with its
    length. rounded: to whole pixels. tilt_deg: None draws it (2.5 degrees). size: of the image, px. edge_deg: the angle
    off the axis that the image's shorter side ends at; NaN: 90, or 60 with a perspective lens. as_prior: the scales of
    radial distortion and decentering are drawn from the fit's prior, too, in place of 1.5 and 0.6 px, and so are air
    and the bias of detections along the radius. published: the radial distortion is that of a published lens curve,
    which has a projection of its own, and the decentering is 1.2 px, as published lenses have it.
    """

    days: tuple[int, ...] = (0,)
    cadence_s: float = 30.0
    sigma_px: float = 0.5
    field_px: float | None = None
    field_length_px: float = 425.0
    noise: Noise = white
    rounded: bool = False
    tilt_deg: float | None = None
    projection: Projection = "equisolid"
    size: tuple[int, int] = (pop.SIZE, pop.SIZE)
    edge_deg: float = math.nan
    site: Site = pop.SGP
    as_prior: bool = False
    published: bool = False


@cache
def published_curves() -> list[tuple[Projection, tuple[float, ...]]]:
    """Return the best simple projections of the published lens curves, and k2 … k9 of what is left."""
    angle, curves = np.linspace(0.0, math.pi / 2.0, 91), []
    powers = (angle / (math.pi / 2.0))[:, None] ** np.array(RADIAL_ORDERS)
    for lens in published():
        if lens.kind == "curve":
            radius = np.asarray(np.polynomial.polynomial.polyval(angle, np.r_[0.0, lens.numbers]), dtype=np.float64)
            projection = best_projection(radius, math.pi / 2.0)
            left, focal = residual_radius(radius, projection, math.pi / 2.0)
            curves.append((projection, tuple(np.linalg.lstsq(powers, left / focal)[0])))
    return curves


def at(latitude: float) -> Site:
    """Return a site at the meridian of the Southern Great Plains."""
    return Site(latitude=latitude, longitude=pop.SGP.longitude, altitude=300.0)


CASES = {
    "1 day": Case(),
    "1 day, no field": Case(field_px=0.0),
    "2 days in a row": Case(days=(0, 1)),
    "3 days in a row": Case(days=(0, 1, 2)),
    "4 days": Case(days=(0, 1, 20, 29)),
    "7 days in a row": Case(days=tuple(range(7))),
    "14 days in a row": Case(days=tuple(range(14))),
    "60 days of a year, every 2 minutes": Case(days=tuple(range(0, 360, 6)), cadence_s=120.0),
    "tilt 15°": Case(tilt_deg=15.0),
    "tilt 40°": Case(tilt_deg=40.0),
    "120° lens": Case(edge_deg=60.0),
    "640 × 480": Case(size=(640, 480)),
    "4096 × 3000": Case(size=(4096, 3000)),
    "latitude -41°": Case(site=at(-41.0)),
    "latitude +79°": Case(site=at(79.0)),
    "the pole": Case(site=at(90.0)),
    "the pole, lenses of any scale": Case(site=at(90.0), as_prior=True),
    "as the prior, 1 day": Case(as_prior=True),
    "as the prior, 1 day, no field": Case(as_prior=True, field_px=0.0),
    "as the prior, 4 days": Case(as_prior=True, days=(0, 1, 20, 29)),
    "as the prior, 4 days, no field": Case(as_prior=True, days=(0, 1, 20, 29), field_px=0.0),
    "as the prior, 4 days, 0.1 px": Case(as_prior=True, days=(0, 1, 20, 29), sigma_px=0.1),
    "as the prior, 7 days in a row": Case(as_prior=True, days=tuple(range(7))),
    "as the prior, tilt 15°": Case(as_prior=True, tilt_deg=15.0),
    "as the prior, latitude -41°": Case(as_prior=True, site=at(-41.0)),
    "published curves, 1 day": Case(published=True),
    "published curves, 4 days": Case(published=True, days=(0, 1, 20, 29)),
    "published curves, tilt 15°": Case(published=True, tilt_deg=15.0),
    "published curves, latitude -41°": Case(published=True, site=at(-41.0)),
    "AR(1) 0.9": Case(noise=correlated),
    "noise × 6 to the horizon": Case(noise=growing, sigma_px=0.25),
    "t3 noise": Case(noise=heavy_tailed, sigma_px=0.3),
    "whole pixels": Case(sigma_px=0.05, rounded=True),
    "equidistant": Case(projection="equidistant"),
    "stereographic": Case(projection="stereographic"),
    "orthographic": Case(projection="orthographic"),
    "perspective": Case(projection="perspective"),
    "field 0.3 px": Case(field_px=0.3),
    "0.03 px, field 0.3 px": Case(sigma_px=0.03, field_px=0.3),
    "4 days, field 0.3 px": Case(days=(0, 1, 20, 29), field_px=0.3),
    "4 days, 0.03 px, field 0.1 px, 200 px": Case(
        days=(0, 1, 20, 29), sigma_px=0.03, field_px=0.1, field_length_px=200.0
    ),
    "4 days, 0.03 px, field 1 px, 850 px": Case(
        days=(0, 1, 20, 29), sigma_px=0.03, field_px=1.0, field_length_px=850.0
    ),
}


def lens_of(case: Case, rng: np.random.Generator) -> Camera:
    """Draw the true camera; its departures from the ideal are the same in angle whatever the image's size."""
    projection, radial = case.projection, None
    if case.published:
        curves = published_curves()
        projection, radial = curves[rng.integers(len(curves))]
    edge = 60.0 if projection == "perspective" else 90.0
    edge = edge if math.isnan(case.edge_deg) else case.edge_deg
    focal = 0.4863 * min(case.size) / float(ideal_radius(projection, math.radians(edge)))
    share = min(case.size) / pop.SIZE
    base = replace(
        pop.CASE_3, width=case.size[0], height=case.size[1], projection=projection, focal_length_px=(focal, focal)
    )
    radial_px, decentering_px = 1.5, 1.2 if case.published else 0.6
    if case.as_prior:
        radial_px, decentering_px = (px * factor ** rng.normal() for px, factor in _SCALES)
    lenses = pop.Lenses(radial_px=radial_px * share, decentering_px=decentering_px * share, center_px=5.0 * share)
    camera = pop.random_camera(rng, lenses, base=base)
    camera = camera if radial is None else replace(camera, radial=radial)
    if case.tilt_deg is None:
        return camera
    azimuth, turn = rng.uniform(-180.0, 180.0), rng.uniform(0.0, 360.0)
    pose = PoseAngles(phi_xz_deg=azimuth, theta_zz_deg=case.tilt_deg, psi_z_deg=turn)
    return replace(camera, rotation_cam_enu=rotation_from_pose_angles(pose))


def field_scales(case: Case, rng: np.random.Generator) -> tuple[float, float]:
    """Draw amplitude and length, px, of what no lens model describes; amplitude 0: there is no field."""
    if case.field_px is not None:
        return case.field_px, case.field_length_px
    return drawn_amplitude_px(rng), min(case.size) * math.exp(rng.uniform(*np.log(FIELD_LENGTHS)))


def field_of(scales: tuple[float, float], rng: np.random.Generator) -> pop.Field | None:
    """Draw what no lens model describes, of an amplitude and a length, px; None where there is no field."""
    amplitude, length = scales
    return pop.smooth_field(rng, amplitude_px=amplitude, length_px=length) if amplitude > 0.0 else None


def in_other_air(directions: FloatArray, unix_s: FloatArray, site: Site, rng: np.random.Generator) -> FloatArray:
    """Return apparent directions (n, 3) in air that is not the assumed one, as the fit's prior has it."""
    day = np.unique(np.floor(unix_s / 86_400.0 + site.longitude / 360.0), return_inverse=True)[1]
    share = ASSUMED_AIR_SD * rng.normal() + DAILY_AIR_SD * rng.normal(size=int(day.max()) + 1)[day]
    return raised(directions, share * refraction_rad(directions, site))


def drawn(seed: int, case: Case) -> tuple[Camera, Sightings, TrueSky]:
    """Draw a camera, what it sees of the sun, and where it sees the sky."""
    rng = np.random.default_rng([seed, 20])
    truth = lens_of(case, rng)
    field = field_of(field_scales(case, rng), rng)
    sun = pop.track(case.days, site=case.site, cadence_s=case.cadence_s).shown_by(truth)
    if case.as_prior:
        sun = replace(sun, directions=in_other_air(sun.directions, sun.unix_s, case.site, rng))
    noise = case.noise(rng, sun.zenith_deg, case.sigma_px)
    points = pop.sightings_of(truth, sun.unix_s, sun.directions, noise, field=field)
    if case.as_prior:
        off = points.pixels - np.array(truth.principal_point_px)
        along = off / np.linalg.norm(off, axis=-1, keepdims=True)
        points = replace(points, pixels=points.pixels + rng.normal(0.0, USUAL_OPTIONS.outwards_px) * along)
    if case.rounded:
        points = replace(points, pixels=np.rint(points.pixels))
    expected = pop.seen_at(truth, SKY, field)
    away = degrees_from_track(SKY, every_so_many(sun.directions))
    return truth, points, TrueSky(expected, camera_sees(truth, expected), away)


def one_lens(seed: int, case: Case, *, search: bool = False) -> FloatArray:
    """Return what `judged` says of the fit of one lens."""
    truth, points, sky = drawn(seed, case)
    options = CalibrationOptions(projection=truth.projection, level_within_deg=60.0)
    start = None if search else truth
    return judged(calibrate(points, site=case.site, image_size=case.size, options=options, start=start), sky)


def write_worlds(path: Path, case: Case, seeds: range) -> None:
    """Write what `coverage_pairs.py` fits by any version, for each lens."""
    arrays: dict[str, NDArray[np.generic]] = {}
    for seed in seeds:
        truth, points, sky = drawn(seed, case)
        plain = {"camera": asdict(truth), "site": asdict(case.site)}
        arrays[f"{seed}.known"] = np.array(json.dumps(plain, default=np.ndarray.tolist))
        arrays |= {f"{seed}.unix_s": points.unix_s, f"{seed}.sighted": points.pixels}
        arrays |= {f"{seed}.{name}": values for name, values in sky._asdict().items()}
    np.savez(path, allow_pickle=False, **arrays)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lenses", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--case", action="append", choices=list(CASES))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--search", action="store_true")
    parser.add_argument("--worlds", type=Path, help="folder to write the lenses and their sightings to")
    chosen = parser.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.lenses)
    if chosen.worlds is not None:
        for name in chosen.case or CASES:
            write_worlds(chosen.worlds / f"{name}.npz", CASES[name], seeds)
        return
    columns = (
        "case",
        "lenses",
        "sky, px",
        "95 % (interval)",
        "50, 68, 99 %",
        "near, far",
        "zenith 0, 30, 60°",
        "accepted",
    )
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for name in chosen.case or CASES:
        of_lens = partial(one_lens, case=CASES[name], search=chosen.search)
        with ProcessPoolExecutor(chosen.jobs) as pool:
            rows = np.array(list(pool.map(of_lens, seeds)), dtype=float)
        low, high = bootstrap_interval(rows[:, 4])
        mean = np.nanmean(rows, axis=0)
        zones = [f"{half:.2f}/{most:.3f}" for half, most in zip(mean[6::2], mean[7::2], strict=True)]
        print(
            f"| {name} | {len(rows)} | {np.median(rows[:, 0]):.3f} | {mean[4]:.3f} ({low:.3f} to {high:.3f}) "
            f"| {mean[2]:.3f}, {mean[3]:.3f}, {mean[5]:.3f} | {', '.join(zones[:2])} | {', '.join(zones[2:])} "
            f"| {int(rows[:, 1].sum())} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
