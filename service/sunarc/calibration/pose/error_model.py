"""What a calibration says of its own errors, as one Gaussian for lens, pose and field that sightings can be held to.

The errors of the lens's parameters, a small turn of the camera *in its own frame*, and the field's coefficients are
jointly Gaussian. In that frame a camera that is turned as a whole keeps its errors: what of a tilt may be a shifted
principal point stays so, wherever the camera now looks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from sunarc.array_types import FloatArray, IntArray, Rows, picked
from sunarc.calibration.model.residual_field import WaveBasis
from sunarc.calibration.model.result import Calibration
from sunarc.errors import InputError
from sunarc.optics import PARAMETER_NAMES, Camera, angle_limit, project_with_rows_fast, rotation_matrix, rotation_vector
from sunarc.optics.camera import POSE
from sunarc.optics.pose import right_jacobian

_SHORTEST_LENGTH_PX = 16.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraErrorModel:
    """Gaussian prior or posterior of a camera's errors.

    Attributes
    ----------
    chosen : (p,) which of the camera's 23 parameters it speaks of.
    turn : (3,) where among those the small turn about the camera's own axes stands, radians.
    mean : (p,) expected error of the estimate (true minus estimated).
    covariance : (p, p) of the errors.
    cross : (2, p, m) their covariance with the field's coefficients.
    amplitude_px, length_px, basis, variances : of the field; (m,) the coefficients' variances before any sighting.
    """

    chosen: IntArray
    turn: IntArray
    mean: FloatArray
    covariance: FloatArray
    cross: FloatArray
    amplitude_px: float
    length_px: float
    basis: WaveBasis
    variances: FloatArray

    def turned_freely(self, mean: FloatArray, *, sigma_rad: float) -> CameraErrorModel:
        """Return the error model after a rotation by `mean` (3,), radians, with an isotropic 1-sigma."""
        covariance, at = self.covariance.copy(), self.mean.copy()
        covariance[np.ix_(self.turn, self.turn)] += sigma_rad**2 * np.eye(3)
        at[self.turn] += mean
        return replace(self, covariance=covariance, mean=at)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Predicted:
    """Where a camera sees directions, and how that changes.

    Attributes
    ----------
    pixels : (n, 2) px, NaN where it sees nothing.
    rows : (n, 2, p) derivatives by the parameters of an error model.
    waves : (n, m) of its field.
    """

    pixels: FloatArray
    rows: FloatArray
    waves: FloatArray

    def select(self, which: Rows) -> Predicted:
        """Return those that a slice, an index or a mask picks."""
        return picked(self, which)


def joined(first: Predicted, second: Predicted) -> Predicted:
    """Return the one after the other."""
    return Predicted(
        pixels=np.concatenate([first.pixels, second.pixels]),
        rows=np.concatenate([first.rows, second.rows]),
        waves=np.concatenate([first.waves, second.waves]),
    )


def stated(calibration: Calibration) -> CameraErrorModel:
    """Return what a calibration says of its errors.

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
    turn = np.array([names.index(name) for name in PARAMETER_NAMES[POSE]])
    to_turn = np.eye(len(names))
    to_turn[np.ix_(turn, turn)] = right_jacobian(-np.array(calibration.camera.rotation_cam_enu))
    field = calibration.field
    length = max(field.length_px, _SHORTEST_LENGTH_PX)
    basis = field.basis.completed(length_px=length) if field.amplitude_px > 0.0 else _none(field.basis)
    return CameraErrorModel(
        chosen=np.array([PARAMETER_NAMES.index(name) for name in names]),
        turn=turn,
        mean=np.zeros(len(names)),
        covariance=to_turn @ calibration.covariance @ to_turn.T,
        cross=to_turn @ _spread(field.basis, field.cross, basis),
        amplitude_px=field.amplitude_px,
        length_px=length,
        basis=basis,
        variances=field.amplitude_px**2 * basis.variances(length_px=length),
    )


def _none(basis: WaveBasis) -> WaveBasis:
    return replace(basis, orders=np.zeros((0, 2), dtype=np.int64))


