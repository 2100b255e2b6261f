"""The blind start: hypotheses of lens, pole, handedness and angle, each judged by the stars it names."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Gt, Le
from scipy.spatial import cKDTree

from sunarc.calibration.answers.covariance import hemisphere, pose_error
from sunarc.calibration.model.options import ImageCircle
from sunarc.calibration.model.result import Calibration, add_finding, refused_for
from sunarc.calibration.quality.tilt import tilt_question
from sunarc.calibration.quality.widening import add_pose_errors
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.bounds import require_bounds
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import biweights, mad_sigma
from sunarc.detection.stars.matching import StarMatches, on_cloud
from sunarc.detection.values import PredictedStars, Stars
from sunarc.optics.camera import Camera, Param
from sunarc.optics.forward import project, project_with_jacobian
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import pose_angles, rotation_matrix
from sunarc.optics.projections import ideal_radius
from sunarc.sky.directions import angular_distance
from sunarc.sky.night import NightSky
from sunarc.sky.site import EARTH_RATE, Site, pole_enu
from sunarc.stars.sky_turn import (
    MAX_ANGLE,
    SIDEREAL_RATE,
    SearchRange,
    Turning,
    Turns,
    count_on_detections,
    image_pairs,
    turnings,
    unmirrored,
)
from sunarc.stars.star_pattern import Bright, Pattern, bright_stars, pattern_camera, patterns
from sunarc.stars.views import (
    MOST_LOG10_CHANCE,
    MatchedView,
    StarView,
    from_all_parts,
    match_views,
    pattern_log10_chance,
    seen_magnitude,
    stars_in_image,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NightDetections:
    """The detections of one image, and the sky at its moment.

    Attributes
    ----------
    unix_s : the middle of the exposure, seconds since 1970-01-01 UTC.
    stars : point sources, the brightest first.
    sky : stars and planets above the horizon, to V 5.5.
    """

    unix_s: float
    stars: Stars
    sky: NightSky


# What a blind start is given, and what it returns.


_MAX_TILT_DEG = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BlindOptions:
    """Prior knowledge of the camera.

    Attributes
    ----------
    level_within_deg : how far its axis may lie from the zenith; unset: 20 degrees, unless a wrong time or place, which
        would make it level, is more probable than its tilt.
    circle : the image circle, where it is known; the axis is then looked for within 8 % of its radius of its centre,
        else of the image's.
    """

    level_within_deg: Annotated[float, Gt(0.0), Le(45.0)] | None = None
    circle: ImageCircle | None = None

    def __post_init__(self) -> None:
        """Refuse a tilt out of bounds."""
        require_bounds(self, section_path="blind start")

    @property
    def max_tilt_deg(self) -> float:
        """Largest angle of the axis from the zenith."""
        return _MAX_TILT_DEG if self.level_within_deg is None else self.level_within_deg


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlindStart:
    """A camera by the stars alone, or the reason why it is missing.

    Attributes
    ----------
    camera : the best one; None where nothing turned. To be used only where `accepted`.
    accepted : whether the stars of the images are named by it, and by no other.
    findings : why, or why not.
    predicted, stars, matches : of each image, in the order given: where the camera sees the stars, the detections
        that are not still, and which is which; empty where there is no camera.
    """

    accepted: bool
    findings: tuple[Finding, ...]
    camera: Camera | None = None
    predicted: tuple[PredictedStars, ...] = field(default=())
    stars: tuple[Stars, ...] = field(default=())
    matches: tuple[StarMatches, ...] = field(default=())


# A rough camera made exact by the catalogue's stars: the nearest detections, ever closer ones, and least squares.

_FIT = (
    Param.FOCAL_LENGTH_X_PX, Param.PRINCIPAL_POINT_X_PX, Param.PRINCIPAL_POINT_Y_PX,
    Param.ROTATION_X, Param.ROTATION_Y, Param.ROTATION_Z, Param.K2, Param.K3, Param.K4, Param.K5,
)  # fmt: skip
_SIGMA_LENS = (0.1, 0.08, 0.08, 0.3, 0.3, 0.3, 0.05, 0.05, 0.05, 0.05)
"""1-sigma of the prior about the rough camera: focal length and centre in focal lengths, rotation in radians."""
_ROUNDS = (
    (0.1, 2.0), (0.08, 2.5), (0.06, 3.0), (0.045, 3.0), (0.03, 3.5), (0.02, 3.5),
    (0.012, 4.0), (0.008, 4.5), (0.006, 4.5),
)  # fmt: skip
"""Reach in focal lengths, and V of the faintest stars of each round."""
_STEPS = 3
_PER_STAR_REFINEMENT = 1.5
_FEWEST = 12
_LEAST_REACH_PX = 2.0


class Refined(NamedTuple):
    """Camera fitted to stars, and the scatter of the stars about it per axis, px."""

    camera: Camera
    scatter_px: float


def refined(
    camera: Camera, images: Sequence[NightDetections], rounds: Sequence[tuple[float, float]] = _ROUNDS
) -> Refined | None:
    """Return the camera fitted by least squares to bright stars of some images; None where too few come near."""
    focal = camera.focal_length_px[0]
    start = camera.to_vector()[list(_FIT)]
    sigma = np.array(_SIGMA_LENS) * np.r_[focal, focal, focal, np.ones(7)]
    scatter = np.nan
    for reach, faintest in rounds:
        for _ in range(_STEPS):
            radius = max(reach * focal, _LEAST_REACH_PX)
            pairs = _pair_nearest(camera, images, radius, faintest)
            if pairs[0].shape[0] < _FEWEST:
                return None
            camera, scatter = _gauss_newton_step(camera, pairs, (start, sigma), radius)
    return Refined(camera, scatter)


def _pair_nearest(
    camera: Camera, images: Sequence[NightDetections], radius: float, faintest: float
) -> tuple[FloatArray, FloatArray]:
    """Return directions (n, 3) of stars and pixels (n, 2) of their mutually nearest detections."""
    directions, pixels = [np.zeros((0, 3))], [np.zeros((0, 2))]
    for image in images:
        sky = _image_sky(camera, image.sky.select(image.sky.magnitude <= faintest))
        some = image.stars.pixels[: round(_PER_STAR_REFINEMENT * len(sky)) + 10]
        if len(sky) == 0 or some.shape[0] == 0:
            continue
        there = project_with_jacobian(camera, sky.directions)[0]
        apart, row = cKDTree(some).query(there)
        back = np.asarray(cKDTree(there).query(some)[1])
        near = (np.asarray(apart) < radius) & (back[np.asarray(row)] == np.arange(len(sky)))
        directions.append(sky.directions[near])
        pixels.append(some[np.asarray(row)[near]])
    return np.concatenate(directions), np.concatenate(pixels)


def _image_sky(camera: Camera, sky: NightSky) -> NightSky:
    pixels = project_with_jacobian(camera, sky.directions)[0]
    size = np.array([camera.width, camera.height])
    return sky.select(np.all((pixels > -0.5) & (pixels < size - 0.5), axis=-1))


def _gauss_newton_step(
    camera: Camera, pairs: tuple[FloatArray, FloatArray], prior: tuple[FloatArray, FloatArray], radius: float
) -> tuple[Camera, float]:
    """Return the camera after a robust Gauss-Newton step, and the scatter about it before."""
    (directions, pixels), (start, sigma) = pairs, prior
    there, rows, _ = project_with_jacobian(camera, directions)
    seen = np.isfinite(there[:, 0])
    residual, rows = (pixels - there)[seen], rows[seen]
    rows[..., Param.FOCAL_LENGTH_X_PX] += rows[..., Param.FOCAL_LENGTH_Y_PX]  # one focal length
    distance = np.linalg.norm(residual, axis=-1)
    scatter = max(mad_sigma(residual.ravel()), 0.1)
    weight = np.sqrt(np.maximum(biweights(distance / max(6.0 * scatter, 0.1 * radius)), 1e-9))
    design = rows[..., list(_FIT)] * weight[:, None, None] / scatter
    now = camera.to_vector()[list(_FIT)]
    matrix = np.concatenate([design.reshape(-1, len(_FIT)), np.diag(1.0 / sigma)])
    goal = np.r_[(residual * weight[:, None] / scatter).ravel(), (start - now) / sigma]
    change = np.linalg.lstsq(matrix, goal, rcond=None)[0]
    vector = camera.to_vector()
    vector[list(_FIT)] = now + change
    vector[Param.FOCAL_LENGTH_Y_PX] = vector[Param.FOCAL_LENGTH_X_PX]
    return camera.replace_parameters(vector), scatter


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
"""1-sigma of a refined camera's prediction: the error of the lens that a smooth correction leaves."""
_MOST_REFINED = 8
_SAME_DEG = 2.0
_MUCH_LESS = 0.4
"""A hypothesis whose stars are fewer than this share of the best's is no rival: chance."""
_NORTH_PER_MINUTE_DEG = 0.25


