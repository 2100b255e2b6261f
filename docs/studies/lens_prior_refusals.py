"""How often a lens prior is refused: a right one, one of another projection, and one of another focal length.

    OMP_NUM_THREADS=1 python docs/studies/lens_prior_refusals.py --lenses 4 [--first 0] [--track "1 day"]…
    OMP_NUM_THREADS=1 python docs/studies/lens_prior_refusals.py --lenses 20 --kind right [--narrow]

For each lens number and each of the five projections a type is drawn as in `coverage.py`, and its lens prior is that
of one unit with three days. Sightings (0.5 px, every two minutes) of half a day, a day and four days are then fitted
with it as `sunarc calibrate --lens-prior` does where no projection is named: those of another unit of the type
("right"), of lenses of the four other projections, of the unit with a focal length 5 % larger and smaller, and of a
lens of the same make that is drawn anew (its focal length 1 %, radial distortion 1.5 px away). Units differ by the
spread that a lens prior of one unit has by default (1 %, 15 px, 0.7 px, 0.5 px), or with `--narrow` by 0.3 %, 8 px,
0.4 px and 0.3 px, and that is stated.

Printed for each: how many were refused for the prior (contradicted), how many for another reason, in how many the prior
was left out, in how many it was used, and of the accepted ones those whose error over the sky, RMS, exceeds the 95 %
quantile of what is stated (joint draws of the stated covariance; 5 % expected).
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from dataclasses import replace

import numpy as np
import population as pop
from coverage import Case, lens_of
from lens_prior import SPREAD, record
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.answers.error_model import build_error_model, joint_covariance, predicted
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.lens_library.joint import Unit, estimate_lens_type
from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread, lens_frame
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.solve.priors import LENS, Whitened
from sunarc.changes.record import calibrate_with_lens
from sunarc.optics.camera import Camera, camera_sees
from sunarc.optics.forward import project
from sunarc.optics.projections import PROJECTIONS, Projection

FloatArray = NDArray[np.float64]
_SKY = hemisphere(60)
_DRAWS = 400
TRACKS = {"half a day": ((10.0,), 0.5), "1 day": ((10.0,), 1.0), "4 days": ((10.0, 11.0, 30.0, 39.0), 1.0)}
KINDS = "right", "projection", "focal length", "same make"
SPREADS = UnitSpread(), SPREAD
OUTCOMES = "contradicted", "otherwise", "left out", "used"


def unit_of(rng: np.random.Generator, mean: Camera, spread: UnitSpread) -> Camera:
    """Draw a unit of a type, in some pose."""
    frame, scales = lens_frame(mean), spread.scales(mean.focal_length_px[0])
    scales[[Whitened.ASPECT, Whitened.SKEW]] = 0.1
    vector = pop.random_camera(rng).to_vector()
    vector[LENS] = frame.lens(frame.whitened(mean) + scales * rng.standard_normal(scales.size))
    return mean.replace_parameters(vector)


def type_of(rng: np.random.Generator, mean: Camera, spread: UnitSpread) -> LensType | None:
    """Return the lens prior of one unit of a type with three days; None where its fit is refused."""
    points = record(rng, unit_of(rng, mean, spread), (0.0, 1.0, 20.0))
    options = CalibrationOptions(projection=mean.projection)
    found = calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE), options=options)
    return estimate_lens_type([Unit("one", found)], spread=spread) if found.verdict.accepted else None


def lenses_of(
    rng: np.random.Generator, mean: Camera, spread: UnitSpread, kinds: tuple[str, ...]
) -> list[tuple[str, Camera]]:
    """Return the lenses whose sightings are fitted with the prior of a type, each with what it is."""
    unit = unit_of(rng, mean, spread)
    found = [("right", unit)]
    others = [projection for projection in PROJECTIONS if projection != mean.projection]
    found += [("projection", lens_of(Case(projection=projection), rng)) for projection in others]
    x, y = unit.focal_length_px
    found += [("focal length", replace(unit, focal_length_px=(factor * x, factor * y))) for factor in (0.95, 1.05)]
    found.append(("same make", lens_of(Case(projection=mean.projection), rng)))
    return [one for one in found if one[0] in kinds]


def outcome(found: Calibration) -> str:
    """Return what became of the lens prior."""
    codes = {finding.code for finding in found.verdict.findings}
    if "lens_prior_contradicted" in codes:
        return "contradicted"
    if not found.verdict.accepted:
        return "otherwise"
    return "left out" if "lens_prior_left_out" in codes else "used"


def dishonest(found: Calibration, truth: Camera) -> bool:
    """Return whether the error over the sky exceeds the 95 % quantile of what is stated."""
    shown = camera_sees(truth, project(truth, _SKY))
    at = predicted(build_error_model(found), found.camera, _SKY[shown])
    fine = np.all(np.isfinite(at.pixels), axis=-1)
    at = predicted(build_error_model(found), found.camera, _SKY[shown][fine])
    covariance = joint_covariance(build_error_model(found), at)
    values, vectors = np.linalg.eigh(covariance.reshape(2 * int(fine.sum()), -1))
    drawn = np.random.default_rng(1).standard_normal((_DRAWS, values.size)) * np.sqrt(np.maximum(values, 0.0))
    stated = np.sum((drawn @ vectors.T) ** 2, axis=1)
    error = at.pixels - project(truth, _SKY[shown][fine])
    return bool(np.sum(error**2) > np.quantile(stated, 0.95))


def add(
    rows: dict[tuple[str, str], Counter[str]],
    seed: int,
    projection: Projection,
    *,
    spread: UnitSpread,
    tracks: list[str],
    kinds: tuple[str, ...],
) -> None:
    """Add what becomes of the prior of one type."""
    rng = np.random.default_rng([seed, PROJECTIONS[projection].code, 42])
    mean = lens_of(Case(projection=projection), rng)
    lens = type_of(rng, mean, spread)
    if lens is None:
        return
    for kind, camera in lenses_of(rng, mean, spread, kinds):
        for track in tracks:
            days, part = TRACKS[track]
            points = record(rng, camera, days, part=part)
            found = calibrate_with_lens(points, lens=lens, site=pop.SGP, options=CalibrationOptions()).calibration
            came_to = outcome(found)
            rows[kind, track][came_to] += 1
            if found.verdict.accepted and dishonest(found, camera):
                rows[kind, track]["dishonest"] += 1


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lenses", type=int, default=4)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--track", action="append", choices=list(TRACKS))
    parser.add_argument("--kind", action="append", choices=KINDS)
    parser.add_argument("--narrow", action="store_true")
    chosen = parser.parse_args()
    rows: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    tracks, kinds = chosen.track or list(TRACKS), tuple(chosen.kind or KINDS)
    for seed in range(chosen.first, chosen.first + chosen.lenses):
        for projection in PROJECTIONS:
            add(rows, seed, projection, spread=SPREADS[chosen.narrow], tracks=tracks, kinds=kinds)
    print("| lens | sightings | fits | contradicted | otherwise refused | left out | used | beyond the stated 95 % |")
    print("|---|---|---|---|---|---|---|---|")
    for (kind, track), found in rows.items():
        counts = [found[name] for name in OUTCOMES]
        print(f"| {kind} | {track} | {sum(counts)} | {' | '.join(map(str, counts))} | {found['dishonest']} |")


if __name__ == "__main__":
    main()
