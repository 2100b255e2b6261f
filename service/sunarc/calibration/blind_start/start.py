"""The blind start: hypotheses of lens, pole, hand and angle, each judged by the stars it names."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sunarc.array_types import BoolArray, FloatArray
from sunarc.calibration.blind_start.phase import phases
from sunarc.calibration.blind_start.refinement import Refined, refined
from sunarc.calibration.blind_start.sky_turn import SIDEREAL_RATE
from sunarc.calibration.blind_start.turning import Field, Turning, pairs_of, turnings
from sunarc.calibration.blind_start.values import BlindOptions, BlindStart, NightImage
from sunarc.calibration.model.covariance import hemisphere
from sunarc.calibration.quality.tilt import tilt_question
from sunarc.calibration.star_prediction import stars_in_image
from sunarc.calibration.star_views import MatchedView, StarView, match_views
from sunarc.findings import Finding
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import pose_angles
from sunarc.optics.projections import ideal_radius
from sunarc.sky.directions import angular_distance
from sunarc.sky.site import Site

_FEWEST_IMAGES = 2
_LEAST_TURN_DEG = 10.0
"""Between the first and the last image whose stars are named: 40 minutes."""
_LEAST_SHARE = 0.15
"""Of the detections that turn: clouds leave a part, chance (taken off) nothing."""
_CIRCLE_OF_SIDE, _CIRCLE_OF_LONG_SIDE = (0.36, 0.72), 0.55
"""Radius of 90 degrees off the axis over the image's shorter and longer side: lenses of 140 to 200 degrees."""
_CIRCLE_WITHIN = (0.85, 1.2)
_SAME_STAR_PX = 0.7
_STILL_TURN_DEG = (3.0, 90.0)
_LEAST_SIGMA_PX, _OF_FOCAL = 0.7, 0.002
"""1-sigma of a refined camera's prediction: what a smooth correction does not know yet of the lens."""
_MOST_REFINED = 8
_SAME_DEG = 2.0
_MUCH_LESS = 0.4
"""A hypothesis whose stars are fewer than this share of the best's is no rival: chance."""
_NORTH_PER_MINUTE_DEG = 0.25


class _Hypothesis(NamedTuple):
    """A refined camera, what it makes of each image, and how many stars it names."""

    camera: Camera
    views: tuple[StarView, ...]
    matched: tuple[MatchedView, ...]
    stars: int


def blind_start(
    images: Sequence[NightImage], site: Site, *, image_size: tuple[int, int], options: BlindOptions | None = None
) -> BlindStart:
    """Find a camera by one night's images alone: no start, no sun, either hand.

    What turns gives the lens, the pole and the hand; the bright catalogue at the stated times the angle about the
    pole. A camera counts where it names the stars of two images or more by the rules of `match_stars`, and no other
    camera does. North is right as the times are: a clock that is wrong turns the camera about the pole, a minute by a
    quarter of a degree, and no star tells it; only a tilt that a wrong zone would explain is refused.

    Parameters
    ----------
    images : of one night, the sky turned by 10 degrees (40 minutes) or more between the first and the last.
    site : where the camera stands.
    image_size : width and height, px.
    options : what is known of the camera.
    """
    known = BlindOptions() if options is None else options
    moving = [_without_still(image, images) for image in images]
    pairs = pairs_of([image.unix_s for image in moving], [image.stars.pixels for image in moving])
    if not pairs:
        turn = math.degrees(SIDEREAL_RATE * float(np.ptp([image.unix_s for image in images]))) if images else 0.0
        few = {"n": len(images), "turn_deg": turn, "limit": _LEAST_TURN_DEG}
        return BlindStart(accepted=False, findings=(Finding("blind_few_images", few),))
    turns = turnings(pairs, _field(site, image_size, known))
    if not turns or turns[0].share < _LEAST_SHARE:
        share = turns[0].share if turns else 0.0
        return BlindStart(
            accepted=False, findings=(Finding("blind_no_turning", {"share": share, "limit": _LEAST_SHARE}),)
        )
    found = _hypotheses(turns, moving, images, site, image_size)
    return _decided(found, site, known) if found else _unnamed(turns[0])


def _unnamed(best: Turning) -> BlindStart:
    return BlindStart(accepted=False, findings=(Finding("blind_no_stars", {"share": best.share}),))


def _without_still(image: NightImage, every: Sequence[NightImage]) -> NightImage:
    """Return an image without the detections that stand on the same pixels in most others, though the sky turned."""
    stars = image.stars
    others = [
        one
        for one in every
        if _STILL_TURN_DEG[0] < math.degrees(SIDEREAL_RATE * abs(one.unix_s - image.unix_s)) < _STILL_TURN_DEG[1]
        and len(one.stars)
    ]
    if not others or not len(stars):
        return image
    same = [np.asarray(cKDTree(one.stars.pixels).query(stars.pixels)[0]) < _SAME_STAR_PX for one in others]
    still: BoolArray = np.sum(same, axis=0) > 0.5 * len(others)
    return NightImage(unix_s=image.unix_s, stars=stars.select(~still), sky=image.sky)