class _Hypothesis(NamedTuple):
    """A refined camera, its matches in each image, and how many stars it names; by one image, the number by chance."""

    camera: Camera
    views: tuple[StarView, ...]
    matched: tuple[MatchedView, ...]
    stars: int
    log10_chance: float = math.nan


def blind_start(
    images: Sequence[NightDetections], site: Site, *, image_size: tuple[int, int], options: BlindOptions | None = None
) -> BlindStart:
    """Find a camera by one night's images alone: no start, no sun, mirrored or not.

    Of one image, or of several between which the sky turned by less than 3 degrees, the pattern of the bright stars
    gives the camera, where it matches far more of them than chance would (`star_pattern`). Of more images what turns
    gives the lens, the pole and the handedness; the bright catalogue at the stated times the angle about the pole. That
    camera counts where it names the stars of two images or more by the rules of `match_stars`, and no other camera
    does. North is right as the times are: a clock that is wrong turns the camera about the pole, a minute by a quarter
    of a degree, and no star tells it; only a tilt that a wrong zone would explain is refused.

    Parameters
    ----------
    images : of one night, one or more; where the sky turned by 3 degrees or more between two, it must have turned by 10
        (40 minutes) between the first and the last.
    site : where the camera stands.
    image_size : width and height, px.
    options : what is known of the camera.
    """
    known = BlindOptions() if options is None else options
    moving = [_remove_still_detections(image, images) for image in images]
    pairs = image_pairs([image.unix_s for image in moving], [image.stars.pixels for image in moving])
    if not pairs:
        return _start_by_pattern(images, site, image_size, known)
    turns = turnings(pairs, _make_search_range(site, image_size, known))
    if not turns or turns[0].share < _LEAST_SHARE:
        share = turns[0].share if turns else 0.0
        return _make_refusal(Finding("blind_no_turning", {"share": share, "limit": _LEAST_SHARE}))
    found = _list_hypotheses(turns, moving, images, site, image_size)
    if not found:
        return _make_refusal(Finding("blind_no_stars", {"share": turns[0].share}))
    return _decide_start(found, site, known)


