"""The unknowns of a fit and their prediction: one lens, a pose for every epoch; sightings in bins of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunarc import _kernels
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import LENS, N_LENS, LensPrior
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.robust_statistics import UNSEEN_PX, is_shown
from sunarc.optics.camera import POSE, Camera, Param
from sunarc.optics.forward import Optics, kernel_optics
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.refraction import upward

_RIGHT_ANGLE = math.pi / 2


class Block(NamedTuple):
    """Unknowns of a shared error, of unit prior variance: its name, and its columns of `Sightings.systematic_px`."""

    name: str
    columns: slice

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.columns.stop - self.columns.start)


class Sighted(NamedTuple):
    """Sightings as contiguous arrays for the kernels.

    directions (n, 3), pixels (n, 2), epoch (n,). systematic_px (n, 2, s): displacements by errors that many share, each
    at its 1-sigma.
    """

    directions: FloatArray
    pixels: FloatArray
    epoch: IntArray
    systematic_px: FloatArray


def residuals_and_jacobian(
    optics: Optics, vectors: FloatArray, seen: Sighted, sizes: FloatArray, basis: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the residuals (2, n) and the derivatives of the prediction by the unknowns (2, size, n).

    Parameters
    ----------
    vectors : (epochs, 23) cameras.
    sizes : (s,) of the systematic errors.
    basis : (17, 17) of the prior.
    """
    return _kernels.residuals_and_jacobian(
        **optics._asdict(), vectors=vectors, basis=basis, **seen._asdict(), sizes=sizes
    )


