"""Follow one cloud's shadow over the map for a quarter of an hour.

A cloud was seen at two places of the image, a minute apart, and a ceilometer tells the height of its base. Where it is
and where its shadow falls at both times gives its speed; its shadow then goes on for 15 minutes.

    python docs/examples/follow_a_shadow.py http://127.0.0.1:8080 shadow.png --at 2013-05-13T18:30:00Z
"""

from __future__ import annotations

import argparse
from datetime import datetime, timedelta
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import numpy as np

from sunarc.client import Imager

SEEN = np.array([[0.24, 0.32], [0.3, 0.38]])
SEEN_EVERY = timedelta(minutes=1)
HEIGHT_M = 1500.0
AHEAD_MIN = np.arange(0.0, 16.0)


def main(address: str, target: Path, at: datetime) -> None:
    imager = Imager(address)
    seen_px = SEEN * imager.status()["image_size"]
    places = [imager.geolocate(pixel, height_m=HEIGHT_M, at=at + k * SEEN_EVERY) for k, pixel in enumerate(seen_px)]
    clouds, shadows = ([place[k].position_m[:2] for place in places] for k in (0, 1))
    velocity = (shadows[1] - shadows[0]) / SEEN_EVERY.total_seconds()
    path = shadows[0] + AHEAD_MIN[:, None] * 60.0 * velocity
    figure, axes = plt.subplots(figsize=(7.0, 6.2), layout="constrained")
    axes.plot(*(path.T / 1000.0), "o-", color="#0072b2", markersize=4, label="its shadow, minute by minute")
    for minute in (0, 5, 10, 15):
        axes.annotate(f"{minute} min", path[minute] / 1000.0, xytext=(6, 6), textcoords="offset points")
    axes.plot(*(np.array(clouds).T / 1000.0), "^-", color="#d55e00", label=f"the cloud, {HEIGHT_M:.0f} m up")
    axes.plot(0.0, 0.0, "k+", markersize=12, label="the imager")
    axes.set(xlabel="east of the imager, km", ylabel="north of the imager, km")
    axes.set_aspect("equal", adjustable="datalim")
    sigma_m = float(places[0][1].sigma_m)
    axes.set_title(
        f"{at:%Y-%m-%d %H:%M} UTC: {np.hypot(*velocity):.1f} m/s; the calibration moves a place by {sigma_m:.1f} m"
    )
    axes.grid(alpha=0.3)
    axes.legend(loc="best")
    figure.savefig(target, dpi=110)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Follow one cloud's shadow over the map.")
    parser.add_argument("address")
    parser.add_argument("target", type=Path)
    parser.add_argument("--at", type=datetime.fromisoformat, required=True)
    given = parser.parse_args()
    main(given.address, given.target, given.at)
