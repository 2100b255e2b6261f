"""How well the slots in which the sun was observed stand for all slots of the time between."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray

PERIOD_S = 600.0
"""Slots within this time count as one independent sample of the clouds, s: about half of the time in which a cumulus
cloud and a gap pass; `docs/studies/missed_slots.py` shows the error rates that come of it."""
_QUANTILE = 1.645  # of the normal distribution: one-sided 95 %


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """The slots of a day in which sun exposures were taken.

    Attributes
    ----------
    n_observed : slots with at least one sun exposure.
    n_span : slots between the first and the last of them, both included.
    n_periods : different periods of 10 minutes with an observed slot.
    """

    n_observed: int
    n_span: int
    n_periods: int

    def lowest_share(self, n_on_arc: int) -> float:
        """Return the one-sided 95 % lower bound of the share of the span's slots that would lie on the arc.

        Wilson's (1927) score bound for `n_periods` samples at most, with the correction for a finite population: where
        every slot of the span was observed there is nothing to infer, and the bound is the share itself.
        """
        share = min(n_on_arc / max(self.n_observed, 1), 1.0)
        # the finite population's correction: slots that were seen need no inference
        not_observed = 1.0 - self.n_observed / max(self.n_span, self.n_observed, 1)
        if not_observed <= 0.0:
            return share
        square = _QUANTILE**2 * not_observed / max(min(self.n_observed, self.n_periods), 1)
        spread = math.sqrt(square * (share * (1.0 - share) + 0.25 * square))
        return (share + 0.5 * square - spread) / (1.0 + square)


def sampling_of(observed_unix_s: FloatArray, *, cadence_s: float, n_possible: int) -> Sampling:
    """Return the sampling of a day from the times of its sun exposures.

    Parameters
    ----------
    observed_unix_s : (n,) mid-exposure times, s since 1970-01-01 UTC; those of one slot count once, NaN not at all.
    cadence_s : seconds from slot to slot.
    n_possible : slots of the day with the sun up, which the span cannot exceed.
    """
    times = observed_unix_s[np.isfinite(observed_unix_s)]
    slots = np.unique(np.floor(times / cadence_s))
    span = int(slots[-1] - slots[0]) + 1 if slots.size else 0
    return Sampling(
        n_observed=int(slots.size),
        n_span=max(min(span, n_possible), int(slots.size)),
        n_periods=int(np.unique(np.floor(times / PERIOD_S)).size),
    )


def fully_observed(n_possible: int) -> Sampling:
    """Return the sampling of a day of which every possible slot counts as observed."""
    return Sampling(n_observed=n_possible, n_span=n_possible, n_periods=n_possible)
