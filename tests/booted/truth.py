"""Compares what the service stored and serves with the camera that the simulated imager truly is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.formats.calibration_document import from_document
from sunarc.lab.simulation.truth import true_camera
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]

_EARTH_RATE_DEG_S = 15.041 / 3600.0
_SIGMAS = 6.0
"""Of the distance from the truth, in units of a sighting's own 1-sigma along both axes; 1 in 6e7 is farther off."""
_SLACK_PX = 0.05
"""Beside it, in px of the sensor: the disc, the PSF and the low sun's refraction are not modelled to better."""
_SKY_FACTOR = 3.0
"""RMS error over the sky, in units of the stated RMS, from which a calibration is served worse than stated."""
_SKY_FLOOR_DEG = 0.002


def true_pixels(directions: FloatArray, *, binning: int) -> FloatArray:
    """Return where directions (..., 3) are imaged, in px (..., 2) of an image of binned pixels.

    The centre of the top-left pixel is (0, 0) in either image, that is ((binning - 1)/2, (binning - 1)/2) of the
    sensor's pixels for a binned one.
    """
    return np.asarray((project(true_camera(), directions) - (binning - 1) / 2.0) / binning)


def wrong_sightings(rows: FloatArray, *, site: Site, binning: int) -> list[str]:
    """Return the sightings that are farther from the truth than they state.

    Parameters
    ----------
    rows : (n, 5) unix time in microseconds, x and y in px, 1-sigma in px, bound of the clock's error in seconds.
    site : of the camera.
    binning : of the image.
    """
    times, pixels, sigma_px, clock_s = rows[:, 0] / 1e6, rows[:, 1:3], rows[:, 3], rows[:, 4]
    off = np.linalg.norm(pixels - true_pixels(sun_directions(times, site), binning=binning), axis=-1)
    px_per_s = np.radians(_EARTH_RATE_DEG_S) * max(true_camera().focal_length_px) / binning
    allowed = _SIGMAS * sigma_px * np.sqrt(2.0) + clock_s * px_per_s + _SLACK_PX / binning
    found = zip(times, off, allowed, strict=True)
    return [f"{time:.3f}: {far:.3f} px off, {most:.3f} allowed" for time, far, most in found if far > most]


def worse_than_stated(document: Mapping[str, Any], *, binning: int) -> str:
    """Return by how much a calibration is worse over the sky than it states; "" where it is not."""
    directions = hemisphere(600)
    pixels, _ = project_with_covariance(from_document(document), directions)
    off = pixels - true_pixels(directions, binning=binning)
    off = off[np.all(np.isfinite(off), axis=-1)]
    rms_px = np.sqrt(np.mean(np.sum(off**2, axis=-1)))
    error_deg = float(np.degrees(rms_px * binning / max(true_camera().focal_length_px)))
    stated_deg = float(document["uncertainty"]["sky_rms_deg"]) * np.sqrt(2.0)
    if error_deg <= _SKY_FACTOR * max(stated_deg, _SKY_FLOOR_DEG):
        return ""
    return f"{document['id']}: {error_deg:.4f} degrees over the sky, {stated_deg:.4f} stated"
