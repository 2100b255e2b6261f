"""Where a calibration sees the stars, and which detections of a night's images they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from sunarc.calibration.answers.covariance import project_with_covariance, sigma_px, without_clock
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.selection import image_parts, pick_surest_in_parts
from sunarc.common.array_types import BoolArray, FloatArray, NameArray
from sunarc.detection.stars.detect import rank_in_part
from sunarc.detection.stars.matching import LIMITS, StarMatches, match_stars, on_cloud, sky_motion, standing_still
from sunarc.detection.values import PredictedStars, Stars
from sunarc.optics.camera import Camera, inside_image
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.night import FAINTEST_V, NightSky, night_sky
from sunarc.sky.site import Site, relative_air_mass
from sunarc.stars.star_pattern import log10_chance

BENT_PX = 1.0
"""1-sigma of the bend of a mount in the cold of the night, in addition to the calibration's own uncertainty."""
_MOST_A_FRAME = 30
"""Sightings stored of an image: the surest of each part. A night of 50 images has as many as a day of the sun."""
_EXTINCTION = 0.25
"""Magnitudes an air mass, of a clear sky in the visible: Rayleigh scattering 0.1, and as much and more of aerosol."""


def predict_stars(
    calibration: Calibration, sky: NightSky, *, within_px: float = 0.0, furthest_deg: float = 85.0
) -> PredictedStars:
    """Return where a calibration sees the stars of a moment.

    Parameters
    ----------
    calibration : the camera, and how sure one is of it.
    sky : stars and planets above the horizon.
    within_px : 1-sigma that is added to the prediction's, px.
    furthest_deg : stars further from the zenith are left out: the refraction of the horizon, and trees.

    Returns
    -------
    Those within the image, as in `sky`: the brightest first.
    """
    pixels, covariance = project_with_covariance(without_clock(calibration), sky.directions)
    sigma = np.hypot(sigma_px(covariance), within_px)
    return stars_in_image(calibration.camera, sky, pixels, sigma, furthest_deg=furthest_deg)


def stars_in_image(
    camera: Camera, sky: NightSky, pixels: FloatArray, sigma: FloatArray, *, furthest_deg: float = 85.0
) -> PredictedStars:
    """Return the stars within a camera's image, of their pixels (n, 2) and 1-sigmas (n,) px; the brightest first."""
    zenith, azimuth = angles_from_direction(sky.directions)
    visible = np.all((pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5), axis=-1)
    visible &= zenith < furthest_deg
    magnitude = seen_magnitude(sky)
    return PredictedStars(
        names=sky.names,
        pixels=pixels,
        sigma_px=sigma,
        magnitude=magnitude,
        azimuth_deg=azimuth,
    ).select(visible)


def seen_magnitude(sky: NightSky) -> FloatArray:
    """Return the magnitudes (n,) behind the air of a clear night; those of the zenith as in the catalogue."""
    zenith, _ = angles_from_direction(sky.directions)
    return np.asarray(sky.magnitude + _EXTINCTION * (relative_air_mass(zenith) - 1.0))


# Images of one night, matched together: what stands still between them is no star.

