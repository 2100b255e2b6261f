"""The unknowns of a fit and what they predict: one lens, and a pose for every epoch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray, Rows, picked
from sunarc.calibration.least_squares.priors import LENS, N_LENS, LensPrior
from sunarc.calibration.model.sightings import FilteredSightings
from sunarc.calibration.robust_loss import finite
from sunarc.optics import Camera, Param, angle_limit, rotation_matrix
from sunarc.optics.camera import POSE
from sunarc.optics.forward import by_direction, kernel_lens
from sunarc.optics.kernels import pixels_and_rows_of, pixels_of
from sunarc.optics.pose import right_jacobian
from sunarc.sky import raised, upward

_RIGHT_ANGLE = math.pi / 2


def _no_refraction() -> FloatArray:
    return np.zeros((1, 1))


def _no_systematic_errors() -> FloatArray:
    return np.zeros((1, 2, 0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observations:
    """Where the sun was detected, and the information of each sighting.

    Attributes
    ----------
    directions : (n, 3) unit vectors, east-north-up.
    pixels : (n, 2) px.
    information : (n,) inverse variance of each axis, px⁻²; relative where the scale is still sought.
    epoch : (n,) pose epochs, 0, 1, ….
    refraction_sd : (n, k) 1-sigma of the refraction by its causes, rad, see `FilteredSightings`; 0 unless given.
    systematic_px : (n, 2, s) displacements by s errors that many sightings share, each at its 1-sigma, px; none unless
        given.
    """

    directions: FloatArray
    pixels: FloatArray
    information: FloatArray
    epoch: IntArray
    refraction_sd: FloatArray = field(default_factory=_no_refraction)
    systematic_px: FloatArray = field(default_factory=_no_systematic_errors)

    def __post_init__(self) -> None:
        """Give every observation its refraction and its systematic errors."""
        for name in ("refraction_sd", "systematic_px"):
            given: FloatArray = getattr(self, name)
            object.__setattr__(self, name, np.broadcast_to(given, (self.information.size, *given.shape[1:])))

    def __len__(self) -> int:
        return int(self.information.size)

    def select(self, which: Rows) -> Observations:
        """Return the observations that a slice, an index or a mask picks."""
        return picked(self, which)

    def weighted(self, information: FloatArray) -> Observations:
        """Return the same observations with other information."""
        return replace(self, information=information)


def observations(usable: FilteredSightings) -> Observations:
    """Return the usable sightings with their relative information."""
    return Observations(
        directions=usable.directions,
        pixels=usable.pixels,
        information=usable.sigma_px**-2.0,
        epoch=usable.epoch,
        refraction_sd=usable.refraction_sd,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """A camera whose parameters are sought.

    Attributes
    ----------
    template : projection, image size and handedness; its parameters do not count.
    prior : what is known of the lens.
    n_epochs : number of poses.
    n_systematic : how many unknowns after the poses are sizes of `Observations.systematic_px`, in units of it.
    n_air : 0 where the air is as it is assumed; else how many of the last unknowns are departures of the refraction,
        one for each cause, in units of `Observations.refraction_sd`.
    max_angle : rad, how far off the axis the fitted camera will answer; the fit itself has no such limit.
    """

    template: Camera
    prior: LensPrior
    n_epochs: int
    n_systematic: int = 0
    n_air: int = 0
    max_angle: float = math.pi

    @property
    def size(self) -> int:
        """The number of unknowns: the lens's, three for each pose, those of systematic errors and of the refraction."""
        return N_LENS + 3 * self.n_epochs + self.n_unit

    @property
    def n_unit(self) -> int:
        """The number of unknowns of unit prior variance, the last ones."""
        return self.n_systematic + self.n_air

    @property
    def systematic_slice(self) -> slice:
        """Where the unknowns hold the sizes of systematic errors."""
        start = N_LENS + 3 * self.n_epochs
        return slice(start, start + self.n_systematic)

    def pose_slice(self, epoch: int) -> slice:
        """Return where the unknowns hold an epoch's rotation."""
        start = N_LENS + 3 * epoch
        return slice(start, start + 3)

    def camera(self, unknowns: FloatArray, epoch: int = 0) -> Camera:
        """Return the camera of an epoch."""
        return self.template.with_parameters(self._vector(unknowns, epoch))

    def _vector(self, unknowns: FloatArray, epoch: int) -> FloatArray:
        vector = np.zeros(len(Param))
        vector[LENS] = self.prior.lens(unknowns[:N_LENS])
        vector[POSE] = unknowns[self.pose_slice(epoch)]
        return vector

    def unknowns(self, cameras: list[Camera]) -> FloatArray:
        """Return the unknowns of cameras that share a lens, one an epoch."""
        poses = [camera.rotation_cam_enu for camera in cameras]
        return np.concatenate([self.prior.whitened(cameras[0]), *poses, np.zeros(self.n_unit)])

    def directions(self, unknowns: FloatArray, observed: Observations) -> FloatArray:
        """Return (n, 3): apparent directions, by the refraction that is sought."""
        if self.n_air == 0:
            return observed.directions
        return raised(observed.directions, np.sum(observed.refraction_sd * unknowns[-self.n_air :], axis=-1))

    def residuals(self, unknowns: FloatArray, observed: Observations) -> FloatArray:
        """Return observed minus predicted pixels, (n, 2)."""
        predicted, directions = np.empty(observed.pixels.shape), self.directions(unknowns, observed)
        for epoch in range(self.n_epochs):
            in_epoch = self._of(epoch, observed)
            lens, turned = self._kernel_lens(unknowns, epoch), np.ascontiguousarray(directions[in_epoch])
            predicted[in_epoch] = pixels_of(*lens, rotation_matrix(unknowns[self.pose_slice(epoch)]), turned)
        return finite(observed.pixels - predicted - self.displaced(unknowns, observed))

    def displaced(self, unknowns: FloatArray, observed: Observations) -> FloatArray | float:
        """Return by how much systematic errors displace the detections, (n, 2) px; 0 where there are none."""
        if self.n_systematic == 0:
            return 0.0
        return np.asarray(observed.systematic_px @ unknowns[self.systematic_slice])

    def beyond(self, unknowns: FloatArray, observed: Observations) -> BoolArray:
        """Return (n,): which directions lie further off the axis than the fitted camera will answer."""
        cosine = np.empty(len(observed))
        for epoch in range(self.n_epochs):
            in_epoch = self._of(epoch, observed)
            axis = rotation_matrix(unknowns[self.pose_slice(epoch)])[2]
            cosine[in_epoch] = observed.directions[in_epoch] @ axis
        return np.asarray(cosine < math.cos(self.max_angle))

    def linearised(self, unknowns: FloatArray, observed: Observations) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (n, 2) and the derivatives of the prediction by the unknowns (n, 2, size)."""
        residual = np.empty(observed.pixels.shape)
        rows, directions = np.empty((len(observed), 2, self.size)), self.directions(unknowns, observed)
        for epoch in range(self.n_epochs):
            in_epoch = self._of(epoch, observed)
            pose = unknowns[self.pose_slice(epoch)]
            lens, turned = self._kernel_lens(unknowns, epoch), np.ascontiguousarray(directions[in_epoch])
            pixel, by_parameters = pixels_and_rows_of(*lens, rotation_matrix(pose), right_jacobian(pose), turned)
            to_unknowns = np.zeros((len(Param), self.size))
            to_unknowns[LENS, :N_LENS] = self.prior.basis
            to_unknowns[POSE, self.pose_slice(epoch)] = np.eye(3)
            rows[in_epoch] = (by_parameters.reshape(-1, len(Param)) @ to_unknowns).reshape(-1, 2, self.size)
            if self.n_air:
                up = by_elevation(self.camera(unknowns, epoch), directions[in_epoch], by_parameters)
                rows[in_epoch, :, -self.n_air :] = up[..., None] * observed.refraction_sd[in_epoch, None]
            residual[in_epoch] = observed.pixels[in_epoch] - pixel
        if self.n_systematic:
            rows[..., self.systematic_slice] = observed.systematic_px
            residual -= self.displaced(unknowns, observed)
        return finite(residual), rows

    def _kernel_lens(self, unknowns: FloatArray, epoch: int) -> tuple[FloatArray, int, float, float]:
        """Return the epoch's camera as the kernels take it, see `kernel_lens`; its displacement does not count."""
        _, code, mirror, max_angle = kernel_lens(self.template)
        return self._vector(unknowns, epoch), code, mirror, max_angle

    def _of(self, epoch: int, observed: Observations) -> slice | BoolArray:
        """Return which observations belong to an epoch."""
        return slice(None) if self.n_epochs == 1 else observed.epoch == epoch


def by_elevation(camera: Camera, directions: FloatArray, by_parameters: FloatArray) -> FloatArray:
    """Return (n, 2): px by which the image of directions (n, 3) moves per radian that they rise.

    Parameters
    ----------
    by_parameters : (n, 2, 23) derivatives at these directions, see `project_with_rows_fast`.
    """
    return np.asarray(np.einsum("nai,ni->na", by_direction(camera, by_parameters), upward(directions)))


def problem_for(template: Camera, prior: LensPrior, *, n_epochs: int, max_angle: float = math.pi) -> Problem:
    """Return the problem of fitting a camera like the template, at any angle that its projection has.

    Parameters
    ----------
    max_angle : rad, see `Problem`; the sun is always allowed to be a right angle off the axis.
    """
    widest = angle_limit(template.projection) * (1.0 - 1e-6)
    template = replace(template, max_angle=widest)
    return Problem(template=template, prior=prior, n_epochs=n_epochs, max_angle=max(max_angle, _RIGHT_ANGLE))
