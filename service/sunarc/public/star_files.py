"""Stars in images of the night: named by a calibration, or a calibration from them alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.selection import MOST_STARS, image_parts, pick_surest_in_parts, sky_parts
from sunarc.common.array_types import FloatArray, Image, IntArray, evenly_spread
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, FindingError, joined
from sunarc.common.foreign_files import is_regular, name_text
from sunarc.common.utc import DAY_S, rfc3339, utc_time
from sunarc.detection.stars.detect import detect_stars
from sunarc.detection.stars.matching import StarMatches
from sunarc.detection.values import FWHM, Bayer, PredictedStars, Stars
from sunarc.formats.csv_files import write_sightings
from sunarc.optics.camera import Camera
from sunarc.public.documents import new_document
from sunarc.sky.directions import angular_distance, direction_from_angles
from sunarc.sky.night import FAINTEST_V, NightSky, night_sky
from sunarc.sky.site import Site
from sunarc.sources.detect_files import estimated_full_scale
from sunarc.sources.file_kinds import find_kind
from sunarc.sources.fits_files import fits_bayer, fits_site
from sunarc.sources.image_files import read_one_image
from sunarc.sources.image_times import ASSUMED_UTC, HEADER_FAMILIES, TimedFrame, TimeRules, name_sidecar, timed_frames
from sunarc.sources.source_files import opened
from sunarc.sources.sources import Folder, open_folder
from sunarc.stars.blind_start import BlindOptions, BlindStart, NightDetections, add_star_clock_error, blind_start
from sunarc.stars.views import StarView, match_views, matching_flip, predict_stars


@dataclass(frozen=True, slots=True, kw_only=True)
class StarOptions:
    """Options of reading images of the night.

    Attributes
    ----------
    rules : how their times are read.
    to_middle_s : seconds from the stated time to the middle of the exposure; the header of a FITS file states that.
    within_px : 1-sigma that is added to the calibration's own uncertainty, px.
    bayer, full_scale : of raw frames; full scale is judged from the file where None.
    gain_e_per_count : electrons per count of a linear camera; None where not known.
    clock_error_s : bound of the error of their times, s; a camera that they give is turned about the pole with it.
    follow_exif : turn pictures as their EXIF orientation states.
    reduced_by : the factor that images are reduced by before stars are detected in them.
    """

    rules: TimeRules = field(default_factory=lambda: ASSUMED_UTC)
    to_middle_s: float = 0.0
    within_px: float = 0.0
    bayer: Bayer | None = None
    full_scale: int | None = None
    gain_e_per_count: float | None = None
    clock_error_s: float = 10.0
    follow_exif: bool = False
    reduced_by: int = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarImage:
    """Stars of an image of the night; without time and stars where it could not be read."""

    file: str
    reason: str
    findings: tuple[Finding, ...]
    time: datetime | None = None
    sky: NightSky | None = None
    stars: Stars | None = None
    predicted: PredictedStars | None = None
    matches: StarMatches | None = None
    size: tuple[int, int] | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the summary of the image."""
        matches, stars = self.matches, self.stars
        return {
            "file": self.file,
            "time_utc": None if self.time is None else rfc3339(self.time),
            "accepted": matches is not None and matches.accepted,
            "reason": self.reason,
            "findings": [finding.as_json() for finding in self.findings],
            "n_detected": 0 if stars is None else len(stars),
            "n_stars": int(self.rows().size),
            "explained": None if matches is None else _finite_or_none(matches.explained),
            "found": None if matches is None else _finite_or_none(matches.found),
            "scatter_px": None if matches is None else _finite_or_none(matches.scatter_px),
            "star_fwhm_px": None if stars is None or len(stars) == 0 else FWHM * float(np.median(stars.width_px)),
        }

    def rows(self) -> IntArray:
        """Return the rows of the matches that are sightings: stars that are not clipped."""
        if self.matches is None or self.stars is None:
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(self.stars.sound[self.matches.detection])


def find_stars(paths: Sequence[Path], calibration: Calibration, options: StarOptions) -> list[StarImage]:
    """Find and name the stars in image files, in the order given; a file that is no image gets its reason.

    What stands still between images of a night (hot pixels, lamps) is left out: give two or more that lie ten minutes
    or more apart.

    Parameters
    ----------
    paths : images of the night.
    calibration : of the camera: its lens and pose, its site, and how sure it is.
    options : see `StarOptions`.

    Raises
    ------
    InputError : an image has not the calibration's size.
    """
    camera = calibration.camera
    size = (camera.width, camera.height)
    seen = [detect_stars_in_file(path, calibration.site, options, size=size) for path in paths]
    return named_or_flipped(seen, calibration, options)


