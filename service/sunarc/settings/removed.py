"""Settings of 0.2.0 that went away, each with what replaces it.

The fields of the rooms' options that are named here are for Python only: tests and studies vary them.
"""

from __future__ import annotations

_CONSTANT = "remove it: it is now a constant"
_REMEDIES: dict[str, tuple[str, ...]] = {
    f"{_CONSTANT} (1 s after the end of the exposure)": ("camera.answer_timeout_s",),
    f"{_CONSTANT} of the detection; behind a dark filter set detection.clear_level_per_us": (
        "detection.faintest_level_per_us",
        "detection.faintest_share",
    ),
    f"{_CONSTANT} of the detection, for any lens": (
        "detection.limb_darkening",
        "detection.max_apparent_zenith_deg",
        "detection.max_ellipticity",
        "detection.max_radius_px",
        "detection.max_residual_fraction",
        "detection.max_sigma_px",
        "detection.max_uneven_px",
        "detection.min_accepted_fraction",
        "detection.min_peak_fraction",
        "detection.min_radius_px",
        "detection.min_snr",
        "detection.psf_px",
        "detection.psf_tolerance",
        "detection.saturation_fraction",
        "detection.solar_radius_deg",
        "detection.veiled_below",
        "detection.wings_tolerance",
    ),
    f"{_CONSTANT} (composites are made until the end of civil twilight, 96 degrees)": ("capture.daylight_zenith_deg",),
    f"{_CONSTANT} (a frame is tried twice; a lost camera is opened again after 1 s, doubled up to 30 s)": (
        "capture.attempts",
        "capture.reopen_after_s",
        "capture.reopen_at_most_s",
    ),
    f"{_CONSTANT} of the control; set sun_exposure.target_low, target_high and first_us": (
        "sun_exposure.bracket_ratio",
        "sun_exposure.lost_after",
        "sun_exposure.low_sun_zenith_deg",
        "sun_exposure.max_change",
        "sun_exposure.spoiled_after",
        "sun_exposure.steady_after",
    ),
    f"{_CONSTANT}; set clock.step_s and clock.assumed_error_s": (
        "clock.check_every_s",
        "clock.least_error_s",
        "clock.show_step_s",
    ),
    "remove it: whether the lens was fitted belongs to the provenance of a calibration; to fit a pose alone, use "
    "sunarc calibrate --pose-only": ("calibration.free",),
    f"{_CONSTANT} of the fit and of its acceptance": (
        "calibration.field_floor_px",
        "calibration.max_angle_deg",
        "calibration.max_below_horizon",
        "calibration.max_rejected",
        "calibration.max_rmse_px",
        "calibration.max_sky_deg",
        "calibration.max_unexplained",
        "calibration.site_error_m",
    ),
    f"{_CONSTANT}: the 1-sigma priors of a lens are in docs/maths.md": (
        "calibration.tolerances.aspect_px",
        "calibration.tolerances.center_fraction",
        "calibration.tolerances.circle_center_px",
        "calibration.tolerances.circle_focal_length_px",
        "calibration.tolerances.decentering_higher",
        "calibration.tolerances.decentering_px",
        "calibration.tolerances.focal_length_fraction",
        "calibration.tolerances.radial_length_deg",
        "calibration.tolerances.radial_px",
        "calibration.tolerances.skew_px",
    ),
    f"{_CONSTANT} of the paper's method": (
        "calibration.paper.circularity_weight",
        "calibration.paper.ellipse_scope",
        "calibration.paper.fit_translation",
        "calibration.paper.monotony_weight",
        "calibration.paper.orthogonality_weight",
        "calibration.paper.pose_start",
    ),
    f"{_CONSTANT} of the selection of sightings": (
        "refit.selection.most",
        "refit.selection.most_per_epoch",
        "refit.selection.most_per_patch",
        "refit.selection.patch_deg",
    ),
    f"{_CONSTANT} (2 s)": ("days.largest_clock_error_s", "refit.selection.largest_clock_error_s"),
    f"{_CONSTANT} of the verdict on a day": (
        "days.clear_sd_px",
        "days.clear_share",
        "days.doubtful_share",
        "days.partly_share",
        "days.smallest_arc_deg",
        "days.smallest_count",
    ),
    f"{_CONSTANT} of the change detection; set watch.wander_deg": (
        "watch.least_agreeing",
        "watch.least_gain",
        "watch.wander_hours",
    ),
    f"{_CONSTANT} (5 s)": ("disk.check_every_s",),
    f"{_CONSTANT} of the web server; set api.requests_per_s": (
        "api.burst",
        "api.max_array_bytes",
        "api.max_at_once",
        "api.max_body_bytes",
        "api.max_connections",
        "api.max_large_at_once",
        "api.max_points",
        "api.max_rows",
        "api.request_within_s",
    ),
    f"{_CONSTANT} (a worker that dies 6 times within 600 s has failed)": (
        "supervisor.max_restarts",
        "supervisor.within_s",
    ),
}

REMOVED: dict[str, str] = {name: remedy for remedy, names in _REMEDIES.items() for name in names}
"""Dotted path of a setting that went away -> what to do instead."""