def _make_refusal(*findings: Finding) -> BlindStart:
    return BlindStart(accepted=False, findings=findings)


# One image, or several between which the sky hardly turned: the pattern of the bright stars, all of the sky at once.

_PATTERN_OF_SIDE = (0.25, 1.0)
"""Radius of 90 degrees off the axis over the image's shorter side: a factor of two about the largest circle in it."""
_CENTRE_LIKE_TILT_DEG = 5.0
"""By how much a centre that is off the image's looks like a tilt more."""
_PATTERNS, _PATTERNS_REFINED = 40, 5
_FIRST_ROUNDS, _LAST_ROUNDS = ((0.06, 3.0), (0.04, 3.5)), _ROUNDS[4:]
_MOST_TRIED = 2
_PROVEN_LOG10_CHANCE = -20.0
"""Of a rough camera, which ends the search: chance brings one in 1e20 images."""


def _start_by_pattern(
    images: Sequence[NightDetections], site: Site, image_size: tuple[int, int], known: BlindOptions
) -> BlindStart:
    """Return the camera that matches the bright stars of one image far beyond chance, or the reason of its lack."""
    lit = sorted((one for one in images if len(one.stars) >= _FEWEST), key=lambda one: -len(one.stars))
    if not lit:
        if len(images) == 1:  # more images are not what is missing
            n = len(images[0].stars)
            return _make_refusal(Finding("stars_few", {"n": n, "limit": _FEWEST, "detected": n}))
        turn = math.degrees(SIDEREAL_RATE * float(np.ptp([image.unix_s for image in images]))) if images else 0.0
        few = {"n": len(images), "turn_deg": turn, "limit": _LEAST_TURN_DEG}
        return _make_refusal(Finding("blind_few_images", few))
    found = [one for image in lit[:_MOST_TRIED] for one in _refine_patterns(image, images, site, image_size, known)]
    found.sort(key=lambda one: one.log10_chance)
    if not found or found[0].log10_chance > MOST_LOG10_CHANCE:
        chance = found[0].log10_chance if found else 0.0
        data = {"log10_chance": chance, "limit": MOST_LOG10_CHANCE, "n": len(lit[0].stars)}
        return _make_refusal(Finding("blind_no_pattern", data))
    if found[0].stars == 0:
        unnamed = {"log10_chance": found[0].log10_chance}
        why = tuple(finding for one in found[0].matched for finding in one.matches.findings)
        return _make_refusal(Finding("blind_pattern_not_named", unnamed), *why)
    return _decide_start(found, site, known)


