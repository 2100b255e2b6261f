"""The errors of a calibration as one Gaussian of lens, pose and field, and joint draws of them.

The errors of the lens's parameters, a small turn of the camera *in its own frame*, and the field's coefficients are
jointly Gaussian. In that frame a camera that is turned as a whole keeps its errors: what of a tilt may be a shifted
principal point stays so, wherever the camera now looks.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sunarc import _kernels
from sunarc.calibration.answers.covariance import without_clock
from sunarc.calibration.answers.direction_table import polar_spline
from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.errors import InputError
from sunarc.optics.camera import PARAMETER_NAMES, POSE, Camera
from sunarc.optics.displacement import WaveBasis
from sunarc.optics.forward import project_fast, project_with_rows_fast
from sunarc.optics.inverse_table import InverseTable, inverse_table
from sunarc.optics.pose import right_jacobian, rotation_matrix, rotation_vector

_SHORTEST_LENGTH_PX = 16.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraErrorModel:
    """Gaussian prior or posterior of a camera's errors.

    Attributes
    ----------
    selected : (p,) which of the camera's 23 parameters it speaks of.
    rotation : (3,) where among those the small turn about the camera's own axes stands, radians.
    mean : (p,) expected error of the estimate (true minus estimated).
    covariance : (p, p) of the errors.
    field : on all the waves that it needs.
    """

    selected: IntArray
    rotation: IntArray
    mean: FloatArray
    covariance: FloatArray
    field: Field

    @property
    def variances(self) -> FloatArray:
        """(m,) of the field's coefficients before any sighting."""
        return self.field.amplitude_px**2 * self.field.basis.variances(length_px=self.field.length_px)

    def add_free_rotation(self, mean: FloatArray, *, sigma_rad: float | FloatArray) -> CameraErrorModel:
        """Return the error model after a rotation by `mean` (3,), radians, with a 1-sigma of all axes or of each."""
        covariance, at = self.covariance.copy(), self.mean.copy()
        covariance[np.ix_(self.rotation, self.rotation)] += sigma_rad**2 * np.eye(3)
        at[self.rotation] += mean
        return replace(self, covariance=covariance, mean=at)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Predicted:
    """Predicted pixels of directions, and their derivatives.

    Attributes
    ----------
    pixels : (n, 2) px, NaN where it sees nothing.
    rows : (n, 2, p) derivatives by the parameters of an error model.
    basis_values : (n, m) of its field.
    """

    pixels: FloatArray
    rows: FloatArray
    basis_values: FloatArray


def build_error_model(calibration: Calibration) -> CameraErrorModel:
    """Return the error model that a calibration states.

    Raises
    ------
    InputError
        Where it says nothing of the pose.
    """
    names = calibration.parameter_names
    if any(name not in names for name in PARAMETER_NAMES[POSE]):
        raise InputError(
            field="uncertainty.parameters", problem="the pose is missing", remedy="give a calibration with its pose"
        )
    rotation = np.array([names.index(name) for name in PARAMETER_NAMES[POSE]])
    to_rotation = np.eye(len(names))
    to_rotation[np.ix_(rotation, rotation)] = right_jacobian(-np.array(calibration.camera.rotation_cam_enu))
    stated = calibration.field
    length = max(stated.length_px, _SHORTEST_LENGTH_PX)
    basis = stated.basis.completed(length_px=length) if stated.amplitude_px > 0.0 else _make_empty_basis(stated.basis)
    return CameraErrorModel(
        selected=np.array([PARAMETER_NAMES.index(name) for name in names]),
        rotation=rotation,
        mean=np.zeros(len(names)),
        covariance=to_rotation @ without_clock(calibration).covariance @ to_rotation.T,
        field=Field(
            amplitude_px=stated.amplitude_px,
            length_px=length,
            basis=basis,
            cross=to_rotation @ stated.basis.spread(stated.cross, basis),
            known=stated.basis.spread(stated.known, basis),
            coupling=stated.basis.spread(stated.coupling, basis),
        ),
    )


def _make_empty_basis(basis: WaveBasis) -> WaveBasis:
    return replace(basis, orders=np.zeros((0, 2), dtype=np.int64))


def predicted(error_model: CameraErrorModel, camera: Camera, directions: FloatArray) -> Predicted:
    """Return the pixels of directions (n, 3) in a camera, and their derivatives by an error model's parameters."""
    pixels, rows = project_with_rows_fast(camera, directions)
    to_rotation = np.linalg.inv(right_jacobian(-np.array(camera.rotation_cam_enu)))
    selected = np.ascontiguousarray(rows[..., error_model.selected])
    selected[..., error_model.rotation] = selected[..., error_model.rotation] @ to_rotation
    return Predicted(pixels=pixels, rows=selected, basis_values=error_model.field.basis.values(np.nan_to_num(pixels)))


