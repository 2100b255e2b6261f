"""Uncertainty of a direction or a pixel.

The truth is camera plus field, the prediction is the camera with the field's mean as its displacement. The errors of
both are jointly Gaussian: the covariance of the prediction's error is J C J' + (cross terms) + (what is not known of
the field), see `Field`. Where the field has no part in the prediction it is unknown by its whole amplitude: the
estimate's error is uncorrelated with the data, so only the field's own block stays the prior's.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.optics import pose
from sunarc.optics.camera import PARAMETER_NAMES, POSE, Camera, camera_sees
from sunarc.optics.forward import by_direction, project, project_with_rows_fast, resolved_limit, tangent_basis
from sunarc.optics.inverse import unproject
from sunarc.sky.refraction import ASSUMED_AIR_SD, DAILY_AIR_SD, MEASURED_AIR_SD, raised, refraction_rad
from sunarc.sky.site import EARTH_RATE, Site, pole_enu

_CHUNK = 4096
_EARTH_RADIUS_M = 6_371_000.0
_HEMISPHERE = 1500
_FURTHEST_DEG = 180.0
_POLAR = 1.55
"""Latitude in radians beyond which east has no meaning."""


def project_with_covariance(calibration: Calibration, directions: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the pixels of directions, and their covariance.

    Parameters
    ----------
    calibration : the calibration.
    directions : (..., 3) unit vectors, east-north-up.

    Returns
    -------
    pixels : (..., 2) px; NaN beyond the camera's field, and where its 1-sigma is beyond its limit.
    covariance : (..., 2, 2) px²; NaN there too.
    """
    direction = np.asarray(directions, dtype=np.float64)
    flat, shape = direction.reshape(-1, 3), direction.shape[:-1]
    pixels, covariance, by_direction = _predict_with_covariance(calibration, flat)
    if calibration.sigma_limit_deg is not None:
        unsure = ~(_sigma_per_axis_deg(covariance, by_direction, flat) <= calibration.sigma_limit_deg)
        pixels[unsure], covariance[unsure] = np.nan, np.nan
    return pixels.reshape(*shape, 2), covariance.reshape(*shape, 2, 2)


