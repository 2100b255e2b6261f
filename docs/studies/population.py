"""Lenses, sun tracks and noise to judge a calibration with: a truth that the fit does not know."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.camera import Camera, camera_sees
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.optics.projections import ideal_radius
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

FloatArray = NDArray[np.float64]
Field = Callable[[FloatArray], FloatArray]
"""Displacement of pixels, px: (n, 2) of (n, 2)."""

SGP = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
SIZE = 1748
MAY_13 = 1_368_403_200.0
"""2013-05-13 00:00 UTC."""
CASE_3 = Camera(
    width=SIZE,
    height=SIZE,
    projection="equisolid",
    focal_length_px=(601.32, 601.32),
    skew_px=2.57e-3,
    principal_point_px=(871.96, 883.0),
    rotation_cam_enu=rotation_from_pose_angles(PoseAngles(phi_xz_deg=47.91, theta_zz_deg=2.46, psi_z_deg=140.16)),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lenses:
    """How lenses are drawn: 1-sigma of what they depart by from the ideal."""

    radial_px: float = 1.5
    radial_length: float = 0.6
    decentering_px: float = 0.6
    skew_px: float = 0.006
    aspect: float = 2e-5
    center_px: float = 5.0
    tilt_deg: float = 2.5


def radial_coefficients(rng: np.random.Generator, camera: Camera, *, scale_px: float, length: float) -> FloatArray:
    """Draw k2 … k9: a smooth random function of the angle, orthogonal to the ideal projection (c1 = 0)."""
    theta = np.linspace(0.0, math.pi / 2, 120)
    kernel = np.exp(-0.5 * ((theta[:, None] - theta) / length) ** 2) + 1e-9 * np.eye(theta.size)
    drawn = np.linalg.cholesky(kernel) @ rng.standard_normal(theta.size) * scale_px / camera.focal_length_px[0]
    ideal = ideal_radius(camera.projection, theta)
    powers = (theta / (math.pi / 2))[:, None] ** np.arange(2, 10)
    drawn = drawn - ideal * (ideal @ drawn) / (ideal @ ideal)
    # least squares under the constraint that the polynomial itself is orthogonal to the ideal projection
    normal = np.zeros((9, 9))
    normal[:8, :8] = powers.T @ powers + 1e-10 * np.eye(8)
    normal[8, :8] = normal[:8, 8] = ideal @ powers
    return np.asarray(np.linalg.solve(normal, np.r_[powers.T @ drawn, 0.0])[:8])


def random_camera(rng: np.random.Generator, lenses: Lenses | None = None, *, base: Camera = CASE_3) -> Camera:
    """Draw a camera about a base."""
    drawn = Lenses() if lenses is None else lenses
    focal = base.focal_length_px[0] + rng.normal(0.0, 6.0)
    edge = float(ideal_radius(base.projection, math.pi / 2))
    decentering = rng.normal(0.0, drawn.decentering_px, 2) / (focal * 3.0 * edge**2)
    pose = PoseAngles(
        phi_xz_deg=rng.uniform(-180.0, 180.0),
        theta_zz_deg=abs(rng.normal(0.0, drawn.tilt_deg)),
        psi_z_deg=rng.uniform(0.0, 360.0),
    )
    return replace(
        base,
        focal_length_px=(focal, focal * (1.0 + rng.normal(0.0, drawn.aspect))),
        skew_px=rng.normal(0.0, drawn.skew_px),
        principal_point_px=(
            (base.width - 1) / 2.0 + rng.normal(0.0, drawn.center_px),
            (base.height - 1) / 2.0 + rng.normal(0.0, drawn.center_px),
        ),
        rotation_cam_enu=rotation_from_pose_angles(pose),
        radial=tuple(radial_coefficients(rng, base, scale_px=drawn.radial_px, length=drawn.radial_length)),
        decentering=(*(float(p) for p in decentering), *(float(p) for p in rng.normal(0.0, 0.3, 2))),
    )


def sun_track(days: FloatArray, *, site: Site = SGP, cadence_s: float = 30.0) -> FloatArray:
    """Return the times of a track: every `cadence_s` on solar days (offsets from 13 May 2013) while the sun is up."""
    noon = MAY_13 + 43_200.0 - site.longitude * 240.0
    times = np.concatenate([noon + 86_400.0 * d + np.arange(-43_200.0, 43_200.0, cadence_s) for d in days])
    return times[sun_angles(times, site).apparent_zenith < 89.6]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Where the sun is: times (n,), s; apparent directions (n, 3); apparent zenith angles (n,), degrees."""

    unix_s: FloatArray
    directions: FloatArray
    zenith_deg: FloatArray

    def shown_by(self, camera: Camera) -> Track:
        """Return the part that lands in a camera's image."""
        shown = camera_sees(camera, project(camera, self.directions))
        return Track(unix_s=self.unix_s[shown], directions=self.directions[shown], zenith_deg=self.zenith_deg[shown])


