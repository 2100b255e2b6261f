"""Runs in the machine, as the service's user: fills the archive with what the simulated imager saw on former days.

Usage: python3 -I past.py MIDNIGHT DAYS A_DAY, MIDNIGHT the unix time at which the present solar day began
"""

import os
import sys
from datetime import UTC, datetime
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

os.environ["NUMBA_CACHE_DIR"] = "/var/cache/sunarc/numba"  # of versions before 0.4
sys.path.insert(0, "/usr/lib/sunarc/site")

import numpy as np

from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions

imager, lab = (
    ("sunarc.imager", "sunarc.lab") if find_spec("sunarc.imager") else ("sunarc", "sunarc")
)  # before the houses
open_archive: Any = import_module(f"{imager}.archive.archive").open_archive
SunPoint: Any = import_module(f"{imager}.archive.values").SunPoint
load_settings: Any = import_module(f"{imager}.settings.load").load_settings
true_camera: Any = import_module(f"{lab}.simulation.truth").true_camera
SENSOR_PX = 1748

midnight, days, a_day = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
settings = load_settings(Path("/etc/sunarc/sunarc.toml"))
archive: Any = open_archive(settings.database)
if hasattr(archive.cameras, "all"):
    cameras, epoch_at, add = archive.cameras.all, archive.epochs.at, archive.sightings.add
else:  # a version from before an archive had parts
    cameras, epoch_at, add = archive.cameras, archive.epoch_at, archive.add_sun_points
binning = SENSOR_PX / cameras()[0].width
noise = np.random.default_rng(1)
for day in range(days, 0, -1):
    times = midnight - 86400.0 * day + np.linspace(0.0, 86400.0, 2 * a_day, endpoint=False)
    times = times[sun_angles(times, settings.site).apparent_zenith < 88.0]
    pixels = (project(true_camera(), sun_directions(times, settings.site)) - (binning - 1.0) / 2.0) / binning
    seen = pixels + noise.normal(0.0, 0.02, pixels.shape)
    begin = datetime.fromtimestamp(times[0], UTC)
    epoch = epoch_at(settings.name, begin, reason="installed").id
    add(
        SunPoint(
            camera=settings.name,
            pose_epoch=epoch,
            time=datetime.fromtimestamp(time, UTC),
            method="disc",
            accepted=True,
            verdict="clear",
            x_px=x,
            y_px=y,
            sigma_px=0.02,
            clock_error_s=0.001,
        )
        for time, (x, y) in zip(times.tolist(), seen.tolist(), strict=True)
    )
archive.close()
