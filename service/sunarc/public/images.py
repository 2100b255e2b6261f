"""The sun and the stars in pictures of a notebook."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from sunarc.common.array_types import FloatArray, Image, NameArray
from sunarc.common.errors import InputError
from sunarc.common.utc import utc_time
from sunarc.detection.values import BAYERS, Bayer, Detection
from sunarc.formats.formats import calibration_view
from sunarc.public.calibration import Calibration
from sunarc.public.documents import as_documented
from sunarc.public.inputs import Times, choice, data_array, one_time, unix_seconds
from sunarc.public.star_files import StarImage, StarOptions, blind_result, detect_star_image, named_or_flipped
from sunarc.public.values import Sightings, Site, require_site
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.site import Site as Place
from sunarc.sources.detect_files import METHODS, Method, detect_in_image
from sunarc.sources.expected_sun import as_predicted, expectations
from sunarc.sources.files import read_image

Picture = Any
"""A picture: (rows, columns) or (rows, columns, 3) of 8 or 16 bits, as OpenCV reads it; or the path of a file."""


def read_picture(picture: Picture, *, field: str = "image") -> Image:
    """Return the pixels of a picture.

    Raises
    ------
    InputError
        Where it is no picture, or the file cannot be read.
    """
    if isinstance(picture, str | os.PathLike):
        return read_image(Path(picture))
    array = data_array(picture)
    found = np.asarray(picture if array is None else array.to_numpy())
    if found.dtype not in (np.uint8, np.uint16):
        raise InputError(field=field, problem=f"is of {found.dtype}", remedy="give counts as uint8 or uint16")
    if found.ndim not in {2, 3} or (found.ndim == 3 and found.shape[2] != 3) or min(found.shape) < 1:
        remedy = "give (rows, columns), or (rows, columns, 3) in the order blue, green, red"
        raise InputError(field=field, problem=f"has shape {found.shape}", remedy=remedy)
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class SunDetection:
    """The sun in a picture, accepted or rejected with the reason."""

    x_px: float | None
    """Column of the centre; None where none was found. A rejected position may be given."""
    y_px: float | None
    """Row of the centre."""
    sigma_px: float | None
    """1-sigma per axis."""
    accepted: bool
    """Whether fits may use the position."""
    reason: str
    """The reason, as a sentence."""
    time: datetime | None
    """Time of the picture, UTC, where it was given."""
    detection: Detection
    """All that was measured."""

    def sightings(self) -> Sightings:
        """Return the sighting where it is accepted, else none; InputError where the picture's time was not given."""
        return _make_sightings(
            self.time,
            x_px=[self.x_px] if self.accepted else [],
            y_px=[self.y_px] if self.accepted else [],
            sigma_px=[self.sigma_px] if self.accepted else [],
        )


