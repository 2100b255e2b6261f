"""Make the table of bright stars (`service/sunarc/sky/stars.csv.gz`) from its two sources.

Hipparcos numbers, positions at 2024.0 and V: the star table of cedar-solve's default database (Apache-2.0). Proper
motions: the fixed stars of the Swiss Ephemeris as Debian's swe-basic-data has them (CC0-1.0); a star that is not among
them has none.

    python docs/studies/star_table.py default_database.npz sefstars.txt service/sunarc/sky/stars.csv.gz
"""

from __future__ import annotations

import argparse
import gzip
import math
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from sunarc.array_types import FloatArray, IntArray
from sunarc.sky import direction_from_angles

EPOCH = 2024.0
FAINTEST = 5.5
SAME_STAR_ARCSEC = 8.0
"""Two entries nearer than this are one star: fast binaries differ so much between centre and component."""
HEADER = """\
# Stars to V {faintest}. hip: Hipparcos number. ra_deg, dec_deg: ICRS at epoch {epoch}. pm_ra, pm_dec: proper motion in
# mas a year, that of the right ascension times the cosine of the declination; empty where unknown. v: magnitude.
# Positions and magnitudes: ESA 1997, The Hipparcos and Tycho Catalogues, ESA SP-1200, as in cedar-solve 0.5.1
# (Apache-2.0). Proper motions: Swiss Ephemeris, fixed stars, of Debian's swe-basic-data 4.0 (CC0-1.0).
# Made by docs/studies/star_table.py.
hip,ra_deg,dec_deg,pm_ra,pm_dec,v
"""


def hipparcos(path: Path) -> tuple[IntArray, FloatArray]:
    """Return Hipparcos numbers (n,) and (n, 3) right ascension, declination in degrees at 2024.0, and V."""
    with np.load(path) as database:
        table, numbers = database["star_table"].astype(np.float64), database["star_catalog_IDs"].astype(np.int64)
    bright = table[:, 5] <= FAINTEST
    return numbers[bright], np.column_stack([np.degrees(table[bright, :2]), table[bright, 5]])


def moving(path: Path) -> FloatArray:
    """Return (n, 4): right ascension and declination in degrees at 2024.0, proper motions in mas a year."""
    rows = []
    for line in path.read_text("latin-1").splitlines():
        cells = [cell.strip() for cell in line.split(",")]
        if line.startswith("#") or len(cells) < 14 or cells[2] != "ICRS" or float(cells[13]) > FAINTEST + 1.5:
            continue
        right = 15.0 * (float(cells[3]) + float(cells[4]) / 60.0 + float(cells[5]) / 3600.0)
        size = abs(float(cells[6])) + float(cells[7]) / 60.0 + float(cells[8]) / 3600.0
        declination = -size if cells[6].startswith("-") else size
        motion = float(cells[9]), float(cells[10])
        years = (EPOCH - 2000.0) / 3.6e6
        right += motion[0] * years / math.cos(math.radians(declination))
        rows.append((right, declination + motion[1] * years, *motion))
    return np.array(rows)


def vectors(right_ascension_deg: FloatArray, declination_deg: FloatArray) -> FloatArray:
    """Return unit vectors (n, 3)."""
    return direction_from_angles(zenith_deg=90.0 - declination_deg, azimuth_deg=right_ascension_deg)


def main() -> None:
    """Write the table and print what it has."""
    parser = argparse.ArgumentParser(prog="star_table.py", description=__doc__)
    parser.add_argument("database", type=Path, help="cedar-solve's default_database.npz")
    parser.add_argument("fixed_stars", type=Path, help="sefstars.txt of swe-basic-data")
    parser.add_argument("target", type=Path)
    asked = parser.parse_args()
    hip, stars = hipparcos(asked.database)
    motions = moving(asked.fixed_stars)
    found = cKDTree(vectors(motions[:, 0], motions[:, 1])).query(vectors(stars[:, 0], stars[:, 1]))
    apart, nearest = np.asarray(found[0]), np.asarray(found[1])
    known = apart < math.radians(SAME_STAR_ARCSEC / 3600.0)
    lines = [HEADER.format(faintest=FAINTEST, epoch=EPOCH)]
    for row in np.argsort(hip):
        motion = "{:.0f},{:.0f}".format(*motions[nearest[row], 2:]) if known[row] else ","
        lines.append(f"{hip[row]},{stars[row, 0]:.5f},{stars[row, 1]:.5f},{motion},{stars[row, 2]:.2f}\n")
    asked.target.write_bytes(gzip.compress("".join(lines).encode(), 9, mtime=0))
    print(f"{hip.size} stars, {int(known.sum())} with proper motion, {asked.target.stat().st_size} bytes")


if __name__ == "__main__":
    main()
