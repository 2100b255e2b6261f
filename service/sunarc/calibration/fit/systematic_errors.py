"""Errors that all sightings of a night share: unknowns of the fit with a Gaussian prior, linear in px.

A Gaussian fitted to a star is displaced along the radius where the lens has coma, and lateral colour displaces the star
as a whole; the sun's disc, much wider than both, is not: so the offset is zero for the sun and the moon. And the cold
of the night bends what the camera stands on. The camera that is sought is that of the day: in its pose the sun is
predicted.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sunarc.array_types import BoolArray, FloatArray
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.model.kinds import Kind
from sunarc.calibration.model.sightings import FilteredSightings
from sunarc.optics.camera import Camera
from sunarc.optics.forward import by_direction, project_with_rows_fast
from sunarc.optics.projections import ideal_radius

POSE_DIFFERENCE_DEG = 0.02
"""1-sigma about each axis of how far the camera of the night is turned against that of the day. A bracket of 10 cm and
5 cm across of aluminium (23e-6 a kelvin), one side of it 5 K warmer by day, bends by 0.013 degrees."""
OFFSET_POWERS = (1, 2, 3)
"""Of the radius. Coma grows with the radius at first, and higher orders of it faster; on the axis it is zero."""
OFFSET_PX = 0.15
"""1-sigma of each coefficient, 0.26 px at the edge together. The simulated lens has 0.13 px there."""
DECENTRED_PX = 0.03
"""1-sigma at the edge of the part of the offset that grows as the cosine and as the sine of the azimuth: of lenses that
are not centred, whose coma is not either. It grows as the square of the radius, as decentering distortion does."""
N_RADIAL = len(OFFSET_POWERS)
N_OFFSET = N_RADIAL + 2
N_POSE = 3


def with_systematic_errors(
    observed: Observations, usable: FilteredSightings, problem: Problem, unknowns: FloatArray
) -> Observations:
    """Return the observations with what errors of the night displace them by.

    Without a sighting of a night, or with nothing of a day beside it, there are none: the camera is then that of the
    night.

    Parameters
    ----------
    observed, usable : the sightings.
    problem, unknowns : a camera near the one sought, in which the displacements are computed.
    """
    day = ~usable.night
    if np.all(day) or not np.any(day):
        return observed
    columns = np.zeros((len(observed), 2, N_OFFSET + N_POSE))
    for epoch in range(problem.n_epochs):
        rows = usable.night & (observed.epoch == epoch)
        if np.any(rows):
            camera = problem.camera(unknowns, epoch)
            columns[rows] = _columns(camera, observed.directions[rows], usable.kind[rows] == Kind.STAR)
    return replace(observed, systematic_px=columns)


def _columns(camera: Camera, directions: FloatArray, star: BoolArray) -> FloatArray:
    """Return (n, 2, s): the parts of the offset of stars, and the turns about east, north and up, at 1-sigma."""
    pixels, by_parameters = project_with_rows_fast(camera, directions)
    # a camera that is turned by d sees the direction u where the one of the day sees u - d x u
    seen = -np.cross(np.eye(3), directions[:, None, :]) * math.radians(POSE_DIFFERENCE_DEG)
    turns = np.einsum("nai,nki->nak", by_direction(camera, by_parameters), seen)
    return np.concatenate([_offsets(camera, pixels) * star[:, None, None], turns], axis=-1)


def _offsets(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return (n, 2, 5): displacements outwards by powers of the radius, and by its square over the azimuth, px."""
    outwards = pixels - np.array(camera.principal_point_px)
    far = np.linalg.norm(outwards, axis=-1)
    edge = camera.focal_length_px[0] * float(ideal_radius(camera.projection, min(camera.max_angle, math.pi / 2)))
    along = outwards / np.maximum(far, 1e-9)[:, None]
    radius = (far / edge)[:, None]
    size = np.concatenate([OFFSET_PX * radius ** np.array(OFFSET_POWERS), DECENTRED_PX * radius**2 * along], axis=-1)
    return np.asarray(along[:, :, None] * size[:, None, :])
