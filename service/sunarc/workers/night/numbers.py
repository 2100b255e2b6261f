"""The numbers of a night and of each of its images: extinction, clouds, limiting magnitude, the stars' shape, dew."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.star_views import MatchedView, StarView
from sunarc.detection.stars.completeness import ZENITH_BANDS_DEG, detected, limiting_magnitude, zenith_bands
from sunarc.detection.stars.extinction import Extinction, StarLight, extinction_of
from sunarc.detection.stars.trend import NightTrend, trend_of
from sunarc.detection.stars.values import FWHM, Stars
from sunarc.sky.air import relative_air_mass
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.night import FAINTEST_V
from sunarc.utc import utc_time

COUNTED_TO_V = 4.0
"""Stars that any clear sky shows; those fainter are lost to the light of towns."""
_OWN_SHAPE_SNR = 20.0
_MOST_IMAGES = 72
"""Images of a night whose numbers are stored, spread over it."""
_DIGITS = 3


class TakenImage(NamedTuple):
    """An image of the night: its detections, which stars they are, its exposure, and the halo around stars.

    The exposure is that which gives as many counts at a gain of 0 dB, seconds.
    """

    view: StarView
    found: MatchedView
    exposure_s: float
    halo: float


class NightNumbers(NamedTuple):
    """Numbers of a whole night by name, by band of zenith angle, and of its images in columns; NaN: not known."""

    of_night: dict[str, float]
    bands: list[dict[str, Any]]
    images: dict[str, list[Any]]


def numbers_of(taken: Sequence[TakenImage]) -> NightNumbers:
    """Return the numbers of a night; only images whose stars were named say something of the sky."""
    named = [one for one in taken if one.found.matches.accepted]
    air = extinction_of([_light(one) for one in named], ZENITH_BANDS_DEG)
    zero_points = dict(zip(map(id, named), air.zero_point.tolist(), strict=True))
    images = [_image_numbers(one, zero_points.get(id(one), math.nan)) for one in taken]
    columns = {name: np.array([image[name] for image in images]) for name in images[0]} if images else {}
    trend = trend_of(*(columns.get(name, np.zeros(0)) for name in ("star_fwhm_px", "halo", "zero_point")))
    return NightNumbers(
        of_night=_of_night(air, trend, columns),
        bands=_bands(named, air),
        images=_stored(taken, columns),
    )


def cloud_fraction(view: StarView) -> float:
    """Return the share of the predicted stars to V 4 that have no detection."""
    counted = view.predicted.magnitude <= COUNTED_TO_V
    return 1.0 - float(np.mean(detected(view.stars, view.predicted)[counted])) if np.any(counted) else math.nan


def limit_of(view: StarView) -> float:
    """Return the V at which half as many stars are detected as of the bright ones, 5.5 at most."""
    listed = view.predicted.magnitude <= FAINTEST_V
    return limiting_magnitude(view.predicted.magnitude[listed], detected(view.stars, view.predicted)[listed])


def _of_night(air: Extinction, trend: NightTrend, columns: dict[str, FloatArray]) -> dict[str, float]:
    return {
        "transparency": 10.0 ** (-0.4 * air.per_air_mass),
        "extinction": air.per_air_mass,
        "extinction_sigma": air.sigma,
        "zero_point": _median(air.zero_point),
        "star_ellipticity": _median(columns.get("star_ellipticity", np.zeros(0))),
        "halo": _median(columns.get("halo", np.zeros(0))),
        **asdict(trend),
    }


def _image_numbers(one: TakenImage, zero_point: float) -> dict[str, float]:
    stars = _own_shapes(one)
    named = one.found.matches.accepted
    return {
        "cloud_fraction": cloud_fraction(one.view) if named else 1.0,
        "limiting_magnitude": limit_of(one.view) if named else math.nan,
        "star_fwhm_px": FWHM * _median(stars.width_px),
        "star_ellipticity": _median(stars.ellipticity),
        "halo": one.halo,
        "zero_point": zero_point,
    }


def _own_shapes(one: TakenImage) -> Stars:
    """Return the named stars that are bright enough for a shape of their own."""
    stars = one.found.stars.select(one.found.matches.detection)
    return stars.select(stars.sound & (stars.snr > _OWN_SHAPE_SNR))


def _light(one: TakenImage) -> StarLight:
    """Return the light of the named, unclipped stars to V 4."""
    stars = one.found.stars.select(one.found.matches.detection)
    zenith, _ = angles_from_direction(one.found.directions(one.view))
    magnitude = one.view.sky.magnitude[one.view.sky.rows_of(one.found.names(one.view))]
    used = stars.sound & (magnitude < COUNTED_TO_V)
    return StarLight(
        zenith_deg=zenith[used],
        air_mass=relative_air_mass(zenith[used]),
        magnitude=magnitude[used],
        rate=stars.flux[used] / one.exposure_s,
    )


def _bands(named: Sequence[TakenImage], air: Extinction) -> list[dict[str, Any]]:
    """Return the bands of zenith angle: stars to V 4 that were predicted and found, and the share of their light."""
    zenith, found = [np.zeros(0)], [np.zeros(0, dtype=np.bool_)]
    for one in named:
        predicted = one.view.predicted
        counted = predicted.magnitude <= COUNTED_TO_V
        directions = one.view.sky.directions[one.view.sky.rows_of(predicted.names.tolist())]
        zenith.append(np.asarray(angles_from_direction(directions)[0])[counted])
        found.append(detected(one.view.stars, predicted)[counted])
    bands = zenith_bands(np.concatenate(zenith), np.concatenate(found))
    return [
        {**asdict(band), "transparency": _rounded(share)}
        for band, share in zip(bands, air.transparency.tolist(), strict=True)
    ]


def _stored(taken: Sequence[TakenImage], columns: dict[str, FloatArray]) -> dict[str, list[Any]]:
    """Return the columns of at most 72 images as JSON, null where a number is not known."""
    if not taken:
        return {}
    rows = np.unique(np.linspace(0, len(taken) - 1, min(len(taken), _MOST_IMAGES)).astype(int)).tolist()
    times = [utc_time(taken[row].view.unix_s).isoformat(timespec="seconds") for row in rows]
    n_matched = [int(taken[row].found.matches.star.size) for row in rows]
    return {
        "time": times,
        "n_matched": n_matched,
        **{name: [_rounded(float(column[row])) for row in rows] for name, column in columns.items()},
    }


def _rounded(value: float) -> float | None:
    return round(value, _DIGITS) if math.isfinite(value) else None


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else math.nan