@lru_cache(maxsize=8)
def track(days: tuple[int, ...], *, site: Site = SGP, cadence_s: float = 30.0) -> Track:
    """Return the sun of a `sun_track`; that of the same days is computed once."""
    times = sun_track(np.array(days, dtype=float), site=site, cadence_s=cadence_s)
    zenith = sun_angles(times, site).apparent_zenith
    return Track(unix_s=times, directions=sun_directions(times, site), zenith_deg=zenith)


def smooth_field(rng: np.random.Generator, *, amplitude_px: float, length_px: float, waves: int = 400) -> Field:
    """Draw a smooth random displacement field over the image, as a function of pixels."""
    frequency = rng.standard_normal((2, waves, 2)) / length_px
    phase = rng.uniform(0.0, 2.0 * math.pi, (2, waves))
    scale = amplitude_px * math.sqrt(2.0 / waves)

    def displacement(pixels: FloatArray) -> FloatArray:
        return np.stack([scale * np.cos(pixels @ frequency[a].T + phase[a]).sum(axis=-1) for a in (0, 1)], axis=-1)

    return displacement


def white_noise(rng: np.random.Generator, n: int, sigma_px: float) -> FloatArray:
    """Draw independent noise, (n, 2)."""
    return rng.normal(0.0, sigma_px, (n, 2))


def correlated_noise(rng: np.random.Generator, n: int, sigma_px: float, rho: float) -> FloatArray:
    """Draw first-order autoregressive noise, (n, 2)."""
    drawn = rng.normal(0.0, sigma_px, (n, 2))
    drawn[1:] *= math.sqrt(1.0 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], drawn, axis=0))


def cloud_noise(rng: np.random.Generator, n: int, *, core_px: float, sd_px: float, share: float) -> FloatArray:
    """Draw clear-sky noise with clustered, heavy-tailed episodes of cloud, clipped at 50 px, (n, 2)."""
    noise = rng.normal(0.0, core_px, (n, 2))
    covered = np.zeros(n, dtype=bool)
    while covered.mean() < share:
        begin, length = rng.integers(n), 1 + rng.geometric(1.0 / 12.0)
        covered[begin : begin + length] = True
    heavy = rng.standard_t(3, (n, 2))
    for i in range(1, n):
        heavy[i] = 0.7 * heavy[i - 1] + math.sqrt(1.0 - 0.49) * heavy[i]
    episode = heavy * (sd_px / math.sqrt(share) / 1.6)
    return np.clip(np.where(covered[:, None], episode, noise), -50.0, 50.0)


def biased_outliers(rng: np.random.Generator, noise: FloatArray, *, share: float, offset_px: float) -> FloatArray:
    """Move a share of the sightings by about the same vector."""
    angle = rng.uniform(0.0, 2.0 * math.pi)
    mean = offset_px * np.array([math.cos(angle), math.sin(angle)])
    bad = np.less(rng.random(noise.shape[0]), share)
    moved = mean + rng.normal(0.0, 3.0, noise.shape)
    return np.where(bad[:, None], noise + moved, noise)


def sightings(
    camera: Camera, times: FloatArray, noise: FloatArray, *, site: Site = SGP, field: Field | None = None
) -> Sightings:
    """Return what a detector would have seen."""
    return sightings_of(camera, times, sun_directions(times, site), noise, field=field)


def sightings_of(
    camera: Camera, times: FloatArray, directions: FloatArray, noise: FloatArray, *, field: Field | None = None
) -> Sightings:
    """Return what a detector would have seen of the sun in directions that are known."""
    return Sightings.of(unix_s=times, pixels=seen_at(camera, directions, field) + noise, clock_error_s=0.0)


def seen_at(camera: Camera, directions: FloatArray, field: Field | None) -> FloatArray:
    """Return the pixels (n, 2) of directions by the true camera and its field."""
    pixels = project(camera, directions)
    return pixels if field is None else np.asarray(pixels + field(pixels))