_LONGEST_NIGHT_S = 6.0 * 3600.0
"""Between two images that are compared: later the stars of one have set in the other."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarView:
    """The detections of one image, the sky at its moment, and where a calibration predicts the stars."""

    unix_s: float
    sky: NightSky
    stars: Stars
    predicted: PredictedStars
    camera: Camera

    @property
    def predicted_directions(self) -> FloatArray:
        """Apparent directions of the predicted stars, (n, 3)."""
        return np.asarray(self.sky.directions[self.sky.find_rows(self.predicted.names.tolist())])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedView:
    """The detections of an image that move with the sky, with the sigma of their scatter, and which stars they are."""

    stars: Stars
    matches: StarMatches

    def names(self, view: StarView) -> list[str]:
        """Return the names of the matches, in their order."""
        names: list[str] = view.predicted.names[self.matches.star].tolist()
        return names

    def directions(self, view: StarView) -> FloatArray:
        """Return the apparent directions of the matches, (m, 3)."""
        return np.asarray(view.sky.directions[view.sky.find_rows(self.names(view))])


def match_views(views: Sequence[StarView]) -> list[MatchedView]:
    """Return the matches of each image, without the detections that stand still between it and another of the night."""
    return [_match_view(view, views) for view in views]


def matching_flip(views: Sequence[StarView], image_size: tuple[int, int]) -> tuple[str, list[int]]:
    """Return the flip of images by which most of their stars match, and how many do in each: 0 where none does."""
    last = np.array(image_size) - 1.0
    flips: dict[str, Callable[[FloatArray], FloatArray]] = {
        "its rows in reverse order": lambda xy: np.stack([xy[:, 0], last[1] - xy[:, 1]], axis=-1),
        "its columns in reverse order": lambda xy: np.stack([last[0] - xy[:, 0], xy[:, 1]], axis=-1),
    }
    if image_size[0] == image_size[1]:
        flips["x and y swapped"] = lambda xy: np.ascontiguousarray(xy[:, ::-1])
    counts = {}
    for name, flip in flips.items():
        flipped = [replace(view, stars=replace(view.stars, pixels=flip(view.stars.pixels))) for view in views]
        matches = [one.matches for one in match_views(flipped)]
        counts[name] = [one.detection.size if one.accepted else 0 for one in matches]
    best = max(counts, key=lambda name: sum(counts[name]))
    return best, counts[best]


def _match_view(view: StarView, every: Sequence[StarView]) -> MatchedView:
    # text beside the image circle does not look at the sky
    stars = view.stars.select(unproject(view.camera, view.stars.pixels)[:, 2] > 0.0)
    other = _find_furthest_view(view, every)
    if other is not None:
        moved = sky_motion(stars, view.predicted, other.predicted)
        stars = stars.select(~standing_still(stars, other.stars, moved_px=moved))
    matches = match_stars(stars, view.predicted)
    if not matches.accepted and pattern_log10_chance(view.camera, view.sky, stars) <= MOST_LOG10_CHANCE:
        # aurora, lamps and hot pixels: that the rest is stars is proven by its pattern
        near = stars.select(_is_near_star(stars, view.predicted))
        tried = (match_stars(near, view.predicted, limits=LIMITS[first:]) for first in range(len(LIMITS)))
        again = next((one for one in tried if one.accepted), None)
        stars, matches = (stars, matches) if again is None else (near, again)
    # what the fit of a star's centre does not know of: the point spread's shape, the air, the grid of pixels
    return MatchedView(stars=replace(stars, sigma_px=np.hypot(stars.sigma_px, matches.floor_px)), matches=matches)


MOST_LOG10_CHANCE = -4.0
"""One camera in 10,000 images is expected to match the bright stars so well by chance."""
_STAR_WITHIN = 4.0
"""1-sigmas of the prediction from a star's place, within which a detection may be it."""


def pattern_log10_chance(camera: Camera, sky: NightSky, stars: Stars) -> float:
    """Return the logarithm of how many cameras would match the bright stars of an image as well by chance."""
    up = sky.select(inside_image(project(camera, sky.directions), (camera.width, camera.height)))
    clear = from_all_parts(stars.select(~on_cloud(stars)), (camera.width, camera.height))
    return log10_chance(camera, up.directions, seen_magnitude(up), clear.pixels)


def from_all_parts(stars: Stars, image_size: tuple[int, int]) -> Stars:
    """Return detections in another order: the brightest of each part of the image, then the next one of each.

    Lamps and roofs are brighter than stars, but in few parts.
    """
    rank = rank_in_part(image_parts(stars.pixels, image_size))
    return stars.select(np.argsort(rank, kind="stable"))


def _is_near_star(stars: Stars, predicted: PredictedStars) -> BoolArray:
    if not len(stars) or not len(predicted):
        return np.zeros(len(stars), dtype=np.bool_)
    apart, row = cKDTree(predicted.pixels).query(stars.pixels)
    return np.asarray(np.asarray(apart) < _STAR_WITHIN * predicted.sigma_px[np.asarray(row)])


def _find_furthest_view(view: StarView, every: Sequence[StarView]) -> StarView | None:
    """Return the image of the same night that is furthest in time; None without another."""
    apart = [(abs(view.unix_s - one.unix_s), index) for index, one in enumerate(every)]
    same_night = [pair for pair in apart if 0.0 < pair[0] < _LONGEST_NIGHT_S]
    return every[max(same_night)[1]] if same_night else None


def star_view(stars: Stars, unix_s: float, *, site: Site, calibration: Calibration) -> StarView:
    """Return the detections of an image, and the stars that a calibration predicts in it."""
    sky = night_sky(unix_s, site, faintest=FAINTEST_V)
    predicted = predict_stars(calibration, sky, within_px=BENT_PX)
    return StarView(unix_s=unix_s, sky=sky, stars=stars, predicted=predicted, camera=calibration.camera)


def surest_named(view: StarView, found: MatchedView, image_size: tuple[int, int]) -> tuple[NameArray, Stars]:
    """Return the named stars of an accepted image that are stored: those not clipped, the surest of each part."""
    names, stars = np.array(found.names(view), dtype=np.str_), found.stars.select(found.matches.detection)
    sound = stars.sound
    names, stars = names[sound], stars.select(sound)
    rows = pick_surest_in_parts(image_parts(stars.pixels, image_size), stars.sigma_px, _MOST_A_FRAME)
    return names[rows], stars.select(rows)