def sun_with_covariance(
    calibration: Calibration, directions: ArrayLike, *, site: Site, measured: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the pixels of the sun, with the covariance from the camera and the refraction.

    Parameters
    ----------
    calibration : the calibration.
    directions : (..., 3) apparent unit vectors, east-north-up.
    site : gives pressure and temperature of the refraction.
    measured : whether these were measured on the day; else they are annual means.

    Returns
    -------
    pixels : (..., 2) px; NaN beyond the camera's field.
    covariance : (..., 2, 2) px²; NaN there too.
    """
    pixels, covariance = project_with_covariance(calibration, directions)
    share = MEASURED_AIR_SD if measured else math.hypot(ASSUMED_AIR_SD, DAILY_AIR_SD)
    # the refraction changes slowly with elevation: a shift by one standard deviation is linear enough
    shift = project(calibration.camera, raised(directions, share * refraction_rad(directions, site))) - pixels
    return pixels, covariance + shift[..., :, None] * shift[..., None, :]


def _predict_with_covariance(
    calibration: Calibration, directions: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pixels (n, 2), their covariance (n, 2, 2), and derivatives by the direction (n, 2, 3)."""
    pixels, covariance = np.empty((directions.shape[0], 2)), np.empty((directions.shape[0], 2, 2))
    by_direction = np.empty((directions.shape[0], 2, 3))
    for begin in range(0, directions.shape[0], _CHUNK):
        part = slice(begin, begin + _CHUNK)
        pixels[part], covariance[part], by_direction[part] = _predict_chunk(calibration, directions[part])
    return pixels, covariance, by_direction


def _predict_chunk(calibration: Calibration, directions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    pixels, by_parameters = project_with_rows_fast(calibration.camera, directions)
    indices = [PARAMETER_NAMES.index(name) for name in calibration.parameter_names]
    rows = np.ascontiguousarray(by_parameters[..., indices])
    size, field = len(indices), calibration.field
    # one large matrix product is several times faster than an einsum over all three factors
    weighted = (rows.reshape(2 * rows.shape[0], size) @ calibration.covariance).reshape(rows.shape)
    visible = np.all(np.isfinite(pixels), axis=-1)
    if field.amplitude_px > 0.0 and np.any(visible):
        both = field.covariance(rows, field.basis.values(np.where(visible[:, None], pixels, 0.0)))
    else:
        both = np.zeros((1, 2, 2))
    covariance = np.einsum("nap,nbp->nab", weighted, rows) + both
    # what the camera cannot see has no error either; zeros here would look like certainty
    covariance[~visible] = np.nan
    return pixels, covariance, by_direction(calibration.camera, by_parameters)


def unproject_with_sigma(calibration: Calibration, pixels: ArrayLike) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the directions of pixels, with their 1-sigma.

    Parameters
    ----------
    calibration : the calibration.
    pixels : (..., 2) px.

    Returns
    -------
    directions : (..., 3) unit vectors, east-north-up; NaN where no direction lands on the pixel, or its 1-sigma is
        beyond the calibration's limit.
    sigma_deg : (...) 1-sigma per axis on the sphere: the root of half the trace of the 2×2 covariance, degrees.
    inside : (...) whether the pixel lies within the image and the camera's field.
    """
    pixel = np.asarray(pixels, dtype=np.float64)
    directions = unproject(calibration.camera, pixel)
    inside = np.all(np.isfinite(directions), axis=-1) & camera_sees(calibration.camera, pixel)
    sigma = np.full(pixel.shape[:-1], np.nan)
    valid = np.all(np.isfinite(directions), axis=-1)
    if np.any(valid):
        sigma[valid] = sigma_deg(calibration, directions[valid])
    if calibration.sigma_limit_deg is not None:
        unsure = ~(sigma <= calibration.sigma_limit_deg)
        directions[unsure], sigma[unsure] = np.nan, np.nan
        inside = inside & ~unsure
    return directions, sigma, inside


def sigma_deg(calibration: Calibration, directions: FloatArray) -> FloatArray:
    """Return (n,): 1-sigma per axis on the sphere of directions (n, 3), degrees."""
    return uncertainties(calibration, directions)[1]


def uncertainties(calibration: Calibration, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return covariances (n, 2, 2) in px² and 1-sigma per axis on the sphere (n,) in degrees of directions (n, 3)."""
    _, covariance, by_direction = _predict_with_covariance(calibration, directions)
    return covariance, _sigma_per_axis_deg(covariance, by_direction, directions)


def _sigma_per_axis_deg(covariance: FloatArray, by_direction: FloatArray, directions: FloatArray) -> FloatArray:
    """Return (n,) degrees: 1-sigma per axis of directions (n, 3), whose pixels have covariances (n, 2, 2) px²."""
    on_sky = _map_to_tangent_plane(covariance, by_direction @ tangent_basis(directions))
    with np.errstate(invalid="ignore"):
        half_trace = np.maximum(0.5 * np.trace(on_sky, axis1=-2, axis2=-1), 0.0)
    return np.asarray(np.degrees(np.sqrt(half_trace)))


def direction_covariance(camera: Camera, directions: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return (n, 3, 3): covariances of unit vectors (n, 3), whose pixels have the covariances (n, 2, 2) px²."""
    _, by_parameters = project_with_rows_fast(camera, directions)
    basis = tangent_basis(directions)
    stretch = by_direction(camera, by_parameters) @ basis
    return np.asarray(basis @ _map_to_tangent_plane(covariance, stretch) @ np.swapaxes(basis, -1, -2))


def _map_to_tangent_plane(covariance: FloatArray, stretch: FloatArray) -> FloatArray:
    """Return (n, 2, 2) rad² on the tangent plane, from px² and px per radian; NaN where the lens hardly stretches."""
    (a, b), (c, d) = np.moveaxis(stretch, 0, -1)
    determinant = a * d - b * c
    with np.errstate(invalid="ignore", divide="ignore"):
        inverse = np.moveaxis(np.array([[d, -b], [-c, a]]), -1, 0) / determinant[:, None, None]
        on_sky = inverse @ covariance @ np.swapaxes(inverse, -1, -2)
        return np.where((np.abs(determinant) > 1e-9)[:, None, None], on_sky, np.nan)


def sigma_px(covariance: FloatArray) -> FloatArray:
    """Return (...): 1-sigma per axis, the root of half the trace of covariances (..., 2, 2)."""
    return np.asarray(np.sqrt(np.maximum(0.5 * np.trace(covariance, axis1=-2, axis2=-1), 0.0)))


def hemisphere(count: int = _HEMISPHERE) -> FloatArray:
    """Return directions spread evenly over the upper hemisphere, (count, 3)."""
    i = np.arange(count) + 0.5
    up = 1.0 - i / count
    # the golden angle: no two turns align, so the directions have no rows
    azimuth = math.pi * (1.0 + math.sqrt(5.0)) * i
    horizontal = np.sqrt(1.0 - up**2)
    return np.stack([horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), up], axis=-1)


_SAME = 1e-6
"""1 minus the cosine of directions that are the same."""


def seen_sky(camera: Camera) -> FloatArray:
    """Return directions (n, 3) spread evenly over the part of the upper hemisphere that a camera sees.

    Beyond the angle at which decentering outgrows the radius directions land in the image a second time: not counted.
    """
    directions = hemisphere()
    pixels = project(camera, directions)
    visible = camera_sees(camera, pixels)
    shown, directions = unproject(camera, pixels[visible]), directions[visible]
    return np.asarray(directions[np.sum(shown * directions, axis=-1) > 1.0 - _SAME])


def sky_sigma_deg(calibration: Calibration) -> tuple[float, float]:
    """Return the root mean square and the maximum 1-sigma over the part of the sky that the camera resolves, degrees.

    Neither is above 180: no direction can be further off, and a linear error may say so. The edge where a lens stops
    resolving angles is left out: the linear error has no bound there, whatever the calibration, and no part in others.
    """
    seen = seen_sky(replace(calibration.camera, max_angle=resolved_limit(calibration.camera)))
    sigma = sigma_deg(calibration, seen) if seen.size else np.array([np.nan])
    sigma = sigma[np.isfinite(sigma)]
    if sigma.size == 0:
        return math.nan, math.nan
    sigma = np.minimum(sigma, _FURTHEST_DEG)
    return float(np.sqrt(np.mean(sigma**2))), float(np.max(sigma))


def sky_share_within(calibration: Calibration, limit_deg: float) -> float:
    """Return the share of the sky seen in which the 1-sigma is at most a limit; NaN where no sky is seen."""
    seen = seen_sky(calibration.camera)
    return float(np.mean(sigma_deg(calibration, seen) <= limit_deg)) if seen.size else math.nan


def replace_covariance(calibration: Calibration, covariance: FloatArray) -> Calibration:
    """Return a calibration whose parameters have another covariance (p, p), by errors independent of the others."""
    changed = replace(calibration, covariance=covariance)
    if calibration.mixture is None:
        return changed
    directions = unproject(calibration.camera, calibration.mixture.pixels_px)
    before, after = (
        np.trace(project_with_covariance(one, directions)[1], axis1=1, axis2=2) for one in (calibration, changed)
    )
    with np.errstate(invalid="ignore"):
        ratio = np.where(before < after, before / after, 1.0)
    return replace(changed, mixture=calibration.mixture.beside(ratio))


def pose_error(camera: Camera, site: Site, *, clock_error_s: float, site_error_m: float) -> FloatArray:
    """Return (3, 3): covariance of the rotation vector from errors that no residual shows.

    A clock that is wrong turns the sky about the pole; a position that is wrong tilts the ground. Both are taken up
    by the pose without trace.

    Parameters
    ----------
    camera : gives the pose.
    site : where it stands.
    clock_error_s : 1-sigma of the clock, s.
    site_error_m : 1-sigma of the position along each axis, m.
    """
    latitude, pole = math.radians(site.latitude), pole_enu(site)
    enu_covariance = (EARTH_RATE * clock_error_s) ** 2 * np.outer(pole, pole)
    # an eastward error turns about the pole: up by tan(latitude) of what it turns about north
    eastward = np.array([0.0, 1.0, math.tan(latitude) if abs(latitude) < _POLAR else 0.0])
    enu_covariance += (site_error_m / _EARTH_RADIUS_M) ** 2 * (np.diag([1.0, 0.0, 0.0]) + np.outer(eastward, eastward))
    return rotation_covariance(camera, enu_covariance)


def without_clock(calibration: Calibration) -> Calibration:
    """Return a calibration without the clock's error that is stated for all of its sightings.

    Sightings by the same clock have the same error: between two fits of one camera, and where the next sighting is,
    it plays no part.
    """
    beyond_s = calibration.evidence.clock_beyond_s
    if beyond_s == 0.0:
        return calibration
    covariance = calibration.covariance.copy()
    covariance[POSE, POSE] -= pose_error(calibration.camera, calibration.site, clock_error_s=beyond_s, site_error_m=0.0)
    rms = calibration.sky_rms_without_clock_deg
    return replace(
        calibration,
        covariance=covariance,
        sky_rms_deg=calibration.sky_rms_deg if rms is None else rms,
        evidence=replace(calibration.evidence, clock_beyond_s=0.0),
    )


def rotation_covariance(camera: Camera, enu_covariance: FloatArray) -> FloatArray:
    """Return (3, 3): covariance of the rotation vector where that of small turns about east, north and up is given."""
    to_vector = np.linalg.inv(pose.right_jacobian(camera.rotation_cam_enu))
    return np.asarray(to_vector @ enu_covariance @ to_vector.T)
