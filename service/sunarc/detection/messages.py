"""The messages of detections: why an image shows the sun, why not, and why a position is rejected."""

from __future__ import annotations

from collections.abc import Iterable

from sunarc.common.findings import Finding, Message, Messages

_ACCEPTED = "Accepted."
_NO_SUN = "No sun in this image."
_REJECTED = "A position is given and not used."
_NO_STARS = "No star of this image is used."
_NO_MOON = "The moon of this image is not used."
_BETTER_START = "check the clock, the site and the calibration that predicts the stars"
_BY_RIM = "The bright region is not the sun, or too little of it is seen; a position is given and not used."
_PREDICT = "none: a prediction from a calibration decides"
_FILTER = "set detection.clear_level_per_us if there is a filter before the lens"

MESSAGES = Messages(
    # accepted discs
    disc_found=Message("a disc was fitted, reduced chi² {chi2:.2f}", _ACCEPTED),
    disc_dimmed=Message("{share:.2f} of the clear sun's brightness", "Accepted as veiled."),
    disc_in_bright_sky=Message("{share:.2f} of the light comes from the disc", "Accepted as veiled."),
    saturated_left_out=Message("{n} saturated pixels left out", "The disc was fitted without them."),
    bracket_mean=Message("mean of {frames} frames (chi² {chi2:.1f}, {freedom} degrees of freedom)", _ACCEPTED),
    # rejected discs
    disc_not_converged=Message("the disc fit did not converge", _NO_SUN),
    disc_below_noise=Message("no disc: signal-to-noise {snr:.1f}, level {level:.4f} of full scale", _NO_SUN),
    disc_low_contrast=Message("no disc: only {share:.2f} of its surroundings' level", _NO_SUN),
    disc_edge_width=Message("no disc: its edge is {width_px:.2f} px wide, not {expected_px:.2f}", _NO_SUN),
    disc_wrong_size=Message("no disc of the sun's size: semi-axes {minor_px:.2f} and {major_px:.2f} px", _NO_SUN),
    disc_too_few_pixels=Message("too few pixels for a fit", _NO_SUN),
    disc_too_long=Message("the bright region is {length_px:.0f} px long, no disc", _NO_SUN),
    disc_saturated=Message(
        "{n} pixels around the sun are saturated", _NO_SUN, "none: the service takes a shorter exposure next"
    ),
    disc_elongated=Message("semi-axes {minor_px:.2f} and {major_px:.2f} px", _REJECTED),
    disc_displaced=Message("a disc {distance_px:.1f} px from where the sun should be", _REJECTED),
    disc_faint_unpredicted=Message(
        "level {level:.3f} of full scale: too faint to be accepted without a prediction", _REJECTED
    ),
    disc_poor_fit=Message("poor disc fit: residuals {residual:.3f} of its level, sigma {sigma_px:.3f} px", _REJECTED),
    disc_without_limb=Message("a disc without the sun's darker limb: the moon, or a lamp", _REJECTED),
    disc_uneven=Message(
        "a brightness gradient across the disc moves its centre by {uneven_px:.2f} px (at most {limit_px:g} px; chi² "
        "{chi2:.0f} with 4 degrees of freedom, at most {limit_chi2:g})",
        _REJECTED,
    ),
    disc_foreign_rows=Message(
        "rows of another image (chi² {rows:.0f}, 2 degrees of freedom; columns {columns:.0f}): lost packets were "
        "replaced by those of another frame, or an edge parallel to the rows covers the sun",
        _REJECTED,
        "look at the network, so that no packet has to be sent again, and at the camera's firmware",
    ),
    disc_residuals=Message("residuals {residual:.3f} of the disc's level, reduced chi² {chi2:.1f}", _REJECTED),
    disc_faint=Message("level {level:.3f} of full scale: a covered disc would look the same", _REJECTED),
    disc_position_uncertain=Message("position uncertain: sigma {sigma_px:.3f} px", _REJECTED),
    disc_below_clear_sun=Message("{share:.1e} of the clear sun's brightness: the moon, or a lamp", _REJECTED, _FILTER),
    disc_below_faintest=Message(
        "{level:.1e} of full scale in 1 µs: the moon, a lamp, or the sun behind a filter that is not in the settings",
        _REJECTED,
        _FILTER,
    ),
    disc_rivals=Message("other regions are as bright, at {places}: reflections or clouds", _REJECTED),
    bracket_covered=Message("sun covered in another frame of the bracket", _REJECTED),
    bracket_inconsistent=Message(
        "the frames of the bracket are inconsistent: mean of {frames} frames (chi² {chi2:.1f}, {freedom} degrees of "
        "freedom)",
        _REJECTED,
    ),
    # frames without a disc
    sun_below_horizon=Message("the sun is at {zenith_deg:.2f} degrees from the zenith", _NO_SUN),
    sun_outside_image=Message("the sun is outside the image", _NO_SUN),
    sun_obstructed=Message("dark at {level:.5f} of full scale where the sky around has {sky:.5f}", _NO_SUN),
    no_bright_region=Message("no region brighter than {least:g} of full scale; only single pixels", _NO_SUN),
    no_outstanding_region=Message("no region stands out: the brightest is at {level:.3f}", _NO_SUN),
    # ordinary images
    blob_found=Message("a bright region of {diameter_px:.0f} px, round in {share:.2f} of the directions", _ACCEPTED),
    stack_mean=Message("mean of {frames} exposures, reduced chi² {chi2:.1f}", _ACCEPTED),
    stack_member=Message("an exposure of a stack whose sighting is that of {file}", "Used there."),
    disc_without_glare=Message("a disc in short exposures, and no glare of the sun about it in longer ones", _NO_SUN),
    image_dark=Message("the brightest pixel is {peak:.2f} of full scale", _NO_SUN),
    image_saturated=Message(
        "the median of the image is {level:.2f} of full scale (at most {limit:.2f} allowed)",
        _NO_SUN,
        "take shorter exposures",
    ),
    no_round_region=Message("no bright region is round", _NO_SUN),
    blob_displaced=Message("a round bright region {distance_px:.0f} px from where the sun should be", _REJECTED),
    blob_edged=Message(
        "edge sharper than the sun's (white surface or lamp): {near:.2f} of its level at 1.7 radii, {far:.2f} at 2.6",
        _BY_RIM,
    ),
    blob_flat=Message(
        "no brighter than its surroundings: {near:.2f} of its level at 1.7 radii, {far:.2f} at 2.6", _BY_RIM
    ),
    blob_not_clipped=Message("only {flat:.2f} of the region is saturated: bright cloud looks alike", _BY_RIM, _PREDICT),
    blob_off_glare=Message("{distance_px:.0f} px from the middle of the glare", _BY_RIM, _PREDICT),
    blob_elongated=Message(
        "too elongated for the sun: its axes differ by {ellipticity:.2f} of the larger one", _BY_RIM, _PREDICT
    ),
    blob_wide=Message(
        "too large for the sun: its radius is {radius:.2f} of the image's smaller side", _BY_RIM, _PREDICT
    ),
    blob_not_alone=Message(
        "other regions are as bright: {area:.1%} of the image (of the square of its smaller side)", _BY_RIM, _PREDICT
    ),
    blob_one_sided=Message("the rim is circular in {share:.2f} of the directions only ({limit:.2f} needed)", _BY_RIM),
    blob_uneven=Message("rim uneven by {scatter:.3f} of its radius", _BY_RIM),
    blob_centre_uncertain=Message("centre known to {sigma_px:.1f} px only", _BY_RIM),
    # images of the night
    stars_matched=Message(
        "{n} stars; {explained:.2f} of the bright detections are stars, {found:.2f} of the bright stars are detected",
        _ACCEPTED,
    ),
    stars_prediction_uncertain=Message(
        "pixels are predicted to {sigma_px:.1f} px: chance would match as many stars", _NO_STARS, _BETTER_START
    ),
    stars_few=Message("{n} stars found, {limit} needed ({detected} detections)", _NO_STARS),
    stars_not_explained=Message(
        "only {share:.2f} of the bright detections are predicted stars, {limit} needed", _NO_STARS, _BETTER_START
    ),
    stars_not_found=Message(
        "only {share:.2f} of the predicted bright stars are detected where the sky is clear, {limit} needed",
        _NO_STARS,
        _BETTER_START,
    ),
    stars_years_apart=Message(
        "taken {days:.0f} days from the night of {date} that gave the camera, which may have been moved since",
        "Its stars are identified where they match; the camera is that of the other night.",
        "give the images of each year by themselves",
    ),
    stars_one_sided=Message("{gap_deg:.0f} degrees of azimuth without a star, {limit:.0f} allowed", _NO_STARS),
    stars_brightness=Message(
        "brightness of detections and stars differs: correlation {correlation:.2f}, {limit:.2f} needed",
        _NO_STARS,
        _BETTER_START,
    ),
    stars_scattered=Message(
        "the stars scatter by {scatter_px:.2f} px within a search of {radius_px:.1f} px", _NO_STARS, _BETTER_START
    ),
    stars_flipped=Message(
        "with {flip} {n} stars match: the image is stored otherwise than those of the calibration",
        "In addition to the reason for which the image is refused.",
        "store the images of night and day alike (FITS files begin with the lowest row or with the highest one); or "
        "give a calibration of such images",
    ),
    moon_found=Message("the moon, reduced chi² {chi2:.2f}, sigma {sigma_px:.3f} px", _ACCEPTED),
    moon_hazy=Message("the sky beside the moon has {haze:.3f} of its light: haze", "Accepted with a larger sigma."),
    moon_thin=Message("{lit:.3f} of the moon's disc is lit, {limit} needed", _NO_MOON),
    moon_not_found=Message(
        "no moon within four times {sigma_px:.1f} px of its predicted place", _NO_MOON, _BETTER_START
    ),
    moon_saturated=Message(
        "{n} pixels of the moon are saturated", _NO_MOON, "none: the service takes a shorter exposure next"
    ),
    moon_displaced=Message(
        "{distance_px:.1f} px from the predicted place, {limit_px:.1f} allowed", _NO_MOON, _BETTER_START
    ),
    moon_in_cloud=Message("the sky beside the moon has {haze:.2f} of its light, {limit} allowed: cloud", _NO_MOON),
    moon_other_shape=Message(
        "not the shape of the moon at this phase: misfit {misfit:.1f}, {limit:.1f} allowed", _NO_MOON
    ),
    moon_poor_fit=Message("residuals {residual:.3f} of the moon's level, sigma {sigma_px:.2f} px", _NO_MOON),
    # by what is known beside the image
    sun_elsewhere=Message(
        "not where it should be", "The sun is in the frame, away from its predicted pixel; a pose change is considered."
    ),
    rows_repeated=Message(
        "the disc is that of the image of {time}, pixel by pixel: lost packets were replaced by those of another frame",
        "Rejected.",
        "look at the network, so that no packet has to be sent again, and at the camera's firmware",
    ),
    frame_repeated=Message(
        "the camera delivered the image of {time} again", "Rejected.", "see the condition `camera_frozen`"
    ),
    file_unreadable=Message("{error}", "The file is not an image."),
)

_JOINED_BEFORE = {"saturated_left_out": ", "}
_JOINED_AFTER = {"bracket_covered": ": ", "sun_elsewhere": ": "}


def reason_of(findings: Iterable[Finding], messages: Messages = MESSAGES) -> str:
    """Return the findings of one detection in a sentence, by the messages of their codes."""
    text, after = "", ""
    for finding in findings:
        text += (text and _JOINED_BEFORE.get(finding.code, after)) + messages.text_of(finding)
        after = _JOINED_AFTER.get(finding.code, "; ")
    return text