def find_sun(
    image: Picture,
    *,
    time: Times | None = None,
    calibration: Calibration | None = None,
    method: Method = "auto",
    full_scale: int | None = None,
    bayer: Bayer | None = None,
) -> SunDetection:
    """Return the sun in a picture, as `sunarc detect` finds it.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3) of 8 or 16 bits, as OpenCV reads it; or the path of a file.
    time : of the picture; it is kept for `Sightings.from_found`.
    calibration : of the camera: the sun is looked for where it should be at `time`.
    method : `disc` for exposures of microseconds, `paper` for ordinary pictures; `auto` chooses by the picture.
    full_scale : the largest count; judged from the picture unless given.
    bayer : colours of a raw mosaic: `RGGB`, `BGGR`, `GRBG` or `GBRG`.

    Raises
    ------
    InputError
        Where the picture is invalid, or the time has no zone.

    Examples
    --------
    >>> import sunarc
    >>> sun = sunarc.find_sun("pictures/20130513T181400Z.jpg", time="2013-05-13T18:14:00Z")
    >>> sun.accepted, round(sun.x_px), round(sun.y_px)
    (True, 158, 154)
    """
    unix_s = None if time is None else one_time(time, remedy="give the time of the picture")
    expected = None
    if calibration is not None:
        if unix_s is None:
            raise InputError(field="time", problem="missing beside calibration", remedy="give the time of the picture")
        solved = calibration.require_usable()
        (expected,) = expectations(solved, np.array([unix_s]), site=solved.site)
    found = detect_in_image(
        read_picture(image),
        method=choice("method", method, METHODS),
        full_scale=full_scale,
        bayer=None if bayer is None else choice("bayer", bayer, BAYERS),
        expectation=expected,
    )
    found = as_predicted(found, expected)
    return SunDetection(
        x_px=found.x_px,
        y_px=found.y_px,
        sigma_px=found.sigma_px,
        accepted=found.accepted,
        reason=found.reason,
        time=None if unix_s is None else utc_time(unix_s),
        detection=found,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarDetections:
    """Stars of a picture that have a name, and the camera that names them."""

    names: NameArray
    """(n,) as `star:HIP32349`; planets by their names."""
    x_px: FloatArray
    """(n,) columns."""
    y_px: FloatArray
    """(n,) rows."""
    sigma_px: FloatArray
    """(n,) 1-sigma per axis."""
    zenith_deg: FloatArray
    """(n,) apparent zenith angles of the catalogue's stars."""
    azimuth_deg: FloatArray
    """(n,) azimuths, clockwise from north."""
    accepted: bool
    """Whether the names are accepted."""
    reason: str
    """The reason, as a sentence."""
    time: datetime | None
    """Time of the picture, UTC."""
    calibration: Calibration | None
    """The calibration that was given, or the one that the stars gave; None where they gave none."""

    def sightings(self) -> Sightings:
        """Return the named stars as sightings where the names are accepted, else none."""
        rows = slice(None if self.accepted else 0)
        return _make_sightings(
            self.time,
            x_px=self.x_px[rows],
            y_px=self.y_px[rows],
            sigma_px=self.sigma_px[rows],
            body=self.names[rows],
            zenith_deg=self.zenith_deg[rows],
            azimuth_deg=self.azimuth_deg[rows],
        )


def _make_sightings(time: datetime | None, **columns: Any) -> Sightings:  # noqa: ANN401 - numbers of each
    """Return sightings of one time."""
    if time is None:
        raise InputError(field="time", problem="missing", remedy="give find_sun the time of the picture")
    return Sightings(time=[time] * len(columns["x_px"]), **columns)


def find_stars(
    image: Picture | Sequence[Picture],
    *,
    time: Times,
    site: Site | None = None,
    calibration: Calibration | None = None,
    full_scale: int | None = None,
    bayer: Bayer | None = None,
) -> StarDetections | list[StarDetections]:
    """Return the stars of a picture of the night with their names, as `sunarc stars` does.

    Parameters
    ----------
    image : a picture, or a list of pictures of one camera: see `find_sun`. Two or more, ten minutes apart, tell what
        stands still (hot pixels, lamps) from stars.
    time : middle of the exposure, of each.
    site : where the camera stands; that of the calibration unless given.
    calibration : names the stars; without one the stars themselves give the camera, as `sunarc stars --blind` finds it.
    full_scale : the largest count; judged from the picture unless given.
    bayer : colours of a raw mosaic.

    Raises
    ------
    InputError
        Where a picture is invalid, a time has no zone, or neither site nor calibration is given.

    Examples
    --------
    >>> import sunarc
    >>> calibration = sunarc.load("pictures.json")
    >>> stars = sunarc.find_stars("night.png", time="2013-05-14T05:00:00Z", calibration=calibration)
    >>> stars.accepted, len(stars.names) > 20
    (True, True)
    """
    several = isinstance(image, list | tuple)
    pictures = list(image) if several else [image]
    unix_s = unix_seconds(time)
    if unix_s.size != len(pictures):
        problem = f"{unix_s.size} times for {len(pictures)} pictures"
        raise InputError(field="time", problem=problem, remedy="give the time of each picture")
    if site is None and calibration is None:
        raise InputError(field="site", problem="missing, as is calibration", remedy="give one of them")
    options = StarOptions(full_scale=full_scale, bayer=None if bayer is None else choice("bayer", bayer, BAYERS))
    solved = None if calibration is None else calibration.require_usable()
    place = solved.site if solved is not None and site is None else require_site(site).place
    size = None if solved is None else (solved.camera.width, solved.camera.height)
    seen: list[StarImage] = []
    for row, (picture, at) in enumerate(zip(pictures, unix_s.ravel().tolist(), strict=True)):
        name = f"image[{row}]" if several else "image"
        one = detect_star_image(read_picture(picture, field=name), utc_time(at), place, options, name=name, size=size)
        seen, size = [*seen, one], size or one.size
    if solved is None:
        found = _find_blind(seen, place, options)
    else:
        found = [_make_star_detections(one, calibration, one.reason) for one in named_or_flipped(seen, solved, options)]
    return found if several else found[0]


def _find_blind(seen: list[StarImage], place: Place, options: StarOptions) -> list[StarDetections]:
    """Return the stars of images of one night, named by the camera that they give."""
    blind = blind_result(seen, place, options)
    made = None
    if blind.calibration is not None:
        now = datetime.now(UTC)  # noqa: TID251 - a notebook's calibration is dated by the machine
        document = blind.document(camera="camera", now=now)
        known = as_documented(document, blind.calibration)
        made = Calibration(calibration_view(known), document=document, solved=known)
    said = str(blind.as_json()["reason"])
    return [
        _make_star_detections(one, made, one.reason if made is not None and made.accepted else said)
        for one in blind.images
    ]


def _make_star_detections(image: StarImage, calibration: Calibration | None, reason: str) -> StarDetections:
    """Return the named stars of an image that are no saturated ones."""
    pixels, sigma_px, names, directions = np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.str_), np.zeros((0, 3))
    matches, stars, sky, predicted = image.matches, image.stars, image.sky, image.predicted
    if matches is not None and stars is not None and sky is not None and predicted is not None:
        used = image.rows()
        seen = stars.select(matches.detection[used])
        pixels, sigma_px, names = seen.pixels, seen.sigma_px, predicted.names[matches.star[used]]
        directions = sky.directions[sky.find_rows(names.tolist())]
    zenith, azimuth = angles_from_direction(directions)
    return StarDetections(
        names=names,
        x_px=pixels[:, 0],
        y_px=pixels[:, 1],
        sigma_px=sigma_px,
        zenith_deg=zenith,
        azimuth_deg=azimuth,
        accepted=matches is not None and matches.accepted,
        reason=reason,
        time=image.time,
        calibration=calibration,
    )
