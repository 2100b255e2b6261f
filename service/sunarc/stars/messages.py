"""The messages of a camera by the stars alone."""

from __future__ import annotations

from sunarc.common.findings import Message, Messages

_NO_CAMERA = "The stars give no camera."

MESSAGES = Messages(
    blind_found=Message(
        "a camera by the stars alone: {n} stars in {images} images (the next best camera: {rival}), tilted by "
        "{tilt_deg:.1f}°; an error of the clock turns north by {north_deg_per_minute:.2f}° per minute",
        "The camera is used. Stars cannot distinguish an error of the clock from a rotation about the pole.",
    ),
    blind_by_pattern=Message(
        "the camera is that of the pattern of bright stars in one image (by chance: 10^{log10_chance:.0f})",
        "The camera is used.",
    ),
    blind_no_pattern=Message(
        "no camera matches the bright stars with the {n} detections of one image better than chance would (10^"
        "{log10_chance:.0f} expected, at most 10^{limit:.0f})",
        _NO_CAMERA,
        "check time, time zone, latitude and longitude; give a clearer image, or several an hour or more apart",
    ),
    blind_pattern_not_named=Message(
        "a camera matches the bright stars of one image (by chance: 10^{log10_chance:.0f}), but not all of the sky",
        _NO_CAMERA,
        "give several images of the night, an hour or more apart",
    ),
    blind_few_images=Message(
        "{n} images with stars, between which the sky turned by {turn_deg:.0f}°; 2 images and {limit:.0f}° are needed",
        _NO_CAMERA,
        "give images of one clear night, an hour or more apart",
    ),
    blind_no_turning=Message(
        "no rotation about the celestial pole maps the detections of one image onto those of another: for the best one "
        "{share:.2f} of them agree ({limit:.2f} needed)",
        _NO_CAMERA,
        "give images of a clear night; check their times and the latitude; crop what is outside the image circle",
    ),
    blind_no_stars=Message(
        "{share:.2f} of the detections rotate about a pole, and no camera with this pole matches them with stars",
        _NO_CAMERA,
        "check the date, the latitude and the longitude",
    ),
    blind_ambiguous=Message(
        "two cameras match the detections with stars: {n} and {rival} of them",
        _NO_CAMERA,
        "give more images, or clearer ones",
    ),
    blind_tilted=Message(
        "the camera is tilted by {tilt_deg:.1f}°, {limit:.0f}° allowed: the clock, its zone or the longitude is wrong, "
        "or the camera lies on its side",
        _NO_CAMERA,
        "check --utc-offset and the longitude (east is positive)",
    ),
)
