"""Images of one night, matched together: what stands still between them is no star."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.detection.stars.matching import StarMatches, match_stars
from sunarc.detection.stars.still import sky_motion, standing_still
from sunarc.detection.stars.values import PredictedStars, Stars
from sunarc.sky.night import NightSky

_LONGEST_NIGHT_S = 6.0 * 3600.0
"""Between two images that are compared: later the stars of one have set in the other."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarView:
    """The detections of one image, the sky at its moment, and where a calibration predicts the stars."""

    unix_s: float
    sky: NightSky
    stars: Stars
    predicted: PredictedStars


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedView:
    """The detections of an image that move with the sky, and which stars they are."""

    stars: Stars
    matches: StarMatches

    def names(self, view: StarView) -> list[str]:
        """Return the names of the matches, in their order."""
        names: list[str] = view.predicted.names[self.matches.star].tolist()
        return names

    def directions(self, view: StarView) -> FloatArray:
        """Return the apparent directions of the matches, (m, 3)."""
        return np.asarray(view.sky.directions[view.sky.rows_of(self.names(view))])


def match_views(views: Sequence[StarView]) -> list[MatchedView]:
    """Return the matches of each image, without the detections that stand still between it and another of the night."""
    return [_matched(view, views) for view in views]


def _matched(view: StarView, every: Sequence[StarView]) -> MatchedView:
    stars, other = view.stars, _furthest(view, every)
    if other is not None:
        moved = sky_motion(stars, view.predicted, other.predicted)
        stars = stars.select(~standing_still(stars, other.stars, moved_px=moved))
    return MatchedView(stars=stars, matches=match_stars(stars, view.predicted))


def _furthest(view: StarView, every: Sequence[StarView]) -> StarView | None:
    """Return the image of the same night that is furthest in time; None where there is none."""
    apart = [(abs(view.unix_s - one.unix_s), index) for index, one in enumerate(every)]
    same_night = [pair for pair in apart if 0.0 < pair[0] < _LONGEST_NIGHT_S]
    return every[max(same_night)[1]] if same_night else None
