"""The named stars of a night: those that become sightings, their offset, and their numbers of the sky."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray
from sunarc.common.robust_statistics import biweights, mad_sigma
from sunarc.common.utc import utc_time
from sunarc.detection.stars import photometry
from sunarc.detection.values import FWHM, Stars
from sunarc.imager.archive.values import NightBand, NightSeries
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.night import FAINTEST_V
from sunarc.sky.site import relative_air_mass
from sunarc.stars.views import BENT_PX, MatchedView, StarView

_POWERS = (1, 2, 3)
_FEWEST = 60
_SURE_PX = 0.02
"""1-sigma of a prediction that counts in full."""
_ROUNDS = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RadialOffset:
    """A displacement along the radius, a polynomial of it.

    Attributes
    ----------
    centre : (2,) px.
    radius : of the farthest star that it rests on, px.
    coefficients : (3,) px, of the first to third power of the radius over `radius`.
    """

    centre: FloatArray
    radius: float
    coefficients: FloatArray

    def at(self, pixels: FloatArray) -> FloatArray:
        """Return the displacements (n, 2) px at pixels (n, 2)."""
        outwards = pixels - self.centre
        far = np.linalg.norm(outwards, axis=-1, keepdims=True)
        size = _radius_powers(far[:, 0] / self.radius) @ self.coefficients
        return np.asarray(size[:, None] * outwards / np.maximum(far, 1e-9))

    @property
    def largest_px(self) -> float:
        """The largest displacement within the radius, px."""
        return float(np.max(np.abs(_radius_powers(np.linspace(0.0, 1.0, 101)) @ self.coefficients)))


def radial_offset(
    pixels: FloatArray, predicted: FloatArray, *, sigma_px: FloatArray, centre: FloatArray
) -> RadialOffset:
    """Return how far the stars lie outside of their predicted places, as a function of the radius.

    The sun crosses every radius: its calibration's radius counts, and of the stars only the rest. Where
    the prediction is sure (near the sun's way) a star counts most. Without enough stars there is no offset.

    Parameters
    ----------
    pixels, predicted : (n, 2) px, of named stars.
    sigma_px : (n,) of the predictions.
    centre : (2,) the principal point, px.
    """
    outwards = predicted - centre
    far = np.linalg.norm(outwards, axis=-1)
    radius = max(float(np.max(far, initial=0.0)), 1.0)
    if far.size < _FEWEST:
        return RadialOffset(centre=centre, radius=radius, coefficients=np.zeros(len(_POWERS)))
    along = np.sum((pixels - predicted) * outwards, axis=-1) / np.maximum(far, 1e-9)
    design, sure = _radius_powers(far / radius), 1.0 / (sigma_px**2 + _SURE_PX**2)
    weight = sure
    for _ in range(_ROUNDS):
        rows = np.sqrt(weight)
        coefficients = np.linalg.lstsq(design * rows[:, None], along * rows, rcond=None)[0]
        residual = along - design @ coefficients
        weight = sure * biweights(residual / (4.0 * max(mad_sigma(residual), 1e-3)))
    return RadialOffset(centre=centre, radius=radius, coefficients=np.asarray(coefficients))


def measure_radial_offset(
    views: Sequence[StarView], matched: Sequence[MatchedView], calibration: Calibration
) -> RadialOffset:
    """Return by how much the unclipped stars of a night lie outside of their predicted places."""
    pixels, predicted, sigma = [np.zeros((0, 2))], [np.zeros((0, 2))], [np.zeros(0)]
    for view, found in zip(views, matched, strict=True):
        stars, star = found.stars.select(found.matches.detection), found.matches.star
        sound = stars.sound
        pixels.append(stars.pixels[sound])
        predicted.append(view.predicted.pixels[star][sound])
        own = np.maximum(view.predicted.sigma_px[star][sound] ** 2 - BENT_PX**2, 0.0)
        sigma.append(np.sqrt(own))
    return radial_offset(
        np.concatenate(pixels),
        np.concatenate(predicted),
        sigma_px=np.concatenate(sigma),
        centre=np.array(calibration.camera.principal_point_px),
    )


def _radius_powers(ratio: FloatArray) -> FloatArray:
    return np.stack([ratio**power for power in _POWERS], axis=-1)


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
    """Extinction of the air, change from the beginning of the night to its end, and the stars' shape; NaN: not known.

    `bands` are by zenith angle, `images` of each image; None without one.
    """

    air: photometry.Extinction
    trend: photometry.NightTrend
    star_ellipticity: float
    halo: float
    bands: tuple[NightBand, ...]
    images: NightSeries | None


MOST_BRIGHTER_MAG = 0.5
"""By so much an image's zero point may exceed the night's; clouds and haze only lower it."""


def exposed_longer(taken: Sequence[TakenImage], before: Sequence[float]) -> dict[int, float]:
    """Return the images whose stars are brighter than their stated exposure allows, and by how many magnitudes.

    The camera exposed them for longer than it states, so the middle of the exposure is not where it is taken to be: an
    exposure of 160 s that is stated as 10 s displaces its stars by 0.3 degrees.

    Parameters
    ----------
    taken : the images of the night.
    before : zero points of the last nights: one below tonight's does not count, as a dome is cleaned.
    """
    named = [row for row, one in enumerate(taken) if one.found.matches.accepted]
    light = [
        _measure_star_light(taken[row], math.inf) for row in named
    ]  # the bright ones are clipped in a longer exposure
    zero_points = photometry.fit_extinction(light, photometry.ZENITH_BANDS_DEG).zero_point
    known = [
        number for number in (_known_median(zero_points), _known_median(np.array(before))) if math.isfinite(number)
    ]
    brighter = zero_points - max(known, default=math.nan)
    return {row: float(by) for row, by in zip(named, brighter, strict=True) if by > MOST_BRIGHTER_MAG}


def night_numbers(taken: Sequence[TakenImage]) -> NightNumbers:
    """Return the numbers of a night; only images whose stars were named say something of the sky."""
    named = [one for one in taken if one.found.matches.accepted]
    air = photometry.fit_extinction([_measure_star_light(one) for one in named], photometry.ZENITH_BANDS_DEG)
    zero_points = dict(zip(map(id, named), air.zero_point.tolist(), strict=True))
    images = [_image_numbers(one, zero_points.get(id(one), math.nan)) for one in taken]
    columns = {name: np.array([image[name] for image in images]) for name in images[0]} if images else {}
    trend = photometry.night_trend(*(columns.get(name, np.zeros(0)) for name in ("star_fwhm_px", "halo", "zero_point")))
    return NightNumbers(
        air=air,
        trend=trend,
        star_ellipticity=_known_median(columns.get("star_ellipticity", np.zeros(0))),
        halo=_known_median(columns.get("halo", np.zeros(0))),
        bands=_make_bands(named, air),
        images=_make_series(taken, columns) if taken else None,
    )


def cloud_fraction(view: StarView) -> float:
    """Return the share of the predicted stars to V 4 that have no detection."""
    counted = view.predicted.magnitude <= COUNTED_TO_V
    found = photometry.detected(view.stars, view.predicted)
    return 1.0 - float(np.mean(found[counted])) if np.any(counted) else math.nan


_CLEAR_CLOUDS = 0.25
"""Cloud fraction of an image up to which a bright star that is not found is behind something else than a cloud."""


def seen_and_missed(views: Sequence[StarView], matched: Sequence[MatchedView]) -> tuple[FloatArray, FloatArray]:
    """Return the directions (n, 3) of a night's named stars, and of bright stars not detected in clear images."""
    seen, missed = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for view, found in zip(views, matched, strict=True):
        if not found.matches.accepted:
            continue
        seen.append(found.directions(view))
        if cloud_fraction(view) <= _CLEAR_CLOUDS:
            bright = view.predicted.magnitude <= COUNTED_TO_V
            missed.append(view.predicted_directions[bright & ~photometry.detected(view.stars, view.predicted)])
    return np.concatenate(seen), np.concatenate(missed)


def estimate_limit(view: StarView) -> float:
    """Return the V at which half as many stars are detected as of the bright ones, 5.5 at most."""
    listed = view.predicted.magnitude <= FAINTEST_V
    found = photometry.detected(view.stars, view.predicted)
    return photometry.limiting_magnitude(view.predicted.magnitude[listed], found[listed])


def _image_numbers(one: TakenImage, zero_point: float) -> dict[str, float]:
    stars = _select_with_own_shape(one)
    named = one.found.matches.accepted
    return {
        "cloud_fraction": cloud_fraction(one.view) if named else 1.0,
        "limiting_magnitude": estimate_limit(one.view) if named else math.nan,
        "star_fwhm_px": FWHM * _known_median(stars.width_px),
        "star_ellipticity": _known_median(stars.ellipticity),
        "halo": one.halo,
        "zero_point": zero_point,
    }


def _select_with_own_shape(one: TakenImage) -> Stars:
    """Return the named stars that are bright enough for a shape of their own."""
    stars = one.found.stars.select(one.found.matches.detection)
    return stars.select(stars.sound & (stars.snr > _OWN_SHAPE_SNR))


def _measure_star_light(one: TakenImage, to_v: float = COUNTED_TO_V) -> photometry.StarLight:
    """Return the photometry of the named, unclipped stars down to a magnitude."""
    stars = one.found.stars.select(one.found.matches.detection)
    zenith, _ = angles_from_direction(one.found.directions(one.view))
    magnitude = one.view.sky.magnitude[one.view.sky.find_rows(one.found.names(one.view))]
    used = stars.sound & (magnitude < to_v)
    return photometry.StarLight(
        zenith_deg=zenith[used],
        air_mass=relative_air_mass(zenith[used]),
        magnitude=magnitude[used],
        rate=stars.flux[used] / one.exposure_s,
    )


def _make_bands(named: Sequence[TakenImage], air: photometry.Extinction) -> tuple[NightBand, ...]:
    """Return the bands of zenith angle: stars to V 4 that were predicted and found, and the share of their light."""
    zenith, found = [np.zeros(0)], [np.zeros(0, dtype=np.bool_)]
    for one in named:
        predicted = one.view.predicted
        counted = predicted.magnitude <= COUNTED_TO_V
        directions = one.view.sky.directions[one.view.sky.find_rows(predicted.names.tolist())]
        zenith.append(np.asarray(angles_from_direction(directions)[0])[counted])
        found.append(photometry.detected(one.view.stars, predicted)[counted])
    bands = photometry.zenith_bands(np.concatenate(zenith), np.concatenate(found))
    return tuple(
        NightBand(**asdict(band), transparency=_round_number(share))
        for band, share in zip(bands, air.transparency.tolist(), strict=True)
    )


def _make_series(taken: Sequence[TakenImage], columns: dict[str, FloatArray]) -> NightSeries:
    """Return the columns of at most 72 images, None where a number is not known."""
    rows = np.unique(np.linspace(0, len(taken) - 1, min(len(taken), _MOST_IMAGES)).astype(int)).tolist()
    known = {name: tuple(_round_number(float(column[row])) for row in rows) for name, column in columns.items()}
    return NightSeries(
        time=tuple(utc_time(taken[row].view.unix_s).replace(microsecond=0) for row in rows),
        n_matched=tuple(int(taken[row].found.matches.star.size) for row in rows),
        **known,
    )


def _round_number(value: float) -> float | None:
    return round(value, _DIGITS) if math.isfinite(value) else None


def _known_median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else math.nan