def joint_covariance(error_model: CameraErrorModel, prediction: Predicted) -> FloatArray:
    """Return (2n, 2n): the covariance of the prediction's errors at all places at once, px²; x, y of each in turn."""
    n = prediction.rows.shape[0]
    flat = prediction.rows.reshape(2 * n, prediction.rows.shape[-1])
    result = flat @ error_model.covariance @ flat.T
    if error_model.field.amplitude_px > 0.0:
        mixed = (flat @ _field_covariance(error_model, prediction)).reshape(2 * n, 2 * n)
        result += mixed + mixed.T
        separation = prediction.pixels[:, None] - prediction.pixels
        smooth = error_model.field.amplitude_px**2 * np.exp(
            -0.5 * np.sum(separation**2, axis=-1) / error_model.field.length_px**2
        )
        reduction = error_model.field.reduction(prediction.basis_values)
        coupled = _coupled_field_rows(error_model, prediction)
        result += np.kron(smooth - reduction @ reduction.T, np.eye(2)) + coupled @ coupled.T
    return np.asarray(result)


def field_and_parameters(error_model: CameraErrorModel) -> FloatArray:
    """Return (p + 2m, p + 2m): the covariance of the errors of the parameters and of the coefficients, x before y."""
    cross = np.concatenate(list(error_model.field.cross), axis=-1)
    coupling = np.concatenate(list(error_model.field.coupling), axis=-1)
    own = np.diag(error_model.variances) - error_model.field.known.T @ error_model.field.known
    field = np.kron(np.eye(2), own) + coupling.T @ coupling
    return np.block([[error_model.covariance, cross], [cross.T, field]])


def parameter_covariance(error_model: CameraErrorModel, prediction: Predicted) -> FloatArray:
    """Return (p, 2n): the covariance of the parameters' errors with the prediction's."""
    flat = prediction.rows.reshape(-1, prediction.rows.shape[-1])
    result = error_model.covariance @ flat.T
    return np.asarray(
        result + _field_covariance(error_model, prediction) if error_model.field.amplitude_px > 0.0 else result
    )


def coefficient_covariance(error_model: CameraErrorModel, prediction: Predicted, axis: int) -> FloatArray:
    """Return (2n, m): the covariance of the prediction's errors with the coefficients of one component of the field."""
    result = prediction.rows.reshape(-1, prediction.rows.shape[-1]) @ error_model.field.cross[axis]
    values = prediction.basis_values
    result[axis::2] += values * error_model.variances - (values @ error_model.field.known.T) @ error_model.field.known
    return np.asarray(result + _coupled_field_rows(error_model, prediction) @ error_model.field.coupling[axis])


def _coupled_field_rows(error_model: CameraErrorModel, prediction: Predicted) -> FloatArray:
    """Return (2n, q): the part of the field that the parameters' errors leave undetermined, where the sun was seen."""
    both = np.stack([prediction.basis_values @ error_model.field.coupling[axis].T for axis in (0, 1)], axis=1)
    return both.reshape(2 * both.shape[0], both.shape[2])


def _field_covariance(error_model: CameraErrorModel, prediction: Predicted) -> FloatArray:
    """Return (p, 2n): the covariance of the parameters' errors with the field where the sun was seen."""
    both = np.stack([error_model.field.cross[axis] @ prediction.basis_values.T for axis in (0, 1)], axis=-1)
    return both.reshape(both.shape[0], 2 * both.shape[1])


def moved(camera: Camera, error_model: CameraErrorModel, change: FloatArray) -> Camera:
    """Return a camera after a change (p,) of its parameters and a rotation about its own axes."""
    vector = camera.to_vector()
    vector[error_model.selected] += change
    vector[POSE] = rotated(camera, change[error_model.rotation]).rotation_cam_enu
    return camera.replace_parameters(vector)


def rotated(camera: Camera, rotation: FloatArray) -> Camera:
    """Return a camera after a rotation (3,) about its own axes, radians."""
    matrix = rotation_matrix(rotation) @ rotation_matrix(camera.rotation_cam_enu)
    return replace(camera, rotation_cam_enu=rotation_vector(matrix))


# Joint draws of a calibration's errors: displacements of the image that are as likely as the stated covariance says.
#
# Each draw is one possible truth: a lens, a pose (with the clock's and the site's error in it) and a field of
# displacements, drawn together, and shown as what they move over the image to first order. What is common to all
# directions stays common within a draw, so that errors of whatever is computed from many directions follow from the
# spread over the draws (Monte Carlo propagation of distributions: JCGM 101:2008).

