"""By how much the centres of stars are displaced against the sun's: coma, which a Gaussian fit takes up in part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.star_views import MatchedView, StarView
from sunarc.robust_statistics import biweights, mad_sigma
from sunarc.workers.night.named_stars import BENT_PX

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
        size = _powers(far[:, 0] / self.radius) @ self.coefficients
        return np.asarray(size[:, None] * outwards / np.maximum(far, 1e-9))

    @property
    def largest_px(self) -> float:
        """The largest displacement within the radius, px."""
        return float(np.max(np.abs(_powers(np.linspace(0.0, 1.0, 101)) @ self.coefficients)))


def radial_offset(
    pixels: FloatArray, predicted: FloatArray, *, sigma_px: FloatArray, centre: FloatArray
) -> RadialOffset:
    """Return how far the stars lie outside of their predicted places, as a function of the radius.

    The sun crosses every radius: what its calibration says of the radius counts, and of the stars only the rest. Where
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
    design, sure = _powers(far / radius), 1.0 / (sigma_px**2 + _SURE_PX**2)
    weight = sure
    for _ in range(_ROUNDS):
        rows = np.sqrt(weight)
        coefficients = np.linalg.lstsq(design * rows[:, None], along * rows, rcond=None)[0]
        residual = along - design @ coefficients
        weight = sure * biweights(residual / (4.0 * max(mad_sigma(residual), 1e-3)))
    return RadialOffset(centre=centre, radius=radius, coefficients=np.asarray(coefficients))


def offset_of(views: Sequence[StarView], matched: Sequence[MatchedView], calibration: Calibration) -> RadialOffset:
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


def _powers(ratio: FloatArray) -> FloatArray:
    return np.stack([ratio**power for power in _POWERS], axis=-1)
