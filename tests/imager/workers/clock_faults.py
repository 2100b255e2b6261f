"""Faults of the host's clock done to the joined service, judged against the true time and the true camera.

    python -m tests.imager.workers.clock_faults --seeds 3

prints a line for every fault and jump: what was lost, and whether a real move was noticed afterwards.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from tests.fixtures.archive import make_empty

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.detection.values import Detection
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.imager.app.service import Service
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.sightings import make_sun_point
from sunarc.imager.archive.values import CameraRecord, Event
from sunarc.imager.cameras.frame import Frame, SkyCamera
from sunarc.imager.cameras.options import AravisOptions
from sunarc.imager.runtime.clock import ClockState, VirtualClock
from sunarc.imager.settings.model import Settings
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.sun import sun_angles, sun_directions

DAY = datetime(2013, 5, 13, 6, tzinfo=UTC)
START = datetime(2013, 5, 14, 16, 0, 7, tzinfo=UTC)
TRUTH = replace(true_camera(), max_angle=2.0)
CADENCE_S = 30.0
SIGMA_PX = 0.02
NEAR_PX = 20.0
JUMPS_S = (5.0, -5.0, 60.0, -60.0, 7200.0, -7200.0, 400 * 86_400.0, -400 * 86_400.0)
SYNCHRONISED = ClockState(synchronised=True, error_bound_s=0.01)
UNSYNCHRONISED = ClockState(synchronised=False, error_bound_s=16.0)


def hand_on(service: Service, x: float, y: float, *, moment: datetime, sigma_px: float) -> None:
    """Keep and report a disc that was detected at a pixel, and let the watch for moves look at it."""
    expected = service.predictor.expectation(moment)
    near = expected is None or float(np.hypot(x - expected.x_px, y - expected.y_px)) < NEAR_PX
    detection = Detection(
        method="disc",
        accepted=near,
        verdict="clear" if near else "elsewhere",
        findings=(),
        x_px=x,
        y_px=y,
        sigma_px=sigma_px,
    )
    frame = Frame(
        image=np.zeros((6, 8), dtype=np.uint16),
        time=moment,
        exposure_us=20.0,
        gain_db=0.0,
        pixel_format="Mono12",
        full_scale=4095,
        frame_id=1,
    )
    error_s = service.clock_watch.error_s(moment)
    point = make_sun_point(detection, camera="roof", pose_epoch="", time=moment, clock_error_s=error_s)
    service.keeper.keep(point)
    service.report(frame, detection)
    while service.watch.process_next():
        pass


@cache
def good_calibration() -> Calibration:
    """Return a calibration of the true camera from the clear day before."""
    times = DAY.timestamp() + np.arange(0.0, 86_400.0, 240.0)
    times = times[sun_angles(times, SGP).apparent_zenith < 88.0]
    noise = np.random.default_rng(3).normal(0.0, SIGMA_PX, (times.size, 2))
    points = Sightings.of(unix_s=times, pixels=project(TRUTH, sun_directions(times, SGP)) + noise)
    return calibrate(points, site=SGP, image_size=(TRUTH.width, TRUTH.height))


def moved_by(turn_deg: tuple[float, float, float]) -> Camera:
    """Return the true camera after it was turned."""
    matrix = Rotation.from_rotvec(np.radians(turn_deg)).as_matrix() @ rotation_matrix(TRUTH.rotation_cam_enu)
    return replace(TRUTH, rotation_cam_enu=rotation_vector(matrix))


def no_camera() -> SkyCamera:
    """Refuse: frames are not taken here."""
    raise AssertionError("no camera is asked for")


class Imager:
    """The joined service on a clock that is wrong, shown the sun where it truly is."""

    def __init__(self, folder: Path, *, seed: int = 1) -> None:
        make_empty(folder / "sunarc.sqlite")
        self._settings = Settings(
            name="roof", site=SGP, state=folder, camera=AravisOptions(address="127.0.0.9", timestamps="host")
        )
        self.archive = open_archive(self._settings.database)
        self.clock = VirtualClock(START)
        self._rng = np.random.default_rng(seed)
        self.camera = TRUTH
        self.open_camera: Callable[[], SkyCamera] = no_camera
        self.true_times: dict[datetime, datetime] = {}
        self._start_record()
        self.boot()

    def _start_record(self) -> None:
        self.archive.cameras.save(CameraRecord.at(SGP, name="roof", width=TRUTH.width, height=TRUTH.height))
        self.archive.epochs.at("roof", DAY, reason="first frame")
        document = to_document(
            good_calibration(),
            id="full",
            camera="roof",
            state="candidate",
            created_at=START,
            valid_from=DAY,
            valid_until=None,
            pose_epoch="roof-1",
            software_version="1",
        )
        self.archive.calibrations.activate(self.archive.calibrations.add(document).id)

    def boot(self) -> None:
        """Start the service (anew): nothing but the archive and the clock is kept."""
        self.service = Service(self._settings, archive=self.archive, clock=self.clock, open_camera=self.open_camera)
        self.service.clock_watch.check()
        self.service.watch.remember()

    @property
    def true_time(self) -> datetime:
        """The time that a good clock would tell."""
        return START + timedelta(seconds=self.clock.monotonic())

    def run(self, minutes: float, *, creep: float = 0.0) -> None:
        """Let time pass: a look at the clock every 2 s, a sighting every 30 s; the clock creeps by a rate."""
        for _ in range(round(60.0 * minutes / CADENCE_S)):
            for _ in range(round(CADENCE_S / 2.0)):
                self.clock.advance(2.0)
                self.clock.step(2.0 * creep)
                self.service.clock_watch.check()
            self._see()

    def _see(self) -> None:
        moment = self.clock.now()
        self.true_times.setdefault(moment, self.true_time)  # of two with one time, the record keeps the first
        pixel = project(self.camera, sun_directions(self.true_time.timestamp(), SGP))
        x, y = (float(v) for v in pixel + self._rng.normal(0.0, SIGMA_PX, 2))
        hand_on(self.service, x, y, moment=moment, sigma_px=SIGMA_PX)

    def trusted_wrong(self) -> int:
        """Return how many accepted sightings have a time that is wrong by more than their stated bound."""
        accepted = self.archive.sightings.find("roof", accepted=True)
        stated = {point.time: point.clock_error_s or 0.0 for point in accepted}
        return sum(abs((t - self.true_times[t]).total_seconds()) > bound + 0.01 for t, bound in stated.items())

    def codes(self) -> set[str]:
        """Return the codes of the conditions that are shown."""
        return {reason.code for reason in self.service.board.snapshot().reasons}

    def synchronise(self) -> None:
        """Let the kernel call the clock synchronised."""
        self.clock.set_state(SYNCHRONISED)

    def alarms(self) -> list[Event]:
        """Return the alarms in the record."""
        return [event for event in self.archive.events.find("roof") if event.severity == "alarm"]

    def served(self) -> str | None:
        """Return the id of the calibration that is current."""
        record = self.archive.calibrations.current("roof")
        return None if record is None else record.id

    def error_deg(self) -> float:
        """Return how far the served calibration sees the true camera's directions off, RMS over the sky, degrees."""
        record = self.archive.calibrations.current("roof")
        if record is None:
            return float("nan")
        found = rotation_matrix(from_document(record.document).camera.rotation_cam_enu)
        return float(
            np.degrees(Rotation.from_matrix(found @ rotation_matrix(self.camera.rotation_cam_enu).T).magnitude())
        )


