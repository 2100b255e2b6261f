"""Records of years at a short cadence: cost and answer of a fit by normal points, and of one of all sightings.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python docs/studies/dense_records.py [--sightings 1000000] [--seed 1]
        [--all] [--write FILE.csv]

The sightings are of `independent_world`, one a minute on two fifths of all days from 2015 on, a fifth of the blocks of
ten minutes behind cloud, 0.15 px of noise, one in 500 false by some px; no code is shared with the fit. Printed are
processor time and memory from the reading of the table on, the true and the stated error over the upper hemisphere
inside the image, px, and the share of it within the stated 95 %. With --all every sighting is fitted as it is.
"""

from __future__ import annotations

import argparse
import math
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import independent_world as world
import numpy as np
from independent_world import FloatArray

from sunarc.calibration import normal_points
from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.formats.csv_files import read_sightings
from sunarc.public.stated_fit import fit_as_stated
from sunarc.sky.site import Site

_BEGIN_S, _SIGMA_PX, _CADENCE_S = 1_420_070_400.0, 0.15, 60.0


def days(rng: np.random.Generator, place: world.Place, lens: world.Lens) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield times (n,) and pixels (n, 2) of clear days without an end."""
    noon = _BEGIN_S + 43_200.0 - 240.0 * place.longitude
    while True:
        if rng.random() < 0.4:
            times = noon + np.arange(-32_400.0, 32_400.0, _CADENCE_S)
            times = times[np.repeat(rng.random(-(-times.size // 10)) < 0.8, 10)[: times.size]]
            directions = world.sun(times, place)
            pixels = lens.project(directions) + rng.normal(0.0, _SIGMA_PX, (times.size, 2))
            pixels += rng.normal(0.0, 5.0, pixels.shape) * (rng.random((times.size, 1)) < 0.002)
            seen = np.all((pixels > 1.0) & (pixels < world.SIZE - 2.0), axis=-1)
            seen &= directions[:, 2] > math.sin(math.radians(2.0))
            yield times[seen], pixels[seen]
        noon += 86_400.0


def table(rng: np.random.Generator, place: world.Place, lens: world.Lens, count: int) -> list[str]:
    """Return the lines of a table of so many sightings."""
    lines = ["time_utc,x_px,y_px"]
    for times, pixels in days(rng, place, lens):
        stamps = np.round(1e3 * times).astype("int64").astype("datetime64[ms]").astype(str)
        rows = zip(stamps.tolist(), pixels.tolist(), strict=True)
        lines += [f"{stamp}Z,{x:.4f},{y:.4f}" for stamp, (x, y) in rows]
        if len(lines) > count:
            break
    return lines[: count + 1]


def main() -> None:
    """Print the result of one record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sightings", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="fit every sighting as it is")
    parser.add_argument("--write", help="write the table, to fit it by `sunarc calibrate`")
    chosen = parser.parse_args()
    rng = np.random.default_rng((9, chosen.seed))
    place, lens = world.drawn_place(rng), world.drawn_lens(rng)
    lines = table(rng, place, lens, chosen.sightings)
    if chosen.write:
        Path(chosen.write).write_text("\n".join(lines), encoding="utf-8")
    if chosen.all:
        normal_points.MOST = chosen.sightings
    begin = time.process_time()
    site = Site(latitude=place.latitude, longitude=place.longitude, altitude=place.altitude)
    points = read_sightings(lines, name="table", site=site)
    fit, _ = fit_as_stated(points, site=site, image_size=(world.SIZE, world.SIZE), options=CalibrationOptions())
    took_s, memory_mb = time.process_time() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    sky = world.hemisphere(400)
    true = lens.project(sky)
    inside = np.all((true > 0.0) & (true < world.SIZE - 1.0), axis=-1)
    predicted, covariance = project_with_covariance(fit, sky[inside])
    off = predicted - true[inside]
    square = np.sum(off * np.linalg.solve(covariance, off[..., None])[..., 0], axis=-1)
    print(
        f"{len(points)} sightings, {place.latitude:.2f} {place.longitude:.2f} {place.altitude:.0f} m: {took_s:.1f} s, "
        f"{memory_mb:.0f} MB, accepted {fit.verdict.accepted}, true {math.sqrt(np.mean(np.sum(off**2, axis=-1))):.4f}, "
        f"stated {math.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))):.4f}, within 95 % "
        f"{np.mean(square < -2.0 * math.log(0.05)):.3f}"
    )


if __name__ == "__main__":
    main()