def named_or_flipped(seen: Sequence[StarImage], calibration: Calibration, options: StarOptions) -> list[StarImage]:
    """Return images with their stars named; where that fails, with a finding that names the flip that would match."""
    return _try_flips(named_stars(seen, calibration, within_px=options.within_px), seen, calibration)


def _try_flips(named: list[StarImage], seen: Sequence[StarImage], calibration: Calibration) -> list[StarImage]:
    """Return images; where no image's stars match, and those of flipped ones do, their findings say which flip."""
    if any(one.matches is not None and one.matches.accepted for one in named):
        return named
    pairs = zip(named, seen, strict=True)
    read = [_make_view(replace(one, stars=as_read.stars), calibration.camera) for one, as_read in pairs]
    size = (calibration.camera.width, calibration.camera.height)
    flip, counts = matching_flip([view for view in read if view is not None], size)
    count_of = iter(counts)
    found = [0 if view is None else next(count_of) for view in read]
    return [
        replace(one, findings=findings, reason=joined(findings))
        if n and (findings := (*one.findings, Finding("stars_flipped", {"flip": flip, "n": n})))
        else one
        for one, n in zip(named, found, strict=True)
    ]


def named_stars(images: Sequence[StarImage], calibration: Calibration, *, within_px: float = 0.0) -> list[StarImage]:
    """Return images with the names that a calibration gives their stars."""
    seen = [
        one if one.sky is None else replace(one, predicted=predict_stars(calibration, one.sky, within_px=within_px))
        for one in images
    ]
    views = {row: view for row, one in enumerate(seen) if (view := _make_view(one, calibration.camera)) is not None}
    found = dict(zip(views, match_views(list(views.values())), strict=True))
    return [
        replace(
            one,
            reason=joined(found[row].matches.findings),
            findings=found[row].matches.findings,
            stars=found[row].stars,
            matches=found[row].matches,
        )
        if row in found
        else one
        for row, one in enumerate(seen)
    ]


def write_star_sightings(
    target: TextIO, images: Sequence[StarImage], *, beside: Sightings | None = None, most: int = MOST_STARS
) -> int:
    """Write the stars of accepted images as `sunarc calibrate` reads them, and return how many.

    `beside` are further sightings (the sun's), which are written before them; `most` of the stars are written, the
    surest of each part of the sky.
    """
    rows: list[tuple[datetime, float, float, float | None, str]] = []
    directions, air = [np.zeros((0, 3))], np.zeros((2, 0))
    if beside is not None:
        names = np.where(np.isnan(beside.directions[:, 0]), "sun", "stated")
        columns = (beside.unix_s, beside.pixels, beside.sigma_px, names)
        rows += [
            (utc_time(t), float(x), float(y), _finite_or_none(sigma), str(body))
            for t, (x, y), sigma, body in zip(*columns, strict=True)
        ]
        directions.append(beside.directions)
        air = np.stack([beside.temperature, beside.pressure])
    sun = len(rows)
    found = [_make_sighting_rows(image) for image in images]
    stars = [row for part, _ in found for row in part]
    around = np.concatenate([np.zeros((0, 3)), *(part for _, part in found)])
    sigma_px = np.array([row[3] for row in stars], dtype=np.float64)
    used = pick_surest_in_parts(sky_parts(around), sigma_px, most)
    rows += [stars[row] for row in used]
    directions.append(around[used])
    air = np.concatenate([air, np.full((2, len(rows) - sun), np.nan)], axis=-1)
    return write_sightings(target, rows, air=(air[0], air[1]), directions=np.concatenate(directions)) - sun


def _make_sighting_rows(image: StarImage) -> tuple[list[tuple[datetime, float, float, float | None, str]], FloatArray]:
    """Return the rows of an image's stars, and their directions (n, 3)."""
    matches, stars, sky, predicted = image.matches, image.stars, image.sky, image.predicted
    if image.time is None or matches is None or stars is None or sky is None or predicted is None:
        return [], np.zeros((0, 3))
    used = image.rows()
    seen, named = stars.select(matches.detection[used]), predicted.names[matches.star[used]].tolist()
    columns = zip(seen.pixels.tolist(), seen.sigma_px.tolist(), named, strict=True)
    rows: list[tuple[datetime, float, float, float | None, str]] = [
        (image.time, x, y, sigma, name) for (x, y), sigma, name in columns
    ]
    return rows, sky.directions[sky.find_rows(named)]


