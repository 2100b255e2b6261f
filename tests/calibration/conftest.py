"""A simulated imager at SGP: the paper's Table 2 case 3, with distortions that the fit does not know."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

FloatArray = NDArray[np.float64]

SGP = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
SIZE = (1748, 1748)
NOON_13_MAY_2013 = 1_368_403_200.0 + 43_200.0 + 97.484856 * 240.0
TRUTH = Camera(
    width=1748,
    height=1748,
    projection="equisolid",
    focal_length_px=(601.32, 601.32),
    skew_px=2.57e-3,
    principal_point_px=(871.96, 883.0),
    rotation_cam_enu=rotation_from_pose_angles(PoseAngles(phi_xz_deg=47.91, theta_zz_deg=2.46, psi_z_deg=140.16)),
    # up to 1.7 px of residual radial distortion, about orthogonal to 2 sin(theta/2); 0.9 px of decentering (radial)
    radial=(-0.013, 0.0, 0.0222, 0.0, -0.0086, 0.0, 0.0, 0.0),
    decentering=(1.5e-4, -1.9e-4, 0.0, 0.0),
)


@dataclass(frozen=True)
class Simulated:
    """Sightings, and the truth behind them."""

    camera: Camera
    site: Site
    points: Sightings

    def sky_error_px(self, camera: Camera) -> float:
        """Root mean square error of a camera over the hemisphere."""
        return rms(project(camera, hemisphere(600)) - project(self.camera, hemisphere(600)))

    def track_error_px(self, camera: Camera) -> float:
        """Root mean square error of a camera on the sun's track."""
        track = sun_directions(self.points.unix_s, self.site)
        return rms(project(camera, track) - project(self.camera, track))


Simulator = Callable[..., Simulated]


def rms(error: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=-1))))


def times_of(days: tuple[float, ...], *, site: Site = SGP, cadence_s: float = 120.0) -> FloatArray:
    """Every `cadence_s` on solar days counted from 13 May 2013, while the sun is up."""
    noon = 1_368_403_200.0 + 43_200.0 - site.longitude * 240.0
    times = np.concatenate([noon + 86_400.0 * d + np.arange(-43_200.0, 43_200.0, cadence_s) for d in days])
    return times[sun_angles(times, site).apparent_zenith < 89.6]


def simulate(
    camera: Camera = TRUTH,
    *,
    days: tuple[float, ...] = (0.0,),
    site: Site = SGP,
    sigma_px: float = 0.02,
    cadence_s: float = 120.0,
    seed: int = 1,
) -> Simulated:
    """Sightings with white noise, those inside the image."""
    times = times_of(days, site=site, cadence_s=cadence_s)
    pixels = project(camera, sun_directions(times, site))
    inside = np.all((pixels > 0.0) & (pixels < camera.width), axis=-1)
    noise = np.random.default_rng(seed).normal(0.0, sigma_px, pixels.shape)
    points = Sightings.of(unix_s=times[inside], pixels=(pixels + noise)[inside], clock_error_s=0.01)
    return Simulated(camera=camera, site=site, points=points)


@pytest.fixture(scope="session")
def clear_day() -> Simulated:
    return simulate()


@pytest.fixture(scope="session")
def calibrated(clear_day: Simulated) -> Calibration:
    return calibrate(clear_day.points, site=clear_day.site, image_size=SIZE)


@pytest.fixture(scope="session")
def simulator() -> Simulator:
    return simulate


@pytest.fixture(scope="session")
def tilted() -> Camera:
    turn = rotation_from_pose_angles(PoseAngles(phi_xz_deg=-30.0, theta_zz_deg=48.0, psi_z_deg=200.0))
    return replace(TRUTH, rotation_cam_enu=turn, max_angle=2.0)


@pytest.fixture(scope="session")
def lens_population() -> Callable[[int], Camera]:
    """Lenses that depart from the ideal by about what the priors expect."""

    def drawn(seed: int) -> Camera:
        rng = np.random.default_rng(100 + seed)
        theta = np.linspace(0.0, np.pi / 2, 60)
        kernel = np.exp(-0.5 * ((theta[:, None] - theta) / 0.6) ** 2) + 1e-8 * np.eye(60)
        wave = np.linalg.cholesky(kernel) @ rng.standard_normal(60) * 1.5 / 601.32
        powers = (theta / (np.pi / 2))[:, None] ** np.arange(2, 10)
        radial = np.linalg.lstsq(powers, wave - wave[0])[0]
        p = rng.normal(0.0, 0.6, 2) / (601.32 * 6.0)
        return replace(TRUTH, radial=tuple(radial), decentering=(float(p[0]), float(p[1]), 0.0, 0.0), skew_px=0.004)

    return drawn
