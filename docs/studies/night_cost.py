"""What the night's worker costs: processor time of a slot with stars and moon, and bytes that a night keeps.

    OMP_NUM_THREADS=1 python docs/studies/night_cost.py

A slot has one exposure of 5 s and two of the moon on the whole simulated sensor; a night has 72 slots (12 h).
"""

from __future__ import annotations

import argparse
import pickle
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sunarc.common.utc import utc_time
from sunarc.imager.archive.archive import CameraArchive, open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.values import CameraRecord, Refit
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.night.exposures import MoonCapture, MoonExposures, NightCapture, NightExposures
from sunarc.imager.workers.night.night import NightWorker
from sunarc.imager.workers.options import SensorOptions
from sunarc.lab.simulation.options import SceneOptions, SimulatedNight
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.sky.night import moon_disc

BEGIN = datetime(2013, 5, 18, 3, 20, tzinfo=UTC)
SLOT_S, SLOTS = 600.0, 72
ROUNDS = 2


def main() -> None:
    """Print the figures."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    camera = true_camera()
    scene = Scene(camera, SGP, options=SceneOptions(night=SimulatedNight()))
    folder = Path(tempfile.mkdtemp())
    upgrade(folder / "sunarc.sqlite")
    archive = open_archive(folder / "sunarc.sqlite")
    archive.cameras.save(CameraRecord.at(SGP, name="roof", width=camera.width, height=camera.height))
    exposures = MoonExposures(lambda at: moon_disc(at.timestamp(), SGP))
    worker = NightWorker(
        NightCapture(
            NightExposures(), DropOldestQueue(capacity=4), MoonCapture(exposures, DropOldestQueue(capacity=4))
        ),
        camera=CameraArchive(archive, name="roof", site=SGP),
        options=SensorOptions(),
        apparent_zenith=lambda: 120.0,
        clock_error_s=lambda _: 0.01,
        trusted=lambda: True,
        now=lambda: BEGIN + timedelta(hours=8),
        request_refit=lambda reason: Refit(id="r", camera="roof", requested_at=BEGIN, reason=reason),
        board=StatusRegistry(version="0", started_at=BEGIN, monotonic=lambda: 0.0),
    )

    def frame(slot: int, exposure_us: float) -> Frame:
        start_us = round((BEGIN.timestamp() + SLOT_S * slot) * 1e6)
        return Frame(
            image=scene.render(start_us, exposure_us=exposure_us), time=utc_time(start_us * 1e-6 + exposure_us * 5e-7),
            exposure_us=exposure_us, gain_db=0.0, pixel_format="Mono12", full_scale=4095, frame_id=slot,
        )  # fmt: skip

    costs = []
    for slot in range(ROUNDS):
        stars, moon = frame(slot, 5e6), [frame(slot, us) for us in (60.0, 180.0)]
        begin = time.process_time()
        worker.look_at(stars)
        worker.add_moon_exposures(moon)
        costs.append(time.process_time() - begin)
    kept = len(pickle.dumps((worker._images, worker._moon._images, list(worker._warm._seen)))) / ROUNDS  # noqa: SLF001
    print(f"{camera.width} x {camera.height} px: {min(costs):.2f} s a slot, {min(costs) / SLOT_S:.2%} of a core")
    print(f"in memory {kept / 1e6:.2f} MB a slot, {kept * SLOTS / 1e6:.0f} MB a night")


if __name__ == "__main__":
    main()