def _spread(known: WaveBasis, cross: FloatArray, whole: WaveBasis) -> FloatArray:
    """Return the cross terms (2, p, m) on a basis that has more waves; those that it has not are lost."""
    place = {(int(x), int(y)): k for k, (x, y) in enumerate(whole.orders)}
    kept = [(k, place[int(x), int(y)]) for k, (x, y) in enumerate(known.orders) if (int(x), int(y)) in place]
    result = np.zeros((2, cross.shape[1], len(whole.orders)))
    if kept:
        old, new = np.array(kept).T
        result[..., new] = cross[..., old]
    return result


def predicted(error_model: CameraErrorModel, camera: Camera, directions: FloatArray) -> Predicted:
    """Return where a camera sees directions (n, 3), and the derivatives by the parameters of an error model."""
    pixels, rows = project_with_rows_fast(camera, directions)
    to_turn = np.linalg.inv(right_jacobian(-np.array(camera.rotation_cam_enu)))
    chosen = np.ascontiguousarray(rows[..., error_model.chosen])
    chosen[..., error_model.turn] = chosen[..., error_model.turn] @ to_turn
    return Predicted(pixels=pixels, rows=chosen, waves=error_model.basis.values(np.nan_to_num(pixels)))


def joint_covariance(error_model: CameraErrorModel, seen: Predicted) -> FloatArray:
    """Return (2n, 2n): the covariance of the prediction's errors at all places at once, px²; x, y of each in turn."""
    n = seen.rows.shape[0]
    flat = seen.rows.reshape(2 * n, seen.rows.shape[-1])
    result = flat @ error_model.covariance @ flat.T
    if error_model.amplitude_px > 0.0:
        mixed = (flat @ _with_field(error_model, seen)).reshape(2 * n, 2 * n)
        result += mixed + mixed.T
        apart = seen.pixels[:, None] - seen.pixels
        smooth = error_model.amplitude_px**2 * np.exp(-0.5 * np.sum(apart**2, axis=-1) / error_model.length_px**2)
        result += np.kron(smooth, np.eye(2))
    return np.asarray(result)


def with_parameters(error_model: CameraErrorModel, seen: Predicted) -> FloatArray:
    """Return (p, 2n): the covariance of the parameters' errors with the prediction's."""
    flat = seen.rows.reshape(-1, seen.rows.shape[-1])
    result = error_model.covariance @ flat.T
    return np.asarray(result + _with_field(error_model, seen) if error_model.amplitude_px > 0.0 else result)


def with_waves(error_model: CameraErrorModel, seen: Predicted, axis: int) -> FloatArray:
    """Return (2n, m): the covariance of the prediction's errors with the coefficients of one component of the field."""
    result = seen.rows.reshape(-1, seen.rows.shape[-1]) @ error_model.cross[axis]
    result[axis::2] += seen.waves * error_model.variances
    return np.asarray(result)


def _with_field(error_model: CameraErrorModel, seen: Predicted) -> FloatArray:
    """Return (p, 2n): the covariance of the parameters' errors with the field where the sun was seen."""
    both = np.stack([error_model.cross[axis] @ seen.waves.T for axis in (0, 1)], axis=-1)
    return both.reshape(both.shape[0], 2 * both.shape[1])


def at_every_angle(camera: Camera) -> Camera:
    """Return the camera answering at every angle that its projection has."""
    return replace(camera, max_angle=angle_limit(camera.projection) * (1.0 - 1e-6))


def moved(camera: Camera, error_model: CameraErrorModel, change: FloatArray) -> Camera:
    """Return a camera changed by (p,): its parameters, and its turn about its own axes."""
    vector = camera.to_vector()
    vector[error_model.chosen] += change
    vector[POSE] = turned(camera, change[error_model.turn]).rotation_cam_enu
    return camera.with_parameters(vector)


def turned(camera: Camera, turn: FloatArray) -> Camera:
    """Return a camera after a turn (3,) about its own axes, radians."""
    matrix = Rotation.from_rotvec(turn).as_matrix() @ rotation_matrix(camera.rotation_cam_enu)
    return replace(camera, rotation_cam_enu=rotation_vector(matrix))
