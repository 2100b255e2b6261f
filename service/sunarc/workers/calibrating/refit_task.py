"""Input of a refit from the archive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime

import numpy as np

from sunarc.archive.camera_archive import CameraArchive
from sunarc.archive.values import SunPointColumns
from sunarc.array_types import IntArray
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.calibration.quality.day_quality import days_left_out
from sunarc.calibration.selection.selection import Selection, SelectionOptions, select_sightings
from sunarc.calibration.selection.star_selection import surest_of_epochs
from sunarc.findings import Finding
from sunarc.sky.night import SUN
from sunarc.workers.calibrating.epoch_search import since_lens
from sunarc.workers.calibrating.solver_process import Problem
from sunarc.workers.fit_input import points_of

_LIMITS = SelectionOptions()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Task:
    """A solve, and the sightings of the archive that it is given.

    Attributes
    ----------
    problem : for the child process.
    used : the sightings, as columns of the archive.
    selection : how they were picked.
    """

    problem: Problem
    used: SunPointColumns
    selection: Selection

    @property
    def pose_epoch(self) -> str:
        """The pose epoch of the result."""
        return self.used.epoch_ids[-1]

    def of_epoch(self, epoch: str) -> Problem:
        """Return the same solve, its answer that of another pose epoch."""
        return replace(self.problem, points=points_of(self.used, site=self.problem.site, latest=epoch))

    def with_selection(self, solved: Calibration) -> Calibration:
        """Return a calibration whose evidence tells how its sightings were picked."""
        counts = {**asdict(_LIMITS), **self.selection.counts()}
        return replace(solved, evidence=replace(solved.evidence, selection=counts))


def next_task(
    camera: CameraArchive,
    *,
    cadence_s: float,
    options: CalibrationOptions,
    circle: ImageCircle | None,
    now: datetime,
) -> Task | Finding:
    """Return what the record of a camera up to now asks for; or why there is nothing to solve."""
    record, since = camera.record(), since_lens(camera, now)
    read = camera.sun_candidates(since=since, until=now)
    if record is None or read.ids.size == 0:
        return Finding("no_accepted_sightings")
    left_out = days_left_out({day.date: day.verdict for day in camera.days()})
    selection = select_sightings(
        read.candidates,
        site=camera.site,
        slot_s=cadence_s,
        options=_LIMITS,
        left_out_days=np.array(left_out),
    )
    if selection.index.size == 0:
        counts = {
            "n": selection.n_supplied,
            "n_doubtful_clock": selection.n_doubtful_clock,
            "n_other_days": selection.n_other_days,
        }
        return Finding("no_usable_sightings", counts)
    epochs = [read.epoch_ids[number] for number in np.unique(read.candidates.epoch[selection.index]).tolist()]
    others = camera.sun_point_columns(since=since, until=now, body=None, no_sun=True)
    stars = _stars(others, epochs, record.image_size)
    used = camera.sightings_of_ids(np.concatenate([read.ids[selection.index], stars]))
    if not np.any(used.body == SUN):  # deleted meanwhile
        return Finding("no_accepted_sightings")
    problem = Problem(
        points=points_of(used, site=camera.site),
        site=camera.site,
        image_size=record.image_size,
        options=options,
        circle=circle,
    )
    return Task(problem=problem, used=used, selection=selection)


def _stars(others: SunPointColumns, epochs: Sequence[str], image_size: tuple[int, int]) -> IntArray:
    """Return the keys of the surest stars and planets of each part of the image.

    Of the pose epochs that the sun was seen in; those of the latest epoch first, then of the others.
    """
    with_sun = np.array([name in epochs for name in others.epoch_ids], dtype=bool)
    usable = with_sun[others.epoch] & (np.nan_to_num(others.clock_error_s) <= MAX_CLOCK_ERROR_S)
    rows = np.flatnonzero(usable)
    chosen = surest_of_epochs(others.pixels[rows], others.sigma_px[rows], others.epoch[rows], image_size)
    return others.ids[rows[chosen]]