def detect_stars_in_file(
    path: Path, site: Site, options: StarOptions, *, size: tuple[int, int] | None = None
) -> StarImage:
    """Return the detections of a file, and the sky at its moment; a file that is no image gets its reason.

    InputError where the image has not the size (width, height) that is wanted.
    """
    try:
        time, image, bayer = read_timed(path, options)
    except FindingError as refused:
        return StarImage(file=name_text(path), reason=refused.finding.text, findings=(refused.finding,))
    except InputError as error:
        unreadable = Finding("file_unreadable", {"error": str(error)})
        return StarImage(file=name_text(path), reason=joined([unreadable]), findings=(unreadable,))
    if (elsewhere := _find_other_site(path, site)) is not None:
        reason = elsewhere.text
        return StarImage(file=name_text(path), reason=reason, findings=(elsewhere,), time=time)
    return detect_star_image(image, time, site, replace(options, bayer=bayer), name=name_text(path), size=size)


def detect_star_image(
    image: Image, time: datetime, site: Site, options: StarOptions, *, name: str, size: tuple[int, int] | None = None
) -> StarImage:
    """Return the detections of an image, and the sky at the middle of its exposure.

    InputError where the image has not the size (width, height) that is wanted.
    """
    found = (image.shape[1], image.shape[0])
    _require_size(name, found, size)
    stars = _detect_reduced(image, options)
    sky = night_sky(time.timestamp(), site, faintest=FAINTEST_V)
    return StarImage(file=name, reason="", findings=(), time=time, sky=sky, stars=stars, size=found)