def _refine_patterns(
    image: NightDetections,
    images: Sequence[NightDetections],
    site: Site,
    image_size: tuple[int, int],
    known: BlindOptions,
) -> list[_Hypothesis]:
    """Return the refined cameras of one image that name its stars, the least probable by chance first."""
    field = _make_search_range(site, image_size, known)
    radius = field.radius_px
    if known.circle is None:
        least, greatest = (share * min(image_size) for share in _PATTERN_OF_SIDE)
        radius = (least, max(greatest, radius[1]))
    sky, clear = image.sky, from_all_parts(image.stars.select(~on_cloud(image.stars)), image_size)
    magnitude = seen_magnitude(sky)
    stars, tilt = bright_stars(sky.directions, magnitude), math.radians(known.max_tilt_deg + _CENTRE_LIKE_TILT_DEG)
    bright = Bright(stars=stars, away=clear.pixels - np.array(field.centre))
    rough = patterns(bright, radius_px=radius, max_tilt=tilt, most=_PATTERNS)
    alone = [NightDetections(unix_s=image.unix_s, stars=clear, sky=sky)]

    def chance(camera: Camera) -> float:
        return pattern_log10_chance(camera, sky, image.stars)

    x, y = field.centre
    centres = {False: (x, y), True: (image_size[0] - 1.0 - x, y)}
    first: list[tuple[float, Camera]] = []
    for one in rough:
        nearer = refined(pattern_camera(one, centres[one.mirrored], image_size), alone, _FIRST_ROUNDS)
        if nearer is not None:
            first.append((chance(nearer.camera), nearer.camera))
            if first[-1][0] < _PROVEN_LOG10_CHANCE:  # no other camera can be
                first = first[-1:]
                break
    first.sort(key=lambda one: one[0])
    found: list[_Hypothesis] = []
    for _, near in first[:_PATTERNS_REFINED]:
        better = refined(near, alone, _LAST_ROUNDS)
        if better is not None and not any(_is_same_camera(better.camera, other.camera) for other in found):
            found.append(_name_stars(better, images)._replace(log10_chance=chance(better.camera)))
    return found