def _field(site: Site, image_size: tuple[int, int], options: BlindOptions) -> Field:
    short, long = min(image_size), max(image_size)
    colatitude, tilt = math.radians(90.0 - site.latitude), math.radians(options.max_tilt_deg)
    centre = (0.5 * image_size[0] - 0.5, 0.5 * image_size[1] - 0.5)
    least, greatest = _CIRCLE_OF_SIDE
    radius = (least * short, max(greatest * short, _CIRCLE_OF_LONG_SIDE * long))
    if (circle := options.circle) is not None:
        centre = (circle.x, circle.y)
        # between an equisolid and an equidistant lens
        angle = np.array([math.radians(circle.angle_deg), 0.5 * math.pi])
        ratio = [float(np.divide(*ideal_radius(name, angle))) for name in ("equisolid", "equidistant")]
        radius = (_CIRCLE_WITHIN[0] * circle.radius / max(ratio), _CIRCLE_WITHIN[1] * circle.radius / min(ratio))
    return Field(centre=centre, radius_px=radius, polar_rad=(colatitude - tilt, colatitude + tilt), width=image_size[0])


def _hypotheses(
    turns: Sequence[Turning],
    moving: Sequence[NightImage],
    images: Sequence[NightImage],
    site: Site,
    image_size: tuple[int, int],
) -> list[_Hypothesis]:
    """Return the refined cameras that name stars, the one that names most first."""
    likely = [one for one in turns if one.share > 0.3 * turns[0].share]
    rough = [found for turn in likely for found in phases(turn, moving, site, image_size=image_size)]
    rough.sort(key=lambda one: -one[0])
    found: list[_Hypothesis] = []
    for _, camera in rough[:_MOST_REFINED]:
        better = refined(camera, moving)
        if better is not None and not any(_same(better.camera, one.camera) for one in found):
            found.append(_judged(better, images))
    found = [one for one in found if one.stars > 0]
    return sorted(found, key=lambda one: -one.stars)


def _judged(one: Refined, images: Sequence[NightImage]) -> _Hypothesis:
    camera = one.camera
    sigma = max(_LEAST_SIGMA_PX, one.scatter_px, _OF_FOCAL * camera.focal_length_px[0])
    views = []
    for image in images:
        pixels = project(camera, image.sky.directions)
        predicted = stars_in_image(camera, image.sky, pixels, np.full(len(image.sky), sigma))
        above = _above(camera, image.stars.pixels)
        views.append(StarView(unix_s=image.unix_s, sky=image.sky, stars=image.stars.select(above), predicted=predicted))
    matched = match_views(views)
    stars = sum(found.matches.star.size for found in matched if found.matches.accepted)
    return _Hypothesis(camera, tuple(views), tuple(matched), stars)


def _above(camera: Camera, pixels: FloatArray) -> BoolArray:
    """Return (n,): which pixels look at the sky; text beside the image circle does not."""
    return np.asarray(unproject(camera, pixels)[:, 2] > 0.0)


def _same(first: Camera, second: Camera) -> bool:
    """Return whether two cameras see most of the sky at the same places."""
    if first.mirrored != second.mirrored:
        return False
    sky = hemisphere(100)
    sky = sky[sky[:, 2] > 0.5]
    apart = np.degrees(angular_distance(unproject(first, project(second, sky)), sky))
    return bool(np.nanmedian(apart) < _SAME_DEG) if np.any(np.isfinite(apart)) else False


def _decided(found: Sequence[_Hypothesis], site: Site, options: BlindOptions) -> BlindStart:
    best = found[0]
    rival = next((one for one in found[1:] if one.stars > _MUCH_LESS * best.stars), None)
    accepted = [view.unix_s for view, one in zip(best.views, best.matched, strict=True) if one.matches.accepted]
    turn = math.degrees(SIDEREAL_RATE * float(np.ptp(accepted)))
    pose = pose_angles(best.camera.rotation_cam_enu)
    data = {
        "n": best.stars,
        "images": len(accepted),
        "rival": 0 if len(found) < 2 else found[1].stars,
        "tilt_deg": pose.theta_zz_deg,
        "north_deg_per_minute": _NORTH_PER_MINUTE_DEG * abs(math.sin(math.radians(site.latitude))),
    }
    findings = [Finding("blind_found", data)]
    question = tilt_question(best.camera, site)
    against = []
    if len(accepted) < _FEWEST_IMAGES or turn < _LEAST_TURN_DEG:
        against.append(Finding("blind_few_images", {"n": len(accepted), "turn_deg": turn, "limit": _LEAST_TURN_DEG}))
    if rival is not None:
        against.append(Finding("blind_ambiguous", {"n": best.stars, "rival": rival.stars}))
    if pose.theta_zz_deg > options.max_tilt_deg:
        against.append(Finding("blind_tilted", {"tilt_deg": pose.theta_zz_deg, "limit": options.max_tilt_deg}))
    if question is not None:
        (against if float(question.data["odds"]) > 1.0 else findings).append(question)
    return BlindStart(
        accepted=not against,
        findings=tuple(against or findings),
        camera=best.camera,
        predicted=tuple(view.predicted for view in best.views),
        stars=tuple(one.stars for one in best.matched),
        matches=tuple(one.matches for one in best.matched),
    )
