"""Joint draws of a calibration's errors: displacements of the image that are as likely as the stated covariance says.

Each draw is one possible truth: a lens, a pose (with the clock's and the site's error in it) and a field of
displacements, drawn together, and shown as what they move over the image to first order. What is common to all
directions stays common within a draw, so that errors of whatever is computed from many directions follow from the
spread over the draws (Monte Carlo propagation of distributions: JCGM 101:2008).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.model.direction_table import polar_directions, polar_spline, ring_and_spoke
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.pose.error_model import CameraErrorModel, error_model_of, field_and_parameters, predicted
from sunarc.jit import njit
from sunarc.optics.cubic_spline import spline_weights
from sunarc.optics.fast import InverseTable, inverse_table
from sunarc.optics.forward import project_fast
from sunarc.optics.inverse_table_kernels import InverseConstants

MOST_DRAWS = 64
"""Draws that one question may ask for: a standard deviation from so many is known to 9 %, 1 / √(2 · 64)."""
_RINGS, _SPOKES = 48, 96
"""Nodes of the displacements: 20 px apart along the radius of a 2000 px image; the field's length is 200 px or more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ensemble:
    """Draws of one calibration; the first k are those of an ensemble of k.

    Attributes
    ----------
    table : the estimated camera and its inverse.
    sheets_px : (draws, rings, spokes, 2) spline coefficients of the displacements, true minus estimated pixel.
    rings_per_radius : rings per unit of the radius, in focal lengths.
    common : (draws,) standard normal numbers, independent of the rest: for an error that is the same in all directions,
        such as a cloud base height's.
    """

    table: InverseTable
    sheets_px: FloatArray
    rings_per_radius: float
    common: FloatArray

    def __len__(self) -> int:
        """Return the number of draws."""
        return int(self.sheets_px.shape[0])

    def displacement(self, draw: int, pixels: FloatArray) -> FloatArray:
        """Return (n, 2): by how much one draw displaces what is estimated to be at pixels (n, 2), px.

        Beyond the camera's field it is that of the field's edge; NaN for a pixel that is NaN.
        """
        result = np.empty((pixels.shape[0], 2))
        sheet, rings_per_radius = self.sheets_px[draw], self.rings_per_radius
        _write_displacement(self.table.constants, sheet, rings_per_radius, np.ascontiguousarray(pixels), result)
        return result

    def project(self, draw: int, directions: FloatArray) -> FloatArray:
        """Return (n, 2): the pixels of unit vectors (n, 3), east-north-up, by one draw; NaN beyond its field."""
        pixels = project_fast(self.table.camera, directions)
        return np.asarray(pixels + self.displacement(draw, pixels))

    def back_project(self, draw: int, pixels: FloatArray) -> FloatArray:
        """Return (n, 3): the unit vectors, east-north-up, of pixels (n, 2) by one draw; NaN where none lands there."""
        result = np.empty((pixels.shape[0], 3))
        estimated = pixels - self.displacement(draw, pixels)
        # the displacement belongs to where the estimate is, which one round more finds to second order
        estimated = pixels - self.displacement(draw, estimated)
        self.table.write_directions(np.ascontiguousarray(estimated), result)
        return result

    def __iter__(self) -> Iterator[int]:
        """Return the numbers of the draws."""
        return iter(range(len(self)))


def draw_ensemble(calibration: Calibration, *, draws: int, seed: int, calibration_id: str) -> Ensemble:
    """Return joint draws of the errors of a calibration's lens, pose and field.

    Parameters
    ----------
    calibration : the estimate and its covariance.
    draws : how many.
    seed : with the id it decides the draws: the same two give the same ones, whatever is asked of them.
    calibration_id : id of the calibration.

    Raises
    ------
    InputError
        Where the calibration says nothing of its pose.

    Notes
    -----
    The parameters' errors e and those of the field's coefficients are jointly Gaussian (`field_and_parameters`). The
    displacement is J e + f, with J the derivatives of the projection by the parameters and f the field of the errors.
    """
    table = inverse_table(calibration.camera)
    radius = np.linspace(0.0, table.constants.limit, _RINGS)
    azimuth = np.linspace(0.0, 2.0 * math.pi, _SPOKES, endpoint=False)
    errors = error_model_of(calibration)
    at = predicted(errors, calibration.camera, polar_directions(table, radius, azimuth))
    sheets = np.empty((draws, _RINGS + 2, _SPOKES + 3, 2))
    normal = _normals(calibration_id, seed, draws, errors.mean.size + 2 * errors.variances.size + 1)
    parameters, coefficients = _drawn(errors, normal[:, :-1])
    for k in range(draws):
        moved = at.rows @ parameters[k] + at.basis_values @ coefficients[k].T
        moved = np.nan_to_num(moved).reshape(_RINGS, _SPOKES, 2)
        sheets[k] = np.stack([polar_spline(moved[..., axis]) for axis in (0, 1)], axis=-1)
    return Ensemble(table=table, sheets_px=sheets, rings_per_radius=float(1.0 / radius[1]), common=normal[:, -1].copy())


def _normals(calibration_id: str, seed: int, draws: int, size: int) -> FloatArray:
    """Return (draws, size) standard normal numbers; more draws begin with the same ones."""
    of_id = int.from_bytes(hashlib.sha256(calibration_id.encode()).digest()[:8], "big")
    return np.random.Generator(np.random.PCG64([of_id, seed])).standard_normal((draws, size))


def _drawn(errors: CameraErrorModel, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return parameters' errors (k, p) and coefficients (k, 2, m) from standard normal numbers (k, p + 2m)."""
    size = errors.mean.size
    drawn = normal @ _root(field_and_parameters(errors)).T
    return drawn[:, :size], drawn[:, size:].reshape(len(normal), 2, -1)


def _root(covariance: FloatArray) -> FloatArray:
    """Return F with F Fᵀ the covariance (p, p); what rounding made negative counts as 0."""
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


@njit(nogil=True)
def _write_displacement(
    constants: InverseConstants, sheet: FloatArray, rings_per_radius: float, pixels: FloatArray, result: FloatArray
) -> None:
    rings, spokes = sheet.shape[0] - 2, sheet.shape[1] - 3
    for i in range(pixels.shape[0]):
        x, y = pixels[i, 0], pixels[i, 1]
        if math.isnan(x) or math.isnan(y):
            result[i, :] = np.nan
            continue
        ring, spoke = ring_and_spoke(constants, rings, spokes, rings_per_radius, x, y)
        a, a0, a1, a2, a3 = spline_weights(ring, rings - 2)
        b, b0, b1, b2, b3 = spline_weights(spoke, spokes - 1)
        along_x, along_y = 0.0, 0.0
        for k, along in enumerate((a0, a1, a2, a3)):
            for m, around in enumerate((b0, b1, b2, b3)):
                weight, node = along * around, sheet[a + k, b + m]
                along_x, along_y = along_x + weight * node[0], along_y + weight * node[1]
        result[i, 0], result[i, 1] = along_x, along_y
