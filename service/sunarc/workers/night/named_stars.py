"""The stars of an image by a calibration: where each is predicted, and which of the named ones are stored."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import NameArray
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.selection.star_selection import image_parts, surest_of_parts
from sunarc.calibration.star_prediction import predict_stars
from sunarc.calibration.star_views import MatchedView, StarView
from sunarc.detection.stars.values import Stars
from sunarc.sky.night import FAINTEST_V, night_sky
from sunarc.sky.site import Site

BENT_PX = 1.0
"""1-sigma of how far the cold of the night bends a mount, beside the calibration's own uncertainty."""
_MOST_A_FRAME = 30
"""Sightings stored of an image: the surest of each part. A night of 50 images has as many as a day of the sun."""


def star_view(stars: Stars, unix_s: float, *, site: Site, calibration: Calibration) -> StarView:
    """Return the detections of an image beside the stars that a calibration predicts in it."""
    sky = night_sky(unix_s, site, faintest=FAINTEST_V)
    return StarView(unix_s=unix_s, sky=sky, stars=stars, predicted=predict_stars(calibration, sky, within_px=BENT_PX))


def surest_named(view: StarView, found: MatchedView, image_size: tuple[int, int]) -> tuple[NameArray, Stars]:
    """Return the named stars of an accepted image that are stored: those not clipped, the surest of each part."""
    names, stars = np.array(found.names(view), dtype=np.str_), found.stars.select(found.matches.detection)
    sound = stars.sound
    names, stars = names[sound], stars.select(sound)
    rows = surest_of_parts(image_parts(stars.pixels, image_size), stars.sigma_px, _MOST_A_FRAME)
    return names[rows], stars.select(rows)