MOST_DRAWS = 64
"""Draws that one question may ask for: a standard deviation from so many is known to 9 %, 1 / √(2 · 64)."""
_RINGS, _SPOKES = 48, 96
"""Nodes of the displacements: 20 px apart along the radius of a 2000 px image; the field's length is 200 px or more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ensemble:
    """Draws of one calibration's errors; the first k are those of an ensemble of k.

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
        """Return (n, 2): the displacement of estimated pixels (n, 2) by one draw, px.

        Beyond the camera's field it is that of the field's edge; NaN for a pixel that is NaN.
        """
        sheets, constants = self.sheets_px[draw], np.array(self.table.constants)
        return _kernels.polar_values(constants, sheets, self.rings_per_radius, np.ascontiguousarray(pixels))

    def project(self, draw: int, directions: FloatArray) -> FloatArray:
        """Return (n, 2): the pixels of unit vectors (n, 3), east-north-up, by one draw; NaN beyond its field."""
        pixels = project_fast(self.table.camera, directions)
        return np.asarray(pixels + self.displacement(draw, pixels))

    def back_project(self, draw: int, pixels: FloatArray) -> FloatArray:
        """Return (n, 3): the unit vectors, east-north-up, of pixels (n, 2) by one draw; NaN where none lands there."""
        estimated = pixels - self.displacement(draw, pixels)
        # the displacement belongs to where the estimate is, which one round more finds to second order
        estimated = pixels - self.displacement(draw, estimated)
        return self.table.directions(estimated)

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
    Where the errors are a mixture, a class is drawn for the whole image, and the displacement is scaled as its 1-sigma
    is.
    """
    table = inverse_table(calibration.camera)
    radius = np.linspace(0.0, table.constants.limit, _RINGS)
    azimuth = np.linspace(0.0, 2.0 * math.pi, _SPOKES, endpoint=False)
    errors = build_error_model(calibration)
    at = predicted(errors, calibration.camera, _directions_on_polar_grid(table, radius, azimuth))
    sheets = np.empty((draws, _RINGS + 2, _SPOKES + 3, 2))
    # more draws begin with the same ones
    size = errors.mean.size + 2 * errors.variances.size + 1
    normal = _make_generator(calibration_id, seed).standard_normal((draws, size))
    parameters, coefficients = draw_errors(errors, normal[:, :-1])
    scales = _draw_scales(calibration, np.nan_to_num(at.pixels), _make_generator(calibration_id, seed, 1), draws)
    for k in range(draws):
        moved = scales[k, :, None] * (at.rows @ parameters[k] + at.basis_values @ coefficients[k].T)
        moved = np.nan_to_num(moved).reshape(_RINGS, _SPOKES, 2)
        sheets[k] = np.stack([polar_spline(moved[..., axis]) for axis in (0, 1)], axis=-1)
    return Ensemble(table=table, sheets_px=sheets, rings_per_radius=float(1.0 / radius[1]), common=normal[:, -1].copy())


def _directions_on_polar_grid(table: InverseTable, radius: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return unit vectors (rings · spokes, 3) that the lens without decentering images at these radii and azimuths."""
    position = np.minimum(radius * table.constants.per_radius, len(table.pieces) - 1e-9)
    piece = position.astype(np.int64)
    powers = (position - piece)[:, None] ** np.arange(4)
    scale = np.sum(table.pieces[piece, :4] * powers, axis=-1)
    sine, cosine = scale * radius, np.sum(table.pieces[piece, 4:] * powers, axis=-1)
    across = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    ray = np.empty((len(radius), len(azimuth), 3))
    ray[..., :2] = sine[:, None, None] * across
    ray[..., 2] = cosine[:, None]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    return np.asarray(ray.reshape(-1, 3) @ table.rotation)


def _draw_scales(
    calibration: Calibration, pixels: FloatArray, generator: np.random.Generator, draws: int
) -> FloatArray:
    """Return (draws, n): the 1-sigma of errors at pixels (n, 2) in stated ones, of a class for each draw."""
    if calibration.mixture is None:
        return np.ones((draws, pixels.shape[0]))
    upto = np.cumsum(calibration.mixture.shares[:-1])
    return calibration.mixture.at(pixels).T[np.searchsorted(upto, generator.uniform(size=draws))]


def _make_generator(calibration_id: str, *numbers: int) -> np.random.Generator:
    of_id = int.from_bytes(hashlib.sha256(calibration_id.encode()).digest()[:8], "big")
    return np.random.Generator(np.random.PCG64([of_id, *numbers]))


def draw_errors(errors: CameraErrorModel, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return parameters' errors (k, p) and coefficients (k, 2, m) from standard normal numbers (k, p + 2m)."""
    size = errors.mean.size
    drawn = normal @ covariance_root(field_and_parameters(errors)).T
    return drawn[:, :size], drawn[:, size:].reshape(len(normal), 2, -1)


def covariance_root(covariance: FloatArray) -> FloatArray:
    """Return F with F Fᵀ the covariance (p, p); eigenvalues that rounding made negative count as 0.

    It is the symmetric one: that of the eigenvectors alone would differ from processor to processor.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * ((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T))
