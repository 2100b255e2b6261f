"""Neighbours under one sun, each with a lens, a pose and noise of its own; no fit, so that days cost milliseconds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from tests.fixtures.calibration import ideal_camera
from tests.fixtures.calibrations import chosen_calibration

from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.daily_rotations import DailyRotations, daily_rotations
from sunarc.common.array_types import FloatArray
from sunarc.optics.camera import PARAMETER_NAMES, POSE, Camera
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

FIRST_NOON = 1_780_339_200.0
"""2026-06-01 18:40 UTC: about noon at 97.5° west."""
NOISE_PX = 0.03
_POSE_NAMES = PARAMETER_NAMES[POSE]


def calibration_of(camera: Camera, site: Site) -> Calibration:
    """Return a calibration of a camera that errs by 0.005 degrees."""
    made = chosen_calibration(
        camera, names=_POSE_NAMES, covariance=np.diag([8e-5] * 3) ** 2, orders=np.array([[1, 1], [2, 1]])
    )
    return replace(made, site=site)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wrong:
    """What is wrong with a camera from a day on.

    Attributes
    ----------
    clock_s : by how much its clock is ahead.
    east_deg : by how much its longitude is stated too far east.
    north_deg : by how much it was turned about the vertical.
    """

    day: int = 25
    clock_s: float = 0.0
    east_deg: float = 0.0
    north_deg: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbour:
    """A camera, its true site, its calibration and what becomes wrong."""

    camera: Camera
    site: Site
    calibration: Calibration
    wrong: Wrong = Wrong()

    def stated_site(self, day: int) -> Site:
        if day < self.wrong.day:
            return self.site
        return replace(self.site, longitude=self.site.longitude + self.wrong.east_deg)

    def sightings(self, day: int, rng: np.random.Generator, *, n: int = 60) -> Sightings:
        """Return a day's sightings, dated by the camera's own clock."""
        after = day >= self.wrong.day
        true_s = FIRST_NOON + 86_400.0 * day + np.linspace(-14_000.0, 14_000.0, n)
        turn = Rotation.from_rotvec([0.0, 0.0, np.radians(self.wrong.north_deg) if after else 0.0]).as_matrix()
        camera = replace(
            self.camera, rotation_cam_enu=rotation_vector(rotation_matrix(self.camera.rotation_cam_enu) @ turn.T)
        )
        pixels = project(camera, sun_directions(true_s, self.site)) + rng.normal(0.0, NOISE_PX, (n, 2))
        return Sightings.of(unix_s=true_s + (self.wrong.clock_s if after else 0.0), pixels=pixels)

    def rotations(self, days: FloatArray, rng: np.random.Generator) -> DailyRotations:
        seen = {day: self.sightings(day, rng) for day in days.astype(int).tolist()}
        return daily_rotations(
            np.repeat(days, [len(points) for points in seen.values()]),
            observed=unproject(self.calibration.camera, np.concatenate([points.pixels for points in seen.values()])),
            expected=np.concatenate(
                [sun_directions(points.unix_s, self.stated_site(day)) for day, points in seen.items()]
            ),
        )


def neighbours(*wrong: Wrong, seed: int = 1) -> tuple[Neighbour, ...]:
    """Return cameras within a kilometre, their lenses and poses independent, their calibrations slightly off."""
    rng = np.random.default_rng(seed)
    made = []
    for number, one in enumerate(wrong):
        site = Site(latitude=36.6 + 0.004 * number, longitude=-97.5 + 0.003 * number**2, altitude=318.0)
        true = replace(
            ideal_camera(),
            focal_length_px=(200.0 + number, 200.0 + number),
            rotation_cam_enu=tuple(rng.normal(0.0, 0.05, 3).tolist()),
        )
        off = np.radians(rng.normal(0.0, 0.005, 3))
        matrix = rotation_matrix(true.rotation_cam_enu) @ Rotation.from_rotvec(off).as_matrix()
        believed = replace(true, rotation_cam_enu=rotation_vector(matrix))
        made.append(Neighbour(camera=true, site=site, calibration=calibration_of(believed, site), wrong=one))
    return tuple(made)
