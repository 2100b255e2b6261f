"""How often the conditions of nights are false: rendered ordinary nights, beside domes that dew over and lost focus.

    OMP_NUM_THREADS=1 python docs/studies/night_conditions.py --nights 16

Ordinary nights have weather of all kinds, the moon of their date, an extinction that changes by up to 0.15 magnitudes
an air mass and a focus that drifts with the cold by up to 0.4 px of blur. On the others the dome takes a part of the
light, widens the stars and spreads a part of them into a halo, more and more over the last two thirds of the night.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.result import Calibration, Metrics, Provenance, Verdict
from sunarc.detection.stars.photometry import NightLimits, NightTrend, dew_suspected, focus_ratio
from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import CameraArchive, open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.values import CameraRecord, Refit
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.night.exposures import NightCapture, NightExposures
from sunarc.imager.workers.night.night import NightWorker
from sunarc.imager.workers.options import SensorOptions
from sunarc.lab.simulation.options import SceneOptions, SimulatedNight, Weather
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.backward import BackwardModel
from sunarc.optics.camera import Camera
from sunarc.optics.displacement import WaveBasis
from sunarc.optics.pose import pose_angles

EXPOSURE_US = 5e6
IMAGES = 9
WEATHERS: tuple[Weather, ...] = ("clear", "clear", "veil", "broken")
LIMITS = NightLimits()


class Dome(NamedTuple):
    """What the dome does at the end of the night: share of light lost, blur in px, share of light in a halo."""

    lost: float = 0.0
    blur_px: float = 0.0
    halo: float = 0.0


def half_camera() -> Camera:
    """Return the true camera at half its size."""
    full = true_camera()
    (fx, fy), (x, y) = full.focal_length_px, full.principal_point_px
    return replace(
        full, width=full.width // 2, height=full.height // 2, focal_length_px=(fx / 2, fy / 2),
        principal_point_px=(x / 2, y / 2),
    )  # fmt: skip


CAMERA = half_camera()


def served() -> Calibration:
    """Return the true camera as a calibration that is sure of it to 0.1 px."""
    basis = WaveBasis(center_px=(436.5, 436.5), half_px=(700.0, 700.0), orders=np.array([[1, 1]]))
    names = ("principal_point_x_px", "principal_point_y_px")
    return Calibration(
        camera=CAMERA, poses=(CAMERA.rotation_cam_enu,), parameter_names=names, covariance=0.01 * np.eye(2),
        field=Field(amplitude_px=0.05, length_px=425.0, basis=basis, cross=np.zeros((2, 2, 1))), sky_rms_deg=0.01,
        sky_max_deg=0.02, metrics=Metrics(
            n=1000, rmse_px=0.04, rmse_all_px=0.06, mae_px=0.036, sd_px=0.04, sd_of_distance_px=0.02, rmse_deg=0.004
        ), pose=pose_angles(CAMERA.rotation_cam_enu),
        backward=BackwardModel(radial=(0.0,) * 8, decentering=(0.0,) * 5, max_error_px=0.003),
        evidence=Provenance(
            days=("2013-05-13",), n_supplied=1000, n_used=1000, n_rejected=0, options={}, sigma_px=0.03, inflation=1.0,
            radial_px=1.7, clock_error_s=0.01,
        ), verdict=Verdict(accepted=True, findings=()), method="robust", site=SGP,
    )  # fmt: skip


def frames(rng: np.random.Generator, begin: datetime, weather: Weather, dome: Dome) -> Iterator[Frame]:
    """Yield the images of a night, 40 minutes apart."""
    air, change = rng.uniform(0.15, 0.35), rng.uniform(-0.15, 0.15)
    focus = rng.uniform(-0.4, 0.4)
    for number in range(IMAGES):
        along = number / (IMAGES - 1)
        night = SimulatedNight(star_e_per_s=50_000.0, faintest=6.0, extinction=max(0.05, air + change * along))
        scene = Scene(CAMERA, SGP, options=SceneOptions(night=night, weather=(weather,)))
        start = begin + timedelta(minutes=40 * number)
        image = scene.render(int(start.timestamp() * 1e6), exposure_us=EXPOSURE_US)
        late = max(0.0, along - 1.0 / 3.0) * 1.5
        drift = abs(focus) * (along if focus > 0.0 else 1.0 - along)
        shown = through(image, drift, Dome(*(late * part for part in dome)))
        middle = start + timedelta(microseconds=0.5 * EXPOSURE_US)
        yield Frame(
            image=shown, time=middle, exposure_us=EXPOSURE_US, gain_db=0.0, pixel_format="Mono12", full_scale=4095,
            frame_id=number,
        )  # fmt: skip


def through(image: NDArray[Any], drift_px: float, dome: Dome) -> NDArray[np.uint16]:
    """Return an image through a dome and a lens that is a little out of focus."""
    ground = float(np.median(image))
    stars = gaussian_filter(image.astype(np.float64) - ground, np.hypot(drift_px, dome.blur_px))
    if dome.halo > 0.0:
        stars = (1.0 - dome.halo) * stars + dome.halo * gaussian_filter(stars, 6.0)
    noise = np.clip(np.rint(ground + (1.0 - dome.lost) * stars), 0, 4095)
    return noise.astype(np.uint16)


def night(seed: int, weather: Weather, dome: Dome) -> dict[str, Any]:
    """Return what the event of one night says."""
    rng = np.random.default_rng(seed)
    begin = datetime(2013, 5, 1, 5, 0, tzinfo=UTC) + timedelta(days=int(rng.integers(0, 60)))
    with tempfile.TemporaryDirectory() as folder:
        upgrade(Path(folder) / "a.sqlite")
        archive = open_archive(Path(folder) / "a.sqlite")
        archive.cameras.save(CameraRecord.at(SGP, name="roof", width=CAMERA.width, height=CAMERA.height))
        epoch = archive.epochs.at("roof", begin - timedelta(days=1), reason="first frame")
        document = to_document(
            served(), id="day", camera="roof", state="candidate", created_at=begin, valid_until=None,
            valid_from=begin - timedelta(days=1), pose_epoch=epoch.id, software_version="0",
        )  # fmt: skip
        archive.calibrations.activate(archive.calibrations.add(document).id)
        worker = NightWorker(
            NightCapture(NightExposures(), DropOldestQueue(capacity=4)),
            camera=CameraArchive(archive, name="roof", site=SGP),
            options=SensorOptions(black_level_fraction=32.0 / 4095.0),
            apparent_zenith=lambda: 90.0,
            clock_error_s=lambda _: 0.01,
            trusted=lambda: True,
            now=lambda: begin + timedelta(hours=8),
            request_refit=lambda reason: Refit(id="r", camera="roof", requested_at=begin, reason=reason),
            board=StatusRegistry(version="0", started_at=begin, monotonic=lambda: 0.0),
        )
        for frame in frames(rng, begin, weather, dome):
            worker.look_at(frame)
        worker.finish()
        (event,) = archive.events.find("roof", kind="night")
        archive.close()
    return dict(event.details)


def trend(details: dict[str, Any]) -> NightTrend:
    """Return how a night ended against how it began."""
    names = ("width_growth", "halo_growth", "fading_mag")
    return NightTrend(**{name: float(details.get(name, float("nan"))) for name in names})


def focus_false(rng: np.random.Generator, widths: NDArray[np.float64], factor: float) -> float:
    """Return the share of 400 sequences of nights, drawn from ordinary ones, whose last two would be said."""
    said = 0
    for _ in range(400):
        drawn = rng.choice(widths, 12)
        drawn[:2] *= factor
        said += focus_ratio(drawn.tolist(), LIMITS) is not None
    return said / 400.0


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(prog="night_conditions.py", description=__doc__)
    parser.add_argument("--nights", type=int, default=16, help="ordinary ones; of each dome a third")
    asked = parser.parse_args()
    ordinary = [night(seed, WEATHERS[seed % len(WEATHERS)], Dome()) for seed in range(asked.nights)]
    report("ordinary", ordinary)
    for name, dome in (
        ("thin dew", Dome(0.3, 0.4, 0.1)), ("dew", Dome(0.5, 0.7, 0.2)), ("ice", Dome(0.7, 1.2, 0.3)),
    ):  # fmt: skip
        report(name, [night(500 + seed, WEATHERS[seed % 4], dome) for seed in range(max(asked.nights // 3, 1))])
    widths = np.array([one["star_fwhm_px"] for one in ordinary if one["verdict"] in {"clear", "partly"}])
    rng = np.random.default_rng(1)
    print("focus: two nights wider by a factor, said in a share of sequences drawn from the ordinary nights")
    for factor in (1.0, 1.1, 1.2, 1.3, 1.5):
        print(f"  {factor:.1f}: {focus_false(rng, widths, factor):.3f}")


def report(name: str, nights: list[dict[str, Any]]) -> None:
    """Print how many nights of a kind would be said to have dew, and their numbers."""
    trends = [trend(one) for one in nights]
    said = sum(dew_suspected(one, LIMITS) for one in trends)
    known = [one for one in trends if np.isfinite(one.width_growth + one.fading_mag)]
    columns = np.array([[one.width_growth, one.halo_growth, one.fading_mag] for one in known]).reshape(-1, 3)
    verdicts = {kind: sum(one["verdict"] == kind for one in nights) for kind in {one["verdict"] for one in nights}}
    spread = "; ".join(
        f"{title} {np.nanmin(column):.2f} to {np.nanmax(column):.2f}"
        for title, column in zip(("width", "halo", "fading"), columns.T, strict=True)
        if column.size
    )
    print(f"{name}: dew said in {said} of {len(nights)} ({len(known)} with a trend); {spread}; {verdicts}", flush=True)


if __name__ == "__main__":
    main()