def _reduce_image(image: Image, by: int) -> Image:
    height, width = (side // by for side in image.shape[:2])
    mean = cv2.resize(image[: by * height, : by * width], (width, height), interpolation=cv2.INTER_AREA)
    return mean.astype(np.uint8) if image.dtype == np.uint8 else mean.astype(np.uint16)


def _detect_reduced(image: Image, options: StarOptions) -> Stars:
    """Return the stars of an image in its own pixels, detected in it at the size that the options state."""
    by, gain = options.reduced_by, options.gain_e_per_count
    stars = detect_stars(
        image if by == 1 else _reduce_image(image, by),
        full_scale=options.full_scale or estimated_full_scale(image),
        bayer=options.bayer if by == 1 else None,  # means of whole tiles of a mosaic are grey
        gain_e_per_count=None if gain is None else by**2 * gain,  # a mean of as many counts
    )
    middle = 0.5 * (by - 1)
    return replace(stars, pixels=by * stars.pixels + middle, sigma_px=by * stars.sigma_px, width_px=by * stars.width_px)


_FARTHEST_DEG = 2.0
"""Between the header's site and the stated one: headers round, and some write degrees and minutes as a decimal."""


def _find_other_site(path: Path, site: Site) -> Finding | None:
    """Return the site of a FITS header that differs; longitudes that are positive to the west are known."""
    if find_kind(path.name) != "fits":
        return None
    with opened(Folder(name_text(path.parent)), name_text(path.name)) as file:
        place = fits_site(file, path.name)
    if place is None:
        return None
    here = direction_from_angles(zenith_deg=90.0 - site.latitude, azimuth_deg=site.longitude)
    there = [direction_from_angles(zenith_deg=90.0 - place[0], azimuth_deg=east) for east in (place[1], -place[1])]
    apart = min(math.degrees(float(angular_distance(here, one))) for one in there)
    data = {"latitude": place[0], "longitude": place[1], "apart_deg": apart, "limit": _FARTHEST_DEG}
    return Finding("file_other_site", data) if apart > _FARTHEST_DEG else None


def read_timed(path: Path, options: StarOptions) -> tuple[datetime, Image, Bayer | None]:
    """Return the middle of an image's exposure, its pixels, and the colours of its mosaic; of several the first one's.

    The time of a header with an exposure is that of the middle. A pattern of names goes first.
    """
    source, name = open_folder(path.parent, follow_exif=options.follow_exif), name_text(path.name)
    time = read_time(path, options)
    found = read_one_image(source, name)
    if isinstance(found, Finding):
        raise FindingError(name, found)
    bayer = options.bayer
    if bayer is None and found.ndim == 2 and find_kind(path.name) == "fits":
        with opened(source, name) as file:
            bayer = fits_bayer(file, name)
    return time, found, bayer


def read_time(path: Path, options: StarOptions) -> datetime:
    """Return the middle of an image's exposure as `read_timed` does, without its pixels."""
    frame = _read_stated_frame(path, Folder(name_text(path.parent)), options.rules)
    is_middle = frame.exposure_us is not None and frame.family in HEADER_FAMILIES.values()
    return frame.time if is_middle else frame.time + timedelta(seconds=options.to_middle_s)


def _read_stated_frame(path: Path, source: Folder, rules: TimeRules) -> TimedFrame:
    beside = Path(name_sidecar(str(path)))
    names = [name_text(beside.name)] if is_regular(beside) else []
    try:
        return timed_frames(source, name_text(path.name), rules, names=names)[0]
    except FindingError as refused:
        if refused.finding.code != "file_time_unknown" or find_kind(path.name) != "fits":
            raise
        raise FindingError(path.name, Finding("file_time_header")) from None


def _require_size(name: str, found: tuple[int, int], size: tuple[int, int] | None) -> None:
    if size is not None and found != size:
        raise InputError(
            field=name,
            problem=f"is {found[0]}x{found[1]}, the calibration of {size[0]}x{size[1]} images",
            remedy="give images of the calibrated camera",
        )


def _make_view(image: StarImage, camera: Camera) -> StarView | None:
    """Return the stars of an image; None where it could not be read."""
    if image.time is None or image.sky is None or image.stars is None or image.predicted is None:
        return None
    unix_s = image.time.timestamp()
    return StarView(unix_s=unix_s, sky=image.sky, stars=image.stars, predicted=image.predicted, camera=camera)


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


_LEAST_REDUCED = 2000
"""Shorter side of pictures in which stars are sought at half the size, too: they are 2 px wide and more there."""
_GAP_S = 6.0 * 3600.0
"""Between images of one night; between nights it is longer."""
_HALF_A_YEAR_S = 182.0 * DAY_S
_MOST_IMAGES = 6
"""Of a night that the start is found by, evenly over it; all are named by its calibration."""
_MOST_STARS = 400
"""Of several images, that the fit takes: the surest of each part of the image. Of one `MOST_STARS`: what errors they
have in common more do not average."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlindResult:
    """Result of images of a night without a calibration.

    Attributes
    ----------
    start : the camera by the stars, or the reason why it is missing.
    images : each image, its stars named by the calibration where there is one.
    calibration : the fit of the stars; None where there was no start.
    """

    start: BlindStart
    images: list[StarImage]
    calibration: Calibration | None = None

    @property
    def accepted(self) -> bool:
        """Return whether there is a camera, and its fit is accepted."""
        return self.calibration is not None and self.calibration.verdict.accepted

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return the findings of the start and of the fit."""
        return self.start.findings + (() if self.calibration is None else self.calibration.verdict.findings)

    def as_json(self) -> dict[str, Any]:
        """Return the summary of the start and of the images."""
        return {
            "accepted": self.accepted,
            "reason": "; ".join(finding.text for finding in self.findings),
            "findings": [finding.as_json() for finding in self.findings],
            "images": [image.as_json() for image in self.images],
        }

    def document(self, *, camera: str, now: datetime) -> dict[str, Any]:
        """Return the calibration's document; InputError where there is no calibration."""
        if self.calibration is None:
            raise InputError(field=camera, problem="no calibration", remedy="see the findings")
        first = min(image.time for image in self.images if image.time is not None)
        return new_document(self.calibration, np.array([first.timestamp()]), created_at=now, camera=camera)


def find_stars_blind(
    paths: Sequence[Path], site: Site, options: StarOptions, *, known: BlindOptions | None = None
) -> BlindResult:
    """Find a camera by images of one night, fit it to their stars, and name the stars of all images by the fit.

    Parameters
    ----------
    paths : images of one camera; of several nights, the one with most images gives the start.
    site : where it stands.
    options : how the images are read.
    known : what is known of the camera.

    Raises
    ------
    InputError : the images are not of one size.
    """
    found = blind_result(_read_images(paths, site, options), site, options, known=known)
    size = next((one.size for one in found.images if one.size is not None), (0, 0))
    if found.start.accepted or min(size) < _LEAST_REDUCED or any(one.stars is None for one in found.images):
        return found
    # wide stars among sharp noise: of a large picture at half its size stars stand out
    half = replace(options, reduced_by=2)
    reduced = blind_result(_read_images(paths, site, half), site, half, known=known)
    return reduced if reduced.accepted else found


def _read_images(paths: Sequence[Path], site: Site, options: StarOptions) -> list[StarImage]:
    seen, size = list[StarImage](), None
    for path in paths:
        seen.append(detect_stars_in_file(path, site, options, size=size))
        size = size or seen[-1].size
    return seen


def blind_result(
    seen: list[StarImage], site: Site, options: StarOptions, *, known: BlindOptions | None = None
) -> BlindResult:
    """Return the camera that images of one night give by their stars; arguments as of `find_stars_blind`."""
    size = next((one.size for one in seen if one.size is not None), None)
    if size is None:
        few = Finding("blind_few_images", {"n": 0, "turn_deg": 0.0, "limit": 10.0})
        return BlindResult(start=BlindStart(accepted=False, findings=(few,)), images=seen)
    night = _select_one_night(seen)
    images = [
        NightDetections(unix_s=one.time.timestamp(), stars=one.stars, sky=one.sky)
        for one in night
        if one.time is not None and one.stars is not None and one.sky is not None
    ]
    start = blind_start(images, site, image_size=size, options=known)
    if not start.accepted or start.camera is None:
        return BlindResult(start=start, images=seen)
    points = _make_sightings(start, images, size)
    choice = CalibrationOptions(
        mirrored="yes" if start.camera.mirrored else "no",
        level_within_deg=None if known is None else known.level_within_deg,
    )
    fitted = calibrate(points, site=site, image_size=size, options=choice, start=start.camera)
    if not fitted.verdict.accepted:
        return BlindResult(start=start, images=seen, calibration=fitted)
    named = named_stars(seen, fitted, within_px=options.within_px)
    stated = add_star_clock_error(fitted, options.clock_error_s, limit_deg=choice.max_sky_deg)
    return BlindResult(
        start=start, images=[_add_date_finding(one, images[0].unix_s) for one in named], calibration=stated
    )


def _add_date_finding(image: StarImage, unix_s: float) -> StarImage:
    """Return an image with a finding where it was taken half a year or more from the night that gave the camera."""
    if image.time is None or abs(image.time.timestamp() - unix_s) < _HALF_A_YEAR_S:
        return image
    days, date = abs(image.time.timestamp() - unix_s) / DAY_S, f"{utc_time(unix_s):%Y-%m-%d}"
    findings = (*image.findings, Finding("stars_years_apart", {"days": days, "date": date}))
    return replace(image, findings=findings, reason=joined(findings))


def _select_one_night(seen: Sequence[StarImage]) -> list[StarImage]:
    """Return images of the night with most of them, evenly spread over it."""
    timed = sorted(
        (one for one in seen if one.time is not None and one.stars is not None), key=lambda one: str(one.time)
    )
    times = np.array([one.time.timestamp() for one in timed if one.time is not None])
    night = np.cumsum(np.diff(times, prepend=times[0]) > _GAP_S)
    rows = np.flatnonzero(night == np.argmax(np.bincount(night)))
    return [timed[row] for row in rows[evenly_spread(rows.size, most=_MOST_IMAGES)].tolist()]


def _make_sightings(start: BlindStart, images: Sequence[NightDetections], size: tuple[int, int]) -> Sightings:
    """Return the stars that the start names as sightings: unclipped, the surest of each part of the image."""
    times, pixels, sigma, directions = [np.zeros(0)], [np.zeros((0, 2))], [np.zeros(0)], [np.zeros((0, 3))]
    for image, predicted, stars, matches in zip(images, start.predicted, start.stars, start.matches, strict=True):
        seen = stars.select(matches.detection)
        sound = seen.sound
        names = predicted.names[matches.star[sound]].tolist()
        times.append(np.full(len(names), image.unix_s))
        pixels.append(seen.pixels[sound])
        sigma.append(seen.sigma_px[sound])
        directions.append(image.sky.directions[image.sky.find_rows(names)])
    every = Sightings.of(
        unix_s=np.concatenate(times),
        pixels=np.concatenate(pixels),
        sigma_px=np.concatenate(sigma),
        directions=np.concatenate(directions),
    )
    most = _MOST_STARS if len(images) > 1 else MOST_STARS
    return every.select(pick_surest_in_parts(image_parts(every.pixels, size), every.sigma_px, most))