def boot_with_wrong_clock(imager: Imager, jump_s: float) -> None:
    """Boot with the board's clock off by a jump, set right by the time service after a minute, restart 40 s later."""
    imager.clock.set_state(UNSYNCHRONISED)
    imager.clock.step(jump_s)
    imager.boot()
    imager.run(1.0)
    imager.clock.step(-jump_s)
    imager.clock.set_state(SYNCHRONISED)
    imager.run(40.0 / 60.0)
    imager.boot()


def wrong_and_synchronised(imager: Imager, jump_s: float) -> None:
    """Set the running service's clock by a jump for five minutes, the kernel calling it synchronised, and back."""
    imager.clock.step(jump_s)
    imager.run(5.0)
    imager.clock.step(-jump_s)
    imager.run(1.0)
    imager.boot()


FAULTS: dict[str, Callable[[Imager, float], None]] = {
    "boot": boot_with_wrong_clock,
    "synchronised": wrong_and_synchronised,
}


@dataclass(frozen=True)
class Outcome:
    """What a fault came to.

    Attributes
    ----------
    kept : the calibration is still served, and no pose epoch was begun.
    alarms : kinds of the alarms before the camera truly moved.
    trusted_wrong : accepted sightings whose time is wrong by more than they state.
    noticed_after : sightings from a true move of 1 degree to its alarm; None where there was none.
    error_deg : of the pose that is served after the move.
    """

    kept: bool
    alarms: tuple[str, ...]
    trusted_wrong: int
    noticed_after: int | None
    error_deg: float


def outcome_of(folder: Path, *, fault: str, jump_s: float, seed: int) -> Outcome:
    """Do a fault, let the clock be right for a quarter of an hour, then move the camera by 1 degree."""
    imager = Imager(folder, seed=seed)
    imager.run(10.0)
    FAULTS[fault](imager, jump_s)
    imager.run(15.0)
    kept = imager.served() == "full" and len(imager.archive.epochs.find("roof")) == 1
    before = imager.alarms()
    imager.camera = moved_by((0.6, 0.6, 0.5))
    noticed = None
    for number in range(1, 31):
        imager.run(CADENCE_S / 60.0)
        if noticed is None and len(imager.alarms()) > len(before):
            noticed = number
    outcome = Outcome(kept, tuple(event.kind for event in before), imager.trusted_wrong(), noticed, imager.error_deg())
    imager.archive.close()
    return outcome


def main() -> None:
    """Do every fault with every jump and print what it came to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    chosen = parser.parse_args()
    for fault in FAULTS:
        for jump_s in JUMPS_S:
            found = []
            for seed in range(chosen.seeds):
                with tempfile.TemporaryDirectory() as folder:
                    found.append(outcome_of(Path(folder), fault=fault, jump_s=jump_s, seed=seed))
            alarms = Counter(kind for one in found for kind in one.alarms)
            print(  # noqa: T201 - a script that tells what it measured
                f"{fault:12} {jump_s:+12.0f} s: kept {sum(one.kept for one in found)}/{len(found)}, alarms before the "
                f"move {dict(alarms)}, trusted and wrong {[one.trusted_wrong for one in found]}, move noticed after "
                f"{[one.noticed_after for one in found]}, error {[round(one.error_deg, 3) for one in found]}",
                flush=True,
            )


if __name__ == "__main__":
    main()
