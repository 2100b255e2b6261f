"""Classification of a disc fit."""

from __future__ import annotations

import math

from sunarc.detection.disc.fit import DiscFit
from sunarc.detection.disc.limits import (
    MAX_ELLIPTICITY,
    MAX_RADIUS_PX,
    MAX_RESIDUAL_FRACTION,
    MAX_SIGMA_PX,
    MAX_UNEVEN_PX,
    MIN_ACCEPTED_FRACTION,
    MIN_PEAK_FRACTION,
    MIN_RADIUS_PX,
    MIN_SNR,
    PSF_PX,
    PSF_TOLERANCE,
    VEILED_BELOW,
)
from sunarc.detection.disc.row_bands import is_foreign
from sunarc.detection.disc.search import semi_axes
from sunarc.detection.values import Detection, Expectation, Sensor, Verdict
from sunarc.findings import Finding

_MIN_CONTRAST = 0.15  # disc over its surroundings; below it, texture resembles a disc
_POSITION_TOLERANCE_PX = 1.0
_UNPREDICTED_LEVEL, _UNPREDICTED_RESIDUAL, _UNPREDICTED_SIGMA_PX = 0.08, 0.01, 0.016
_SIGNIFICANT = 16.0  # chi² of four parameters


def verdict_of(fit: DiscFit, *, expectation: Expectation | None, sensor: Sensor) -> tuple[Verdict, bool, Finding]:
    """Return the verdict, whether the position can be accepted, and what decided."""
    for check in (_no_disc, _misplaced, _covered, _uncertain):
        found = check(fit, expectation, sensor)
        if found is not None:
            return found[0], False, found[1]
    veil = _veil(fit, expectation, sensor)
    return ("clear", True, Finding("disc_found", {"chi2": fit.chi2})) if veil is None else ("veiled", True, veil)


def _no_disc(fit: DiscFit, expectation: Expectation | None, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    numbers = (fit.x_px, fit.y_px, fit.sigma_px, fit.level, fit.chi2, fit.snr)
    if not all(math.isfinite(number) for number in numbers) or not fit.converged:
        return "hidden", Finding("disc_not_converged")
    if fit.snr < MIN_SNR or fit.level < MIN_PEAK_FRACTION * sensor.full_scale:
        return "hidden", Finding("disc_below_noise", {"snr": fit.snr, "level": fit.level / sensor.full_scale})
    if fit.level < _MIN_CONTRAST * fit.background:
        return "hidden", Finding("disc_low_contrast", {"share": fit.level / max(fit.background, 1e-9)})
    psf_px = PSF_PX / sensor.binning
    deviation = abs(math.log(fit.psf_px / psf_px))
    if deviation > 4.0 * PSF_TOLERANCE:
        return "hidden", Finding("disc_edge_width", {"width_px": fit.psf_px, "expected_px": psf_px})
    return _unusual_size(fit, sensor) if expectation is None or expectation.stretch_px_per_rad is None else None


def _unusual_size(fit: DiscFit, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    minor, major = semi_axes(fit.stretch)
    axes = {"minor_px": minor, "major_px": major}
    if not MIN_RADIUS_PX <= minor * sensor.binning <= major * sensor.binning <= MAX_RADIUS_PX:
        return "hidden", Finding("disc_wrong_size", axes)
    if 1.0 - minor / major > MAX_ELLIPTICITY:
        return "partly_covered", Finding("disc_elongated", axes)
    return None


def _misplaced(fit: DiscFit, expectation: Expectation | None, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    if expectation is None:
        return _unlikely(fit, sensor)
    distance = math.hypot(fit.x_px - expectation.x_px, fit.y_px - expectation.y_px)
    if distance > _POSITION_TOLERANCE_PX + 5.0 * expectation.uncertainty_px:
        return "reflection", Finding("disc_displaced", {"distance_px": distance})
    return None


def _unlikely(fit: DiscFit, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    """Return why a disc without a prediction is rejected: the moon and small clouds are fainter or fit worse."""
    if fit.level < _UNPREDICTED_LEVEL * sensor.full_scale:
        return "hidden", Finding("disc_faint_unpredicted", {"level": fit.level / sensor.full_scale})
    poor = fit.residual > _UNPREDICTED_RESIDUAL or (fit.chi2 > 3.0 and fit.residual > 0.3 * _UNPREDICTED_RESIDUAL)
    if poor or fit.sigma_px > _UNPREDICTED_SIGMA_PX:
        return "hidden", Finding("disc_poor_fit", {"residual": fit.residual, "sigma_px": fit.sigma_px})
    return None


def is_flat(fit: DiscFit, flat: DiscFit | None) -> bool:
    """Return whether a disc of even brightness explains the pixels clearly better than a limb-darkened one."""
    return flat is not None and flat.chi2 * flat.used_px < fit.chi2 * fit.used_px - _SIGNIFICANT


def _covered(fit: DiscFit, expectation: Expectation | None, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    del expectation, sensor
    uneven_px = math.sqrt(max(fit.uneven, 0.0)) * fit.sigma_px
    if fit.uneven > _SIGNIFICANT and uneven_px > MAX_UNEVEN_PX:
        return "partly_covered", Finding("disc_uneven", {"uneven_px": uneven_px, "chi2": fit.uneven})
    if fit.residual > MAX_RESIDUAL_FRACTION:
        return "partly_covered", Finding("disc_residuals", {"residual": fit.residual, "chi2": fit.chi2})
    if is_foreign(*fit.bands):
        return "partly_covered", Finding("disc_foreign_rows", {"rows": fit.bands[0], "columns": fit.bands[1]})
    return None


def _uncertain(fit: DiscFit, expectation: Expectation | None, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    del expectation
    if fit.level < MIN_ACCEPTED_FRACTION * sensor.full_scale:
        return "veiled", Finding("disc_faint", {"level": fit.level / sensor.full_scale})
    if fit.sigma_px > MAX_SIGMA_PX:
        return "veiled", Finding("disc_position_uncertain", {"sigma_px": fit.sigma_px})
    return None


def _veil(fit: DiscFit, expectation: Expectation | None, sensor: Sensor) -> Finding | None:
    if expectation is not None and expectation.clear_peak_fraction:
        share = fit.level / sensor.full_scale / expectation.clear_peak_fraction
        if share < VEILED_BELOW:
            return Finding("disc_dimmed", {"share": share})
    contrast = fit.level / max(fit.level + fit.background, 1e-9)
    return Finding("disc_in_bright_sky", {"share": contrast}) if contrast < VEILED_BELOW else None


def detection_of(
    fit: DiscFit, verdict: tuple[Verdict, bool, Finding], *, sensor: Sensor, saturated_px: int
) -> Detection:
    """Return the detection of a classified fit."""
    name, accepted, finding = verdict
    minor, major = semi_axes(fit.stretch)
    left_out = (Finding("saturated_left_out", {"n": saturated_px}),) if accepted and saturated_px else ()
    return Detection(
        method="disc",
        accepted=accepted,
        verdict=name,
        findings=(finding, *left_out),
        x_px=fit.x_px,
        y_px=fit.y_px,
        sigma_px=fit.sigma_px,
        peak_fraction=(fit.level + max(fit.background, 0.0)) / sensor.full_scale,
        background_fraction=fit.background / sensor.full_scale,
        radius_px=math.sqrt(minor * major),
        ellipticity=1.0 - minor / max(major, 1e-9),
        residual_chi2=fit.chi2,
        snr=fit.snr,
        saturated_px=saturated_px,
    )
