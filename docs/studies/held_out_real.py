"""Real sun tracks, fitted on a part and held against the rest, whose sightings are the truth.

    python docs/studies/held_out_real.py --track FILE.csv LATITUDE LONGITUDE … [--projection equidistant] [--size 1920]

Each track (`time_utc,x_px,y_px`) is fitted on either half, on each third, on two thirds, on every other half hour and
on all but two hours about its middle. Printed for every part: the verdict, the stated error over the sky, degrees, the
median distance, px, of the sightings left out, and the shares of them within the stated 50, 68 and 95 %, the noise that
the fit states included; then the means over the accepted parts, and how many of these have fewer than 0.6 within 95 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from coverage_statistics import STATED, within_stated
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.formats.csv_files import read_sightings
from sunarc.optics.projections import PROJECTIONS
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]
_BLOCK_S, _NOON_S = 1800.0, 3600.0


def parts(unix_s: FloatArray) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield names and masks (n,) of what is fitted."""
    rows = np.arange(unix_s.size)
    half, third = 2 * rows // rows.size, 3 * rows // rows.size
    yield from ((f"half {k}", half == k) for k in range(2))
    yield from ((f"without third {k}", third != k) for k in range(3))
    yield from ((f"third {k}", third == k) for k in range(3))
    yield "every other half hour", (unix_s - unix_s[0]) // _BLOCK_S % 2.0 == 0.0
    noon = np.abs(unix_s - 0.5 * (unix_s[0] + unix_s[-1])) > _NOON_S
    if not np.all(noon):
        yield "without two hours", noon


def judged(
    points: Sightings, site: Site, mask: NDArray[np.bool_], options: CalibrationOptions, size: int
) -> FloatArray:
    """Return verdict, stated error, median distance and shares of one part."""
    fit = calibrate(points.select(mask), site=site, image_size=(size, size), options=options)
    pixels = points.pixels[~mask]
    found, covariance = project_with_covariance(fit, sun_directions(points.unix_s[~mask], site))
    covariance = covariance + fit.evidence.sigma_px**2 * np.eye(2)
    within = within_stated(fit, found, pixels - found, covariance, STATED[:3]).mean(axis=0)
    distance = float(np.nanmedian(np.linalg.norm(pixels - found, axis=-1)))
    return np.array([fit.verdict.accepted, fit.sky_rms_deg, distance, *within])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--track", nargs=3, action="append", required=True, metavar=("FILE", "LATITUDE", "LONGITUDE"))
    parser.add_argument("--projection", default="equidistant", choices=PROJECTIONS)
    parser.add_argument("--size", type=int, default=1920)
    chosen = parser.parse_args()
    print("| track | part | accepted | stated, ° | median, px | within 50, 68, 95 % |\n|---|---|---|---|---|---|")
    found = []
    for name, latitude, longitude in chosen.track:
        path, site = Path(name), Site(latitude=float(latitude), longitude=float(longitude), altitude=9.0)
        points = read_sightings(path.read_text(encoding="utf-8").splitlines(), name=path.name)
        points = points.select(np.argsort(points.unix_s, kind="stable"))
        for part, mask in parts(points.unix_s):
            row = judged(points, site, mask, CalibrationOptions(projection=chosen.projection), chosen.size)
            shares = ", ".join(f"{share:.2f}" for share in row[3:])
            print(f"| {path.stem} | {part} | {row[0]:.0f} | {row[1]:.2f} | {row[2]:.2f} | {shares} |", flush=True)
            found.append(row)
    rows = np.array(found)
    accepted = rows[rows[:, 0] > 0.0]
    print(f"accepted {len(accepted)} of {len(rows)}, within", *np.round(accepted[:, 3:].mean(axis=0), 3), end="; ")
    print(f"wrong {int(np.sum(accepted[:, 5] < 0.6))}, median {np.median(accepted[:, 2]):.2f} px")


if __name__ == "__main__":
    main()
