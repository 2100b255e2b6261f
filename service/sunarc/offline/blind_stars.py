"""A camera by images of one night alone: files in, named stars and a calibration out."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import sunarc
from sunarc.array_types import evenly_spread
from sunarc.calibration.blind_start.start import blind_start
from sunarc.calibration.blind_start.values import BlindOptions, BlindStart, NightImage
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.messages import text_of
from sunarc.calibration.model.document import to_document
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import SunPoints
from sunarc.calibration.selection.star_selection import image_parts, surest_of_parts
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.offline.star_files import StarImage, StarOptions, named_stars, read_stars
from sunarc.runtime.clock import Clock
from sunarc.sky.site import Site
from sunarc.utc import utc_time

_GAP_S = 6.0 * 3600.0
"""Between images of one night; between nights it is longer."""
_MOST_IMAGES = 6
"""Of a night that the start is found by, evenly over it; all are named by its calibration."""
_MOST_STARS = 400
"""Of all images, that the fit takes: the surest of each part of the image."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlindResult:
    """What images of a night show without a calibration.

    Attributes
    ----------
    start : the camera that the stars gave, or why there is none.
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
        """Return what the start and the fit say."""
        return self.start.findings + (() if self.calibration is None else self.calibration.verdict.findings)

    def as_json(self) -> dict[str, Any]:
        """Return the summary of the start and of the images."""
        return {
            "accepted": self.accepted,
            "reason": "; ".join(text_of(finding) for finding in self.findings),
            "findings": [finding.as_json() for finding in self.findings],
            "images": [image.as_json() for image in self.images],
        }

    def document(self, *, camera: str, clock: Clock) -> dict[str, Any]:
        """Return the calibration's document; InputError where there is no calibration."""
        if self.calibration is None:
            raise InputError(field=camera, problem="no calibration", remedy="see the findings")
        first = min(image.time for image in self.images if image.time is not None)
        return to_document(
            self.calibration,
            id=uuid.uuid4().hex,
            camera=camera,
            state="candidate" if self.accepted else "refused",
            created_at=clock.now(),
            valid_from=utc_time(first.timestamp()),
            valid_until=None,
            pose_epoch="",
            software_version=sunarc.__version__,
        )


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
    InputError : the images are not of one size, or ephem is not installed.
    """
    seen, size = list[StarImage](), None
    for path in paths:
        seen.append(read_stars(path, site, options, size=size))
        size = size or seen[-1].size
    if size is None:
        few = Finding("blind_few_images", {"n": 0, "turn_deg": 0.0, "limit": 10.0})
        return BlindResult(start=BlindStart(accepted=False, findings=(few,)), images=seen)
    night = _one_night(seen)
    images = [
        NightImage(unix_s=one.time.timestamp(), stars=one.stars, sky=one.sky)
        for one in night
        if one.time is not None and one.stars is not None and one.sky is not None
    ]
    start = blind_start(images, site, image_size=size, options=known)
    if not start.accepted or start.camera is None:
        return BlindResult(start=start, images=seen)
    points = _points(start, images, size)
    choice = CalibrationOptions(mirrored="yes" if start.camera.mirrored else "no")
    fitted = calibrate(points, site=site, image_size=size, options=choice, start=start.camera)
    if not fitted.verdict.accepted:
        return BlindResult(start=start, images=seen, calibration=fitted)
    return BlindResult(start=start, images=named_stars(seen, fitted, within_px=options.within_px), calibration=fitted)


def _one_night(seen: Sequence[StarImage]) -> list[StarImage]:
    """Return images of the night that has most of them, evenly over it."""
    timed = sorted((one for one in seen if one.time is not None), key=lambda one: str(one.time))
    times = np.array([one.time.timestamp() for one in timed if one.time is not None])
    night = np.cumsum(np.diff(times, prepend=times[0]) > _GAP_S)
    rows = np.flatnonzero(night == np.argmax(np.bincount(night)))
    return [timed[row] for row in rows[evenly_spread(rows.size, most=_MOST_IMAGES)].tolist()]


def _points(start: BlindStart, images: Sequence[NightImage], size: tuple[int, int]) -> SunPoints:
    """Return the stars that the start names as sightings: unclipped, the surest of each part of the image."""
    times, pixels, sigma, directions = [np.zeros(0)], [np.zeros((0, 2))], [np.zeros(0)], [np.zeros((0, 3))]
    for image, predicted, stars, matches in zip(images, start.predicted, start.stars, start.matches, strict=True):
        seen = stars.select(matches.detection)
        sound = seen.sound
        names = predicted.names[matches.star[sound]].tolist()
        times.append(np.full(len(names), image.unix_s))
        pixels.append(seen.pixels[sound])
        sigma.append(seen.sigma_px[sound])
        directions.append(image.sky.directions[image.sky.rows_of(names)])
    every = SunPoints(
        unix_s=np.concatenate(times),
        pixels=np.concatenate(pixels),
        sigma_px=np.concatenate(sigma),
        directions=np.concatenate(directions),
    )
    return every.select(surest_of_parts(image_parts(every.pixels, size), every.sigma_px, _MOST_STARS))