def _remove_still_detections(image: NightDetections, every: Sequence[NightDetections]) -> NightDetections:
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
    return NightDetections(unix_s=image.unix_s, stars=stars.select(~still), sky=image.sky)


def _make_search_range(site: Site, image_size: tuple[int, int], options: BlindOptions) -> SearchRange:
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
    return SearchRange(
        centre=centre, radius_px=radius, polar_rad=(colatitude - tilt, colatitude + tilt), width=image_size[0]
    )


def _list_hypotheses(
    turns: Sequence[Turning],
    moving: Sequence[NightDetections],
    images: Sequence[NightDetections],
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
        if better is not None and not any(_is_same_camera(better.camera, one.camera) for one in found):
            found.append(_name_stars(better, images))
    found = [one for one in found if one.stars > 0]
    return sorted(found, key=lambda one: -one.stars)


def _name_stars(one: Refined, images: Sequence[NightDetections]) -> _Hypothesis:
    """Return the stars that a camera names."""
    camera = one.camera
    sigma = max(_LEAST_SIGMA_PX, one.scatter_px, _OF_FOCAL * camera.focal_length_px[0])
    views = []
    for image in images:
        pixels = project(camera, image.sky.directions)
        predicted = stars_in_image(camera, image.sky, pixels, np.full(len(image.sky), sigma))
        view = StarView(unix_s=image.unix_s, sky=image.sky, stars=image.stars, predicted=predicted, camera=camera)
        views.append(view)
    matched = match_views(views)
    stars = sum(found.matches.star.size for found in matched if found.matches.accepted)
    return _Hypothesis(camera, tuple(views), tuple(matched), stars)


def _is_same_camera(first: Camera, second: Camera) -> bool:
    """Return whether two cameras see most of the sky at the same places."""
    if first.mirrored != second.mirrored:
        return False
    sky = hemisphere(100)
    sky = sky[sky[:, 2] > 0.5]
    apart = np.degrees(angular_distance(unproject(first, project(second, sky)), sky))
    return bool(np.nanmedian(apart) < _SAME_DEG) if np.any(np.isfinite(apart)) else False


def _decide_start(found: Sequence[_Hypothesis], site: Site, options: BlindOptions) -> BlindStart:
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
    question, stated = tilt_question(best.camera, site), options.level_within_deg is not None
    against = []
    if math.isfinite(best.log10_chance):
        findings.append(Finding("blind_by_pattern", {"log10_chance": best.log10_chance}))
    elif len(accepted) < _FEWEST_IMAGES or turn < _LEAST_TURN_DEG:
        against.append(Finding("blind_few_images", {"n": len(accepted), "turn_deg": turn, "limit": _LEAST_TURN_DEG}))
    if rival is not None:
        against.append(Finding("blind_ambiguous", {"n": best.stars, "rival": rival.stars}))
    if pose.theta_zz_deg > options.max_tilt_deg:
        against.append(Finding("blind_tilted", {"tilt_deg": pose.theta_zz_deg, "limit": options.max_tilt_deg}))
    if question is not None:
        (against if not stated and float(question.data["odds"]) > 1.0 else findings).append(question)
    return BlindStart(
        accepted=not against,
        findings=tuple(against or findings),
        camera=best.camera,
        predicted=tuple(view.predicted for view in best.views),
        stars=tuple(one.stars for one in best.matched),
        matches=tuple(one.matches for one in best.matched),
    )


# The angle about the pole of a camera whose lens and pole are known: by the bright catalogue at the stated times.

_STEP_DEG = 1.0
_REACH = 0.035
"""Focal lengths: 2 degrees, for a lens and a pole that the turning alone found."""
_BRIGHT = 3.2
"""V of the faintest; 40 to 80 stars above a horizon."""
_PER_STAR = 2
"""Detections for each of these stars: planets, and false ones."""
_KEPT = 3
_APART_DEG = 6.0


def phases(
    turning: Turning, images: Sequence[NightDetections], site: Site, *, image_size: tuple[int, int]
) -> list[tuple[float, Camera]]:
    """Return the best angles about the pole as cameras, each with its share of bright stars on detections."""
    pole = pole_enu(site)
    first = _make_frame(turning.pole).T @ _make_frame(
        pole
    )  # one of the rotations that take the pole to its place in the camera
    angles = np.radians(np.arange(0.0, 360.0, _STEP_DEG))
    share = np.zeros(angles.size)
    for image in images:
        share += _share_on_detections(turning, image, first, angles)
    share /= len(images)
    found: list[tuple[float, Camera]] = []
    taken: list[float] = []
    for row in np.argsort(-share, kind="stable").tolist():
        apart = [abs((row * _STEP_DEG - other + 180.0) % 360.0 - 180.0) for other in taken]
        if min(apart, default=360.0) > _APART_DEG:
            taken.append(row * _STEP_DEG)
            turn = rotation_matrix(angles[row] * turning.pole)
            best, (x, y) = float(share[row]), turning.centre.tolist()
            pattern = Pattern(best, turning.mirrored, turning.focal_px, turning.shape, turn @ first)
            found.append((best, pattern_camera(pattern, (x, y), image_size)))
        if len(found) == _KEPT:
            break
    return found


def _share_on_detections(turning: Turning, image: NightDetections, first: FloatArray, angles: FloatArray) -> FloatArray:
    stars = image.sky.directions[image.sky.magnitude <= _BRIGHT]
    centre, focal = turning.centre, turning.focal_px
    pixels = image.stars.pixels[: _PER_STAR * stars.shape[0]]
    if min(stars.shape[0], pixels.shape[0]) < 3:
        return np.zeros(angles.size)
    pixels = unmirrored(pixels, turning.width, mirrored=turning.mirrored)
    poles = np.broadcast_to(turning.pole, (angles.size, 3))
    onto = (pixels - centre) / focal
    rays, turns = stars @ first.T, Turns(poles, angles)
    return count_on_detections(rays, onto, turns, shape=turning.shape, reach=_REACH, largest=MAX_ANGLE)


def _make_frame(axis: FloatArray) -> FloatArray:
    """Return (3, 3): rows are a right-handed frame whose last is the axis."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(other, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis])


def add_star_clock_error(calibration: Calibration, clock_error_s: float, *, limit_deg: float) -> Calibration:
    """Return a calibration by stars alone whose uncertainty holds an error of the clock, which its verdict states.

    A clock that is wrong turns the sky about the pole, and the fit the camera: nothing in images tells the two apart.
    One that is then less sure than a limit is refused.

    Parameters
    ----------
    calibration : by sightings without any error of the clock.
    clock_error_s : the bound of the clock's error, s.
    limit_deg : of the 1-sigma over the sky, degrees.
    """
    camera, site = calibration.camera, calibration.site
    wider = add_pose_errors(calibration, pose_error(camera, site, clock_error_s=clock_error_s, site_error_m=0.0))
    latitude, turn = math.radians(site.latitude), math.degrees(EARTH_RATE * clock_error_s)
    turns = {"turn_deg": turn, "north_deg": turn * abs(math.sin(latitude)), "tilt_deg": turn * math.cos(latitude)}
    wider = replace(wider, evidence=replace(wider.evidence, clock_error_s=clock_error_s))
    clock = Finding("pose_or_clock", {"clock_error_s": clock_error_s, **turns})
    if wider.sky_rms_deg <= limit_deg or not wider.verdict.accepted:
        return add_finding(wider, clock)
    of_sigma = {"sigma_deg": wider.sky_rms_deg, "limit_deg": limit_deg, "scatter_px": wider.evidence.sigma_px}
    counts = {"n": wider.metrics.n, "days": len(wider.evidence.days)}
    return refused_for(wider, Finding("direction_sigma_too_large", {**of_sigma, **counts}), clock)