def camera_vectors(mean: FloatArray, basis: FloatArray, unknowns: FloatArray, epochs: int) -> FloatArray:
    """Return the cameras (epochs, 23) of some unknowns: lens = mean + basis · its part of them."""
    vectors = np.zeros((epochs, len(Param)))
    vectors[:, LENS] = mean + basis @ unknowns[:N_LENS]
    vectors[:, POSE] = unknowns[N_LENS : N_LENS + 3 * epochs].reshape(epochs, 3)
    return vectors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FitProblem:
    """Least-squares problem of a camera's parameters.

    Attributes
    ----------
    template : projection, image size and handedness; its parameters do not count.
    prior : what is known of the lens.
    n_epochs : number of poses.
    blocks : of systematic errors, whose unknowns follow the poses.
    max_angle : rad, how far off the axis the fitted camera will answer; the fit itself has no such limit.
    """

    template: Camera
    prior: LensPrior
    n_epochs: int
    blocks: tuple[Block, ...] = ()
    max_angle: float = math.pi

    @property
    def size(self) -> int:
        """The number of unknowns: the lens's, three for each pose, those of systematic errors."""
        return N_LENS + 3 * self.n_epochs + self.n_unit

    @property
    def n_unit(self) -> int:
        """The number of unknowns of unit prior variance, the last ones."""
        return sum(block.size for block in self.blocks)

    def block_slice(self, name: str) -> slice:
        """Return the place of a block in the unknowns; an empty slice without one of this name."""
        start = N_LENS + 3 * self.n_epochs
        for block in self.blocks:
            if block.name == name:
                return slice(start, start + block.size)
            start += block.size
        return slice(start, start)

    @property
    def names(self) -> frozenset[str]:
        """The names of the blocks."""
        return frozenset(block.name for block in self.blocks)

    def only(self, names: Collection[str]) -> tuple[FitProblem, IntArray]:
        """Return the problem with some of its blocks alone, and the places of its unknowns among those of this one."""
        kept = [np.arange(self.size)[self.block_slice(name)] for name in (b.name for b in self.blocks) if name in names]
        places = np.concatenate([np.arange(N_LENS + 3 * self.n_epochs), *kept])
        return replace(self, blocks=tuple(block for block in self.blocks if block.name in names)), places

    def pose_slice(self, epoch: int) -> slice:
        """Return where the unknowns hold an epoch's rotation."""
        start = N_LENS + 3 * epoch
        return slice(start, start + 3)

    def camera(self, unknowns: FloatArray, epoch: int = 0) -> Camera:
        """Return the camera of an epoch."""
        return self.template.replace_parameters(self._camera_parameter_vectors(unknowns)[epoch])

    def unknowns(self, cameras: list[Camera]) -> FloatArray:
        """Return the unknowns of cameras that share a lens, one an epoch."""
        poses = [camera.rotation_cam_enu for camera in cameras]
        return np.concatenate([self.prior.whitened(cameras[0]), *poses, np.zeros(self.n_unit)])

    def residuals(self, unknowns: FloatArray, observed: Sightings) -> FloatArray:
        """Return observed minus predicted pixels, (n, 2)."""
        vectors = self._camera_parameter_vectors(unknowns)
        residual = np.empty(observed.pixels.shape)
        for epoch in range(self.n_epochs):
            in_epoch = slice(None) if self.n_epochs == 1 else observed.epoch == epoch
            residual[in_epoch] = _kernels.compute_residuals(
                *self.kernel_numbers(),
                vectors[epoch],
                np.ascontiguousarray(observed.directions[in_epoch]),
                np.ascontiguousarray(observed.pixels[in_epoch]),
            )
        if not self.blocks:
            return residual
        columns, sizes = self._systematic_columns(observed), unknowns[N_LENS + 3 * self.n_epochs :]
        displaced = (columns.reshape(-1, sizes.size) @ sizes).reshape(columns.shape[:2])
        return np.where(residual == UNSEEN_PX, residual, residual - displaced)

    def beyond(self, unknowns: FloatArray, observed: Sightings) -> BoolArray:
        """Return (n,): which directions lie further off the axis than the fitted camera will answer."""
        cosine = np.empty(len(observed))
        for epoch in range(self.n_epochs):
            in_epoch = observed.epoch == epoch
            axis = rotation_matrix(unknowns[self.pose_slice(epoch)])[2]
            cosine[in_epoch] = observed.directions[in_epoch] @ axis
        return np.asarray(cosine < math.cos(self.max_angle))

    def linearised(self, unknowns: FloatArray, observed: Sightings) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (n, 2) and the derivatives of the prediction by the unknowns (n, 2, size)."""
        residual, columns = residuals_and_jacobian(
            self.kernel_numbers(),
            self._camera_parameter_vectors(unknowns),
            self.sighted(observed),
            np.ascontiguousarray(unknowns[N_LENS + 3 * self.n_epochs :], dtype=np.float64),
            np.ascontiguousarray(self.prior.basis),
        )
        return np.ascontiguousarray(residual.T), np.ascontiguousarray(np.moveaxis(columns, -1, 0))

    def sighted(self, observed: Sightings) -> Sighted:
        """Return the sightings as the kernels take them."""
        return Sighted(
            directions=np.ascontiguousarray(observed.directions),
            pixels=np.ascontiguousarray(observed.pixels),
            systematic_px=np.ascontiguousarray(self._systematic_columns(observed)),
            epoch=np.ascontiguousarray(observed.epoch, dtype=np.int64),
        )

    def _systematic_columns(self, observed: Sightings) -> FloatArray:
        """Return (n, 2, s): the displacements by the errors of the blocks, in their order."""
        if self.n_unit == observed.systematic_px.shape[2]:
            return observed.systematic_px
        of_blocks = [np.arange(block.columns.start, block.columns.stop) for block in self.blocks]
        return observed.systematic_px[:, :, np.concatenate([np.zeros(0, dtype=np.int64), *of_blocks])]

    def kernel_numbers(self) -> Optics:
        """Return the numbers of the template that the kernels take; its displacement does not count."""
        return kernel_optics(self.template)

    def _camera_parameter_vectors(self, unknowns: FloatArray) -> FloatArray:
        at, prior = np.asarray(unknowns, dtype=np.float64), self.prior
        return np.asarray(camera_vectors(prior.mean, np.ascontiguousarray(prior.basis), at, self.n_epochs))


def by_elevation(directions: FloatArray, by_directions: FloatArray) -> FloatArray:
    """Return (n, 2): px by which the image of directions (n, 3) moves per radian that they rise.

    Parameters
    ----------
    by_directions : (n, 2, 3) derivatives by these directions, see `optics.forward.by_direction`.
    """
    return np.asarray(np.einsum("nai,ni->na", by_directions, upward(directions)))


def problem_for(template: Camera, prior: LensPrior, *, n_epochs: int, max_angle: float = math.pi) -> FitProblem:
    """Return the problem of fitting a camera like the template, at any angle that its projection has.

    Parameters
    ----------
    max_angle : rad, see `FitProblem`; the sun is always allowed to be a right angle off the axis.
    """
    widest, max_angle = template.at_every_angle(), max(max_angle, _RIGHT_ANGLE)
    return FitProblem(template=widest, prior=prior, n_epochs=n_epochs, max_angle=max_angle)


# Neighbouring sightings taken together: the solve sees their mean residual, at their mean direction.

_MOST = 16
_SECONDS = 360.0
"""A bin spans at most 6 minutes, in which the sun moves 1.5 degrees."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bins:
    """Assignment of sightings to bins of time.

    Attributes
    ----------
    member : (n,) the bin of each sighting; bins are runs in time.
    count : the number of bins.
    """

    member: IntArray
    count: int

    def select(self, which: BoolArray) -> Bins:
        """Return the bins of the sightings that a mask picks, numbered anew."""
        fresh, member = np.unique(self.member[which], return_inverse=True)
        return Bins(member=member, count=fresh.size)

    def gathered(
        self, observed: Sightings, residual: FloatArray, information: FloatArray
    ) -> tuple[Sightings, FloatArray]:
        """Return one observation a bin (its pixels: those of the heaviest share) and the mean residuals (bins, 2)."""
        total = self._sum_by_bin(information)
        safe = np.where(total > 0.0, total, 1.0)
        share = information / safe[self.member]
        first = np.searchsorted(self.member, np.arange(self.count + 1))
        means = self._make_bin_mean(share, first)
        # the mean of directions within a bin is shorter than 1 by 1e-4 at most; it is made a unit vector below
        columns = observed.directions, observed.pixels, residual, *np.moveaxis(observed.systematic_px, 1, 0)
        direction, pixels, mean, *systematic = (means(column) for column in columns)
        norm = np.linalg.norm(direction, axis=-1, keepdims=True)
        # a bin of outliers alone still needs a direction: its weight of 0 keeps it out of the sums
        empty = total <= 0.0
        direction[empty], norm[empty], pixels[empty] = (
            observed.directions[first[:-1][empty]],
            1.0,
            observed.pixels[first[:-1][empty]],
        )
        gathered = Sightings(
            directions=direction / norm,
            pixels=pixels,
            information=total,
            epoch=observed.epoch[first[:-1]],
            systematic_px=np.stack(systematic, axis=1),
        )
        return gathered, mean

    def observations(
        self, observed: Sightings, problem: FitProblem, unknowns: FloatArray, *, information: FloatArray
    ) -> Sightings:
        """Return one observation a bin, its pixel such that its residual is the bin's mean one at some unknowns.

        A sighting where the lens sees nothing takes no part.
        """
        residuals = problem.residuals(unknowns, observed)
        gathered, residual = self.gathered(observed, residuals, information * is_shown(residuals))
        return replace(gathered, pixels=gathered.pixels + residual - problem.residuals(unknowns, gathered))

    def _sum_by_bin(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self.member, weights=values, minlength=self.count))

    def _make_bin_mean(self, share: FloatArray, first: IntArray) -> Callable[[FloatArray], FloatArray]:
        """Return the function from columns (n, k) to their means (bins, k) by the shares (n,) of the bins' sightings.

        `first` (bins + 1,) are the sightings that the bins begin at.
        """
        if share.size < _MANY:
            return lambda columns: (
                np.array([self._sum_by_bin(share * one) for one in columns.T]).reshape(columns.shape[1], self.count).T
            )
        from scipy.sparse import csr_array  # noqa: PLC0415 - a fit of one day loads without scipy

        to_means = csr_array((share, np.arange(share.size), first), shape=(self.count, share.size))
        return lambda columns: np.asarray(to_means @ columns)


_MANY = 2000
"""Sightings from which on scipy's sparse product saves more time than its library takes to load."""


def _first_row_of_part(first: BoolArray) -> IntArray:
    """Return (n,): the row that begins the part which each belongs to; a mask (n,) marks those that begin one."""
    return np.asarray(np.maximum.accumulate(np.where(first, np.arange(first.size), 0)))


def time_bins(usable: Sightings) -> Bins:
    """Return bins of consecutive sightings of one day and epoch, at most 16 sightings and 6 minutes each.

    One that is alone has a bin of its own.
    """
    n = len(usable)
    if n == 0:
        return Bins(member=np.zeros(0, dtype=np.int64), count=0)
    run = np.r_[True, (np.diff(usable.day) != 0) | (np.diff(usable.epoch) != 0) | np.diff(usable.alone)]
    slot = np.floor((usable.unix_s - usable.unix_s[_first_row_of_part(run)]) / _SECONDS).astype(np.int64)
    part = run | usable.alone | np.r_[True, np.diff(slot) != 0]
    fresh = part | ((np.arange(n) - _first_row_of_part(part)) % _MOST == 0)
    member = np.cumsum(fresh) - 1
    return Bins(member=member, count=int(member[-1]) + 1)
