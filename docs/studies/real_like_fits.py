"""The service's fit beside the paper's on real-like tracks: where it meets the sightings less well.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python docs/studies/real_like_fits.py --tracks 200 [--first 0] [--moves]

For every place of the cloud: tracks, how many fits end above the paper's by the data part of the robust cost
(relative 1e-6, at the noise that the fit states), how many have a median residual more than 1.05 times the paper's,
the median of the ratios of the median residuals, the residual of the sightings that no cloud drew aside, the true error
over the sky inside the image of both, how many verdicts accept, and processor seconds. With --moves the tracks are
fitted as `sunarc calibrate` does.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from real_like_tracks import Track, real_like_track

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.changes.record import calibrate_moved
from sunarc.common.robust_statistics import tukey_loss
from sunarc.optics.forward import project
from sunarc.optics.projections import angle_limit
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]

_RELATIVE = 1e-6
_MEDIAN_RATIO = 1.05
_HEADS = (
    "cloud",
    "tracks",
    "above the paper's cost",
    "median > 1.05 of the paper's",
    "median ratio",
    "RMS off cloud, in noise",
    "sky, px: median (90 %)",
    "the paper's",
    "accepted",
    "s",
)


class Compared(NamedTuple):
    """One track: see the module's docstring."""

    cloud: str
    above: float
    ratio: float
    core_px: float
    sky_px: float
    paper_sky_px: float
    accepted: float
    seconds: float


def distances(fit: Calibration, track: Track) -> FloatArray:
    """Return (n,): px between the sightings and where a camera, at any angle, sees the sun."""
    camera = replace(fit.camera, max_angle=angle_limit(fit.camera.projection) * (1.0 - 1e-6))
    predicted = project(camera, sun_directions(track.points.unix_s, track.site))
    return np.asarray(np.linalg.norm(np.nan_to_num(track.points.pixels - predicted, nan=1e4), axis=-1))


def sky_error_px(fit: Calibration, track: Track) -> float:
    """Return the root mean square error over the sky inside the image, px."""
    sky = hemisphere(600)
    true = track.true_pixels(sky)
    inside = np.all((true > 0.0) & (true < np.array(track.image_size)), axis=-1)
    error = project(fit.camera, sky[inside]) - true[inside]
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=-1))))


def robust_cost(distance: FloatArray, sigma_px: float) -> float:
    """Return the data part of the robust cost."""
    return float(np.sum(tukey_loss(distance, sigma=sigma_px)))


def compared(track: Track, *, moves: bool = False) -> Compared:
    """Return both fits of a track, compared."""
    begin = time.process_time()
    if moves:
        fit = calibrate_moved(track.points, site=track.site, image_size=track.image_size, options=track.options)[0]
    else:
        fit = calibrate(track.points, site=track.site, image_size=track.image_size, options=track.options)
    seconds = time.process_time() - begin
    as_paper = replace(track.options, method="paper")
    paper = calibrate(track.points, site=track.site, image_size=track.image_size, options=as_paper)
    own, other = distances(fit, track), distances(paper, track)
    sigma = fit.evidence.sigma_px
    core = own[~track.clouded & ~track.wrong]
    return Compared(
        cloud=str(track.drawn.cloud),
        above=robust_cost(own, sigma) / robust_cost(other, sigma) - 1.0,
        ratio=float(np.median(own) / np.median(other)),
        core_px=float(np.sqrt(np.mean(core**2))) / track.sigma_px,
        sky_px=sky_error_px(fit, track),
        paper_sky_px=sky_error_px(paper, track),
        accepted=float(fit.verdict.accepted),
        seconds=seconds,
    )


def table(found: list[Compared]) -> str:
    """Return the table in Markdown."""
    lines = [
        f"| {' | '.join(_HEADS)} |",
        f"|{'---|' * len(_HEADS)}",
    ]
    for cloud in ("none", "middle", "start", "end", "both", "all"):
        mine = [one for one in found if cloud in (one.cloud, "all")]
        if not mine:
            continue
        sky = np.array([[one.sky_px, one.paper_sky_px] for one in mine])
        middle, most = np.nanmedian(sky, axis=0), np.nanquantile(sky, 0.9, axis=0)
        lines.append(
            f"| {cloud} | {len(mine)} | {sum(one.above > _RELATIVE for one in mine)} "
            f"| {sum(one.ratio > _MEDIAN_RATIO for one in mine)} | {np.median([one.ratio for one in mine]):.3f} "
            f"| {np.median([one.core_px for one in mine]):.2f} | {middle[0]:.2f} ({most[0]:.1f}) "
            f"| {middle[1]:.2f} ({most[1]:.0f}) | {sum(one.accepted for one in mine):.0f} "
            f"| {np.mean([one.seconds for one in mine]):.1f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print the table, and every track that ends above the paper's answer."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tracks", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--moves", action="store_true")
    parser.add_argument("--verbose", action="store_true")
    chosen = parser.parse_args()
    found = []
    for seed in range(chosen.first, chosen.first + chosen.tracks):
        one = compared(real_like_track(seed), moves=chosen.moves)
        found.append(one)
        if chosen.verbose or one.above > _RELATIVE or one.ratio > _MEDIAN_RATIO:
            print(seed, [round(value, 6) if isinstance(value, float) else value for value in one], flush=True)
    print(table(found))


if __name__ == "__main__":
    main()
