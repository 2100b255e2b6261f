"""Normal points of dense records: one sighting for each slot of time, so that a million cost as few as thirty thousand.

A normal point is the sighting in the middle of its slot, moved by the difference between its residual and the mean one
of the slot, both about a pilot fit of some sightings. It is a sighting of the sun at a true time as any other one, so
clocks, seasons, days and changes of the camera are seen as before. Normal points are formed in satellite laser ranging
for the same reason.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import Calibration, Metrics, residuals_by_pose
from sunarc.calibration.model.sightings import Sightings, filter_sightings, grid_steps_px
from sunarc.calibration.selection import sky_patches
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import tukey_weights
from sunarc.sky.site import Site

MOST = 30_000
"""Sightings up to which a record is fitted as it is."""
_FEWEST_PER_POINT = 4
"""Sightings of a normal point in the mean, at least: the median of fewer does not show which of them is false."""
_SLOTS_S = (2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 1800.0, 3600.0)
"""Lengths of slots. In an hour the sun moves by 15 degrees: the difference of two fits is a straight line over them."""
_PILOT = 3_000
"""Sightings of the pilot fit."""
_CONTRADICTING = 1e-6
"""Weight of the sightings of a slot that contradict each other: the fit decides on it."""
_PATCH_DEG = 2.0
"""Width of the parts of the sky within which stated directions are taken together."""


class DenseRecord(NamedTuple):
    """Sightings with their normal points.

    points : all sightings that were given; usable: the usable ones.
    normal : the normal points, as sightings that are given to a fit.
    member : (n,) the normal point of each usable sighting; counted (n,): whether it is part of its mean.
    sigma_px : 1-sigma of a sighting about the pilot fit; within_px: root mean square distance of the counted sightings
        from their normal points.
    slot_s : length of a slot.
    """

    points: Sightings
    usable: Sightings
    normal: Sightings
    member: IntArray
    counted: BoolArray
    sigma_px: float
    within_px: float
    slot_s: float

    def fit_as_all_sightings(self, solved: Calibration, normal: Sightings) -> tuple[Calibration, Sightings]:
        """Return a fit of the normal points as one of all sightings, and these with their pose epochs.

        Parameters
        ----------
        solved : the fit.
        normal : the normal points as it numbered them by pose epochs.
        """
        if len(normal) < len(self.normal):  # of the latest pose alone
            return solved, normal
        used = np.ones(len(normal), dtype=bool)
        if solved.left_out is not None:
            used[solved.left_out] = False
        counted = self.counted & used[self.member]
        left_out = np.setdiff1d(np.arange(len(self.points)), self.usable.index[counted])
        n, evidence = int(np.count_nonzero(counted)), solved.evidence
        size = float(np.median(np.bincount(self.member)))
        noise = evidence.sigma_px**2 * evidence.inflation * size / self.sigma_px**2
        whole = replace(
            solved,
            left_out=left_out,
            metrics=self._make_metrics(solved.metrics, n),
            evidence=replace(
                evidence,
                n_supplied=len(self.points),
                n_used=n,
                n_rejected=len(self.points) - n,
                sigma_px=self.sigma_px,
                inflation=max(noise, 1.0) if math.isfinite(noise) else evidence.inflation,
            ),
        )
        said = {"n": int(np.sum(normal.count)), "n_points": len(normal), "slot_s": self.slot_s}
        found = [_refer_to_all_sightings(one, whole) for one in solved.verdict.findings]
        if solved.verdict.accepted:
            found.append(Finding("sightings_in_slots", said))
        return replace(whole, verdict=replace(solved.verdict, findings=tuple(found))), self._assign_epochs(normal)

    def _make_metrics(self, of_points: Metrics, n: int) -> Metrics:
        """Return the metrics of n sightings: of the normal points, with the scatter within the slots."""

        def add_slot_scatter(rmse_px: float | None) -> float | None:
            return None if rmse_px is None else math.hypot(rmse_px, self.within_px)

        rmse_px = math.hypot(of_points.rmse_px, self.within_px)
        factor = rmse_px / of_points.rmse_px if of_points.rmse_px > 0.0 else 1.0
        scaled = ("mae_px", "sd_px", "sd_of_distance_px", "rmse_deg")
        return replace(
            of_points,
            n=n,
            rmse_px=rmse_px,
            rmse_all_px=math.hypot(of_points.rmse_all_px, self.within_px),
            held_out_rmse_px=add_slot_scatter(of_points.held_out_rmse_px),
            held_out_expected_px=add_slot_scatter(of_points.held_out_expected_px),
            **{name: factor * getattr(of_points, name) for name in scaled},
        )

    def _assign_epochs(self, normal: Sightings) -> Sightings:
        """Return all sightings with the pose epochs of their normal points, those that are not usable by their time."""
        epoch = np.array(self.points.epoch)
        moved = normal.epoch - self.normal.epoch
        for number in range(1, int(moved.max(initial=0)) + 1):
            since = float(np.min(self.usable.unix_s[moved[self.member] >= number]))
            epoch += self.points.unix_s >= since
        return replace(self.points, epoch=epoch)


def _refer_to_all_sightings(finding: Finding, solved: Calibration) -> Finding:
    """Return a finding, that of the residuals with those of all sightings."""
    if finding.code != "fit_rmse":
        return finding
    return Finding(finding.code, {**finding.data, "n": solved.metrics.n, "rmse_px": solved.metrics.rmse_px})


def dense_record(
    points: Sightings,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions,
    circle: ImageCircle | None = None,
) -> DenseRecord | None:
    """Return sightings with their normal points; None of few, which are fitted as they are.

    Where no pilot fit meets the sightings, the one in the middle of each slot stands for all of it.

    Parameters
    ----------
    points, site, image_size, options, circle : as `calibrate` takes them.
    """
    if len(points) <= MOST:
        return None
    usable = filter_sightings(points, site=site, image_size=image_size)
    if len(usable) <= MOST:
        return None
    pilot = calibrate(
        points.select(usable.thinned(_PILOT).index),
        site=site,
        image_size=image_size,
        options=replace(options, max_unexplained=1.0, mirrored=options.mirrored or "auto"),
        circle=circle,
        parts=False,
    )
    residual = residuals_by_pose(pilot.camera, pilot.poses, usable)
    seen = np.all(np.isfinite(residual), axis=-1)
    if not pilot.metrics.rmse_px <= options.max_rmse_px:
        return _make_dense_record(points, usable, None, sigma_px=1.0)
    return _make_dense_record(points, usable.select(seen), residual[seen], sigma_px=pilot.evidence.sigma_px)


def _make_dense_record(
    points: Sightings, usable: Sightings, residual: FloatArray | None, *, sigma_px: float
) -> DenseRecord:
    """Return the record of sightings with residuals (n, 2) of 1-sigma `sigma_px` about a camera that is near.

    Without residuals the sighting in the middle of a slot stands for it.
    """
    slot_s, member = _assign_slots(usable)
    middle = _middle_rows(usable.unix_s, member)
    if residual is None:
        residual, weight = np.zeros(usable.pixels.shape), np.zeros(len(usable))
        weight[middle] = 1.0
    else:
        weight = tukey_weights(_distances_from_medians(residual, member) / usable.sigma_px, sigma=sigma_px)
        lost = np.bincount(member, weight) <= 0.0
        weight[lost[member]] = _CONTRADICTING
    information = weight / usable.sigma_px**2
    total, count = np.bincount(member, information), np.bincount(member)
    mean = np.stack([np.bincount(member, information * axis) for axis in residual.T], axis=-1) / total[:, None]
    apart, counted = residual - mean[member], weight > 0.0
    free = max(float(np.sum(counted)) - count.size, 1.0)
    # the part of a sighting's variance that the others of its slot do not share
    own = min(float(np.sum(information * np.sum(apart**2, axis=-1))) / (2.0 * free * sigma_px**2), 1.0)
    variance = (1.0 - own) * count / np.bincount(member, usable.sigma_px**-2.0) + own / total
    normal = replace(
        points.select(usable.index[middle]),
        pixels=_round_to_grid(usable.pixels[middle] + mean - residual[middle], usable),
        sigma_px=sigma_px * np.sqrt(variance),
        count=count,
        filtering=usable.filtering,
    )
    within = math.sqrt(float(np.mean(np.sum(apart[counted] ** 2, axis=-1))))
    return DenseRecord(points, usable, normal, member, counted, sigma_px, within, slot_s)


def _assign_slots(usable: Sightings) -> tuple[float, IntArray]:
    """Return the shortest slot that makes few enough normal points, s, and the slot of each sighting (n,)."""
    most = min(MOST, len(usable) // _FEWEST_PER_POINT)
    patch = np.zeros(len(usable), dtype=np.int64)
    patch[usable.alone] = 1 + sky_patches(usable.directions[usable.alone], width_deg=_PATCH_DEG)
    alike = np.stack([usable.epoch, usable.kind, patch, usable.day - usable.day.min()])
    group = np.ravel_multi_index(tuple(alike), tuple(alike.max(axis=1) + 1))
    group = np.unique(group, return_inverse=True)[1]
    for slot_s in _SLOTS_S:
        slot = np.floor(usable.unix_s / slot_s).astype(np.int64)
        slot -= slot.min()
        found, member = np.unique(group * (int(slot.max()) + 1) + slot, return_inverse=True)
        if found.size <= most:
            break
    return slot_s, member.ravel()


def _distances_from_medians(residual: FloatArray, member: IntArray) -> FloatArray:
    """Return (n,): distances of residuals (n, 2) from the medians of their slots."""
    count = np.bincount(member)
    first = np.cumsum(count) - count
    medians = []
    for axis in residual.T:
        ordered = axis[np.lexsort((axis, member))]
        medians.append(0.5 * (ordered[first + (count - 1) // 2] + ordered[first + count // 2]))
    return np.asarray(np.linalg.norm(residual - np.stack(medians, axis=-1)[member], axis=-1))


def _middle_rows(unix_s: FloatArray, member: IntArray) -> IntArray:
    """Return the row of each slot that is closest to the mean time of its sightings."""
    count = np.bincount(member)
    begin = unix_s.min()
    mean = np.bincount(member, unix_s - begin) / count
    order = np.lexsort((np.abs(unix_s - begin - mean[member]), member))
    return np.asarray(order[np.cumsum(count) - count])


def _round_to_grid(pixels: FloatArray, usable: Sightings) -> FloatArray:
    """Return pixels (n, 2) on the grid that those of all sightings are on, if they are on one.

    Sightings that may have been cut share an error of half a step, far more than what is lost by it.
    """
    step = grid_steps_px(usable.pixels)
    origin = usable.pixels[0]
    return np.where(step > 0.0, origin + step * np.round((pixels - origin) / np.where(step > 0.0, step, 1.0)), pixels)
